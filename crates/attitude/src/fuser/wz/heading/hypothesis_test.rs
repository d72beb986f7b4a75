//! Runs three hypotheses about the same magnetic field and selects the one that gives the heading.
//!
//! | | hypothesis | start |
//! | --- | --- | --- |
//! | M | the hard iron is unchanged | main filter, gives the heading |
//! | B | a magnet was attached to the body or removed | copy of M with 15 µT added to the uncertainty of b |
//! | E | the ambient field has changed | copy of M with 15 µT added to the uncertainty of e |
//!
//! The gate of M rejects disturbances, during which the heading follows the gyro. A sudden change
//! of a field that is fixed to the body fits only B. A changed ambient field fits E as well as B,
//! and passing magnets fit none of the three.
//!
//! The evidence is a sum of log-likelihood ratios over the time in which the body turns, because
//! the three cannot be distinguished at rest. Each update subtracts an allowance. It is needed
//! because no hypothesis models soft iron or field gradients, and B, having more freedom than the
//! others, explains a little of both. The sum does not fall below zero.
//!
//! A fourth possibility is that M relies on a field that is not the earth's, because the body has
//! started near iron or a magnet. M restarts with another field if that field has been steady for
//! longer than M has used its own field (`new_field`). Both times are counted only while the body
//! turns.
//!
//! B replaces M when it leads both others by the margin, its hard iron differs from that of M, and
//! the body has turned. B and E restart from M when B fails, or after 50 s without a decision.

use super::{
    field_averager::IntervalMeans,
    filter::{B, BETA, E, FieldFilter, Propagation, TAU},
    new_field::NewField,
};
use crate::{fuser::wz::settings::Settings, scalars::scalars};

