//! The fuser stage `levelling-unified`: S4's figure 7 as printed, two platforms in parallel and a choice by k.
//!
//! P1 is levelled with the velocity that a receiver tells, P2 by the low-passed force alone; both run all the time, each with its
//! own correction. With k = 1, and k = 0 in a gap of the receiver and before its first fix,
//!
//! roll, pitch = k · P1 + (1 − k) · P2,  course = k · H + (1 − k) · HΓ of P2
//!
//! where H is the complex course: the gyroscopic course HΓ, drawn to the track over ground with T = 50 s — S4, (5),
//!
//! H_k = H_{k−1} + (HΓ_k − HΓ_{k−1}) − h (H_{k−1} − H_track)/T
//!
//! In a gap P1 keeps the last speed with V' = 0. HΓ is counted from wherever its platform began: at each change of k the offset is
//! taken anew, so that the course goes on and only roll and pitch jump, by as much as the platforms are apart. More than 0.03° is
//! told as `aligned`. That jump, and a P2 that carries the gyro's bias for as long as the flight lasts, is what the stages with one
//! attitude do better.

use core::f64::consts::{FRAC_PI_2, PI};

use super::{
    limits::{credible, interval_s},
    platform::{Law, Levelled, Platform},
    speed::Speed,
};
use crate::{
    Vector3,
    course::Reference,
    fuser::{
        carried::Carried,
        estimate::Estimate,
        fused::{Corrections, Fused},
        input::FuserInput,
        leaky_velocity::LeakyVelocity,
    },
    gnss::Fix,
    numbers::Numbers,
    parameters::{Parameter, ParameterError, Parameters, settings},
    stage::{RestoreError, Stage},
    state::{Attitude, wrapped_rad},
};

settings! {
    /// Settings of `levelling-unified`.
    pub struct UnifiedSettings {
        /// Time constant of the platform that is levelled with satellite velocity, 1/(K g).
        time_constant_s: 5.0 in 1.0 .. 1000.0, "s";
        /// Time constant of the platform that is levelled without it.
        autonomous_time_constant_s: 60.0 in 1.0 .. 10000.0, "s";
        /// Low-pass of the specific force of that platform.
        low_pass_s: 20.0 in 0.0 .. 1000.0, "s";
        /// Time after the last fix from which k = 0.
        gap_s: 1.5 in 0.1 .. 60.0, "s";
        /// Time constant T at which the complex course follows the track.
        course_time_constant_s: 50.0 in 1.0 .. 10000.0, "s";
        /// Ground speed below which a track says nothing about the course.
        track_speed_m_s: 3.0 in 0.5 .. 100.0, "m/s";
    }
}

/// A change of the level by more is a jump, rad: 0.03°.
const JUMP_RAD: f64 = 0.03 * PI / 180.0;
/// A nose that is steeper has no course, rad: 80°.
const STEEP_RAD: f64 = FRAC_PI_2 * 80.0 / 90.0;
/// Drift of the gyroscopic course, for the standard deviation, rad/s: 0.05 °/s.
const DRIFT_RAD_S: f64 = 0.05 * PI / 180.0;
/// How far a vehicle's nose is from its track, RMS, rad: 3°.
const CRAB_RAD: f64 = 3.0 * PI / 180.0;

/// The fuser stage `levelling-unified`.
#[derive(Debug, Clone, PartialEq)]
pub struct LevellingUnified {
    settings: UnifiedSettings,
    /// P1 and P2.
    aided: Platform,
    autonomous: Platform,
    speed: Speed,
    /// k.
    is_aided: bool,
    /// From the azimuth of the chosen platform to that of the output, rad.
    offset_rad: f64,
    /// A track has set the course.
    known: bool,
    since_track_s: f64,
    drift_sd_rad: f64,
    carried: Carried,
}

impl Default for LevellingUnified {
    fn default() -> Self {
        Self {
            settings: UnifiedSettings::default(),
            aided: Platform::default(),
            autonomous: Platform::default(),
            speed: Speed::default(),
            is_aided: false,
            offset_rad: 0.0,
            known: false,
            since_track_s: 0.0,
            drift_sd_rad: PI,
            carried: Carried::default(),
        }
    }
}

impl LevellingUnified {
    pub(in crate::fuser) fn realign(&mut self) {
        self.aided.realign();
        self.autonomous.realign();
    }

    fn chosen(&self) -> &Platform {
        if self.is_aided { &self.aided } else { &self.autonomous }
    }

    fn attitude(&self) -> Attitude {
        let Attitude { up, z_rad } = self.chosen().attitude;
        Attitude { up, z_rad: wrapped_rad(z_rad + self.offset_rad) }
    }

    /// Sets k; true where the level jumps with it.
    fn choose(&mut self, is_aided: bool) -> bool {
        if self.is_aided == is_aided {
            return false;
        }
        let before = self.attitude();
        self.is_aided = is_aided;
        // What is left between the two, beside the tilt, is a turn about the vertical.
        let turn = before.quaternion() * self.attitude().quaternion().conjugate();
        self.offset_rad = wrapped_rad(self.offset_rad + 2.0 * libm::atan2(turn.k, turn.w));
        let (one, other) = (before.up.direction(), self.attitude().up.direction());
        one.cross(&other).norm() > JUMP_RAD || one.dot(&other) < 0.0
    }

