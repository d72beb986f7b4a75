//! Heading from the magnetic field. The field corrects only the rotation about the vertical, never
//! the level.
//!
//! Input: the attitude with the heading of the gyro alone, the rate, and the magnetic field sample,
//! if present.
//!
//! Output: the angle `a` by which the attitude must be rotated about the vertical so that its
//! heading refers to magnetic north, and the standard deviation of `a`.
//!
//! Time: the intervals of the ticks.
//!
//! Failure: if there is no field, or no hypothesis explains it, `a` is kept and the heading follows
//! the gyro.
//!
//! In the frame of the gyro heading, north is fixed except for a slow drift. The field is therefore
//! a linear measurement of the unknowns: the ambient field e, the drift rate β, the magnetometer
//! delay τ, the hard iron b, the local disturbance d, the gyro scale error κ, and the field p at
//! the last rest site (see `filter`). The result is `a` = atan2(e_ξ, e_η).
//!
//! | file | content |
//! | --- | --- |
//! | `drift_monitor` | detection of a large drift |
//! | `field_averager` | means of the field in the reference frame, with the attitude at the time of measurement |
//! | `filter` | equations of one Kalman filter |
//! | `vibration` | vibration detector |
//! | `rest_site` | detection of a return to the last rest site |
//! | `new_field` | detection of a steady field other than the one in use |
//! | `hypothesis_test` | three filters for the same field: no change, a magnet on the body, a changed ambient field |
//!
//! The reasons for this design:
//!
//! - The delay matters: 13 ms at 7 rad/s are 5° of field direction.
//! - A gate alone, on strength and dip or on the innovation, rejects passing magnets. Once a magnet
//!   is attached to the body, however, such a gate rejects the field permanently. The disturbed
//!   field cannot be used uncorrected either: at a dip of 70°, an error of 1 µT causes 4° of
//!   heading error.
//! - A hard iron that is always estimated absorbs gradients of the field. While a body hardly
//!   rotates, b and e cannot be separated, and the heading is wrong by degrees. b is therefore
//!   estimated only if its likelihood exceeds that of a changed field.
//! - A main hypothesis that rejects everything is replaced only by a field that is steady. If it
//!   were replaced after a fixed time by any field, the error among magnets would increase by 4°
//!   (Nexus 5: 8.5° instead of 4.5°).
//! - While a magnet moves away, its field passes the gate for a moment and still rotates the
//!   estimated field. The field is therefore not used for 2 s after a strong disturbance. On Nexus
//!   5 among magnets, this reduces the error from 4.5° to 4.2°.
//!
//! The following variants have no effect or increase the heading error. They were measured on Nexus
//! 5 among magnets and on BROAD, without the pause after strong disturbances. The errors without a
//! variant are 4.5° and 1.63°.
//!
//! - The local disturbance is enlarged by the innovations (roughness, 40 s). The error is 6.3°,
//!   that of crossed trials 1.25° instead of 1.19°, and that in a changed ambient field 5.5°
//!   instead of 1.4°. The roughness is therefore only reported.
//! - The drift rate is not updated within 2 s after a rejection. The error is 5.3°, and on iPhone 5
//!   it is 57° instead of 10°.
//! - The prior of the drift rate is smaller, 0.002 rad/s. The error is 4.7°, and the other errors
//!   are unchanged.

mod drift_monitor;
mod field_averager;
mod filter;
mod hypothesis_test;
mod input;
mod new_field;
mod rest_site;
mod vibration;

pub(super) use {filter::Drift, input::HeadingInput};

use core::f64::consts::PI;

use crate::{
    Vector3,
    course::CourseReference,
    fuser::{
        estimate::Estimate,
        hard_iron::HardIron,
        wz::{correction_smoothing, gyro_errors::ASSUMED_UNOBSERVED_RATE_RAD_S, settings::Settings},
    },
    scalars::scalars,
    state::{Attitude, wrapped_rad},
};
use {
    drift_monitor::DriftMonitor,
    field_averager::{FieldAverager, IntervalMeans},
    filter::{BETA, DRIFT_SD_RAD_S, FieldFilter, Propagation, TAU},
    hypothesis_test::HypothesisTest,
    rest_site::{RestSite, SiteMatch},
};

