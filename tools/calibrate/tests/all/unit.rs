//! A simulated sensor unit: a body that is turned by hand, and sensors with errors and noise from a seed.
use attitude::{GRAVITY_M_S2, Matrix3, Quaternion, Vector3, calibration::Calibration};
use calibrate::Sample;
use rand_chacha::{
    ChaCha8Rng,
    rand_core::{Rng, SeedableRng},
};

/// The field of the place, µT, east, north, up.
pub(crate) const FIELD_UT: [f64; 3] = [0.0, 20.0, -44.0];

/// Random numbers.
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

    /// A direction, uniform on the sphere.
    pub(crate) fn direction(&mut self) -> Vector3<f64> {
        self.normals(1.0).normalize()
    }

    /// A symmetric matrix near one.
    pub(crate) fn symmetric(&mut self, scale: f64, cross: f64) -> Matrix3<f64> {
        let [xy, xz, yz] = [0; 3].map(|_| self.within(cross));
        let [x, y, z] = [0; 3].map(|_| 1.0 + self.within(scale));
        Matrix3::new(x, xy, xz, xy, y, yz, xz, yz, z)
    }
}

/// What is wrong with the sensors: a raw reading is M⁻¹ true + bias, so that M (raw − bias) is the truth.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Errors {
    pub(crate) gyro_bias_rad_s: Vector3<f64>,
    pub(crate) accel_bias_m_s2: Vector3<f64>,
    pub(crate) accel: Matrix3<f64>,
    pub(crate) hard_iron_ut: Vector3<f64>,
    pub(crate) soft_iron: Matrix3<f64>,
    /// The magnetometer is so late.
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

    /// The raw reading of an exact one.
    pub(crate) fn spoil(&self, sample: &Sample) -> Sample {
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

/// White noise of one reading.
#[derive(Debug, Clone, Copy)]
pub(crate) struct NoiseSd {
    pub(crate) gyro_rad_s: f64,
    pub(crate) accel_m_s2: f64,
    pub(crate) mag_ut: f64,
}

/// Of a consumer MEMS unit.
pub(crate) const MEMS: NoiseSd = NoiseSd { gyro_rad_s: 0.003, accel_m_s2: 0.03, mag_ut: 0.4 };

/// A body whose orientation is given at every moment, and the readings of the unit on it.
pub(crate) struct Unit {
    pub(crate) rate_hz: f64,
    pub(crate) errors: Errors,
    pub(crate) noise: NoiseSd,
    pub(crate) seed: u64,
}

impl Unit {
    pub(crate) fn of(errors: Errors, seed: u64) -> Self {
        Self { rate_hz: 100.0, errors, noise: MEMS, seed }
    }

    /// Readings while the body goes through poses (body → earth): it rests in each for `rest_s` and turns to the next in `turn_s`.
    pub(crate) fn through(&self, poses: &[Quaternion<f64>], rest_s: f64, turn_s: f64) -> Vec<Sample> {
        let leg_s = rest_s + turn_s;
        let turns: Vec<_> = poses.windows(2).map(|pair| scaled_axis(pair[0].conjugate() * pair[1])).collect();
        let whole_s = leg_s * turns.len() as f64 + rest_s;
        self.along(whole_s, |t_s| {
            let leg = ((t_s / leg_s) as usize).min(poses.len() - 1);
            let since_s = t_s - leg as f64 * leg_s - rest_s;
            let (Some(turn), true) = (turns.get(leg), since_s > 0.0) else { return poses[leg] };
            let share = since_s / turn_s;
            // Without a jerk at both ends.
            poses[leg] * exp(*turn * (share * share * (3.0 - 2.0 * share)))
        })
    }

    /// Readings while the body has these orientations.
    pub(crate) fn along(&self, whole_s: f64, pose: impl Fn(f64) -> Quaternion<f64>) -> Vec<Sample> {
        let mut noise = Noise::new(self.seed);
        let dt_s = self.rate_hz.recip();
        let into = |pose: Quaternion<f64>, earth: Vector3<f64>| rotated(pose.conjugate(), earth);
        (1..(whole_s * self.rate_hz) as i64)
            .map(|i| {
                let t_s = i as f64 * dt_s;
                let (before, now, late) = (pose(t_s - dt_s), pose(t_s), pose(t_s - self.errors.delay_s));
                let exact = Sample {
                    t_ns: (t_s * 1e9).round() as i64,
                    // The mean over the interval.
                    rate_rad_s: scaled_axis(before.conjugate() * now) / dt_s,
                    force_m_s2: into(now, Vector3::z() * GRAVITY_M_S2),
                    field_ut: Some(into(late, FIELD_UT.into())),
                };
                let raw = self.errors.spoil(&exact);
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

/// A turn by a vector along its axis, as long as its angle.
pub(crate) fn exp(turn: Vector3<f64>) -> Quaternion<f64> {
    let half = 0.5 * turn.norm();
    let along = if half > 1e-12 { turn * (half.sin() / (2.0 * half)) } else { turn * 0.5 };
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

/// A pose in which `up` of the body points up.
pub(crate) fn with_up(up: Vector3<f64>) -> Quaternion<f64> {
    let (up, zeta) = (up.normalize(), Vector3::z());
    let axis = up.cross(&zeta);
    let angle = axis.norm().atan2(up.dot(&zeta));
    if axis.norm() < 1e-9 {
        return if angle < 1.0 { Quaternion::new(1.0, 0.0, 0.0, 0.0) } else { Quaternion::new(0.0, 1.0, 0.0, 0.0) };
    }
    exp(axis.normalize() * angle)
}

/// The six sides up, one after the other.
pub(crate) fn six_sides() -> Vec<Quaternion<f64>> {
    let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
    axes.iter().flat_map(|axis| [*axis, -*axis]).map(with_up).collect()
}