/// Standard deviation added to the changed field of a challenger (hypothesis B or E), µT.
///
/// The changed field is the hard iron in B and the ambient field in E. The value corresponds to a
/// magnet a few centimetres away, or to a loudspeaker in the same room.
const CHALLENGER_SD_UT: f64 = 15.0;
/// Gate on the normalised innovation squared. Regular innovations exceed it in 1 % of cases.
const GATE: f64 = 11.0;
/// Largest normalised innovation squared used in a likelihood. Without this limit, a single
/// disturbance would decide the test.
const MAX_NIS: f64 = 30.0;
/// Normalised innovation squared above which a disturbance counts as strong.
///
/// The innovation is that of the main filter M. A magnet passing close by exceeds the threshold.
const STRONG_NIS: f64 = 200.0;
/// Time for which the main filter M uses no magnetic field after a strong disturbance, s.
///
/// While a magnet moves away, its field is inside the gate for a moment, but still rotates the
/// estimated field by degrees.
const HOLD_S: f64 = 2.0;
/// Lead at which hypothesis B replaces the main filter M, as twice the log-likelihood ratio.
const WIN_MARGIN: f64 = 85.0;
/// Minimum difference of the hard iron for hypothesis B to replace the main filter M, µT.
const MIN_HARD_IRON_CHANGE_UT: f64 = 3.0;
/// Minimum rotation since the start of the challenge for hypothesis B to replace the main filter M,
/// rad.
const MIN_CHALLENGE_TURN_RAD: f64 = 2.0;
/// Evidence subtracted per second of turning.
const ALLOWANCE_PER_S: f64 = 5.5;
/// Rate above which the body counts as turning, rad/s.
const MIN_TURN_RATE_RAD_S: f64 = 0.3;
/// Time for which hypothesis B must reject the magnetic field for the challenge to fail, s.
const CHALLENGER_REJECTION_TIMEOUT_S: f64 = 0.2;
/// Maximum duration of a challenge, s. The challenge then restarts.
const CHALLENGE_TIMEOUT_S: f64 = 50.0;
/// Time for which a different magnetic field must be steady to replace a well supported one, s. It
/// is also the time for which the field must be rejected before all states that depend on it are
/// reset. The rejection is counted only while the body turns or the main filter is on probation.
const REJECTION_TIMEOUT_S: f64 = 60.0;
/// Time for which the main filter M must use a magnetic field before the field counts as well
/// supported, s. Like the times below, it is counted only while the body turns.
const WELL_SUPPORTED_S: f64 = 20.0;
/// Shortest time for which another magnetic field must be steady to replace that of the main
/// filter, s. Hypothesis B needs less time to recognise a field that is fixed to the body.
const MIN_NEW_FIELD_S: f64 = 10.0;
/// Value of [`MIN_NEW_FIELD_S`] while the main filter is on probation, s. A passing magnet is near
/// for less time.
const MIN_NEW_FIELD_ON_PROBATION_S: f64 = 3.0;
/// Averaging time of the roughness, s. The roughness is the mean square of the normalised
/// innovations.
const ROUGHNESS_MEMORY_S: f64 = 40.0;
/// Excess of the roughness in an undisturbed indoor magnetic field.
///
/// The excess is relative to a field with the assumed local disturbance. It is subtracted before
/// the roughness is used.
const REGULAR_ROUGHNESS: f64 = 1.0;
/// Limits of the factor by which the roughness changes the reported variance of the heading.
const MIN_ROUGHNESS: f64 = 0.85;
const MAX_ROUGHNESS: f64 = 9.0;
/// Number of components of an innovation.
const DEGREES_OF_FREEDOM: f64 = 3.0;
/// Standard deviation of the heading before the body has moved, rad (29°). Iron near a parked
/// vehicle rotates the magnetic field by tens of degrees.
const UNMOVED_SD_RAD: f64 = 0.5;
/// Time constant with which a magnetic field is confirmed while it is used in motion, s.
/// [`UNMOVED_SD_RAD`] decays with this time constant.
const CONFIRMATION_S: f64 = 3.0;
/// Time for which a new main filter must accept the magnetic field to end its probation, s.
const PROBATION_S: f64 = 10.0;
/// Time for which the magnetic field must be rejected before the direction of north is invalidated
/// once more, s.
///
/// This happens only if the direction was invalidated before and the main filter is on probation.
/// The main filter must also have rejected the magnetic field for longer than it has accepted it.
const MIN_PROBATION_REJECTION_S: f64 = 2.0;
/// Standard deviation of the drift rate once the gyro bias has been observed at rest, rad/s.
const DRIFT_SD_AT_REST_RAD_S: f64 = 6.5e-4;
/// Standard deviation of the drift rate after a rest of one second, rad/s. Because the gyro bias is
/// averaged over the rest, its error falls with the square root of the duration.
const DRIFT_SD_AFTER_1_S_RAD_S: f64 = 1.45e-3;
/// Standard deviation of the drift rate after a long rest, rad/s: the bias of a moving gyro differs
/// from its bias at rest.
const MIN_DRIFT_SD_RAD_S: f64 = 5e-4;

/// Outcome of the hypothesis test for one interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct TestOutcome {
    /// The main filter M used the magnetic field.
    pub(super) accepted: bool,
    /// The main filter M was replaced or reset.
    pub(super) replaced: bool,
}

/// The three hypotheses and the evidence for them.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct HypothesisTest {
    pub(super) main: FieldFilter,
    body: FieldFilter,
    environment: FieldFilter,
    /// Lead of hypothesis B over the main filter M, as twice the log-likelihood ratio.
    lead_over_main: f64,
    /// Lead of hypothesis B over hypothesis E, as twice the log-likelihood ratio.
    lead_over_environment: f64,
    challenger_rejected_s: f64,
    challenge_age_s: f64,
    challenge_turn_rad: f64,
    accepted_s: f64,
    rejected_s: f64,
    new_field: NewField,
    /// Time for which the main filter M has used the magnetic field while the body turned, s.
    ///
    /// The time is limited to [`WELL_SUPPORTED_S`].
    supported_s: f64,
    /// Mean square of the main filter's innovations in motion, relative to their predicted
    /// variance.
    roughness: f64,
    /// Remaining time for which the main filter M uses no magnetic field after a strong
    /// disturbance, s.
    hold_s: f64,
    /// Set when the direction of north is invalidated. Cleared by the first long rejection after
    /// that.
    direction_invalidated: bool,
}