/// Smallest plausible magnetic field reading, µT. Smaller readings are ignored.
const MIN_READING_UT: f64 = 1.0;
/// Largest plausible magnetic field reading, µT. Larger readings are ignored.
const MAX_READING_UT: f64 = 500.0;
/// Noise of the mean magnetic field over a window of 20 ms, µT.
const NOISE_UT: f64 = 0.46;
/// Additional noise per unit of rate, as a fraction of the magnetic field, s. It corresponds to a
/// time offset of half a millisecond between samples and attitude.
const NOISE_PER_RATE_S: f64 = 4.5e-4;
/// Tilt error after a start in motion, rad.
const SETTLING_TILT_RAD: f64 = 0.3;
/// Time constant with which the tilt error after a start in motion decays, s.
const SETTLING_S: f64 = 3.0;
/// Tilt error below which the tilt counts as settled, rad.
const SETTLED_TILT_RAD: f64 = 4e-4;
/// Rate above which a start counts as a start in motion, rad/s.
const MAX_STILL_RATE_RAD_S: f64 = 0.1;
/// Standard deviation above which a heading counts as unknown, rad.
const UNKNOWN_HEADING_SD_RAD: f64 = 1.0;
/// Largest unobserved rotation that only increases the variance of the heading, rad.
///
/// Up to this angle, the magnetic field is nearly linear in the heading. After a larger rotation,
/// the direction of north is unknown.
const MAX_LINEAR_RAD: f64 = 0.3;
/// Additional standard deviation of the heading of a vibrating body, rad (3.4°). The motor that
/// causes the vibration has a magnetic field.
const VIBRATION_SD_RAD: f64 = 0.06;
/// Averaging time of the vibration, s.
const VIBRATION_MEMORY_S: f64 = 10.0;
/// Standard deviation above which the drift of the gyro heading counts as uncertain, rad/s (0.9
/// °/s).
const MAX_DRIFT_SD_RAD_S: f64 = 0.015;
/// Local fields in a building, as a fraction of the earth's field.
///
/// A moving body measures fields whose direction changes by 5 to 12° within seconds. Only while the
/// drift is known do they differ clearly from a drift.
const LOCAL_FIELD_FRACTION: f64 = 0.1;
/// Time for which local fields stay correlated, s.
const LOCAL_FIELD_CORRELATION_S: f64 = 3.0;
/// Averaging time of the vertical in body axes, s. A drift is observed over about this time.
const DRIFT_AXIS_MEMORY_S: f64 = 10.0;
/// Smallest length of the mean vertical for which a drift is attributed to it. The body then keeps
/// its vertical axis within about 60°.
const MIN_DRIFT_AXIS: f64 = 0.5;
/// Largest heading correction that is applied gradually, rad (1°). A larger one is a flagged jump.
const MAX_SMOOTHED_RAD: f64 = 0.017_453_293;

/// Effect of a tick on the heading.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct HeadingUpdate {
    /// A magnetic field was used.
    pub(super) magnetic: bool,
    /// The heading jumps at this tick.
    pub(super) aligned: bool,
    /// The gyro heading drifts faster than the heading filter considers possible.
    pub(super) drifts: bool,
}

/// State of the heading.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Heading {
    field_averager: FieldAverager,
    hypothesis_test: HypothesisTest,
    rest_site: RestSite,
    /// Set if the body was at rest at the end of the last interval.
    was_at_rest: bool,
    /// Set once a magnetic field sample has been used.
    started: bool,
    /// Set once the heading has become known, from another stage or from the magnetic field.
    heading_known: bool,
    has_rested: bool,
    /// Fraction of the recent intervals in which the body vibrated.
    vibrating_fraction: f64,
    disturbed: bool,
    /// Remaining tilt error after a start in motion, rad.
    settling_tilt_rad: f64,
    correction_rad: f64,
    /// Heading correction that has not been applied to the attitude yet, rad.
    pending_rad: f64,
    sd_rad: f64,
    /// Standard deviation of the heading, rad.
    ///
    /// Includes allowances for a magnetic field that the main hypothesis does not explain.
    credible_sd_rad: f64,
    /// Standard deviation of the gyro heading's drift rate before the first magnetic field sample,
    /// rad/s.
    drift_sd_rad_s: f64,
    /// Set while the assumed noise of the field includes local fields.
    expects_local_fields: bool,
    drift_monitor: DriftMonitor,
    /// Mean of the vertical in body axes; zero before the first interval.
    mean_up: Vector3<f64>,
    /// Set if the adopted heading refers to magnetic north.
    adopted_magnetic: bool,
    /// Set if the adopted heading refers to true north.
    adopted_true: bool,
}

