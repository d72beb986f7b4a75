//! What is worth being sent.
//!
//! Input: an attitude and CLOCK_MONOTONIC. Output: whether others should see it. Time: an attitude has an age. Failure: the reason.

use messages::{AttitudeOutput, Flags};

/// An attitude that was published longer ago is not sent, ns.
pub const STALE_NS: u64 = 500_000_000;
/// How far the length of a quaternion may be from 1.
const LENGTH_TOLERANCE: f64 = 1e-6;

/// Why an attitude is not sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Withheld {
    /// It is only a start: no accelerometer has been heard.
    Unaligned,
    /// It is no rotation, or not finite.
    Invalid,
    /// It was published too long ago.
    Stale,
}

/// An attitude that has a meaning, is a rotation with rates and angles that single precision holds, and was published not long before `now_ns`.
pub fn check(output: &AttitudeOutput, now_ns: u64) -> Result<(), Withheld> {
    let AttitudeOutput { header, quaternion, yaw_rad, pitch_rad, roll_rad, rate_rad_s, .. } = output;
    if header.flags.any(Flags::UNALIGNED) {
        return Err(Withheld::Unaligned);
    }
    if now_ns.saturating_sub(header.t_sent_ns) > STALE_NS {
        return Err(Withheld::Stale);
    }
    let length = quaternion.iter().map(|part| part * part).sum::<f64>().sqrt();
    let finite =
        [yaw_rad, pitch_rad, roll_rad].into_iter().chain(rate_rad_s).all(|number| (*number as f32).is_finite());
    if !((length - 1.0).abs() <= LENGTH_TOLERANCE && finite) {
        return Err(Withheld::Invalid);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable;

    use super::*;

    /// Level, nose to the north, published at 0.
    fn level() -> AttitudeOutput {
        AttitudeOutput { quaternion: [1.0, 0.0, 0.0, 0.0], ..AttitudeOutput::zeroed() }
    }

    #[test]
    fn what_nobody_should_rely_on_is_withheld() {
        let with = |change: fn(&mut AttitudeOutput)| {
            let mut output = level();
            change(&mut output);
            check(&output, 1)
        };
        assert_eq!(with(|_| ()), Ok(()));
        assert_eq!(with(|output| output.header.flags = Flags::UNALIGNED), Err(Withheld::Unaligned));
        assert_eq!(with(|output| output.quaternion = [0.0; 4]), Err(Withheld::Invalid));
        assert_eq!(with(|output| output.quaternion[3] = f64::NAN), Err(Withheld::Invalid));
        assert_eq!(with(|output| output.rate_rad_s[1] = 1e300), Err(Withheld::Invalid));
        assert_eq!(check(&level(), STALE_NS), Ok(()));
        assert_eq!(check(&level(), STALE_NS + 1), Err(Withheld::Stale));
    }
}
