//! Second filter of the gyro errors, for a bias that the first one considers impossible.
//!
//! Input: the samples and the errors of the first filter.
//!
//! Output: the second filter, once its bias differs significantly from that of the first.
//!
//! Time: the intervals of the updates.
//!
//! Failure: a movement that has the effect of a bias for [`MIN_APART_S`] is mistaken for a bias.
//! This happens in none of the calibrated recordings of the test sets.
//!
//! The first filter estimates its noise from its innovations. It mistakes the effect of a bias of
//! many standard deviations for accelerations. The second filter has a wide prior and follows such
//! a bias. With a calibrated gyro, however, it is less accurate, because accelerations affect its
//! bias more. It is therefore used only if there is evidence of such a bias. The evidence must be
//! stronger once a rest has shown the bias or another stage has handed it over, because the bias
//! must then have changed in motion. A temperature shock may cause such a change.
//!
//! The force in a long turn of a vehicle also looks like the effect of a bias. The second filter
//! restarts from the first one at regular intervals, and after a gyro outage or a tilt fault, whose
//! force would look like the effect of a bias.
//!
//! A large bias causes a tilt fault every few seconds, and a filter that starts again each time
//! does not find it. The second filter therefore continues if its bias explains the fault. The
//! biases must differ, and most of the level error must be part of its estimated tilt error. After
//! a clipped force the biases differ as well, but the filter has not estimated the level error.
//!
//! Measured on Nexus 5 with a bias of 10 °/s on each axis, this rule finds the bias within 60 s in
//! 40 of 40 runs. Two variants are worse. If the biases must differ significantly instead, 39 runs
//! find the bias. If any difference is enough, the level recovers from a clipped force in 41 s
//! instead of 22 s.
//!
//! A prior of 0.05 rad/s instead of 0.1 rad/s is too narrow. A bias of 10 °/s on each axis is then
//! found later or not at all while the body moves. On TUM VI, the mean inclination error rises from
//! 6.8° to 12.3°.
//!
//! The force does not show the bias about the vertical. While the bias has been found only in
//! motion, the stage corrects this component by the drift of the heading, which the magnetic field
//! shows. On Nexus 5 with a bias of 10 °/s added to each axis, the heading error is 9° instead of
//! 38°.

use super::{
    gyro_errors::{GyroErrorFilter, Samples, UpdateInput},
    settings::Settings,
};
use crate::{Complex, scalars::scalars};

/// Standard deviation of an unknown large bias, rad/s. Data sheets of consumer MEMS gyros allow a
/// bias of 10 °/s, which is 1.7 standard deviations.
pub(super) const UNKNOWN_BIAS_SD_RAD_S: f64 = 0.1;
/// Standard deviation of the change of a known bias in the second filter, rad/s. A temperature
/// shock changes the bias by up to a few °/s.
const CHANGED_BIAS_SD_RAD_S: f64 = 0.05;
/// Squared distance between the biases of the two filters above which they count as different.
///
/// The distance is divided by the squared standard deviation of the second filter. The value
/// applies while the bias is unknown. If the errors of the three components were normally
/// distributed, a value of 80 would practically never be exceeded. The margin allows for
/// accelerations that are not normally distributed.
const MIN_DISTANCE2: f64 = 80.0;
/// Value of [`MIN_DISTANCE2`] after a rest or a hand-over has shown the bias. A known bias changes
/// rarely. In the test sets, the distance then stays below 40.
const MIN_DISTANCE2_FROM_KNOWN: f64 = 160.0;
/// Squared distance between the biases above which their difference adds to the level uncertainty.
///
/// The distance is scaled as in [`MIN_DISTANCE2`]. If the errors of the three components are
/// normally distributed, 0.1 % of the distances exceed this value.
const SUSPECTED_DISTANCE2: f64 = 16.0;
/// Largest fraction of the level error that may be missing from the second filter's tilt error, if
/// the filter's bias explains a tilt fault.
///
/// With a bias of 10 °/s on each axis, limits from 0.5 to 0.7 find the bias in 40 of 40 runs, and
/// 0.3 in 36. After a clipped force, the fraction is 0.95.
const MAX_UNEXPLAINED_FRACTION: f64 = 0.6;
/// Time for which the biases of the two filters must differ, s.
const MIN_APART_S: f64 = 2.0 - 1e-6;
/// Time after which the second filter is restarted, s.
const RESTART_S: f64 = 30.0;

