//! Random numbers for the fault injector.

use attitude::{
    Vector3,
    gnss::{Fix, ReceiverFix},
};

use crate::source::Reading;

/// Random number generator (splitmix64) with the same sequence on every machine.
#[derive(Debug, Clone)]
pub(super) struct FaultRng(pub(super) u64);

impl FaultRng {
    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Returns a uniform deviate in [0, 1).
    pub(super) fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    fn value(&mut self) -> f64 {
        match self.bits() % 8 {
            0 => f64::NAN,
            1 => f64::INFINITY,
            2 => f64::NEG_INFINITY,
            3 => 1e300,
            4 => -1e300,
            5 => 200.0 * self.unit() - 100.0,
            _ => f64::from_bits(self.bits()),
        }
    }

    fn vector(&mut self) -> [f64; 3] {
        std::array::from_fn(|_| self.value())
    }

    /// Returns the reading with arbitrary values in place of those present.
    pub(super) fn garbage(&mut self, reading: &Reading) -> Reading {
        Reading {
            rate_rad_s: self.vector(),
            force_m_s2: self.vector(),
            field_ut: reading.field_ut.map(|_| self.vector()),
            fix: reading.fix.map(|received| {
                let fix = Fix {
                    velocity_m_s: Vector3::from(self.vector()),
                    sd_m_s: Some(self.value()),
                    age_s: Some(self.value()),
                    latitude_rad: Some(self.value()),
                };
                ReceiverFix { fix, ..received }
            }),
            ..*reading
        }
    }
}
