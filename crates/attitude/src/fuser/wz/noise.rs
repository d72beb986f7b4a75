//! How far the force, and the velocity that it makes, stray from what the level explains: the noise of the two measurements.
//!
//! Input: an innovation of each update. Output: the variance it stands for, were the next independent of it. Time: the
//! updates' intervals. Failure: none.

use crate::{Complex, numbers::Numbers};

/// Memory of the innovation's mean square, s.
pub(super) const MEMORY_S: f64 = 5.0;
/// For how long the innovations before the first are taken to have lasted, s.
pub(super) const MEMORY_BEFORE_S: f64 = 0.5;
/// Square of the largest innovation that is believed, in standard deviations.
const OUTLIER2: f64 = 9.0;

/// The mean square of innovations, and of how alike neighbours are.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Noise {
    mean_square: f64,
    mean_product: f64,
    before: Complex<f64>,
    memory_s: f64,
}

impl Noise {
    /// Before there were any, of this standard deviation.
    pub(super) fn before(sd: f64) -> Self {
        Self { mean_square: sd * sd, mean_product: 0.0, before: Complex::new(0.0, 0.0), memory_s: MEMORY_BEFORE_S }
    }

    /// For how long innovations were seen, s, up to the memory.
    pub(super) fn memory_s(&self) -> f64 {
        self.memory_s
    }

    /// The variance that one innovation stands for, taken for at least `alike.0` and at most `alike.1` that count as one because they
    /// are alike.
    ///
    /// The mean of a sequence whose neighbours correlate by ρ varies by (1 + ρ)/(1 − ρ) as much as if they did not.
    pub(super) fn variance(&mut self, innovation: Complex<f64>, interval_s: f64, alike: (f64, f64)) -> f64 {
        self.memory_s = (self.memory_s + interval_s).min(MEMORY_S);
        let share = (interval_s / self.memory_s).min(1.0);
        let square = 0.5 * innovation.norm_sqr();
        let product = 0.5 * (innovation.re * self.before.re + innovation.im * self.before.im);
        self.mean_square += (square - self.mean_square) * share;
        self.mean_product += (product - self.mean_product) * share;
        self.before = innovation;
        let (together, apart) = (self.mean_square + self.mean_product, self.mean_square - self.mean_product);
        let (least, most) = alike;
        let alike = if together < most * apart { (together / apart).max(least) } else { most };
        (self.mean_square * alike).max(square / OUTLIER2)
    }

    /// What is wrong with the state.
    pub(super) fn flaw(&self) -> Option<&'static str> {
        (self.mean_square < 0.0)
            .then_some("a mean square below zero")
            .or((self.memory_s <= 0.0).then_some("a memory of innovations that is no time"))
    }
}

impl Numbers for Noise {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.mean_square.visit(visit);
        self.mean_product.visit(visit);
        self.before.visit(visit);
        self.memory_s.visit(visit);
    }
}
