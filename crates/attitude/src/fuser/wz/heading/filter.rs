//! Kalman filter of the levelled field: one hypothesis.

use super::{Settings, levelled::Interval};
use crate::stage::Numbers;

/// Numbers in the state: e(3), β, τ, b(3), d(3).
pub(super) const N: usize = 11;
/// Where they begin.
pub(super) const E: usize = 0;
pub(super) const BETA: usize = 3;
pub(super) const TAU: usize = 4;
pub(super) const B: usize = 5;
pub(super) const D: usize = 8;
/// Columns of the covariance, filled up to whole vector registers.
const COLUMNS: usize = 12;

/// What an interval said about a hypothesis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Verdict {
    /// Normalised square of the innovation, three degrees of freedom.
    pub(super) nis: f64,
    /// −2 ln of its likelihood, less a constant.
    pub(super) cost: f64,
    /// It passed the gate and was used.
    pub(super) accepted: bool,
}

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Filter {
    pub(super) x: [f64; N],
    /// Symmetric, both halves kept.
    p: [[f64; COLUMNS]; N],
}

impl Filter {
    pub(super) fn begun(settings: &Settings) -> Self {
        let mut filter = Self { x: [0.0; N], p: [[0.0; COLUMNS]; N] };
        filter.x[TAU] = settings.delay_s;
        filter.open(E, settings.e_sd_ut);
        filter.open(B, settings.hard_iron_sd_ut);
        filter.open(D, settings.d_sd_ut);
        filter.p[BETA][BETA] = settings.beta0_rad_s * settings.beta0_rad_s;
        filter.p[TAU][TAU] = settings.delay_sd_s * settings.delay_sd_s;
        filter
    }

    /// Field, hard iron and disturbance begin anew; drift and delay stay.
    pub(super) fn restart(&mut self, settings: &Settings, young: bool) {
        let begun = Self::begun(settings);
        for i in (E..E + 3).chain(B..D + 3) {
            self.x[i] = 0.0;
            for j in 0..N {
                self.p[i][j] = 0.0;
                self.p[j][i] = 0.0;
            }
            self.p[i][i] = begun.p[i][i];
        }
        if young {
            self.reset(BETA, settings.beta0_rad_s);
            self.reset(TAU, settings.delay_sd_s);
            self.x[TAU] = settings.delay_s;
            return;
        }
        for i in B..B + 3 {
            self.p[i][i] = settings.restart_b_ut * settings.restart_b_ut;
        }
    }

    /// Three states from `first` on may be anything within `sd` of what they were.
    pub(super) fn open(&mut self, first: usize, sd: f64) {
        for i in first..first + 3 {
            self.p[i][i] += sd * sd;
        }
    }

    pub(super) fn variance(&self, i: usize) -> f64 {
        self.p[i][i]
    }

    /// A state is zero within `sd`, whatever was believed of it.
    pub(super) fn reset(&mut self, i: usize, sd: f64) {
        self.x[i] = 0.0;
        for j in 0..N {
            self.p[i][j] = 0.0;
            self.p[j][i] = 0.0;
        }
        self.p[i][i] = sd * sd;
    }

    /// Angle that turns the earth's field to north.
    pub(super) fn turn_rad(&self) -> f64 {
        libm::atan2(self.x[E], self.x[E + 1])
    }

    /// Variance of that angle.
    pub(super) fn turn_variance_rad2(&self) -> f64 {
        let (x, y) = (self.x[E], self.x[E + 1]);
        let across = self.p[0][0] * y * y - 2.0 * self.p[0][1] * x * y + self.p[1][1] * x * x;
        let h2 = x * x + y * y;
        across / (h2 * h2).max(f64::MIN_POSITIVE)
    }

    pub(super) fn predict(&mut self, interval: &Interval, s: &Settings) {
        let t = interval.duration_s;
        let (x, y) = (self.x[E], self.x[E + 1]);
        if !interval.at_rest {
            let angle = (self.x[BETA] * t).clamp(-0.1, 0.1);
            let cos = 1.0 - 0.5 * angle * angle;
            let (tx, ty) = (-y * t, x * t);
            (self.x[E], self.x[E + 1]) = (cos * x - angle * y, cos * y + angle * x);
            let [p0, p1, _, p3, ..] = self.p;
            for j in 0..N {
                self.p[0][j] = cos * p0[j] - angle * p1[j] + tx * p3[j];
                self.p[1][j] = cos * p1[j] + angle * p0[j] + ty * p3[j];
            }
            for row in &mut self.p {
                let (a, b, c) = (row[0], row[1], row[3]);
                row[0] = cos * a - angle * b + tx * c;
                row[1] = cos * b + angle * a + ty * c;
            }
        }
        let f = libm::exp(
            -(s.nu0 + s.nu1 * (interval.turning_rad_s + (interval.acceleration_m_s2 - 0.3).max(0.0) / 2.0)) * t,
        );
        for i in D..D + 3 {
            self.x[i] *= f;
            for j in 0..N {
                self.p[i][j] *= f;
                self.p[j][i] *= f;
            }
            self.p[i][i] += (1.0 - f * f) * s.d_sd_ut * s.d_sd_ut;
        }
        let walk = s.turn0 + s.turn1 * interval.turning_rad_s;
        let q = walk * walk * t;
        self.p[0][0] += q * y * y;
        self.p[0][1] -= q * x * y;
        self.p[1][0] -= q * x * y;
        self.p[1][1] += q * x * x;
        for i in E..E + 3 {
            self.p[i][i] += s.e_walk * s.e_walk * t;
        }
        for i in B..B + 3 {
            self.p[i][i] += s.b_walk * s.b_walk * t;
        }
        self.p[BETA][BETA] += s.beta_walk * s.beta_walk * t;
    }