/// Second filter of the gyro errors.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct WideBiasFilter {
    filter: GyroErrorFilter,
    running: bool,
    /// Set once a rest has shown the bias or another stage has handed it over. Cleared when the
    /// bias has changed.
    is_bias_known: bool,
    age_s: f64,
    apart_s: f64,
    /// Difference between the biases of the two filters, rad/s, if their squared distance exceeds
    /// `SUSPECTED_DISTANCE2`; otherwise 0.
    suspected_rad_s: f64,
}

impl Default for WideBiasFilter {
    fn default() -> Self {
        Self {
            filter: GyroErrorFilter::default(),
            running: false,
            is_bias_known: false,
            age_s: 0.0,
            apart_s: 0.0,
            suspected_rad_s: 0.0,
        }
    }
}

impl WideBiasFilter {
    /// Creates the filter after a hand-over. `is_bias_known` is `true` if a bias was handed over.
    pub(super) fn after_hand_over(is_bias_known: bool) -> Self {
        Self { is_bias_known, ..Self::default() }
    }

    /// Restarts the filter at the next update.
    pub(super) fn restart(&mut self) {
        *self = Self::after_hand_over(self.is_bias_known);
    }

    /// Processes an update of `first`. `samples` are those of `first` before the update, and
    /// `corrected_rad` is the tilt that the update corrected.
    ///
    /// Returns the second filter if its bias has differed significantly from that of `first` for
    /// [`MIN_APART_S`].
    pub(super) fn update(
        &mut self,
        first: &GyroErrorFilter,
        samples: &Samples,
        input: &UpdateInput,
        corrected_rad: Complex<f64>,
        settings: &Settings,
    ) -> Option<GyroErrorFilter> {
        if input.bias_at_rest.is_some() {
            *self = Self::after_hand_over(true);
            return None;
        }
        let interval_s = samples.interval_s();
        self.age_s += interval_s;
        let expired = self.age_s > RESTART_S && self.apart_s == 0.0;
        if expired || !self.running {
            let bias_sd_rad_s = if self.is_bias_known { CHANGED_BIAS_SD_RAD_S } else { UNKNOWN_BIAS_SD_RAD_S };
            let filter = first.with_unknown_bias(bias_sd_rad_s);
            *self = Self { filter, running: true, ..Self::after_hand_over(self.is_bias_known) };
            return None;
        }
        self.filter.update_unused(samples, input, corrected_rad, settings);
        let distance2 = self.filter.bias_distance2(first);
        let is_suspected = distance2 > SUSPECTED_DISTANCE2;
        self.suspected_rad_s = if is_suspected { self.filter.bias_difference_rad_s(first) } else { 0.0 };
        let min_distance2 = if self.is_bias_known { MIN_DISTANCE2_FROM_KNOWN } else { MIN_DISTANCE2 };
        let is_apart = distance2 > min_distance2;
        self.apart_s = if is_apart { self.apart_s + interval_s } else { 0.0 };
        (self.apart_s >= MIN_APART_S).then(|| core::mem::take(self).filter)
    }

    /// Returns `true` if the bias of the second filter explains the level error at a tilt fault.
    pub(super) fn explains(&self, level_error_rad: Complex<f64>) -> bool {
        const MAX_FRACTION2: f64 = MAX_UNEXPLAINED_FRACTION * MAX_UNEXPLAINED_FRACTION;
        let unexplained_rad = level_error_rad - self.filter.tilt_error_rad();
        self.suspected_rad_s > 0.0 && unexplained_rad.norm_sqr() < MAX_FRACTION2 * level_error_rad.norm_sqr()
    }

    /// Returns `true` once a rest has shown the bias or another stage has handed it over.
    pub(super) fn is_bias_known(&self) -> bool {
        self.is_bias_known
    }

    /// Returns the difference between the biases of the two filters, rad/s.
    ///
    /// Returns 0 unless the difference is suspected to be real.
    pub(super) fn suspected_rad_s(&self) -> f64 {
        self.suspected_rad_s
    }

    /// Returns the reason why the state is invalid, or `None` if it is valid.
    pub(super) fn validation_error(&self) -> Option<&'static str> {
        (self.age_s < 0.0 || self.apart_s < 0.0 || self.suspected_rad_s < 0.0)
            .then_some("a time or rate of the second bias filter below zero")
            .or_else(|| self.filter.validation_error())
    }
}

scalars!(WideBiasFilter: filter, running, is_bias_known, age_s, apart_s, suspected_rad_s);
