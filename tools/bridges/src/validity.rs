//! Validity check of an attitude before it is sent.
//!
//! - Input: an attitude and CLOCK_MONOTONIC.
//! - Output: `Ok` if the attitude may be sent, otherwise the reason.

use messages::{AttitudeOutput, Flags, Header};

/// Maximum age of a message since its publication, ns.
pub const MAX_AGE_NS: u64 = 500_000_000;
/// Maximum deviation of the quaternion's norm from 1.
const NORM_TOLERANCE: f64 = 1e-6;

/// Reason for not sending a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WithholdReason {
    /// The attitude is an initial value, not yet aligned with the accelerometer.
    Unaligned,
    /// The quaternion is not a rotation, or a value is not finite.
    Invalid,
    /// The message was published too long ago.
    Stale,
}

/// Checks that an attitude may be sent.
///
/// The attitude must be aligned and recent. The quaternion must be a rotation, and the angles and
/// rates must be finite in single precision.
///
/// # Errors
///
/// Returns the reason why the attitude must not be sent.
pub fn validate(output: &AttitudeOutput, now_ns: u64) -> Result<(), WithholdReason> {
    let AttitudeOutput { header, quaternion, yaw_rad, pitch_rad, roll_rad, rate_rad_s, .. } = output;
    if header.flags.any(Flags::UNALIGNED) {
        return Err(WithholdReason::Unaligned);
    }
    check_age(header, now_ns)?;
    let norm = quaternion.iter().map(|part| part * part).sum::<f64>().sqrt();
    let finite =
        [yaw_rad, pitch_rad, roll_rad].into_iter().chain(rate_rad_s).all(|number| (*number as f32).is_finite());
    if !((norm - 1.0).abs() <= NORM_TOLERANCE && finite) {
        return Err(WithholdReason::Invalid);
    }
    Ok(())
}

/// Checks that a message is recent.
///
/// # Errors
///
/// Returns [`WithholdReason::Stale`] if the message was published too long ago.
pub fn check_age(header: &Header, now_ns: u64) -> Result<(), WithholdReason> {
    if now_ns.saturating_sub(header.t_sent_ns) > MAX_AGE_NS { Err(WithholdReason::Stale) } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable;

    use super::*;

    /// Level attitude facing north, published at time 0.
    fn level() -> AttitudeOutput {
        AttitudeOutput { quaternion: [1.0, 0.0, 0.0, 0.0], ..AttitudeOutput::zeroed() }
    }

    #[test]
    fn invalid_and_stale_attitudes_are_withheld() {
        let with = |change: fn(&mut AttitudeOutput)| {
            let mut output = level();
            change(&mut output);
            validate(&output, 1)
        };
        assert_eq!(with(|_| ()), Ok(()));
        assert_eq!(with(|output| output.header.flags = Flags::UNALIGNED), Err(WithholdReason::Unaligned));
        assert_eq!(with(|output| output.quaternion = [0.0; 4]), Err(WithholdReason::Invalid));
        assert_eq!(with(|output| output.quaternion[3] = f64::NAN), Err(WithholdReason::Invalid));
        assert_eq!(with(|output| output.rate_rad_s[1] = 1e300), Err(WithholdReason::Invalid));
        assert_eq!(validate(&level(), MAX_AGE_NS), Ok(()));
        assert_eq!(validate(&level(), MAX_AGE_NS + 1), Err(WithholdReason::Stale));
    }
}
