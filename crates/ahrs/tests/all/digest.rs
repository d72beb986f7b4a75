//! Bitwise digest of attitudes. It shows that all processors and languages yield the same bits.
use plumbline_ahrs::Attitude;

/// FNV-1a hash over 64-bit words.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Digest(pub(crate) u64);

impl Digest {
    /// Returns the digest before any attitude is added.
    pub(crate) fn new() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }

    /// Adds all values of an attitude to the digest.
    pub(crate) fn add(&mut self, attitude: &Attitude) {
        words(attitude).for_each(|word| self.add_word(word));
    }

    fn add_word(&mut self, word: u64) {
        self.0 = (self.0 ^ word).wrapping_mul(0x100_0000_01b3);
    }
}

/// Returns the bit patterns of all values in an attitude.
pub(crate) fn words(attitude: &Attitude) -> impl Iterator<Item = u64> {
    let words = [
        attitude.tick(),
        attitude.t_ns().cast_unsigned(),
        attitude.flags().0,
        attitude.heading_reference() as u64,
        attitude.reset_counter(),
    ];
    let angles = attitude.angles();
    let scalars = [
        angles.yaw_rad,
        angles.pitch_rad,
        angles.roll_rad,
        attitude.heading_rad(),
        attitude.heading_sd_rad(),
        attitude.declination_rad(),
        attitude.inclination_sd_rad(),
        attitude.innovation_rad(),
    ];
    let vectors = attitude.quaternion().into_iter().chain(attitude.rate_rad_s()).chain(attitude.gyro_bias_rad_s());
    let numbers = scalars.into_iter().chain(vectors).chain(attitude.jump());
    words.into_iter().chain(numbers.map(f64::to_bits))
}
