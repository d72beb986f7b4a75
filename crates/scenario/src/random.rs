//! Random numbers with the same bits on every machine.

use attitude::Vector3;
use rand_chacha::{ChaCha8Rng, rand_core::Rng, rand_core::SeedableRng};

/// Purpose of a random stream. Each purpose has its own stream, so that drawing from one does not
/// affect the others.
#[derive(Debug, Clone, Copy)]
pub(crate) enum StreamId {
    Accel,
    Gyro,
    Field,
    Fix,
    Constants,
    Flight,
    Air,
}

/// Stream of random numbers.
#[derive(Debug, Clone)]
pub(crate) struct RandomStream(ChaCha8Rng);

impl RandomStream {
    pub(crate) fn new(seed: u64, stream: StreamId) -> Self {
        let mut numbers = ChaCha8Rng::seed_from_u64(seed);
        numbers.set_stream(stream as u64);
        Self(numbers)
    }

    /// Returns a uniform deviate in (0, 1).
    pub(crate) fn unit(&mut self) -> f64 {
        ((self.0.next_u64() >> 11) as f64 + 0.5) / (1u64 << 53) as f64
    }

    /// Returns a uniform deviate between `min` and `max`.
    pub(crate) fn uniform(&mut self, min: f64, max: f64) -> f64 {
        min + (max - min) * self.unit()
    }

    /// Returns a uniformly distributed phase, rad.
    pub(crate) fn phase(&mut self) -> f64 {
        self.uniform(0.0, core::f64::consts::TAU)
    }

    /// Returns −1 or 1 with equal probability.
    pub(crate) fn sign(&mut self) -> f64 {
        if self.unit() < 0.5 { -1.0 } else { 1.0 }
    }

    /// Returns a random sign for each axis.
    pub(crate) fn signs(&mut self) -> Vector3<f64> {
        Vector3::new(self.sign(), self.sign(), self.sign())
    }

    /// Returns a standard normal deviate (Box-Muller method).
    pub(crate) fn normal(&mut self) -> f64 {
        let (first, second) = (self.unit(), self.unit());
        libm::sqrt(-2.0 * libm::log(first)) * libm::cos(core::f64::consts::TAU * second)
    }

    /// Returns a standard normal deviate for each axis.
    pub(crate) fn normals(&mut self) -> Vector3<f64> {
        Vector3::new(self.normal(), self.normal(), self.normal())
    }
}