    pub(super) fn measure(&mut self, interval: &Interval, delay_s: f64, noise: f64, gate: f64) -> Verdict {
        let rate = interval.rate_rad_s;
        let e = [self.x[0], self.x[1], self.x[2]];
        let swept =
            [rate[1] * e[2] - rate[2] * e[1], rate[2] * e[0] - rate[0] * e[2], rate[0] * e[1] - rate[1] * e[0]];
        let late_s = self.x[TAU] - delay_s;
        let mut innovation = [0.0; 3];
        let mut spread = [[0.0; COLUMNS]; 3];
        for i in 0..3 {
            let axes = interval.axes[i];
            innovation[i] = interval.field_ut[i]
                - (e[i]
                    + late_s * swept[i]
                    + axes[0] * self.x[B]
                    + axes[1] * self.x[B + 1]
                    + axes[2] * self.x[B + 2]
                    + self.x[D + i]);
            for j in 0..COLUMNS {
                spread[i][j] = self.p[E + i][j]
                    + self.p[D + i][j]
                    + swept[i] * self.p[TAU][j]
                    + axes[0] * self.p[B][j]
                    + axes[1] * self.p[B + 1][j]
                    + axes[2] * self.p[B + 2][j];
            }
        }
        let s = |i: usize, j: usize| {
            let axes = interval.axes[j];
            spread[i][E + j]
                + spread[i][D + j]
                + swept[j] * spread[i][TAU]
                + axes[0] * spread[i][B]
                + axes[1] * spread[i][B + 1]
                + axes[2] * spread[i][B + 2]
        };
        // S = L Lᵀ
        let d00 = s(0, 0).max(0.0) + noise;
        let r0 = libm::sqrt(d00).recip();
        let (l10, l20) = (s(0, 1) * r0, s(0, 2) * r0);
        let d11 = (s(1, 1) - l10 * l10).max(0.0) + noise;
        let r1 = libm::sqrt(d11).recip();
        let l21 = (s(1, 2) - l10 * l20) * r1;
        let d22 = (s(2, 2) - l20 * l20 - l21 * l21).max(0.0) + noise;
        let r2 = libm::sqrt(d22).recip();
        let z0 = innovation[0] * r0;
        let z1 = (innovation[1] - l10 * z0) * r1;
        let z2 = (innovation[2] - l20 * z0 - l21 * z1) * r2;
        let nis = z0 * z0 + z1 * z1 + z2 * z2;
        let accepted = nis < gate;
        let cost = nis.min(30.0) + libm::log(d00 * d11 * d22);
        if accepted {
            for j in 0..COLUMNS {
                let w0 = spread[0][j] * r0;
                let w1 = (spread[1][j] - l10 * w0) * r1;
                let w2 = (spread[2][j] - l20 * w0 - l21 * w1) * r2;
                (spread[0][j], spread[1][j], spread[2][j]) = (w0, w1, w2);
            }
            let [w0, w1, w2] = spread;
            for i in 0..N {
                self.x[i] += w0[i] * z0 + w1[i] * z1 + w2[i] * z2;
                for j in 0..COLUMNS {
                    self.p[i][j] -= w0[i] * w0[j] + w1[i] * w1[j] + w2[i] * w2[j];
                }
            }
            self.x[TAU] = self.x[TAU].clamp(-0.01, 0.04);
        }
        Verdict { nis, cost, accepted }
    }

    pub(super) fn flaw(&self) -> Option<&'static str> {
        (0..N).any(|i| self.p[i][i] < 0.0).then_some("a variance below zero")
    }
}

impl Numbers for Filter {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.x.iter_mut().for_each(&mut *visit);
        for i in 0..N {
            for j in i..N {
                visit(&mut self.p[i][j]);
                self.p[j][i] = self.p[i][j];
            }
        }
    }
}
