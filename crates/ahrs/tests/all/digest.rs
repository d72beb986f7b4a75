//! Digest of all bits of attitudes, to compare processors and languages.
use plumbline_ahrs::Attitude;

/// FNV-1a hash over 64-bit words.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Digest(pub(crate) u64);

impl Digest {
    /// Returns the digest of no attitude.
    pub(crate) fn new() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }

    /// Adds all values of an attitude.
    pub(crate) fn add(&mut self, attitude: &Attitude) {
        let words = [
            attitude.tick(),
            attitude.t_ns().cast_unsigned(),
            attitude.flags().0,
            attitude.heading_reference() as u64,
            attitude.reset_counter(),
        ];
        words.into_iter().for_each(|word| self.add_word(word));
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
        self.add_numbers(&scalars);
        self.add_numbers(&attitude.quaternion());
        self.add_numbers(&attitude.rate_rad_s());
        self.add_numbers(&attitude.gyro_bias_rad_s());
        self.add_numbers(&attitude.jump());
    }

    fn add_numbers(&mut self, numbers: &[f64]) {
        numbers.iter().for_each(|number| self.add_word(number.to_bits()));
    }

    fn add_word(&mut self, word: u64) {
        self.0 = (self.0 ^ word).wrapping_mul(0x100_0000_01b3);
    }
}
