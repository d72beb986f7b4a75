//! Coning: what the rotation vector of an interval is more than the integral of the rate.
//!
//! While the axis of a rotation turns, the integral Δθ of the rate is not the rotation vector φ of the interval. To the second order
//!
//! φ = Δθ + ½ ∫ α × ω dt, α the integral of ω from the interval's start
//!
//! — Bortz, A new mathematical formulation for strapdown inertial navigation, *IEEE Transactions AES* 7, 1971. With the rate taken as
//! a polynomial of time the integral is a sum of cross products of samples:
//!
//! - of means, linear through this interval's and the one before's: φ = Δθ + h³/(6 (h₀ + h)) ω₀ × ω, which for equal intervals is
//!   Δθ_k + 1/12 Δθ_{k−1} × Δθ_k — Savage, Strapdown inertial navigation integration algorithm design, *Journal of Guidance, Control,
//!   and Dynamics* 21, 1998; the two-sample algorithm of Miller, *ibid.* 6, 1983, at every sample instead of every other;
//! - of instants, quadratic through the last three: ω₀ + b t + c t², which gives Δθ = h ω₀ + h²/2 b + h³/3 c too, because the mean of
//!   both ends makes every vibration too small, and an error of Δθ's size is an error of the cone's area.
//!
//! A constant error remains, of the order (Ω h)² beside the drift that is taken off, Ω the frequency of the coning.

use super::motion::{RateKind, RateSample};
use crate::{Vector3, numbers::Numbers};

/// Intervals that differ by more than this factor tell nothing about each other's slope.
const ALIKE: f64 = 2.0;

/// The samples before.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Coning {
    /// The latest two, the latest first, rad/s.
    rates_rad_s: [Vector3<f64>; 2],
    /// The interval between them, or that the latest is the mean of, s; 0 where there is none.
    interval_s: f64,
    started: bool,
}

/// The rotation of one interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Rotation {
    /// φ, rad.
    pub(super) vector_rad: Vector3<f64>,
    /// Δθ/h, rad/s.
    pub(super) mean_rate_rad_s: Vector3<f64>,
}

impl Coning {
    /// The rotation that a sample ends.
    pub(super) fn step(&mut self, sample: &RateSample) -> Rotation {
        let (h, rate) = (sample.dt_s, sample.rate_rad_s);
        let alike = self.interval_s > 0.0 && h <= ALIKE * self.interval_s && self.interval_s <= ALIKE * h;
        // The series is one for small angles.
        let small = self.started && rate.norm_squared().max(self.rates_rad_s[0].norm_squared()) * h * h < 1.0;
        let rotation = match sample.kind {
            RateKind::Mean => self.of_means(rate, h, alike && small),
            RateKind::Instant => self.of_instants(rate, h, alike, small),
        };
        self.rates_rad_s = [rate, self.rates_rad_s[0]];
        self.interval_s = if self.started { h } else { 0.0 };
        self.started = true;
        rotation
    }

    pub(super) fn flaw(&self) -> Option<&'static str> {
        (self.interval_s < 0.0).then_some("an interval below zero")
    }

    fn of_means(&self, rate: Vector3<f64>, h: f64, known: bool) -> Rotation {
        let coning = if known {
            self.rates_rad_s[0].cross(&rate) * (h * h * h / (6.0 * (self.interval_s + h)))
        } else {
            Vector3::zeros()
        };
        Rotation { vector_rad: rate * h + coning, mean_rate_rad_s: rate }
    }

    fn of_instants(&self, rate: Vector3<f64>, h: f64, alike: bool, small: bool) -> Rotation {
        let [first, earlier] = self.rates_rad_s;
        if !small {
            let mean = if self.started { first * 0.5 + rate * 0.5 } else { rate };
            return Rotation { vector_rad: mean * h, mean_rate_rad_s: mean };
        }
        // b h and c h², so that h may be 0.
        let rise = rate - first;
        let bend = if alike {
            (rise - (first - earlier) * (h / self.interval_s)) * (h / (h + self.interval_s))
        } else {
            Vector3::zeros()
        };
        let slope = rise - bend;
        let mean = first + slope / 2.0 + bend / 3.0;
        let coning = first.cross(&slope) / 12.0 + first.cross(&bend) / 12.0 + slope.cross(&bend) / 60.0;
        Rotation { vector_rad: mean * h + coning * (h * h), mean_rate_rad_s: mean }
    }
}

impl Numbers for Coning {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.rates_rad_s.iter_mut().for_each(|rate| rate.visit(visit));
        self.interval_s.visit(visit);
        self.started.visit(visit);
    }
}
