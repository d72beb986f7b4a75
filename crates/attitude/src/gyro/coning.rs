//! Coning correction: the difference between the rotation vector of an interval and the integral of
//! the rate.
//!
//! If the axis of rotation moves, the integral Δθ of the rate is not the rotation vector φ of the
//! interval. To the second order
//!
//! φ = Δθ + ½ ∫ α × ω dt, α the integral of ω from the interval's start
//!
//! — Bortz, A new mathematical formulation for strapdown inertial navigation, *IEEE Transactions
//! AES* 7, 1971. If the rate is a polynomial in time, the integral is a sum of cross products of
//! samples:
//!
//! - If the samples are means over their intervals, the rate is assumed to be linear in time. Its
//!   mean is ω₀ over the previous interval, of length h₀, and ω over this interval, of length h.
//!   Then φ = Δθ + h³/(6 (h₀ + h)) ω₀ × ω. For equal intervals this is Δθ_k + 1/12 Δθ_{k−1} × Δθ_k
//!   — Savage, Strapdown inertial navigation integration algorithm design, *Journal of Guidance,
//!   Control, and Dynamics* 21, 1998. It is the two-sample algorithm of Miller, *ibid.* 6, 1983,
//!   applied at every sample instead of every second one.
//! - If the samples are instantaneous values, the rate is assumed to be quadratic in time and to
//!   pass through the last three samples: ω₀ + b t + c t², where ω₀ is the rate at the start of the
//!   interval. The same quadratic gives Δθ = h ω₀ + h²/2 b + h³/3 c. Computing Δθ as h times the
//!   mean of the rates at both ends would attenuate every vibration, and any error in the amplitude
//!   of Δθ is an error in the area of the cone.
//!
//! The ratio of the residual drift to the drift without correction is of the order (Ω h)², with Ω
//! the frequency of the coning.

use super::motion::{RateKind, RateSample};
use crate::{Vector3, scalars::scalars};

/// Maximum ratio of the longer to the shorter of two successive intervals. Above it, the trend of
/// the rate over both intervals is not used.
const MAX_INTERVAL_RATIO: f64 = 2.0;

/// Coning correction, with the last two rates that it needs.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Coning {
    /// Last two rates, newest first, rad/s.
    rates_rad_s: [Vector3<f64>; 2],
    /// Interval between the two rates, s; 0 before the second sample. If the rates are means, it is
    /// the averaging interval of the newer one.
    interval_s: f64,
    started: bool,
}

/// Rotation of one interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct IntervalRotation {
    /// Rotation vector φ in body axes at the start of the interval, rad.
    pub(super) vector_rad: Vector3<f64>,
    /// Mean rate Δθ/h in body axes, rad/s.
    pub(super) mean_rate_rad_s: Vector3<f64>,
}

impl Coning {
    /// Returns the rotation over the interval that ends with `sample`.
    pub(super) fn step(&mut self, sample: &RateSample) -> IntervalRotation {
        let (h, rate) = (sample.dt_s, sample.rate_rad_s);
        let comparable = self.interval_s > 0.0
            && h <= MAX_INTERVAL_RATIO * self.interval_s
            && self.interval_s <= MAX_INTERVAL_RATIO * h;
        // The correction is the second-order term of a series, which is valid only for small
        // angles.
        let small = self.started && rate.norm_squared().max(self.rates_rad_s[0].norm_squared()) * h * h < 1.0;
        let rotation = match sample.kind {
            RateKind::Mean => self.rotation_from_means(rate, h, comparable && small),
            RateKind::Instant => self.rotation_from_instants(rate, h, comparable, small),
        };
        self.rates_rad_s = [rate, self.rates_rad_s[0]];
        self.interval_s = if self.started { h } else { 0.0 };
        self.started = true;
        rotation
    }

    pub(super) fn validation_error(&self) -> Option<&'static str> {
        (self.interval_s < 0.0).then_some("a negative interval")
    }

    fn rotation_from_means(&self, rate: Vector3<f64>, h: f64, usable: bool) -> IntervalRotation {
        let coning = if usable {
            self.rates_rad_s[0].cross(&rate) * (h * h * h / (6.0 * (self.interval_s + h)))
        } else {
            Vector3::zeros()
        };
        IntervalRotation { vector_rad: rate * h + coning, mean_rate_rad_s: rate }
    }

    fn rotation_from_instants(&self, rate: Vector3<f64>, h: f64, comparable: bool, small: bool) -> IntervalRotation {
        let [latest, earlier] = self.rates_rad_s;
        if !small {
            let mean = if self.started { latest * 0.5 + rate * 0.5 } else { rate };
            return IntervalRotation { vector_rad: mean * h, mean_rate_rad_s: mean };
        }
        // Uses b h and c h² instead of b and c, because h may be 0.
        let difference = rate - latest;
        let curvature = if comparable {
            (difference - (latest - earlier) * (h / self.interval_s)) * (h / (h + self.interval_s))
        } else {
            Vector3::zeros()
        };
        let slope = difference - curvature;
        let mean = latest + slope / 2.0 + curvature / 3.0;
        let coning = latest.cross(&slope) / 12.0 + latest.cross(&curvature) / 12.0 + slope.cross(&curvature) / 60.0;
        IntervalRotation { vector_rad: mean * h + coning * (h * h), mean_rate_rad_s: mean }
    }
}

scalars!(Coning: rates_rad_s, interval_s, started);
