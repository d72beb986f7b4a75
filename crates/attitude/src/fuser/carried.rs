//! The gyro's bias for the stage that comes after: as the stage before handed it over, or as the gyro reads at rest. Kept by every stage that
//! does not estimate it, or finds it less often.

use super::{
    estimate::{BIAS_WALK_RAD_S, Estimate},
    gyro_scale::GyroScale,
    hard_iron::HardIron,
    input::FuserInput,
    rest::{Rest, SD_REST_RAD_S},
};
use crate::{Vector3, accel::Inclination, numbers::Numbers, stage::bias_flaw};

/// More than an accelerometer measures, m/s², and than a body turns, rad/s.
const FORCE_MAX_M_S2: f64 = 3000.0;
const RATE_MAX_RAD_S: f64 = 1e3;
/// Speed over ground at which a body may be at rest, m/s.
const STANDING_M_S: f64 = 0.7;
/// Interval at which rest is looked for, s; less a little, for sums of intervals that are rounded.
const INTERVAL_S: f64 = 0.2 - 1e-6;

/// The bias as it was known last, and how old that is.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Carried {
    bias_rad_s: Vector3<f64>,
    sd_rad_s: f64,
    age_s: f64,
    known: bool,
    gyro_scale: GyroScale,
    hard_iron: HardIron,
    /// A receiver told so last: a smooth ride looks like rest.
    rides: bool,
    rest: Rest,
    /// Since rest was looked for, s.
    since_s: f64,
}

impl Carried {
    /// Of a giver that knows a bias, or of one that does not. Gyro scale and hard iron are handed on as they came.
    pub(super) fn of(common: &Estimate) -> Self {
        let nothing = Self { gyro_scale: common.gyro_scale, hard_iron: common.hard_iron, ..Self::default() };
        if common.bias_sd_rad_s.is_infinite() {
            return nothing;
        }
        Self { bias_rad_s: common.bias_rad_s, sd_rad_s: common.bias_sd_rad_s, known: true, ..nothing }
    }

    /// One sample: time passes, and at rest the gyro reads its bias.
    pub(super) fn observe(&mut self, input: &FuserInput) {
        let Some(motion) = &input.motion else { return };
        self.age_s += motion.dt_s;
        self.since_s += motion.dt_s;
        if let Some(fix) = &input.fix {
            self.rides = fix.velocity_m_s.norm() > STANDING_M_S;
        }
        let at_most = |inclination: &&Inclination| {
            inclination.norm_m_s2 <= FORCE_MAX_M_S2 && motion.rate_rad_s.amax() <= RATE_MAX_RAD_S
        };
        let inclination = input.inclination.as_ref().filter(at_most);
        let (Some(inclination), true, false) = (inclination, input.rest_credible, self.rides) else {
            self.rest.interrupt();
            return;
        };
        self.rest.observe(motion.rate_rad_s, motion.dt_s);
        if self.since_s < INTERVAL_S {
            return;
        }
        self.rest.update(inclination.force_m_s2, core::mem::take(&mut self.since_s));
        if let Some(bias_rad_s) = self.rest.bias_rad_s() {
            (self.bias_rad_s, self.sd_rad_s, self.age_s, self.known) = (bias_rad_s, SD_REST_RAD_S, 0.0, true);
        }
    }

    /// The bias and the standard deviation of each component, rad/s; infinite where nobody found one.
    pub(super) fn bias(&self) -> (Vector3<f64>, f64) {
        let sd_rad_s = libm::hypot(self.sd_rad_s, BIAS_WALK_RAD_S * libm::sqrt(self.age_s));
        (self.bias_rad_s, if self.known { sd_rad_s } else { f64::INFINITY })
    }

    /// The same, or what the stage itself found, whichever is known better.
    pub(super) fn or(&self, own_rad_s: Vector3<f64>, own_sd_rad_s: f64) -> (Vector3<f64>, f64) {
        let (bias_rad_s, sd_rad_s) = self.bias();
        if own_sd_rad_s <= sd_rad_s { (own_rad_s, own_sd_rad_s) } else { (bias_rad_s, sd_rad_s) }
    }

    pub(super) fn gyro_scale(&self) -> GyroScale {
        self.gyro_scale
    }

    pub(super) fn hard_iron(&self) -> HardIron {
        self.hard_iron
    }

    /// What is wrong with the state.
    pub(super) fn flaw(&self) -> Option<&'static str> {
        let negative = self.sd_rad_s < 0.0 || self.age_s < 0.0 || self.since_s < 0.0;
        let negative = negative.then_some("an age or standard deviation below zero");
        bias_flaw(self.bias_rad_s)
            .or(negative)
            .or_else(|| self.rest.flaw())
            .or_else(|| self.gyro_scale.flaw())
            .or_else(|| self.hard_iron.flaw())
    }
}

impl Numbers for Carried {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.bias_rad_s.visit(visit);
        self.sd_rad_s.visit(visit);
        self.age_s.visit(visit);
        self.known.visit(visit);
        self.gyro_scale.visit(visit);
        self.hard_iron.visit(visit);
        self.rides.visit(visit);
        self.rest.visit(visit);
        self.since_s.visit(visit);
    }
}
