//! Fuser stage `levelling`: S4 as published, aided and autonomous, with automatic switching.

use super::{
    limits::{interval_s, plausible_fix},
    platform::{Law, LevelUpdate, Platform},
    speed::GroundSpeed,
};
use crate::{
    Vector3,
    course::CourseReference,
    fuser::{
        bias_handover::HandedOverBias,
        estimate::Estimate,
        finite::fuser_items,
        fused::{Corrections, Fused},
        input::FuserInput,
    },
    parameters::{parameters_of, settings},
    scalars::visit_fields,
    stage::Stage,
};
use core::f64::consts::PI;

settings! {
    /// Settings of `levelling`.
    pub struct LevellingSettings {
        /// Time constant of levelling with satellite velocity, 1/(K g). A shorter one reduces the
        /// effect of the gyro bias but passes more noise.
        time_constant_s: 5.0 in 1.0 .. 1000.0, "s";
        /// Time constant of levelling without GNSS velocity.
        autonomous_time_constant_s: 60.0 in 1.0 .. 10000.0, "s";
        /// Low-pass time constant of the specific force without GNSS velocity.
        low_pass_s: 20.0 in 0.0 .. 1000.0, "s";
        /// Time without a fix after which levelling becomes autonomous.
        gap_s: 1.5 in 0.1 .. 60.0, "s";
    }
}

/// Fuser stage `levelling`: platform levelling as published in S4.
///
/// The heading is free: it follows the gyro from an arbitrary initial direction.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Levelling {
    settings: LevellingSettings,
    platform: Platform,
    speed: GroundSpeed,
    bias_handover: HandedOverBias,
}

impl Levelling {
    pub(in crate::fuser) fn realign(&mut self) {
        self.platform.realign();
    }

    /// Returns the levelling law for this tick: aided if the speed is recent, else autonomous.
    fn law(&self) -> Law {
        if self.speed.is_recent(self.settings.gap_s) {
            Law::Aided {
                speed_m_s: self.speed.speed_m_s(),
                speed_rate_m_s2: self.speed.rate_m_s2(),
                time_constant_s: self.settings.time_constant_s,
            }
        } else {
            Law::Autonomous { time_constant_s: self.settings.autonomous_time_constant_s }
        }
    }

    fn fuse(&mut self, input: &FuserInput) -> Fused {
        let mut corrections = Corrections::default();
        let dt_s = interval_s(input.motion.as_ref());
        let rate_rad_s = input.motion.map_or(Vector3::zeros(), |motion| motion.rate_rad_s);
        self.platform.rotate(input.motion.as_ref(), dt_s);
        self.bias_handover.observe(input);
        self.speed.advance(dt_s);
        if let Some(fix) = plausible_fix(input.fix.as_ref()) {
            self.speed.record_fix(fix, self.settings.gap_s);
            corrections.velocity = true;
        }
        let mut innovation = 0.0;
        if let Some(inclination) = &input.inclination {
            match self.platform.update(inclination, rate_rad_s, self.law(), self.settings.low_pass_s) {
                LevelUpdate::Set => corrections.aligned = true,
                LevelUpdate::Moved { innovation_rad } => {
                    innovation = innovation_rad;
                    corrections.tilt = true;
                }
            }
        }
        self.speed.end_tick(dt_s);
        Fused {
            attitude: self.platform.attitude,
            rate_rad_s,
            bias_rad_s: Vector3::zeros(),
            innovation_rad: innovation,
            inclination_sd_rad: self.platform.inclination_sd_rad(),
            heading_sd_rad: PI,
            reference: CourseReference::Arbitrary,
            corrections,
        }
    }

    fn continue_from(&mut self, common: &Estimate) {
        self.platform.adopt(common.attitude, self.settings.low_pass_s);
        self.bias_handover = HandedOverBias::from_estimate(common);
    }
}

impl Stage for Levelling {
    fuser_items!();

    fn name(&self) -> &'static str {
        "levelling"
    }

    parameters_of!(LevellingSettings in settings);

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        visit_fields!(self, visit: platform, speed, bias_handover; without settings);
    }

    fn validation_error(&self) -> Option<&'static str> {
        self.platform
            .validation_error()
            .or_else(|| self.speed.validation_error())
            .or_else(|| self.bias_handover.validation_error())
    }

    fn common(&self) -> Estimate {
        Estimate {
            attitude: self.platform.attitude,
            inclination_sd_rad: self.platform.inclination_sd_rad(),
            ..self.bias_handover.sensor_errors()
        }
    }
}
