//! Messages of this system.
//!
//! Input: protobuf as `proto/plumbline/v1` defines it. Output: samples; axes and units are ours already. Time: that of each sample
//! on the source's clock, `t_end_ns`; the reference has the number of its sample. Failure: `None` of what is no message.

use std::collections::VecDeque;

use messages::{Flags, GnssFix, ImuSample, MagSample, Reference};
use wire::Payload;

use super::{Fix, Inertial, Position};
use crate::{force_aligner::Sample, row_writer::Attitude};

/// Samples and references that wait for each other.
const MAX_WAITING: usize = 4096;

/// A sample and its number.
pub(super) fn inertial(data: &[u8]) -> Option<(u64, Inertial)> {
    let ImuSample { header, rate_rad_s, force_m_s2 } = ImuSample::from_bytes(data).ok()?;
    let is_instant = header.flags.any(Flags::RATE_INSTANT);
    Some((header.tick, Inertial { t_ns: header.t_end_ns, rate_rad_s, force_m_s2, is_instant, attitude: None }))
}

pub(super) fn field(data: &[u8]) -> Option<Sample> {
    let MagSample { header, field_ut } = MagSample::from_bytes(data).ok()?;
    Some((header.t_end_ns, field_ut))
}

pub(super) fn fix(data: &[u8]) -> Option<Fix> {
    let GnssFix { header, velocity_m_s, latitude_rad, longitude_rad, altitude_m, .. } = GnssFix::from_bytes(data).ok()?;
    let [latitude_deg, longitude_deg] = [latitude_rad, longitude_rad].map(degrees);
    Some(Fix {
        t_ns: header.t_end_ns,
        velocity_m_s,
        position: Some(Position { latitude_deg, longitude_deg, altitude_m }),
    })
}

/// The angle in degrees that has these radians: of the few that do, the one with the fewest digits, which is the one that was written.
fn degrees(angle_rad: f64) -> f64 {
    let near = angle_rad.to_degrees();
    let neighbours = [near, near.next_up(), near.next_down(), near.next_up().next_up(), near.next_down().next_down()];
    let same = neighbours.into_iter().filter(|angle_deg| angle_deg.to_radians() == angle_rad);
    same.min_by_key(|angle_deg| angle_deg.to_string().len()).unwrap_or(near)
}

pub(super) fn reference(data: &[u8]) -> Option<Reference> {
    Reference::from_bytes(data).ok()
}

/// Samples and references, joined by their number.
#[derive(Default)]
pub(super) struct Joined {
    samples: VecDeque<(u64, i64)>,
    references: VecDeque<Reference>,
}

impl Joined {
    /// Takes a sample's number and time.
    pub(super) fn sample(&mut self, tick: u64, t_ns: i64) -> Option<Attitude> {
        let waiting = self.references.iter().position(|reference| reference.tick == tick);
        if let Some(reference) = waiting.and_then(|index| self.references.drain(..=index).next_back()) {
            return Some(attitude(t_ns, &reference));
        }
        push(&mut self.samples, (tick, t_ns));
        None
    }

    pub(super) fn reference(&mut self, reference: Reference) -> Option<Attitude> {
        let waiting = self.samples.iter().position(|(tick, _)| *tick == reference.tick);
        if let Some((_, t_ns)) = waiting.and_then(|index| self.samples.drain(..=index).next_back()) {
            return Some(attitude(t_ns, &reference));
        }
        push(&mut self.references, reference);
        None
    }
}

fn attitude(t_ns: i64, reference: &Reference) -> Attitude {
    let reference = recording::Reference { quaternion: reference.quaternion, scored: reference.scored != 0 };
    Attitude { t_ns, reference, reset_counter: None }
}

fn push<T>(waiting: &mut VecDeque<T>, next: T) {
    if waiting.len() >= MAX_WAITING {
        waiting.pop_front();
    }
    waiting.push_back(next);
}

#[cfg(test)]
mod tests {
    use super::degrees;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn degrees_as_they_are_written_come_back_from_radians(steps in -1_800_000_000_i64..=1_800_000_000) {
            let told_deg = steps as f64 / 1e7;
            prop_assert_eq!(degrees(told_deg.to_radians()), told_deg);
        }
    }

    #[test]
    fn what_is_not_known_stays_so() {
        assert!(degrees(f64::NAN).is_nan());
    }
}
