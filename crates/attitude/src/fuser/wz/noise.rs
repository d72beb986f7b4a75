//! Noise of force and velocity measurements, estimated from their innovations.
//!
//! Input: the innovation of each update.
//!
//! Output: the variance of an equivalent measurement whose noise is independent from update to
//! update.
//!
//! Time: the intervals of the updates.

use crate::{Complex, scalars::scalars};

/// Averaging time of the innovations' mean square, s.
pub(super) const MEMORY_S: f64 = 5.0;
/// Duration over which the initial mean square is assumed to have been observed, s.
pub(super) const INITIAL_MEMORY_S: f64 = 0.5;
/// Largest squared innovation that is treated as regular, in variances.
const MAX_INNOVATION2: f64 = 9.0;

/// Mean square of the innovations, and mean product of successive innovations.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct InnovationNoise {
    mean_square: f64,
    mean_lag_product: f64,
    last_innovation: Complex<f64>,
    memory_s: f64,
}

impl InnovationNoise {
    /// Creates the estimate with an initial standard deviation.
    pub(super) fn new(sd: f64) -> Self {
        Self {
            mean_square: sd * sd,
            mean_lag_product: 0.0,
            last_innovation: Complex::new(0.0, 0.0),
            memory_s: INITIAL_MEMORY_S,
        }
    }

    /// Returns the averaging time in effect, s. It includes [`INITIAL_MEMORY_S`].
    pub(super) fn memory_s(&self) -> f64 {
        self.memory_s
    }

    /// Records an innovation and returns the variance to use for its measurement.
    ///
    /// Successive innovations with correlation coefficient ρ contain as much information as fewer
    /// independent ones: the variance of their mean is (1 + ρ)/(1 − ρ) times that of independent
    /// innovations. `correlation` holds the lower and the upper limit of this factor.
    pub(super) fn update(&mut self, innovation: Complex<f64>, interval_s: f64, correlation: (f64, f64)) -> f64 {
        self.memory_s = (self.memory_s + interval_s).min(MEMORY_S);
        let gain = (interval_s / self.memory_s).min(1.0);
        let square = 0.5 * innovation.norm_sqr();
        let product = 0.5 * (innovation.re * self.last_innovation.re + innovation.im * self.last_innovation.im);
        self.mean_square += (square - self.mean_square) * gain;
        self.mean_lag_product += (product - self.mean_lag_product) * gain;
        self.last_innovation = innovation;
        let (sum, difference) = (self.mean_square + self.mean_lag_product, self.mean_square - self.mean_lag_product);
        let (min, max) = correlation;
        let factor = if sum < max * difference { (sum / difference).max(min) } else { max };
        (self.mean_square * factor).max(square / MAX_INNOVATION2)
    }

    /// Returns the reason why the state is invalid, or `None` if it is valid.
    pub(super) fn validation_error(&self) -> Option<&'static str> {
        (self.mean_square < 0.0)
            .then_some("a mean square below zero")
            .or((self.memory_s <= 0.0).then_some("an averaging time of innovations that is not positive"))
    }
}

scalars!(InnovationNoise: mean_square, mean_lag_product, last_innovation, memory_s);