    /// One step of the complex course towards a track; true where it is the first, which sets it.
    fn follow(&mut self, fix: &Fix) -> bool {
        let angles = self.attitude().angles();
        if fix.speed_m_s() < self.settings.track_speed_m_s || libm::fabs(angles.pitch_rad) > STEEP_RAD {
            return false;
        }
        let interval_s = core::mem::take(&mut self.since_track_s).min(self.settings.gap_s);
        let first = !core::mem::replace(&mut self.known, true);
        let gain = if first { 1.0 } else { -libm::expm1(-interval_s / self.settings.course_time_constant_s) };
        // The course is clockwise, yaw and azimuth are not.
        let off_rad = wrapped_rad(-angles.yaw_rad - fix.track_rad());
        self.offset_rad = wrapped_rad(self.offset_rad + off_rad * gain);
        self.drift_sd_rad -= self.drift_sd_rad * gain;
        first
    }

    fn heading_sd_rad(&self) -> f64 {
        if self.known { libm::hypot(self.drift_sd_rad, CRAB_RAD).min(PI) } else { PI }
    }

    fn reference(&self) -> Reference {
        if self.known { Reference::True } else { Reference::Arbitrary }
    }
}

impl Stage for LevellingUnified {
    type Input = FuserInput;
    type Output = Fused;
    type Common = Estimate;

    fn name(&self) -> &'static str {
        "levelling-unified"
    }

    fn parameters(&self) -> &'static [Parameter] {
        UnifiedSettings::TABLE
    }

    fn set(&mut self, name: &str, value: f64) -> Result<(), ParameterError> {
        self.settings.set(name, value)
    }

    fn step(&mut self, input: &FuserInput) -> Fused {
        let mut room = None;
        let input = input.finite(&mut room);
        let mut corrections = Corrections::default();
        let dt_s = interval_s(input.motion.as_ref());
        let rate_rad_s = input.motion.map_or(Vector3::zeros(), |motion| motion.rate_rad_s);
        self.aided.turn(input.motion.as_ref(), dt_s);
        self.autonomous.turn(input.motion.as_ref(), dt_s);
        self.carried.observe(input);
        self.speed.wait(dt_s);
        self.since_track_s += dt_s;
        self.drift_sd_rad = (self.drift_sd_rad + DRIFT_RAD_S * dt_s).min(PI);
        let fix = credible(input.fix.as_ref());
        if let Some(fix) = fix {
            self.speed.take(fix, self.settings.gap_s);
            corrections.velocity = true;
        }
        let mut innovation = [0.0; 2];
        if let Some(inclination) = &input.inclination {
            let UnifiedSettings { time_constant_s, autonomous_time_constant_s, low_pass_s, .. } = self.settings;
            let (speed_m_s, along_m_s2) = (self.speed.along_m_s(), self.speed.rate_m_s2());
            let laws = [
                Law::Autonomous { time_constant_s: autonomous_time_constant_s },
                Law::Aided { speed_m_s, along_m_s2, time_constant_s },
            ];
            for (which, platform) in [&mut self.autonomous, &mut self.aided].into_iter().enumerate() {
                match platform.see(inclination, rate_rad_s, laws[which], low_pass_s) {
                    Levelled::Set => corrections.aligned = true,
                    Levelled::Moved { innovation_rad } => {
                        innovation[which] = innovation_rad;
                        corrections.tilt = true;
                    }
                }
            }
        }
        self.speed.spend(dt_s);
        corrections.aligned |= self.choose(self.speed.is_told(self.settings.gap_s));
        if let Some(fix) = fix {
            corrections.aligned |= self.follow(fix);
        }
        Fused {
            attitude: self.attitude(),
            rate_rad_s,
            bias_rad_s: Vector3::zeros(),
            innovation_rad: innovation[usize::from(self.is_aided)],
            inclination_sd_rad: self.chosen().inclination_sd_rad(),
            heading_sd_rad: self.heading_sd_rad(),
            reference: self.reference(),
            corrections,
        }
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.aided.visit(visit);
        self.autonomous.visit(visit);
        self.speed.visit(visit);
        self.is_aided.visit(visit);
        self.offset_rad.visit(visit);
        self.known.visit(visit);
        self.since_track_s.visit(visit);
        self.drift_sd_rad.visit(visit);
        self.carried.visit(visit);
    }

    fn flaw(&self) -> Option<&'static str> {
        let negative = self.since_track_s < 0.0 || self.drift_sd_rad < 0.0;
        self.aided
            .flaw()
            .or_else(|| self.autonomous.flaw())
            .or_else(|| self.speed.flaw())
            .or((libm::fabs(self.offset_rad) > 4.0).then_some("an angle of more than a turn"))
            .or(negative.then_some("a time or a standard deviation below zero"))
            .or_else(|| self.carried.flaw())
    }

    fn common(&self) -> Estimate {
        let (bias_rad_s, bias_sd_rad_s) = self.carried.bias();
        Estimate {
            attitude: self.attitude(),
            reference: self.reference(),
            bias_rad_s,
            inclination_sd_rad: self.chosen().inclination_sd_rad(),
            heading_sd_rad: self.heading_sd_rad(),
            bias_sd_rad_s,
            gyro_scale: self.carried.gyro_scale(),
            hard_iron: self.carried.hard_iron(),
            leaky_velocity: LeakyVelocity::UNKNOWN,
        }
    }

    /// Both platforms go on with what was handed over; a course that is not true is set by the next track.
    fn adopt(&mut self, common: &Estimate) -> Result<(), RestoreError> {
        common.checked()?;
        self.aided.adopt(common.attitude, self.settings.low_pass_s);
        self.autonomous.adopt(common.attitude, self.settings.low_pass_s);
        self.offset_rad = 0.0;
        self.known = common.reference == Reference::True;
        self.drift_sd_rad = common.heading_sd_rad.min(PI);
        self.carried = Carried::of(common);
        Ok(())
    }
}