impl Default for Heading {
    fn default() -> Self {
        Self::from_estimate(&Settings::default(), &Estimate::UNKNOWN)
    }
}

impl Heading {
    /// Creates the state from another stage's estimate. The heading of the estimate is already part
    /// of the attitude.
    pub(super) fn from_estimate(settings: &Settings, common: &Estimate) -> Self {
        let Estimate { reference, heading_sd_rad, bias_sd_rad_s, hard_iron, .. } = *common;
        let mut main = FieldFilter::new(settings);
        main.set_hard_iron(hard_iron);
        Self {
            field_averager: FieldAverager::default(),
            hypothesis_test: HypothesisTest::new(main),
            rest_site: RestSite::default(),
            was_at_rest: false,
            started: false,
            heading_known: reference == CourseReference::Magnetic && heading_sd_rad < UNKNOWN_HEADING_SD_RAD,
            has_rested: false,
            vibrating_fraction: 0.0,
            disturbed: false,
            settling_tilt_rad: 0.0,
            correction_rad: 0.0,
            pending_rad: 0.0,
            sd_rad: heading_sd_rad.min(PI),
            credible_sd_rad: heading_sd_rad.min(PI),
            drift_sd_rad_s: bias_sd_rad_s.min(DRIFT_SD_RAD_S),
            expects_local_fields: false,
            drift_monitor: DriftMonitor::default(),
            mean_up: Vector3::zeros(),
            adopted_magnetic: reference == CourseReference::Magnetic,
            adopted_true: reference == CourseReference::True,
        }
    }

    /// Returns the attitude with the heading corrected by the magnetic field.
    #[inline]
    pub(super) fn with_heading(&self, attitude: Attitude) -> Attitude {
        if !self.started {
            return attitude;
        }
        Attitude { z_rad: wrapped_rad(attitude.z_rad + self.correction_rad - self.pending_rad), ..attitude }
    }

    /// Returns the standard deviation of the heading, rad.
    pub(super) fn sd_rad(&self) -> f64 {
        self.sd_rad
    }

    /// Returns the standard deviation of the heading, rad.
    ///
    /// Includes allowances for a magnetic field that the main hypothesis does not explain.
    #[inline]
    pub(super) fn credible_sd_rad(&self) -> f64 {
        self.credible_sd_rad
    }

    /// Returns the reference direction of the heading.
    pub(super) fn reference(&self) -> CourseReference {
        match (self.started || self.adopted_magnetic, self.adopted_true) {
            (true, _) => CourseReference::Magnetic,
            (_, true) => CourseReference::True,
            _ => CourseReference::Arbitrary,
        }
    }

    /// Returns `true` if the last magnetic field sample was rejected.
    pub(super) fn is_disturbed(&self) -> bool {
        self.disturbed
    }

    /// Returns the hard iron, or [`HardIron::UNKNOWN`] if it is assumed to be zero and not
    /// estimated.
    pub(super) fn hard_iron(&self) -> HardIron {
        self.hypothesis_test.main.hard_iron()
    }

    /// Returns the delay of the magnetometer relative to the gyro, s.
    pub(super) fn delay_s(&self) -> f64 {
        self.hypothesis_test.main.x[TAU]
    }

    /// Handles a loss of the level, which also invalidates the gyro heading.
    pub(super) fn realign(&mut self) {
        self.field_averager = FieldAverager::default();
        // Before the first magnetic field sample, there is no magnetic heading to invalidate.
        if self.started {
            self.invalidate_heading();
            self.update_correction();
        }
    }

    /// Handles a large change of a known gyro bias, which invalidates the gyro heading and its
    /// drift. `drift_sd_rad_s` is the standard deviation of the new bias about the vertical.
    pub(super) fn invalidate_by_drift(&mut self, drift_sd_rad_s: f64) {
        self.realign();
        self.hypothesis_test.reset_drift(drift_sd_rad_s);
        self.mean_up = Vector3::zeros();
    }

