//! Fuser stage `levelling-unified`: S4's figure 7 as published, two platforms in parallel and a
//! selection by k.
//!
//! P1 is levelled with the velocity of a receiver, P2 by the low-pass filtered force alone. Both
//! run all the time, each with its own corrections. Here k = 1 while fixes arrive, and k = 0 in a
//! gap and before the first fix:
//!
//! roll, pitch = k · P1 + (1 − k) · P2,  course = k · H + (1 − k) · HΓ of P2
//!
//! where H is the complex course: the gyroscopic course HΓ, corrected towards the track over ground
//! with T = 50 s. At each step of length h — S4, (5),
//!
//! H_k = H_{k−1} + (HΓ_k − HΓ_{k−1}) − h (H_{k−1} − H_track)/T
//!
//! In a gap P1 keeps the last speed with V' = 0. The HΓ of each platform starts in an arbitrary
//! direction. The azimuth offset from the selected platform to the output is recomputed at each
//! change of k, so the course is continuous. Only roll and pitch jump, by the difference between
//! the platforms. A jump above 0.03° is flagged as `aligned`.
//!
//! The stages that keep a single attitude do not have this jump. Nor do they have a second platform
//! on which the effect of the gyro bias persists for the whole flight.

use core::f64::consts::{FRAC_PI_2, PI};

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
    gnss::Fix,
    parameters::{parameters_of, settings},
    scalars::visit_fields,
    stage::Stage,
    state::{Attitude, wrapped_rad},
};

settings! {
    /// Settings of `levelling-unified`.
    pub struct UnifiedSettings {
        /// Time constant of the platform that is levelled with satellite velocity, 1/(K g).
        time_constant_s: 5.0 in 1.0 .. 1000.0, "s";
        /// Time constant of the platform that is levelled without satellite velocity.
        autonomous_time_constant_s: 60.0 in 1.0 .. 10000.0, "s";
        /// Low-pass time constant of the specific force, for the platform without satellite
        /// velocity.
        low_pass_s: 20.0 in 0.0 .. 1000.0, "s";
        /// Time after the last fix at which k becomes 0.
        gap_s: 1.5 in 0.1 .. 60.0, "s";
        /// Time constant T with which the complex course follows the track.
        course_time_constant_s: 50.0 in 1.0 .. 10000.0, "s";
        /// Minimum ground speed at which the track is used.
        track_speed_m_s: 3.0 in 0.5 .. 100.0, "m/s";
    }
}

/// Smallest change of the level that is flagged as a jump, rad (0.03°).
const MIN_JUMP_RAD: f64 = 0.03 * PI / 180.0;
/// Largest pitch at which the course is corrected, rad (80°).
const MAX_COURSE_PITCH_RAD: f64 = FRAC_PI_2 * 80.0 / 90.0;
/// Assumed drift rate of the gyroscopic course, rad/s (0.05 °/s). The standard deviation of the
/// course grows at this rate.
const DRIFT_RAD_S: f64 = 0.05 * PI / 180.0;
/// Assumed RMS angle between a vehicle's nose and its track, rad (3°).
const CRAB_SD_RAD: f64 = 3.0 * PI / 180.0;

/// Fuser stage `levelling-unified`: two platforms in parallel, one of which provides the level.
#[derive(Debug, Clone, PartialEq)]
pub struct LevellingUnified {
    settings: UnifiedSettings,
    /// Platform P1, levelled with the velocity of the receiver.
    aided: Platform,
    /// Platform P2, levelled by the low-pass filtered force alone.
    autonomous: Platform,
    speed: GroundSpeed,
    /// Selected platform: `true` for P1 (k = 1), `false` for P2 (k = 0).
    is_aided: bool,
    /// Rotation from the azimuth of the selected platform to that of the output, rad.
    offset_rad: f64,
    course_known: bool,
    since_track_s: f64,
    drift_sd_rad: f64,
    bias_handover: HandedOverBias,
}

impl Default for LevellingUnified {
    fn default() -> Self {
        Self {
            settings: UnifiedSettings::default(),
            aided: Platform::default(),
            autonomous: Platform::default(),
            speed: GroundSpeed::default(),
            is_aided: false,
            offset_rad: 0.0,
            course_known: false,
            since_track_s: 0.0,
            drift_sd_rad: PI,
            bias_handover: HandedOverBias::default(),
        }
    }
}

impl LevellingUnified {
    pub(in crate::fuser) fn realign(&mut self) {
        self.aided.realign();
        self.autonomous.realign();
    }

    fn selected(&self) -> &Platform {
        if self.is_aided { &self.aided } else { &self.autonomous }
    }

    fn attitude(&self) -> Attitude {
        let Attitude { up, z_rad } = self.selected().attitude;
        Attitude { up, z_rad: wrapped_rad(z_rad + self.offset_rad) }
    }

    /// Selects P1 if `is_aided` is `true`, else P2. Returns `true` if the level jumps as a result.
    fn select(&mut self, is_aided: bool) -> bool {
        if self.is_aided == is_aided {
            return false;
        }
        let previous = self.attitude();
        self.is_aided = is_aided;
        // Apart from the tilt, the platforms differ by a rotation about the vertical.
        let rotation = previous.quaternion() * self.attitude().quaternion().conjugate();
        self.offset_rad = wrapped_rad(self.offset_rad + 2.0 * libm::atan2(rotation.k, rotation.w));
        let (previous_up, new_up) = (previous.up.direction(), self.attitude().up.direction());
        previous_up.cross(&new_up).norm() > MIN_JUMP_RAD || previous_up.dot(&new_up) < 0.0
    }