impl HypothesisTest {
    /// Creates the test with a main filter that has not processed a magnetic field yet.
    pub(super) fn new(main: FieldFilter) -> Self {
        let mut hypothesis_test = Self {
            main,
            body: main,
            environment: main,
            lead_over_main: 0.0,
            lead_over_environment: 0.0,
            challenger_rejected_s: 0.0,
            challenge_age_s: 0.0,
            challenge_turn_rad: 0.0,
            accepted_s: 0.0,
            rejected_s: 0.0,
            new_field: NewField::default(),
            supported_s: 0.0,
            roughness: 1.0,
            hold_s: 0.0,
            direction_invalidated: false,
        };
        hypothesis_test.restart_challengers();
        hypothesis_test
    }

    /// Processes the first interval, which all hypotheses must use.
    ///
    /// In hypothesis B, both the ambient field and the hard iron are unknown at that point.
    pub(super) fn start(&mut self, interval: &IntervalMeans, delay_s: f64, variance_ut2: f64) {
        self.for_each_filter(|filter| {
            filter.measure(interval, delay_s, variance_ut2, f64::INFINITY);
        });
    }

    /// Propagates all hypotheses over an interval.
    pub(super) fn predict(&mut self, propagation: &Propagation) {
        self.for_each_filter(|filter| filter.predict(propagation));
    }

    /// Forgets the drift rate, because the gyro bias has changed. The earlier drift may have been
    /// mistaken for hard iron, so the hard iron becomes less certain.
    pub(super) fn reset_drift(&mut self, sd_rad_s: f64) {
        self.for_each_filter(|filter| {
            filter.reset(BETA, sd_rad_s);
            filter.inflate(B, CHALLENGER_SD_UT);
        });
    }

    /// Restarts with a main filter that has not processed a magnetic field yet and with an unknown
    /// drift rate.
    pub(super) fn restart(&mut self, settings: &Settings, drift_sd_rad_s: f64) {
        let mut main = FieldFilter::new(settings);
        main.reset(BETA, drift_sd_rad_s);
        *self = Self { roughness: self.roughness, direction_invalidated: true, ..Self::new(main) };
    }

    /// Subtracts a rate from the drift rate.
    pub(super) fn subtract_drift(&mut self, rate_rad_s: f64) {
        self.for_each_filter(|filter| filter.x[BETA] -= rate_rad_s);
    }

    /// Adds a variance to the gyro heading, rad².
    pub(super) fn add_heading_variance(&mut self, variance_rad2: f64) {
        self.for_each_filter(|filter| filter.add_heading_variance(variance_rad2));
    }

    /// Makes the direction of north unknown.
    pub(super) fn invalidate_direction(&mut self) {
        self.for_each_filter(FieldFilter::invalidate_direction);
        (self.accepted_s, self.rejected_s, self.hold_s, self.direction_invalidated) = (0.0, 0.0, 0.0, true);
    }

    /// Resets the drift rate on the first rest, when the gyro bias is observed.
    ///
    /// Earlier drift does not predict later drift.
    pub(super) fn on_first_rest(&mut self) {
        self.for_each_filter(|filter| filter.reset(BETA, DRIFT_SD_AT_REST_RAD_S));
    }

    /// Limits the variance of the drift rate after a rest of the given duration.
    pub(super) fn limit_drift_variance(&mut self, rest_s: f64) {
        let sd_rad_s = (DRIFT_SD_AFTER_1_S_RAD_S / libm::sqrt(rest_s)).max(MIN_DRIFT_SD_RAD_S);
        self.for_each_filter(|filter| filter.limit_variance(BETA, sd_rad_s * sd_rad_s));
    }