    /// Handles a large gyro bias that has been present from the start.
    ///
    /// Everything derived from the magnetic field so far is then invalid. `drift_sd_rad_s` is the
    /// standard deviation of the unknown drift.
    pub(super) fn restart_after_drift(&mut self, drift_sd_rad_s: f64, settings: &Settings) {
        self.invalidate_by_drift(drift_sd_rad_s);
        self.hypothesis_test.restart(settings, drift_sd_rad_s);
    }

    /// Increases the assumed noise of the field by local fields until the drift is known.
    ///
    /// After a large bias about a horizontal axis, the level still changes. The filter would
    /// otherwise mistake local fields for a drift of several °/s, and then reject the true field.
    pub(super) fn expect_local_fields(&mut self) {
        self.expects_local_fields = true;
    }

    /// Returns the drift of the gyro heading.
    ///
    /// Returns `None` if the drift is uncertain or the last magnetic field was rejected.
    pub(super) fn drift(&self) -> Option<Drift> {
        let has_axis = self.mean_up.norm_squared() > MIN_DRIFT_AXIS * MIN_DRIFT_AXIS;
        let is_known = self.started && self.heading_known && !self.disturbed && has_axis;
        is_known
            .then(|| self.hypothesis_test.main.drift(self.mean_up))
            .filter(|drift| drift.variance_rad2_s2 < MAX_DRIFT_SD_RAD_S * MAX_DRIFT_SD_RAD_S)
    }

    /// Handles a bias about the vertical that the force has shown, for example because the body has
    /// turned over. The drift then counts as known.
    pub(super) fn accept_drift(&mut self) {
        self.expects_local_fields = false;
    }

    /// Subtracts a rate from the drift, because the gyro bias now contains it.
    pub(super) fn subtract_drift(&mut self, rate_rad_s: f64) {
        self.hypothesis_test.subtract_drift(rate_rad_s);
        self.expects_local_fields = false;
    }

    /// Handles a bias that was found at rest to be far from its estimate.
    ///
    /// The gyro heading and its drift are then invalid.
    pub(super) fn invalidate_at_rest(&mut self) {
        self.realign();
        self.expects_local_fields = false;
        self.hypothesis_test.on_first_rest();
    }

    /// Invalidates the heading and lets the level settle again.
    fn invalidate_heading(&mut self) {
        self.hypothesis_test.invalidate_direction();
        self.rest_site = RestSite::default();
        self.drift_monitor = DriftMonitor::default();
        self.settling_tilt_rad = SETTLING_TILT_RAD;
    }

    /// Handles a gyro outage. Returns `true` if the magnetic field of the interval can be used.
    ///
    /// After a large unobserved rotation, the field can be used only if the outage covers the whole
    /// interval. Otherwise the mean field mixes two directions.
    fn handle_unobserved_turn(&mut self, interval: &IntervalMeans) -> bool {
        let unobserved_rad = ASSUMED_UNOBSERVED_RATE_RAD_S * interval.gyro_outage_s;
        if unobserved_rad <= MAX_LINEAR_RAD {
            self.hypothesis_test.add_heading_variance(unobserved_rad * unobserved_rad);
            return true;
        }
        self.invalidate_heading();
        interval.gyro_outage_s >= interval.duration_s
    }

    /// Processes one tick.
    #[inline]
    pub(super) fn step(&mut self, input: &HeadingInput, settings: &Settings) -> HeadingUpdate {
        let is_plausible = |field: &Vector3<f64>| {
            (MIN_READING_UT * MIN_READING_UT..MAX_READING_UT * MAX_READING_UT).contains(&field.norm_squared())
        };
        let field_ut = input.field_ut.filter(is_plausible);
        if input.gyro_outage_s > 0.0 {
            let unobserved_rad = ASSUMED_UNOBSERVED_RATE_RAD_S * input.gyro_outage_s;
            for sd_rad in [&mut self.sd_rad, &mut self.credible_sd_rad] {
                *sd_rad = libm::hypot(*sd_rad, unobserved_rad).min(PI);
            }
        }
        if !self.started && field_ut.is_none() && self.field_averager.is_empty() {
            return HeadingUpdate::default();
        }
        self.pending_rad -=
            self.pending_rad * correction_smoothing::fraction(self.pending_rad * self.pending_rad, input.dt_s);
        match self.field_averager.step(input, field_ut, self.hypothesis_test.main.x[TAU], !self.started) {
            Some(interval) => self.update(&interval, settings),
            None => HeadingUpdate::default(),
        }
    }

