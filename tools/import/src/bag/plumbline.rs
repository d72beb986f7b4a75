//! Decoding of Plumbline messages.
//!
//! Input: protobuf as defined in `proto/plumbline/v1`.
//!
//! Output: samples. Axes and units are already native.
//!
//! Time: `t_end_ns` of each sample, on the source's clock. A reference contains the tick of its
//! sample instead of a time.
//!
//! Failure: `None` if the message is invalid.

use std::collections::VecDeque;

use messages::{Flags, GnssFix, ImuSample, MagSample, Reference};
use wire::Payload;

use super::samples::{InertialSample, Position, VelocityFix};
use crate::row_writer::{Attitude, Sample};

/// Maximum length of each queue. One queue holds the samples waiting for their reference. The other
/// queue holds the references waiting for their sample.
const MAX_PENDING: usize = 4096;

/// Decodes an IMU sample and returns it together with its tick.
pub(super) fn inertial(data: &[u8]) -> Option<(u64, InertialSample)> {
    let ImuSample { header, rate_rad_s, force_m_s2 } = ImuSample::from_bytes(data).ok()?;
    let is_instant = header.flags.any(Flags::RATE_INSTANT);
    let (rate_rad_s, force_m_s2) = (Some(rate_rad_s), Some(force_m_s2));
    Some((header.tick, InertialSample { t_ns: header.t_end_ns, rate_rad_s, force_m_s2, is_instant, attitude: None }))
}

pub(super) fn field(data: &[u8]) -> Option<Sample> {
    let MagSample { header, field_ut } = MagSample::from_bytes(data).ok()?;
    Some((header.t_end_ns, field_ut))
}

pub(super) fn fix(data: &[u8]) -> Option<VelocityFix> {
    let GnssFix { header, velocity_m_s, latitude_rad, longitude_rad, altitude_m, .. } =
        GnssFix::from_bytes(data).ok()?;
    let [latitude_deg, longitude_deg] = [latitude_rad, longitude_rad].map(shortest_degrees);
    Some(VelocityFix {
        t_ns: header.t_end_ns,
        velocity_m_s,
        position: Some(Position { latitude_deg, longitude_deg, altitude_m }),
    })
}

/// Converts an angle in radians back to the degrees from which it was computed.
///
/// Several neighbouring values in degrees convert to the same radians. The one with the fewest
/// digits is returned.
fn shortest_degrees(angle_rad: f64) -> f64 {
    let nearest_deg = angle_rad.to_degrees();
    let candidates = [
        nearest_deg,
        nearest_deg.next_up(),
        nearest_deg.next_down(),
        nearest_deg.next_up().next_up(),
        nearest_deg.next_down().next_down(),
    ];
    let matching = candidates.into_iter().filter(|angle_deg| angle_deg.to_radians() == angle_rad);
    matching.min_by_key(|angle_deg| angle_deg.to_string().len()).unwrap_or(nearest_deg)
}

pub(super) fn reference(data: &[u8]) -> Option<Reference> {
    Reference::from_bytes(data).ok()
}

/// Joins samples and references by tick.
#[derive(Default)]
pub(super) struct ReferenceJoin {
    pending_samples: VecDeque<(u64, i64)>,
    pending_references: VecDeque<Reference>,
}

impl ReferenceJoin {
    /// Adds the tick and the time of a sample.
    ///
    /// Returns the attitude if the reference for this tick has already been added.
    pub(super) fn push_sample(&mut self, tick: u64, t_ns: i64) -> Option<Attitude> {
        let index = self.pending_references.iter().position(|reference| reference.tick == tick);
        if let Some(reference) = index.and_then(|index| self.pending_references.drain(..=index).next_back()) {
            return Some(attitude(t_ns, &reference));
        }
        push_bounded(&mut self.pending_samples, (tick, t_ns));
        None
    }

    /// Adds a reference. Returns the attitude if the sample for its tick has already been added.
    pub(super) fn push_reference(&mut self, reference: Reference) -> Option<Attitude> {
        let index = self.pending_samples.iter().position(|(tick, _)| *tick == reference.tick);
        if let Some((_, t_ns)) = index.and_then(|index| self.pending_samples.drain(..=index).next_back()) {
            return Some(attitude(t_ns, &reference));
        }
        push_bounded(&mut self.pending_references, reference);
        None
    }
}

fn attitude(t_ns: i64, reference: &Reference) -> Attitude {
    let reference = recording::Reference { quaternion: reference.quaternion, scored: reference.scored != 0 };
    Attitude { t_ns, reference, reset_counter: None }
}

/// Appends to a queue and drops the oldest item if the queue is full.
fn push_bounded<T>(queue: &mut VecDeque<T>, item: T) {
    if queue.len() >= MAX_PENDING {
        queue.pop_front();
    }
    queue.push_back(item);
}

#[cfg(test)]
mod tests {
    use super::shortest_degrees;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn degrees_survive_conversion_to_radians_and_back(steps in -1_800_000_000_i64..=1_800_000_000) {
            let written_deg = steps as f64 / 1e7;
            prop_assert_eq!(shortest_degrees(written_deg.to_radians()), written_deg);
        }
    }

    #[test]
    fn nan_angle_stays_nan() {
        assert!(shortest_degrees(f64::NAN).is_nan());
    }
}
