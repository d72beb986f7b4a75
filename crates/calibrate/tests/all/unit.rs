//! Simulated sensor unit: a body turned by hand, and sensors with seeded random errors and noise.
use attitude::{GRAVITY_M_S2, Matrix3, Quaternion, Vector3, calibration::Calibration};
use calibrate::Sample;
use rand_chacha::{
    ChaCha8Rng,
    rand_core::{Rng, SeedableRng},
};

/// Local magnetic field (east, north, up), µT.
pub(crate) const FIELD_UT: [f64; 3] = [0.0, 20.0, -44.0];

/// Source of random numbers.
pub(crate) struct Noise(ChaCha8Rng);

impl Noise {
    pub(crate) fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    pub(crate) fn unit(&mut self) -> f64 {
        ((self.0.next_u64() >> 11) as f64 + 0.5) / (1u64 << 53) as f64
    }

    pub(crate) fn within(&mut self, size: f64) -> f64 {
        size * (2.0 * self.unit() - 1.0)
    }

    pub(crate) fn normal(&mut self) -> f64 {
        let (first, second) = (self.unit(), self.unit());
        (-2.0 * first.ln()).sqrt() * (std::f64::consts::TAU * second).cos()
    }

    pub(crate) fn vector_within(&mut self, size: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.within(size))
    }

    pub(crate) fn normals(&mut self, sd: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| sd * self.normal())
    }

    /// Returns a direction, uniform on the sphere.
    pub(crate) fn direction(&mut self) -> Vector3<f64> {
        self.normals(1.0).normalize()
    }

    /// Returns a symmetric matrix near the identity.
    pub(crate) fn symmetric(&mut self, scale: f64, cross: f64) -> Matrix3<f64> {
        let [xy, xz, yz] = [0; 3].map(|_| self.within(cross));
        let [x, y, z] = [0; 3].map(|_| 1.0 + self.within(scale));
        Matrix3::new(x, xy, xz, xy, y, yz, xz, yz, z)
    }
}

/// Sensor errors. A raw reading is M⁻¹ v + b for the true vector v, a matrix M (`accel` or
/// `soft_iron`) and a bias b, so that M (raw − b) restores v.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Errors {
    pub(crate) gyro_bias_rad_s: Vector3<f64>,
    pub(crate) accel_bias_m_s2: Vector3<f64>,
    pub(crate) accel: Matrix3<f64>,
    pub(crate) hard_iron_ut: Vector3<f64>,
    pub(crate) soft_iron: Matrix3<f64>,
    /// Magnetometer delay, s.
    pub(crate) delay_s: f64,
}

impl Errors {
    pub(crate) const NONE: Self = Self {
        gyro_bias_rad_s: Vector3::new(0.0, 0.0, 0.0),
        accel_bias_m_s2: Vector3::new(0.0, 0.0, 0.0),
        accel: Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        hard_iron_ut: Vector3::new(0.0, 0.0, 0.0),
        soft_iron: Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        delay_s: 0.0,
    };

    /// Returns the raw reading that this unit would report for the exact reading `sample`.
    pub(crate) fn distort(&self, sample: &Sample) -> Sample {
        let raw = |matrix: &Matrix3<f64>, exact: Vector3<f64>, bias: Vector3<f64>| {
            matrix.try_inverse().unwrap() * exact + bias
        };
        Sample {
            t_ns: sample.t_ns,
            rate_rad_s: sample.rate_rad_s + self.gyro_bias_rad_s,
            force_m_s2: raw(&self.accel, sample.force_m_s2, self.accel_bias_m_s2),
            field_ut: sample.field_ut.map(|field_ut| raw(&self.soft_iron, field_ut, self.hard_iron_ut)),
        }
    }

    pub(crate) fn accel(&self) -> Calibration {
        Calibration::new(self.accel_bias_m_s2, self.accel).unwrap()
    }
}

/// Standard deviation of the white noise of one reading.
#[derive(Debug, Clone, Copy)]
pub(crate) struct NoiseSd {
    pub(crate) gyro_rad_s: f64,
    pub(crate) accel_m_s2: f64,
    pub(crate) mag_ut: f64,
}

/// Noise of a consumer MEMS unit.
pub(crate) const MEMS: NoiseSd = NoiseSd { gyro_rad_s: 0.003, accel_m_s2: 0.03, mag_ut: 0.4 };

/// Sensor unit on a body with a given motion.
pub(crate) struct Unit {
    pub(crate) rate_hz: f64,
    pub(crate) errors: Errors,
    pub(crate) noise: NoiseSd,
    pub(crate) seed: u64,
}

