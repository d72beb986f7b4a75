//! Random numbers, the same bits on every machine.

use attitude::Vector3;
use rand_chacha::{ChaCha8Rng, rand_core::Rng, rand_core::SeedableRng};

/// What a sequence of random numbers is for; each use has its own, so that none shifts another.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Use {
    Accel,
    Gyro,
    Field,
    Fix,
    Constants,
    Flight,
    Air,
}

/// A sequence of random numbers.
#[derive(Debug, Clone)]
pub(crate) struct Noise(ChaCha8Rng);

impl Noise {
    pub(crate) fn new(seed: u64, of: Use) -> Self {
        let mut numbers = ChaCha8Rng::seed_from_u64(seed);
        numbers.set_stream(of as u64);
        Self(numbers)
    }

    /// Uniform in (0, 1).
    pub(crate) fn unit(&mut self) -> f64 {
        ((self.0.next_u64() >> 11) as f64 + 0.5) / (1u64 << 53) as f64
    }

    /// Uniform between two numbers.
    pub(crate) fn between(&mut self, least: f64, most: f64) -> f64 {
        least + (most - least) * self.unit()
    }

    /// Uniform phase, rad.
    pub(crate) fn phase(&mut self) -> f64 {
        self.between(0.0, core::f64::consts::TAU)
    }

    /// −1 or 1.
    pub(crate) fn sign(&mut self) -> f64 {
        if self.unit() < 0.5 { -1.0 } else { 1.0 }
    }

    /// A sign for each axis.
    pub(crate) fn signs(&mut self) -> Vector3<f64> {
        Vector3::new(self.sign(), self.sign(), self.sign())
    }

    /// A normal deviate by Box and Muller.
    pub(crate) fn normal(&mut self) -> f64 {
        let (first, second) = (self.unit(), self.unit());
        libm::sqrt(-2.0 * libm::log(first)) * libm::cos(core::f64::consts::TAU * second)
    }

    /// A normal deviate for each axis.
    pub(crate) fn normals(&mut self) -> Vector3<f64> {
        Vector3::new(self.normal(), self.normal(), self.normal())
    }
}
