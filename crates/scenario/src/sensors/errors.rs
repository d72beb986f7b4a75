//! Errors of the simulated sensors, and the optional magnetometer and satellite receiver.

use attitude::{GRAVITY_M_S2, Vector3};

const DEGREE_RAD: f64 = core::f64::consts::PI / 180.0;

/// Errors of the sensors. A constant error has the same size on each axis, optionally with random
/// signs.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SensorErrors {
    /// Constant gyro bias on each axis, rad/s.
    pub gyro_bias_rad_s: f64,
    /// Standard deviation of the accelerometer's white noise on each axis and sample, m/s².
    pub accel_noise_m_s2: f64,
    /// If `true`, every constant error has a random sign on each axis. The seed determines the
    /// signs.
    pub random_signs: bool,
    /// If `true`, the force and the magnetic field of the first reading have no noise. A filter
    /// initialised from them then starts at the true attitude.
    pub exact_start: bool,
    /// Standard deviation of the gyro's white noise on each axis and sample, rad/s.
    pub gyro_noise_rad_s: f64,
    /// Growth rate of the gyro bias on each axis, rad/s².
    pub gyro_bias_ramp_rad_s2: f64,
    /// Scale error of the gyro on each axis, dimensionless.
    pub gyro_scale: f64,
    /// Latitude of the body, rad; `None` for an earth that does not rotate. If set, the gyro also
    /// measures the earth's rotation, while the attitude remains relative to the earth.
    pub earth_latitude_rad: Option<f64>,
    /// Constant accelerometer bias on each axis, m/s².
    pub accel_bias_m_s2: f64,
    /// Magnetometer, if present.
    pub magnetometer: Option<Magnetometer>,
    /// Satellite receiver, if present.
    pub receiver: Option<Receiver>,
}

/// Magnetometer and the magnetic field around it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Magnetometer {
    /// Magnetic field, µT, reference axes.
    pub reference_ut: Vector3<f64>,
    /// Standard deviation of the white noise on each axis and sample, µT.
    pub noise_ut: f64,
}

/// Satellite receiver that reports its velocity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Receiver {
    /// Time between fixes, s.
    pub interval_s: f64,
    /// Latency of the fixes, s. The fixes do not report their latency.
    pub latency_s: f64,
    /// Standard deviation of the white noise on each axis and fix, m/s.
    pub noise_m_s: f64,
    /// Position of the antenna relative to the sensors, m, body axes. The fixes report the velocity
    /// of the antenna.
    pub antenna_m: Vector3<f64>,
    /// Times at which the receiver has fixes.
    pub coverage: Coverage,
    /// Latitude reported in the fixes, rad; `None` if they have no position.
    pub latitude_rad: Option<f64>,
}

/// Times at which a receiver has fixes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Coverage {
    /// Fixes at all times.
    #[default]
    Always,
    /// Fixes at all times except in gaps of 60 s. The first gap starts at 300 s, and the following
    /// ones start every 240 s.
    Gaps,
    /// Fixes during the first ten minutes only.
    Start,
    /// No fixes.
    Never,
}

impl Coverage {
    /// All variants with the names that select them.
    pub const BY_NAME: [(&'static str, Self); 4] =
        [("always", Self::Always), ("gaps", Self::Gaps), ("start", Self::Start), ("never", Self::Never)];

    /// Returns `true` if the receiver delivers a fix that is due at `t_s`.
    pub fn covers(self, t_s: f64) -> bool {
        match self {
            Self::Always => true,
            Self::Gaps => t_s < 300.0 || (t_s - 300.0) % 240.0 >= 60.0,
            Self::Start => t_s < 600.0,
            Self::Never => false,
        }
    }
}

impl SensorErrors {
    /// Errors of the reference scenario of Matveev 2025: gyro bias 0.1 °/s, accelerometer noise
    /// 0.01 g.
    pub const S1: Self =
        Self { gyro_bias_rad_s: 0.1 * DEGREE_RAD, accel_noise_m_s2: 0.01 * GRAVITY_M_S2, ..Self::NONE };

    /// No errors, no magnetometer and no satellite receiver.
    pub const NONE: Self = Self {
        gyro_bias_rad_s: 0.0,
        accel_noise_m_s2: 0.0,
        random_signs: false,
        exact_start: false,
        gyro_noise_rad_s: 0.0,
        gyro_bias_ramp_rad_s2: 0.0,
        gyro_scale: 0.0,
        earth_latitude_rad: None,
        accel_bias_m_s2: 0.0,
        magnetometer: None,
        receiver: None,
    };

    /// Returns the errors of S3. On each axis, the gyro noise is 1 °/s, the force noise 0.03 g, and
    /// the magnetometer noise 0.03 times the strength of the magnetic field.
    pub fn s3() -> Self {
        let reference_ut = Vector3::from(crate::s3::FIELD_UT);
        Self {
            gyro_noise_rad_s: DEGREE_RAD,
            accel_noise_m_s2: 0.03 * GRAVITY_M_S2,
            magnetometer: Some(Magnetometer { reference_ut, noise_ut: 0.03 * reference_ut.norm() }),
            exact_start: true,
            ..Self::NONE
        }
    }

    /// Errors of a low-grade MEMS sensor at 100 Hz with a 10 Hz receiver.
    ///
    /// Gyro: bias ±0.05 °/s, noise 0.05 °/s rms. Accelerometer: bias ±0.02 m/s², noise 0.02 m/s²
    /// rms. Velocity: noise 0.05 m/s rms on each axis, latency 0.2 s.
    pub const CRUISE: Self = Self {
        gyro_bias_rad_s: 0.05 * DEGREE_RAD,
        gyro_noise_rad_s: 0.05 * DEGREE_RAD,
        accel_bias_m_s2: 0.02,
        accel_noise_m_s2: 0.02,
        random_signs: true,
        receiver: Some(Receiver {
            interval_s: 0.1,
            latency_s: 0.2,
            noise_m_s: 0.05,
            antenna_m: Vector3::new(0.0, 0.0, 0.0),
            coverage: Coverage::Always,
            latitude_rad: None,
        }),
        ..Self::NONE
    };

    /// [`CRUISE`](Self::CRUISE) with larger errors.
    ///
    /// Adds a gyro scale error of ±1 %, a gyro bias drift of ±0.03 °/s in 30 min and the earth's
    /// rate at 50° north. The velocity has a noise of 0.15 m/s rms and a latency of 0.25 s.
    pub const CRUISE_HARD: Self = Self {
        gyro_scale: 0.01,
        gyro_bias_ramp_rad_s2: 0.03 * DEGREE_RAD / 1800.0,
        earth_latitude_rad: Some(50.0 * DEGREE_RAD),
        receiver: Some(Receiver {
            interval_s: 0.1,
            latency_s: 0.25,
            noise_m_s: 0.15,
            antenna_m: Vector3::new(0.0, 0.0, 0.0),
            coverage: Coverage::Always,
            latitude_rad: None,
        }),
        ..Self::CRUISE
    };

    /// Scales the noise of gyro and accelerometer from one sampling rate to another.
    ///
    /// The noise density is constant, as for a sensor that averages over the sampling interval.
    pub fn resampled(self, from_hz: f64, to_hz: f64) -> Self {
        let factor = libm::sqrt(to_hz / from_hz);
        Self {
            gyro_noise_rad_s: self.gyro_noise_rad_s * factor,
            accel_noise_m_s2: self.accel_noise_m_s2 * factor,
            ..self
        }
    }
}
