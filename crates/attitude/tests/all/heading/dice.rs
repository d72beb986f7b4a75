//! Random numbers, the same on every machine.

use attitude::Vector3;

/// Steele's splitmix64.
pub(crate) struct Dice(u64);

impl Dice {
    /// From a seed.
    pub(crate) fn of(seed: u64) -> Self {
        Self(seed)
    }

    /// In 0..1.
    pub(crate) fn roll(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Between two bounds.
    pub(crate) fn between(&mut self, least: f64, most: f64) -> f64 {
        least + (most - least) * self.roll()
    }

    /// Normal, of mean 0 and variance 1 (Box and Muller).
    pub(crate) fn normal(&mut self) -> f64 {
        let (length, angle) = ((-2.0 * (1.0 - self.roll()).ln()).sqrt(), core::f64::consts::TAU * self.roll());
        length * angle.cos()
    }

    /// A direction, even over the sphere.
    pub(crate) fn direction(&mut self) -> Vector3<f64> {
        let (z, angle) = (self.between(-1.0, 1.0), self.between(0.0, core::f64::consts::TAU));
        let r = (1.0 - z * z).sqrt();
        Vector3::new(r * angle.cos(), r * angle.sin(), z)
    }
}
