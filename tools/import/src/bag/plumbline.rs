//! Decoding of Plumbline messages.
//!
//! Input: protobuf as defined in `proto/plumbline/v1`.
//!
//! Output: samples. Axes and units are already native.
//!
//! Time: `t_end_ns` of each message, on the source's clock.
//!
//! Failure: `None` if the message is invalid.

use messages::{Flags, GnssFix, ImuSample, MagSample, Reference};
use wire::Payload;

use super::samples::{InertialSample, Position, VelocityFix};
use crate::row_writer::{Attitude, Sample};

pub(super) fn inertial(data: &[u8]) -> Option<InertialSample> {
    let ImuSample { header, rate_rad_s, force_m_s2 } = ImuSample::from_bytes(data).ok()?;
    let is_instant = header.flags.any(Flags::RATE_INSTANT);
    let (rate_rad_s, force_m_s2) = (Some(rate_rad_s), Some(force_m_s2));
    Some(InertialSample { t_ns: header.t_end_ns, rate_rad_s, force_m_s2, is_instant, attitude: None })
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

pub(super) fn reference(data: &[u8]) -> Option<Attitude> {
    let Reference { t_end_ns, scored, quaternion, .. } = Reference::from_bytes(data).ok()?;
    let reference = recording::Reference { quaternion, scored: scored != 0 };
    Some(Attitude { t_ns: t_end_ns, reference, reset_counter: None })
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