    /// Processes an interval. `variance_ut2` is the variance of its magnetic field on each axis.
    pub(super) fn update(&mut self, interval: &IntervalMeans, settings: &Settings, variance_ut2: f64) -> TestOutcome {
        let (t_s, delay_s) = (interval.duration_s, self.main.x[TAU]);
        let main_gate = if self.hold_s > 0.0 { 0.0 } else { GATE };
        let main = self.main.measure(interval, delay_s, variance_ut2, main_gate);
        self.hold_s = if main.nis > STRONG_NIS { HOLD_S } else { (self.hold_s - t_s).max(0.0) };
        let body = self.body.measure(interval, delay_s, variance_ut2, GATE);
        let environment = self.environment.measure(interval, delay_s, variance_ut2, GATE);
        let is_turning = interval.rate_rms_rad_s > MIN_TURN_RATE_RAD_S;
        if is_turning {
            let lead = |nis: f64, determinant: f64| {
                nis.min(MAX_NIS) - body.nis.min(MAX_NIS) + libm::log(determinant / body.determinant)
                    - ALLOWANCE_PER_S * t_s
            };
            self.lead_over_main = (self.lead_over_main + lead(main.nis, main.determinant)).max(0.0);
            self.lead_over_environment =
                (self.lead_over_environment + lead(environment.nis, environment.determinant)).max(0.0);
        }
        self.challenger_rejected_s = if body.accepted { 0.0 } else { self.challenger_rejected_s + t_s };
        self.challenge_age_s += t_s;
        self.challenge_turn_rad += interval.rate_rms_rad_s * t_s;
        let on_probation = self.accepted_s < PROBATION_S;
        if main.accepted {
            self.accepted_s = (self.accepted_s + t_s).min(PROBATION_S);
            self.rejected_s = (self.rejected_s - 2.0 * t_s).max(0.0);
        } else if is_turning || on_probation {
            self.rejected_s += t_s;
        }
        self.update_roughness(main.nis, interval);
        if main.accepted {
            self.new_field.observe_other(t_s);
        } else if is_turning {
            self.new_field.observe_rejected(interval.field_ut, t_s);
        }
        if main.accepted && is_turning {
            self.supported_s = (self.supported_s + t_s).min(WELL_SUPPORTED_S);
        }
        let is_field_new = self.new_field.steady_s() > self.min_new_field_s(on_probation);
        let max_rejected_s = self.accepted_s.max(MIN_PROBATION_REJECTION_S);
        let mut replaced = false;
        if self.lead_over_main > WIN_MARGIN && self.lead_over_environment > WIN_MARGIN && self.has_new_hard_iron() {
            self.main = self.body;
            (self.rejected_s, self.hold_s) = (0.0, 0.0);
            self.restart_challengers();
            replaced = true;
        } else if self.rejected_s > max_rejected_s && self.direction_invalidated && on_probation {
            // The first magnetic fields after the invalidation were rotated into the level frame
            // while the level was still wrong, so the direction is invalidated once more.
            self.invalidate_direction();
            self.direction_invalidated = false;
            replaced = true;
        } else if is_field_new || self.rejected_s > REJECTION_TIMEOUT_S {
            let mut reset = FieldFilter::new(settings);
            if !on_probation {
                reset.keep_gyro_and_delay(&self.main, CHALLENGER_SD_UT);
            }
            *self = Self { roughness: self.roughness, ..Self::new(reset) };
            self.start(interval, delay_s, variance_ut2);
            replaced = true;
        } else if self.challenger_rejected_s > CHALLENGER_REJECTION_TIMEOUT_S
            || self.challenge_age_s > CHALLENGE_TIMEOUT_S
        {
            self.restart_challengers();
        }
        TestOutcome { accepted: main.accepted, replaced }
    }

    /// Updates the roughness of the magnetic field. `nis` is the main filter's normalised
    /// innovation squared.
    fn update_roughness(&mut self, nis: f64, interval: &IntervalMeans) {
        if interval.at_rest {
            return;
        }
        let roughness = nis.min(MAX_NIS) / DEGREES_OF_FREEDOM;
        let gain = (interval.duration_s / ROUGHNESS_MEMORY_S).min(1.0);
        self.roughness += (roughness - self.roughness) * gain;
    }

