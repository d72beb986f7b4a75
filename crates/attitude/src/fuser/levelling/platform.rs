//! One platform: an attitude that a law of levelling acts on.

use super::{
    geometry::{azimuth, carried, lean_of, tilt_of, turn_rate_rad_s},
    limits::FLOOR_RAD,
    pull::Pull,
};
use crate::{
    Complex, Vector3,
    accel::Inclination,
    fuser::{
        fused::innovation_rad,
        low_pass::{averaging_gain, low_pass_gain},
    },
    gyro::Motion,
    numbers::Numbers,
    stage::attitude_flaw,
    state::Attitude,
};

/// What acts on a platform: S4, (3), (4), or the low-passed force alone.
#[derive(Debug, Clone, Copy)]
pub(super) enum Law {
    /// Less the motion that a receiver tells.
    Aided {
        /// V, m/s.
        speed_m_s: f64,
        /// V', m/s².
        along_m_s2: f64,
        /// 1/(K g), s.
        time_constant_s: f64,
    },
    /// By the low-passed force.
    Autonomous {
        /// 1/(K g), s.
        time_constant_s: f64,
    },
}

/// What an inclination did to a platform.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Levelled {
    /// It set the level, the first time.
    Set,
    /// It moved the level, which was so far off, rad.
    Moved { innovation_rad: f64 },
}

/// A platform and its low-pass.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Platform {
    pub(super) attitude: Attitude,
    pub(super) started: bool,
    /// Time since the last force, s.
    unlevelled_s: f64,
    /// The low-passed f_P, platform, m/s².
    low_pass_m_s2: Complex<f64>,
    /// How much less than its time constant the low-pass has averaged, s.
    unaveraged_s: f64,
    /// What levelling took for tilt, low-passed over its own time constant, platform, rad.
    lag_rad: Complex<f64>,
}

impl Platform {
    /// The next inclination sets the level.
    pub(super) fn realign(&mut self) {
        self.started = false;
        self.low_pass_m_s2 = Complex::new(0.0, 0.0);
        self.unaveraged_s = 0.0;
        self.lag_rad = Complex::new(0.0, 0.0);
    }

    /// Goes on with an attitude that somebody else kept.
    pub(super) fn adopt(&mut self, attitude: Attitude, low_pass_s: f64) {
        self.realign();
        self.attitude = attitude;
        self.started = true;
        // The giver's level lags by what it lags by: what is left of the force then is not zero.
        self.unaveraged_s = low_pass_s;
    }

    /// Follows the gyro over one interval.
    pub(super) fn turn(&mut self, motion: Option<&Motion>, dt_s: f64) {
        if let Some(motion) = motion {
            self.attitude = self.attitude.turned(motion.turn).attitude;
        }
        self.unlevelled_s += dt_s;
    }

    /// Takes one inclination, by a law and with the low-pass over `low_pass_s`.
    pub(super) fn see(
        &mut self,
        inclination: &Inclination,
        rate_rad_s: Vector3<f64>,
        law: Law,
        low_pass_s: f64,
    ) -> Levelled {
        let levelled = if self.started {
            let innovation_rad = innovation_rad(inclination, self.attitude);
            let pull = Pull::of(self.attitude, inclination, self.unlevelled_s);
            self.level(pull, turn_rate_rad_s(self.attitude, rate_rad_s), law, low_pass_s);
            Levelled::Moved { innovation_rad }
        } else {
            self.attitude = self.attitude.realigned(inclination.up).attitude;
            self.started = true;
            Levelled::Set
        };
        self.unlevelled_s = 0.0;
        levelled
    }

    /// One move of the level towards what the force and the speed say.
    fn level(&mut self, pull: Pull, turn_rate_rad_s: f64, law: Law, low_pass_s: f64) {
        let Pull { level_m_s2, dt_s } = pull;
        let azimuth = azimuth(self.attitude);
        let gain = averaging_gain(dt_s, low_pass_s, &mut self.unaveraged_s);
        self.low_pass_m_s2 += (azimuth * level_m_s2 - self.low_pass_m_s2) * gain;
        let (unexplained_m_s2, time_constant_s) = match law {
            Law::Aided { speed_m_s, along_m_s2, time_constant_s } => {
                let motion_m_s2 = carried(self.attitude, speed_m_s * turn_rate_rad_s, along_m_s2);
                (level_m_s2 - motion_m_s2, time_constant_s)
            }
            Law::Autonomous { time_constant_s } => (azimuth.conj() * self.low_pass_m_s2, time_constant_s),
        };
        let (tilt_rad, gain) = (tilt_of(unexplained_m_s2), low_pass_gain(dt_s, time_constant_s));
        self.attitude = self.attitude.leaned(lean_of(tilt_rad * gain)).attitude;
        self.lag_rad += (azimuth * tilt_rad - self.lag_rad) * gain;
    }

    /// A loop of first order lags by τ b, and shows that as the tilt it never gets rid of.
    pub(super) fn inclination_sd_rad(&self) -> f64 {
        libm::hypot(FLOOR_RAD, libm::sqrt(self.lag_rad.norm_sqr()))
    }

    /// What is wrong with the state.
    pub(super) fn flaw(&self) -> Option<&'static str> {
        let negative = self.unlevelled_s < 0.0 || self.unaveraged_s < 0.0;
        attitude_flaw(self.attitude).or(negative.then_some("a time below zero"))
    }
}

impl Numbers for Platform {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let Self { attitude, started, unlevelled_s, low_pass_m_s2, unaveraged_s, lag_rad } = self;
        attitude.visit(visit);
        started.visit(visit);
        unlevelled_s.visit(visit);
        low_pass_m_s2.visit(visit);
        unaveraged_s.visit(visit);
        lag_rad.visit(visit);
    }
}