impl Unit {
    pub(crate) fn new(errors: Errors, seed: u64) -> Self {
        Self { rate_hz: 100.0, errors, noise: MEMS, seed }
    }

    /// Returns readings while the body moves from pose to pose (body → earth). It spends `rest_s`
    /// in each pose and moves for `move_s` between poses.
    pub(crate) fn readings_in_poses(&self, poses: &[Quaternion<f64>], rest_s: f64, move_s: f64) -> Vec<Sample> {
        let period_s = rest_s + move_s;
        let rotations: Vec<_> = poses.windows(2).map(|pair| scaled_axis(pair[0].conjugate() * pair[1])).collect();
        let duration_s = period_s * rotations.len() as f64 + rest_s;
        self.readings_along(duration_s, |t_s| {
            let index = ((t_s / period_s) as usize).min(poses.len() - 1);
            let since_s = t_s - index as f64 * period_s - rest_s;
            let (Some(rotation), true) = (rotations.get(index), since_s > 0.0) else { return poses[index] };
            let share = since_s / move_s;
            // This polynomial makes the rotation start and end smoothly.
            poses[index] * exp(*rotation * (share * share * (3.0 - 2.0 * share)))
        })
    }

    /// Returns readings for an orientation given as a function of time, s.
    pub(crate) fn readings_along(&self, duration_s: f64, pose: impl Fn(f64) -> Quaternion<f64>) -> Vec<Sample> {
        let mut noise = Noise::new(self.seed);
        let dt_s = self.rate_hz.recip();
        let to_body = |pose: Quaternion<f64>, earth: Vector3<f64>| rotated(pose.conjugate(), earth);
        (1..(duration_s * self.rate_hz) as i64)
            .map(|i| {
                let t_s = i as f64 * dt_s;
                let (before, now, delayed) = (pose(t_s - dt_s), pose(t_s), pose(t_s - self.errors.delay_s));
                let exact = Sample {
                    t_ns: (t_s * 1e9).round() as i64,
                    // The rate is the mean over the interval.
                    rate_rad_s: scaled_axis(before.conjugate() * now) / dt_s,
                    force_m_s2: to_body(now, Vector3::z() * GRAVITY_M_S2),
                    field_ut: Some(to_body(delayed, FIELD_UT.into())),
                };
                let raw = self.errors.distort(&exact);
                Sample {
                    t_ns: raw.t_ns,
                    rate_rad_s: raw.rate_rad_s + noise.normals(self.noise.gyro_rad_s),
                    force_m_s2: raw.force_m_s2 + noise.normals(self.noise.accel_m_s2),
                    field_ut: raw.field_ut.map(|field_ut| field_ut + noise.normals(self.noise.mag_ut)),
                }
            })
            .collect()
    }
}

/// Returns a rotation about the axis `rotation`. The length of this vector is the angle, rad.
pub(crate) fn exp(rotation: Vector3<f64>) -> Quaternion<f64> {
    let half = 0.5 * rotation.norm();
    let along = if half > 1e-12 { rotation * (half.sin() / (2.0 * half)) } else { rotation * 0.5 };
    Quaternion::new(half.cos(), along.x, along.y, along.z)
}

fn scaled_axis(q: Quaternion<f64>) -> Vector3<f64> {
    let q = if q.w < 0.0 { -q } else { q };
    let axis = Vector3::new(q.i, q.j, q.k);
    let sin = axis.norm();
    if sin < 1e-12 { axis * 2.0 } else { axis * (2.0 * sin.atan2(q.w) / sin) }
}

pub(crate) fn rotated(q: Quaternion<f64>, v: Vector3<f64>) -> Vector3<f64> {
    let turned = q * Quaternion::new(0.0, v.x, v.y, v.z) * q.conjugate();
    Vector3::new(turned.i, turned.j, turned.k)
}

/// Returns a pose in which the body direction `up` points up.
pub(crate) fn with_up(up: Vector3<f64>) -> Quaternion<f64> {
    let (up, zeta) = (up.normalize(), Vector3::z());
    let axis = up.cross(&zeta);
    let angle = axis.norm().atan2(up.dot(&zeta));
    if axis.norm() < 1e-9 {
        return if angle < 1.0 { Quaternion::new(1.0, 0.0, 0.0, 0.0) } else { Quaternion::new(0.0, 1.0, 0.0, 0.0) };
    }
    exp(axis.normalize() * angle)
}

/// Returns poses with each of the six sides up in turn.
pub(crate) fn six_sides() -> Vec<Quaternion<f64>> {
    let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
    axes.iter().flat_map(|axis| [*axis, -*axis]).map(with_up).collect()
}
