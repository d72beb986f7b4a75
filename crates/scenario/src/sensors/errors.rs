//! What is wrong with the sensors, and what there is to be sensed besides rate and force.

use attitude::{GRAVITY_M_S2, Vector3};

const DEGREE_RAD: f64 = core::f64::consts::PI / 180.0;

/// What is wrong with the sensors. A constant error is the same on each axis, or has a sign of its own there.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Errors {
    /// Constant gyro bias on each axis, rad/s.
    pub gyro_bias_rad_s: f64,
    /// White noise of the accelerometer on each axis and sample, standard deviation, m/s².
    pub accel_noise_m_s2: f64,
    /// Every constant error has a sign on each axis that the seed draws.
    pub random_signs: bool,
    /// Forces and fields have no noise in the first reading, so that a filter that begins with it begins with the truth.
    pub exact_start: bool,
    /// White noise of the gyro on each axis and sample, standard deviation, rad/s.
    pub gyro_noise_rad_s: f64,
    /// Growth of the gyro bias on each axis, rad/s².
    pub gyro_bias_ramp_rad_s2: f64,
    /// Scale error of the gyro on each axis, dimensionless.
    pub gyro_scale: f64,
    /// Latitude at which the gyro feels the earth turn, rad; `None` where it does not. The attitude is against the earth.
    pub earth_latitude_rad: Option<f64>,
    /// Constant accelerometer bias on each axis, m/s².
    pub accel_bias_m_s2: f64,
    /// The magnetic field, where there is a magnetometer.
    pub field: Option<Field>,
    /// The satellite receiver, where there is one.
    pub receiver: Option<Receiver>,
}

/// A magnetic field and its sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Field {
    /// The field, µT, reference axes.
    pub reference_ut: Vector3<f64>,
    /// White noise on each axis and sample, standard deviation, µT.
    pub noise_ut: f64,
}

/// A satellite receiver that tells its velocity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Receiver {
    /// Time between fixes, s.
    pub interval_s: f64,
    /// How late they arrive, s; it does not say so.
    pub latency_s: f64,
    /// White noise on each axis and fix, standard deviation, m/s.
    pub noise_m_s: f64,
    /// From the sensors to its antenna, whose velocity it tells, m, body axes.
    pub antenna_m: Vector3<f64>,
    /// When there are fixes.
    pub coverage: Coverage,
    /// The latitude that it tells, rad.
    pub latitude_rad: Option<f64>,
}

/// When a receiver has fixes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Coverage {
    /// All the time.
    #[default]
    Always,
    /// Not in the 60 s from 300 s on, and again every 240 s.
    Gaps,
    /// In the first ten minutes alone.
    Start,
    /// Not once.
    Never,
}

impl Coverage {
    /// All of them, by name.
    pub const NAMED: [(&'static str, Self); 4] =
        [("always", Self::Always), ("gaps", Self::Gaps), ("start", Self::Start), ("never", Self::Never)];

    /// Whether a fix arrives at `t_s`.
    pub fn covers(self, t_s: f64) -> bool {
        match self {
            Self::Always => true,
            Self::Gaps => t_s < 300.0 || (t_s - 300.0) % 240.0 >= 60.0,
            Self::Start => t_s < 600.0,
            Self::Never => false,
        }
    }
}

impl Errors {
    /// Those of the reference scenario of Matveev 2025: 0.1 °/s, 0.01 g.
    pub const S1: Self =
        Self { gyro_bias_rad_s: 0.1 * DEGREE_RAD, accel_noise_m_s2: 0.01 * GRAVITY_M_S2, ..Self::NONE };

    /// None.
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
        field: None,
        receiver: None,
    };

    /// Those of S3: gyro 1 °/s, directions of gravity and field 0.03 on each axis.
    pub fn s3() -> Self {
        let reference_ut = Vector3::from(crate::s3::FIELD_UT);
        Self {
            gyro_noise_rad_s: DEGREE_RAD,
            accel_noise_m_s2: 0.03 * GRAVITY_M_S2,
            field: Some(Field { reference_ut, noise_ut: 0.03 * reference_ut.norm() }),
            exact_start: true,
            ..Self::NONE
        }
    }

    /// Of a low-grade MEMS sensor at 100 Hz with a receiver of 10 Hz: gyro ±0.05 °/s and 0.05 °/s rms, accelerometer ±0.02 m/s² and
    /// 0.02 m/s² rms, velocity 0.05 m/s rms on each axis, 0.2 s late.
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

    /// The same with a gyro scale error of ±1 %, a bias that grows by ±0.03 °/s in 30 min, the earth's rate at 50° north, and a
    /// velocity of 0.15 m/s rms, 0.25 s late.
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

    /// The noise of gyro and accelerometer at another sampling rate, its density the same: of a sensor that averages.
    pub fn resampled(self, from_hz: f64, to_hz: f64) -> Self {
        let factor = libm::sqrt(to_hz / from_hz);
        Self {
            gyro_noise_rad_s: self.gyro_noise_rad_s * factor,
            accel_noise_m_s2: self.accel_noise_m_s2 * factor,
            ..self
        }
    }
}
