//! Platform: an attitude that is levelled by a control law.

use super::{
    geometry::{azimuth, level_correction, tilt_from_acceleration, turn_rate_rad_s, vehicle_acceleration_m_s2},
    level_force::LevelForce,
    limits::MIN_INCLINATION_SD_RAD,
};
use crate::{
    Complex, Vector3,
    accel::Inclination,
    fuser::{
        fused::innovation_rad,
        low_pass::{averaging_gain, low_pass_gain},
    },
    gyro::Motion,
    scalars::scalars,
    stage::attitude_validation_error,
    state::Attitude,
};

/// Control law of a platform: equations (3) and (4) of S4, or the low-pass filtered force alone.
#[derive(Debug, Clone, Copy)]
pub(super) enum Law {
    /// Force minus the acceleration known from a receiver.
    Aided {
        /// Speed over ground V, m/s.
        speed_m_s: f64,
        /// Derivative V' of the speed, m/s².
        speed_rate_m_s2: f64,
        /// Time constant of levelling, 1/(K g), s.
        time_constant_s: f64,
    },
    /// Low-pass filtered force.
    Autonomous {
        /// Time constant of levelling, 1/(K g), s.
        time_constant_s: f64,
    },
}

/// Effect of an inclination measurement on a platform.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum LevelUpdate {
    /// The measurement initialised the level.
    Set,
    /// The measurement corrected the level.
    Moved {
        /// Error of the level before the correction, rad.
        innovation_rad: f64,
    },
}

/// Platform, and the low-pass filter of the specific force.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Platform {
    pub(super) attitude: Attitude,
    pub(super) started: bool,
    /// Time since the last force, s.
    since_force_s: f64,
    /// Low-pass filtered horizontal force f_P in platform axes, m/s².
    low_pass_m_s2: Complex<f64>,
    /// Time for which the low-pass filter still computes a plain mean, s. After that, the filter
    /// uses its time constant.
    averaging_deficit_s: f64,
    /// Tilt measured by levelling, in platform axes, low-pass filtered over the levelling time
    /// constant, rad.
    ///
    /// Platform axes, rad.
    lag_rad: Complex<f64>,
}

impl Platform {
    /// Lets the next inclination set the level.
    pub(super) fn realign(&mut self) {
        self.started = false;
        self.low_pass_m_s2 = Complex::new(0.0, 0.0);
        self.averaging_deficit_s = 0.0;
        self.lag_rad = Complex::new(0.0, 0.0);
    }

    /// Continues from an attitude that another stage has estimated.
    pub(super) fn adopt(&mut self, attitude: Attitude, low_pass_s: f64) {
        self.realign();
        self.attitude = attitude;
        self.started = true;
        // The previous stage's level may lag. The mean horizontal force is then not zero, so the
        // low-pass filter starts as a plain mean.
        self.averaging_deficit_s = low_pass_s;
    }

    /// Applies the gyro motion of one interval.
    pub(super) fn rotate(&mut self, motion: Option<&Motion>, dt_s: f64) {
        if let Some(motion) = motion {
            self.attitude = self.attitude.rotated(motion.rotation).attitude;
        }
        self.since_force_s += dt_s;
    }

    /// Processes an inclination: initialises the level, or corrects it by one step of the given
    /// law.
    ///
    /// `low_pass_s` is the time constant of the low-pass filter of the force.
    pub(super) fn update(
        &mut self,
        inclination: &Inclination,
        rate_rad_s: Vector3<f64>,
        law: Law,
        low_pass_s: f64,
    ) -> LevelUpdate {
        let update = if self.started {
            let innovation_rad = innovation_rad(inclination, self.attitude);
            let force = LevelForce::new(self.attitude, inclination, self.since_force_s);
            self.apply_force(force, turn_rate_rad_s(self.attitude, rate_rad_s), law, low_pass_s);
            LevelUpdate::Moved { innovation_rad }
        } else {
            self.attitude = self.attitude.realigned(inclination.up).attitude;
            self.started = true;
            LevelUpdate::Set
        };
        self.since_force_s = 0.0;
        update
    }

    /// Corrects the level towards the force minus the known acceleration.
    fn apply_force(&mut self, force: LevelForce, turn_rate_rad_s: f64, law: Law, low_pass_s: f64) {
        let LevelForce { level_m_s2, dt_s } = force;
        let azimuth = azimuth(self.attitude);
        let gain = averaging_gain(dt_s, low_pass_s, &mut self.averaging_deficit_s);
        self.low_pass_m_s2 += (azimuth * level_m_s2 - self.low_pass_m_s2) * gain;
        let (unexplained_m_s2, time_constant_s) = match law {
            Law::Aided { speed_m_s, speed_rate_m_s2, time_constant_s } => {
                let motion_m_s2 =
                    vehicle_acceleration_m_s2(self.attitude, speed_m_s * turn_rate_rad_s, speed_rate_m_s2);
                (level_m_s2 - motion_m_s2, time_constant_s)
            }
            Law::Autonomous { time_constant_s } => (azimuth.conj() * self.low_pass_m_s2, time_constant_s),
        };
        let (tilt_rad, gain) = (tilt_from_acceleration(unexplained_m_s2), low_pass_gain(dt_s, time_constant_s));
        self.attitude = self.attitude.tilted(level_correction(tilt_rad * gain)).attitude;
        self.lag_rad += (azimuth * tilt_rad - self.lag_rad) * gain;
    }

    /// Returns the standard deviation of the inclination, rad.
    ///
    /// Because of a gyro bias b, a first-order loop with the time constant τ lags by τ b. The lag
    /// appears as a tilt that the loop never removes, so the filtered tilt measures it.
    pub(super) fn inclination_sd_rad(&self) -> f64 {
        libm::hypot(MIN_INCLINATION_SD_RAD, libm::sqrt(self.lag_rad.norm_sqr()))
    }

    pub(super) fn validation_error(&self) -> Option<&'static str> {
        let negative = self.since_force_s < 0.0 || self.averaging_deficit_s < 0.0;
        attitude_validation_error(self.attitude).or(negative.then_some("a negative time"))
    }
}

scalars!(Platform: attitude, started, since_force_s, low_pass_m_s2, averaging_deficit_s, lag_rad);