    /// Returns the time for which another magnetic field must be steady to replace that of the main
    /// filter, s.
    fn min_new_field_s(&self, on_probation: bool) -> f64 {
        if self.supported_s >= WELL_SUPPORTED_S {
            return REJECTION_TIMEOUT_S;
        }
        self.supported_s.max(if on_probation { MIN_NEW_FIELD_ON_PROBATION_S } else { MIN_NEW_FIELD_S })
    }

    /// Returns the standard deviation of the heading, rad, given that of the main filter M.
    ///
    /// - A magnetic field with a high roughness increases the deviation.
    /// - A new field is the earth's field with a probability that depends on the times for which
    ///   the new field and the field of M were observed. In that case the heading is wrong by the
    ///   angle between the two fields.
    /// - Until the body has moved, the field in use may be that of iron nearby.
    pub(super) fn credible_sd_rad(&self, sd_rad: f64) -> f64 {
        let steady_s = self.new_field.steady_s();
        let [x, y, _] = self.new_field.mean_ut();
        let [across, along] = [self.main.x[E], self.main.x[E + 1]];
        let angle_rad = libm::atan2(across * y - along * x, across * x + along * y);
        let probability = steady_s / (steady_s + self.supported_s + 1.0);
        let unmoved_rad = UNMOVED_SD_RAD * libm::exp(-self.supported_s / CONFIRMATION_S);
        let variance_rad2 = sd_rad * sd_rad * (self.roughness - REGULAR_ROUGHNESS).clamp(MIN_ROUGHNESS, MAX_ROUGHNESS)
            + angle_rad * angle_rad * probability
            + unmoved_rad * unmoved_rad;
        libm::sqrt(variance_rad2)
    }

    /// Restarts the hypotheses B and E from the main filter M.
    fn restart_challengers(&mut self) {
        (self.body, self.environment) = (self.main, self.main);
        self.body.inflate(B, CHALLENGER_SD_UT);
        self.environment.inflate(E, CHALLENGER_SD_UT);
        (self.lead_over_main, self.lead_over_environment) = (0.0, 0.0);
        (self.challenger_rejected_s, self.challenge_age_s, self.challenge_turn_rad) = (0.0, 0.0, 0.0);
    }

    /// Returns `true` if hypothesis B has found a different hard iron.
    ///
    /// The body must also have turned enough to confirm the change.
    fn has_new_hard_iron(&self) -> bool {
        let distance2_ut2 = self.body.hard_iron_distance2_ut2(&self.main);
        distance2_ut2 > MIN_HARD_IRON_CHANGE_UT * MIN_HARD_IRON_CHANGE_UT
            && self.challenge_turn_rad > MIN_CHALLENGE_TURN_RAD
    }

    /// Processes a return to the last rest site.
    ///
    /// Returns `false` if the magnetic field there does not pass the gate of the main filter M.
    pub(super) fn update_at_rest_site(&mut self) -> bool {
        let accepted = self.main.update_at_rest_site();
        if accepted {
            self.body.update_at_rest_site();
            self.environment.update_at_rest_site();
        }
        accepted
    }

    /// Stores the magnetic field of the current rest site in all hypotheses.
    pub(super) fn store_rest_site(&mut self) {
        self.for_each_filter(FieldFilter::store_rest_site);
    }

    fn for_each_filter(&mut self, mut act: impl FnMut(&mut FieldFilter)) {
        [&mut self.main, &mut self.body, &mut self.environment].into_iter().for_each(&mut act);
    }

    /// Returns the reason why the state is invalid, or `None` if it is valid.
    pub(super) fn validation_error(&self) -> Option<&'static str> {
        let negative = self.supported_s < 0.0 || self.roughness < 0.0 || self.hold_s < 0.0;
        [&self.main, &self.body, &self.environment]
            .into_iter()
            .find_map(FieldFilter::validation_error)
            .or_else(|| self.new_field.validation_error())
            .or(negative.then_some("a time or roughness of the field below zero"))
    }
}

scalars!(HypothesisTest:
    main, body, environment, lead_over_main, lead_over_environment, challenger_rejected_s, challenge_age_s,
    challenge_turn_rad, accepted_s, rejected_s, new_field, supported_s, roughness, hold_s,
    direction_invalidated
);
