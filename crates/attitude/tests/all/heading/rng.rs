//! Pseudo-random numbers that are identical on every machine.

use attitude::Vector3;

/// Steele's splitmix64 generator.
pub(crate) struct Rng(u64);

impl Rng {
    pub(crate) fn from_seed(seed: u64) -> Self {
        Self(seed)
    }

    /// Returns a number uniformly distributed in 0..1.
    pub(crate) fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Returns a number uniformly distributed between two bounds.
    pub(crate) fn uniform_in(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Returns a normally distributed number with mean 0 and variance 1 (Box and Muller).
    pub(crate) fn normal(&mut self) -> f64 {
        let (length, angle) = ((-2.0 * (1.0 - self.uniform()).ln()).sqrt(), core::f64::consts::TAU * self.uniform());
        length * angle.cos()
    }

    /// Returns a direction uniformly distributed over the sphere.
    pub(crate) fn direction(&mut self) -> Vector3<f64> {
        let (z, angle) = (self.uniform_in(-1.0, 1.0), self.uniform_in(0.0, core::f64::consts::TAU));
        let r = (1.0 - z * z).sqrt();
        Vector3::new(r * angle.cos(), r * angle.sin(), z)
    }
}