    /// Corrects the complex course towards a track. Returns `true` for the first track, which sets
    /// the course.
    fn apply_track(&mut self, fix: &Fix) -> bool {
        let angles = self.attitude().angles();
        if fix.speed_m_s() < self.settings.track_speed_m_s || libm::fabs(angles.pitch_rad) > MAX_COURSE_PITCH_RAD {
            return false;
        }
        let interval_s = core::mem::take(&mut self.since_track_s).min(self.settings.gap_s);
        let first = !core::mem::replace(&mut self.course_known, true);
        let gain = if first { 1.0 } else { -libm::expm1(-interval_s / self.settings.course_time_constant_s) };
        // The course is clockwise, whereas yaw and azimuth are counter-clockwise.
        let error_rad = wrapped_rad(-angles.yaw_rad - fix.track_rad());
        self.offset_rad = wrapped_rad(self.offset_rad + error_rad * gain);
        self.drift_sd_rad -= self.drift_sd_rad * gain;
        first
    }

    fn heading_sd_rad(&self) -> f64 {
        if self.course_known { libm::hypot(self.drift_sd_rad, CRAB_SD_RAD).min(PI) } else { PI }
    }

    fn reference(&self) -> CourseReference {
        if self.course_known { CourseReference::True } else { CourseReference::Arbitrary }
    }

    fn fuse(&mut self, input: &FuserInput) -> Fused {
        let mut corrections = Corrections::default();
        let dt_s = interval_s(input.motion.as_ref());
        let rate_rad_s = input.motion.map_or(Vector3::zeros(), |motion| motion.rate_rad_s);
        self.aided.rotate(input.motion.as_ref(), dt_s);
        self.autonomous.rotate(input.motion.as_ref(), dt_s);
        self.bias_handover.observe(input);
        self.speed.advance(dt_s);
        self.since_track_s += dt_s;
        self.drift_sd_rad = (self.drift_sd_rad + DRIFT_RAD_S * dt_s).min(PI);
        let fix = plausible_fix(input.fix.as_ref());
        if let Some(fix) = fix {
            self.speed.record_fix(fix, self.settings.gap_s);
            corrections.velocity = true;
        }
        let mut innovation = [0.0; 2];
        if let Some(inclination) = &input.inclination {
            let UnifiedSettings { time_constant_s, autonomous_time_constant_s, low_pass_s, .. } = self.settings;
            let (speed_m_s, speed_rate_m_s2) = (self.speed.speed_m_s(), self.speed.rate_m_s2());
            let laws = [
                Law::Autonomous { time_constant_s: autonomous_time_constant_s },
                Law::Aided { speed_m_s, speed_rate_m_s2, time_constant_s },
            ];
            for (index, platform) in [&mut self.autonomous, &mut self.aided].into_iter().enumerate() {
                match platform.update(inclination, rate_rad_s, laws[index], low_pass_s) {
                    LevelUpdate::Set => corrections.aligned = true,
                    LevelUpdate::Moved { innovation_rad } => {
                        innovation[index] = innovation_rad;
                        corrections.tilt = true;
                    }
                }
            }
        }
        self.speed.end_tick(dt_s);
        corrections.aligned |= self.select(self.speed.is_recent(self.settings.gap_s));
        if let Some(fix) = fix {
            corrections.aligned |= self.apply_track(fix);
        }
        Fused {
            attitude: self.attitude(),
            rate_rad_s,
            bias_rad_s: Vector3::zeros(),
            innovation_rad: innovation[usize::from(self.is_aided)],
            inclination_sd_rad: self.selected().inclination_sd_rad(),
            heading_sd_rad: self.heading_sd_rad(),
            reference: self.reference(),
            corrections,
        }
    }

    /// Continues both platforms from the handed-over attitude. If the course does not refer to true
    /// north, the next track sets the course.
    fn continue_from(&mut self, common: &Estimate) {
        self.aided.adopt(common.attitude, self.settings.low_pass_s);
        self.autonomous.adopt(common.attitude, self.settings.low_pass_s);
        self.offset_rad = 0.0;
        self.course_known = common.reference == CourseReference::True;
        self.drift_sd_rad = common.heading_sd_rad.min(PI);
        self.bias_handover = HandedOverBias::from_estimate(common);
    }
}

impl Stage for LevellingUnified {
    fuser_items!();

    fn name(&self) -> &'static str {
        "levelling-unified"
    }

    parameters_of!(UnifiedSettings in settings);

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        visit_fields!(self, visit:
            aided, autonomous, speed, is_aided, offset_rad, course_known, since_track_s, drift_sd_rad, bias_handover;
            without settings
        );
    }

    fn validation_error(&self) -> Option<&'static str> {
        let negative = self.since_track_s < 0.0 || self.drift_sd_rad < 0.0;
        self.aided
            .validation_error()
            .or_else(|| self.autonomous.validation_error())
            .or_else(|| self.speed.validation_error())
            .or((libm::fabs(self.offset_rad) > 4.0).then_some("an angle of more than one revolution"))
            .or(negative.then_some("a negative time or standard deviation"))
            .or_else(|| self.bias_handover.validation_error())
    }

    fn common(&self) -> Estimate {
        Estimate {
            attitude: self.attitude(),
            reference: self.reference(),
            inclination_sd_rad: self.selected().inclination_sd_rad(),
            heading_sd_rad: self.heading_sd_rad(),
            ..self.bias_handover.sensor_errors()
        }
    }
}