    #[inline(never)]
    fn update(&mut self, interval: &IntervalMeans, settings: &Settings) -> HeadingUpdate {
        let vibrating = if interval.is_vibrating { 1.0 } else { 0.0 };
        let gain = (interval.duration_s / VIBRATION_MEMORY_S).min(1.0);
        self.vibrating_fraction += (vibrating - self.vibrating_fraction) * gain;
        self.expects_local_fields &= !interval.at_rest;
        if interval.at_rest && !self.has_rested {
            self.has_rested = true;
            self.hypothesis_test.on_first_rest();
        }
        let motion_changed = core::mem::replace(&mut self.was_at_rest, interval.at_rest) != interval.at_rest;
        if motion_changed {
            self.rest_site.end_rest();
        }
        let usable = interval.gyro_outage_s == 0.0 || self.handle_unobserved_turn(interval);
        if interval.windows == 0.0 || !usable {
            if !self.started {
                return HeadingUpdate::default();
            }
            self.hypothesis_test.predict(&Propagation::from_interval(interval, motion_changed));
            return HeadingUpdate { aligned: self.update_correction(), ..HeadingUpdate::default() };
        }
        self.average_up(interval);
        let [x, y, z] = interval.field_ut;
        let strength_ut = libm::sqrt(x * x + y * y + z * z);
        let first = !self.started;
        if first {
            let is_still = interval.at_rest || interval.rate_rms_rad_s < MAX_STILL_RATE_RAD_S;
            self.settling_tilt_rad = if is_still { 0.0 } else { SETTLING_TILT_RAD };
        }
        let rate_noise_ut = NOISE_PER_RATE_S * strength_ut * interval.rate_rms_rad_s;
        let settling_noise_ut = self.settling_tilt_rad * strength_ut;
        let mut variance_ut2 = NOISE_UT * NOISE_UT / interval.windows
            + rate_noise_ut * rate_noise_ut
            + settling_noise_ut * settling_noise_ut;
        if self.expects_local_fields {
            variance_ut2 += Self::local_field_density_ut2_s(strength_ut) / interval.duration_s;
        }
        if self.settling_tilt_rad > 0.0 {
            self.settling_tilt_rad *= libm::exp(-interval.duration_s / SETTLING_S);
            self.settling_tilt_rad =
                if self.settling_tilt_rad < SETTLED_TILT_RAD { 0.0 } else { self.settling_tilt_rad };
        }
        if first {
            return self.start(interval, settings, variance_ut2);
        }
        self.hypothesis_test.predict(&Propagation::from_interval(interval, motion_changed));
        let outcome = self.hypothesis_test.update(interval, settings, variance_ut2);
        self.disturbed = !(outcome.accepted || outcome.replaced);
        if outcome.replaced {
            self.rest_site = RestSite::default();
        } else if outcome.accepted && interval.at_rest {
            self.update_rest_site(interval);
        }
        // The first rest shows the bias.
        let drifts =
            !self.has_rested && self.drift_monitor.observe(interval, Self::local_field_density_ut2_s(strength_ut));
        HeadingUpdate { magnetic: !self.disturbed, aligned: self.update_correction(), drifts }
    }

    /// Returns the spectral density of the local fields in a field of the given strength, µT² s.
    fn local_field_density_ut2_s(strength_ut: f64) -> f64 {
        let local_field_ut = LOCAL_FIELD_FRACTION * strength_ut;
        local_field_ut * local_field_ut * LOCAL_FIELD_CORRELATION_S
    }

    /// Averages the vertical in body axes.
    fn average_up(&mut self, interval: &IntervalMeans) {
        let up = Vector3::from(interval.axes[2]);
        let is_first = self.mean_up == Vector3::zeros();
        let gain = if is_first { 1.0 } else { (interval.duration_s / DRIFT_AXIS_MEMORY_S).min(1.0) };
        self.mean_up += (up - self.mean_up) * gain;
    }

