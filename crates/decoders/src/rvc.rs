//! BNO08x on a serial line in robot vacuum cleaner mode (UART-RVC): 19-byte frames at 100 Hz.
//!
//! A frame consists of 0xAA 0xAA, a one-byte index, six little-endian 16-bit numbers, three unused
//! bytes and a checksum byte. The numbers are yaw, pitch and roll in 0.01° and the acceleration in
//! mg. The checksum is the sum of the bytes after the 0xAA 0xAA (BNO08X datasheet, 1.3.5.2).
//!
//! **A frame contains no rate.** The body rate is computed as the rotation between the attitudes of
//! two frames divided by their interval. It is the mean rate of the chip's own estimate. A single
//! rate has a coarse resolution of about 1 °/s, but the rounding errors do not accumulate: the
//! integrated rates reproduce the chip's angles. An attitude estimated from these rates is
//! therefore no better than the chip's, and the only visible bias is the one left in the chip's
//! estimate. Use another mode of the chip to read the gyro itself.
//!
//! Axes: x right, y forward, z up. Yaw rotates about z, then pitch about x, then roll about y, as
//! the datasheet's example shows: pitch −1.10°, roll 20.85° and force (−371, −20, 977) mg.
//!
//! Time: the frame index as a 10 ms counter that wraps after 2.56 s. The chip sends no other
//! timestamp.
//!
//! Limits: the first frame, and a frame after more than [`MAX_LOST_FRAMES`] lost ones, yields no
//! measurement. Near pitch ±90° yaw and roll jump, but the rate does not. Because the checksum has
//! only 8 bits, one in 256 corrupted frames is accepted unless its angles are out of range.

use attitude::Quaternion;

use crate::{
    DeviceTime, Measurement, Value,
    framed::{Format, ParseOutcome, three_i16, wrapping_sum},
};

const SYNC: u8 = 0xaa;
const FRAME_BYTES: usize = 19;
const INTERVAL_NS: u64 = 10_000_000;
/// Largest valid yaw, pitch and roll, in units of 0.01°.
const MAX_ANGLES_CENTIDEG: [f64; 3] = [18_000.0, 9_000.0, 18_000.0];
const STANDARD_GRAVITY_M_S2: f64 = 9.80665;
/// Maximum number of lost frames between two frames from which a rate is computed.
pub const MAX_LOST_FRAMES: u8 = 9;

/// UART-RVC format, with the attitude of the last frame.
#[derive(Debug, Clone, Default)]
pub struct Rvc {
    last: Option<(u8, Attitude)>,
}

impl Format for Rvc {
    fn parse(&mut self, bytes: &[u8], measurements: &mut Vec<Measurement>) -> ParseOutcome {
        match bytes {
            [SYNC] => return ParseOutcome::Incomplete,
            [SYNC, SYNC, ..] => {}
            _ => return ParseOutcome::Skip(1),
        }
        let Some(frame) = bytes.first_chunk::<FRAME_BYTES>() else { return ParseOutcome::Incomplete };
        if wrapping_sum(&frame[2..FRAME_BYTES - 1]) != frame[FRAME_BYTES - 1] {
            return ParseOutcome::Rejected;
        }
        let (Some(angles), Some(force)) = (three_i16(frame, 3), three_i16(frame, 9)) else {
            return ParseOutcome::Rejected;
        };
        if angles.iter().zip(MAX_ANGLES_CENTIDEG).any(|(angle, max)| angle.abs() > max) {
            return ParseOutcome::Rejected;
        }
        measurements.extend(self.measurement(frame[2], Attitude::from_angles(angles), force));
        ParseOutcome::Frame(FRAME_BYTES)
    }
}

impl Rvc {
    fn measurement(&mut self, number: u8, attitude: Attitude, force_mg: [f64; 3]) -> Option<Measurement> {
        let (last_number, last) = self.last.replace((number, attitude))?;
        let intervals = number.wrapping_sub(last_number);
        if !(1..=MAX_LOST_FRAMES + 1).contains(&intervals) {
            return None;
        }
        let interval_s = f64::from(intervals) * INTERVAL_NS as f64 / 1e9;
        let rate_rad_s = last.rotation_to(attitude).map(|part| part / interval_s);
        let force_m_s2 = force_mg.map(|part| part / 1000.0 * STANDARD_GRAVITY_M_S2);
        let time = DeviceTime::Counter { now_ns: u64::from(number) * INTERVAL_NS, period_ns: (1 << 8) * INTERVAL_NS };
        Some(Measurement { time: Some(time), value: Value::Imu { rate_rad_s, force_m_s2, field_ut: None } })
    }
}

/// Unit quaternion from the chip's axes to its axes at power-on.
#[derive(Debug, Clone, Copy)]
struct Attitude(Quaternion<f64>);

impl Attitude {
    /// Creates an attitude from yaw, pitch and roll, 0.01°.
    fn from_angles(angles: [f64; 3]) -> Self {
        let [yaw, pitch, roll] = angles.map(|angle| (angle / 200.0).to_radians().sin_cos());
        let about_z = Quaternion::new(yaw.1, 0.0, 0.0, yaw.0);
        let about_x = Quaternion::new(pitch.1, pitch.0, 0.0, 0.0);
        let about_y = Quaternion::new(roll.1, 0.0, roll.0, 0.0);
        Self(about_z * about_x * about_y)
    }

    /// Returns the rotation vector from this attitude to `later` in the chip's axes, rad.
    fn rotation_to(self, later: Self) -> [f64; 3] {
        let rotation = self.0.conjugate() * later.0;
        let sine = rotation.imag().norm();
        // The sign of w selects the shorter of the two rotations.
        let angle = 2.0 * sine.atan2(rotation.w.abs()) * rotation.w.signum();
        let scale = if sine > 0.0 { angle / sine } else { 0.0 };
        (rotation.imag() * scale).into()
    }
}