    /// Processes an interval at rest.
    ///
    /// If the body is back at the last rest site, the magnetic field reveals the drift of the gyro.
    fn update_rest_site(&mut self, interval: &IntervalMeans) {
        let field_ut = self.hypothesis_test.main.field_without_hard_iron_ut(interval);
        match self.rest_site.observe(field_ut, interval.axes[2]) {
            SiteMatch::Undecided => {}
            SiteMatch::Revisited if self.hypothesis_test.update_at_rest_site() => {}
            SiteMatch::Revisited | SiteMatch::Current => self.hypothesis_test.store_rest_site(),
        }
        self.hypothesis_test.limit_drift_variance(self.rest_site.intervals() * interval.duration_s);
    }

    /// Initialises the heading with the first magnetic field sample.
    ///
    /// If the heading is already known relative to magnetic north, the filter starts at that
    /// heading and the output does not jump.
    fn start(&mut self, interval: &IntervalMeans, settings: &Settings, variance_ut2: f64) -> HeadingUpdate {
        let mut main = FieldFilter::new(settings);
        if self.heading_known && self.sd_rad < UNKNOWN_HEADING_SD_RAD {
            main.set_north(interval.field_ut, self.sd_rad);
        }
        main.reset(BETA, self.drift_sd_rad_s);
        main.set_hard_iron(self.hard_iron());
        self.hypothesis_test = HypothesisTest::new(main);
        if self.has_rested {
            self.hypothesis_test.on_first_rest();
        }
        self.hypothesis_test.start(interval, settings.magnetometer_delay_s, variance_ut2);
        self.started = true;
        let aligned = self.update_correction();
        HeadingUpdate { magnetic: true, aligned, drifts: false }
    }

    /// Sets the heading correction to that of the main hypothesis. Returns `true` if the heading
    /// jumps.
    ///
    /// If the heading was known before, it follows the gyro while the magnetic heading is unknown.
    /// If the heading was never known, the magnetic heading is used regardless of its uncertainty.
    fn update_correction(&mut self) -> bool {
        let (correction_rad, variance_rad2) = self.hypothesis_test.main.heading_correction();
        self.sd_rad = libm::sqrt(variance_rad2).min(PI);
        let vibration_rad = VIBRATION_SD_RAD * self.vibrating_fraction;
        self.credible_sd_rad = libm::hypot(self.hypothesis_test.credible_sd_rad(self.sd_rad), vibration_rad).min(PI);
        if self.sd_rad >= UNKNOWN_HEADING_SD_RAD && self.heading_known {
            return false;
        }
        self.heading_known |= self.sd_rad < UNKNOWN_HEADING_SD_RAD;
        self.pending_rad = wrapped_rad(self.pending_rad + correction_rad - self.correction_rad);
        self.correction_rad = correction_rad;
        let jumps = libm::fabs(self.pending_rad) > MAX_SMOOTHED_RAD;
        self.pending_rad = if jumps { 0.0 } else { self.pending_rad };
        jumps
    }

    /// Returns the reason why the state is invalid, or `None` if it is valid.
    pub(super) fn validation_error(&self) -> Option<&'static str> {
        let Self { settling_tilt_rad, correction_rad, pending_rad, sd_rad, credible_sd_rad, drift_sd_rad_s, .. } = self;
        let bounds = (0.0..=PI).contains(sd_rad) && libm::fabs(*correction_rad) <= PI && libm::fabs(*pending_rad) <= PI;
        let bounds =
            bounds && *settling_tilt_rad >= 0.0 && *drift_sd_rad_s >= 0.0 && (0.0..=PI).contains(credible_sd_rad);
        self.field_averager
            .validation_error()
            .or_else(|| self.rest_site.validation_error())
            .or_else(|| self.drift_monitor.validation_error())
            .or((!bounds).then_some("a heading or deviation out of range"))
            .or_else(|| self.hypothesis_test.validation_error())
    }
}

scalars!(Heading:
    field_averager, hypothesis_test, rest_site, was_at_rest, started, heading_known, has_rested, vibrating_fraction, disturbed,
    expects_local_fields, drift_monitor, mean_up, adopted_magnetic, adopted_true, settling_tilt_rad, correction_rad,
    pending_rad, sd_rad, credible_sd_rad, drift_sd_rad_s
);
