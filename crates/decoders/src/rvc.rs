//! BNO08x on a serial line in its mode for robot vacuum cleaners (UART-RVC): frames of 19 bytes, 100 each second.
//!
//! A frame is 0xAA 0xAA, its number, yaw, pitch, roll in 0.01°, acceleration in mg, each of 16 bits, low byte first, three bytes, and
//! the sum of the bytes between (BNO08X datasheet, 1.3.5.2).
//!
//! **There is no rate in a frame.** The body rate that comes out is the turn between the attitudes of two frames, divided by their
//! interval: the mean rate over it, of the chip's own estimate. It comes in steps of about 1 °/s, which is coarse for one sample, but
//! the steps do not add up: summed, the rates give the chip's own angles again. So the attitude that is made of it is no better than
//! the chip's, and as bias there is only what the chip lets through. Whoever wants the gyro itself reads the chip in another mode.
//!
//! Axes: x right, y forward, z up; yaw turns about z, then pitch about x, then roll about y. The datasheet's example shows it:
//! pitch −1.10°, roll 20.85° and force (−371, −20, 977) mg. Time: the frame's number as a counter of 10 ms, which begins again after
//! 2.56 s; the chip tells no other. Limits: the first frame, and one after more than [`LOST_MAX`] lost ones, make no measurement; pitch
//! near ±90° makes yaw and roll jump, not the rate. The sum has 8 bits: of 256 frames that the line broke, one is taken for good unless
//! its angles are none.

use crate::{
    DeviceTime, Measurement, Value,
    framed::{Format, Seen, sum, three_i16},
};

const BEGIN: u8 = 0xaa;
const FRAME_BYTES: usize = 19;
const INTERVAL_NS: u64 = 10_000_000;
/// Of yaw, pitch, roll, 0.01°.
const ANGLES_MAX: [f64; 3] = [18_000.0, 9_000.0, 18_000.0];
const STANDARD_GRAVITY_M_S2: f64 = 9.80665;
/// Frames that may be missing between two of which a rate is made.
pub const LOST_MAX: u8 = 9;

/// The attitude of the last frame.
#[derive(Debug, Clone, Default)]
pub struct Rvc {
    last: Option<(u8, Attitude)>,
}

impl Format for Rvc {
    fn look(&mut self, bytes: &[u8], found: &mut Vec<Measurement>) -> Seen {
        match bytes {
            [BEGIN] => return Seen::More,
            [BEGIN, BEGIN, ..] => {}
            _ => return Seen::Nothing(1),
        }
        let Some(frame) = bytes.first_chunk::<FRAME_BYTES>() else { return Seen::More };
        if sum(&frame[2..FRAME_BYTES - 1]) != frame[FRAME_BYTES - 1] {
            return Seen::Refused;
        }
        let (Some(angles), Some(force)) = (three_i16(frame, 3), three_i16(frame, 9)) else { return Seen::Refused };
        if angles.iter().zip(ANGLES_MAX).any(|(angle, max)| angle.abs() > max) {
            return Seen::Refused;
        }
        found.extend(self.measurement(frame[2], Attitude::of(angles), force));
        Seen::Frame(FRAME_BYTES)
    }
}

impl Rvc {
    fn measurement(&mut self, number: u8, attitude: Attitude, force_mg: [f64; 3]) -> Option<Measurement> {
        let (last_number, last) = self.last.replace((number, attitude))?;
        let intervals = number.wrapping_sub(last_number);
        if !(1..=LOST_MAX + 1).contains(&intervals) {
            return None;
        }
        let interval_s = f64::from(intervals) * INTERVAL_NS as f64 / 1e9;
        let rate_rad_s = last.turn_to(attitude).map(|part| part / interval_s);
        let force_m_s2 = force_mg.map(|part| part / 1000.0 * STANDARD_GRAVITY_M_S2);
        let time = DeviceTime::Counter { now_ns: u64::from(number) * INTERVAL_NS, period_ns: (1 << 8) * INTERVAL_NS };
        Some(Measurement { time: Some(time), value: Value::Imu { rate_rad_s, force_m_s2, field_ut: None } })
    }
}

/// A unit quaternion, w first, from the chip's axes to those where it was switched on.
#[derive(Debug, Clone, Copy)]
struct Attitude([f64; 4]);

impl Attitude {
    /// Yaw, pitch, roll in 0.01°.
    fn of(angles: [f64; 3]) -> Self {
        let [yaw, pitch, roll] = angles.map(|angle| (angle / 200.0).to_radians().sin_cos());
        let about_z = [yaw.1, 0.0, 0.0, yaw.0];
        let about_x = [pitch.1, pitch.0, 0.0, 0.0];
        let about_y = [roll.1, 0.0, roll.0, 0.0];
        Self(product(product(about_z, about_x), about_y))
    }

    /// The rotation vector from this to a later one, in the chip's axes, rad.
    fn turn_to(self, later: Self) -> [f64; 3] {
        let [w, x, y, z] = self.0;
        let [w, x, y, z] = product([w, -x, -y, -z], later.0);
        let sine = (x * x + y * y + z * z).sqrt();
        // The shorter way round.
        let angle = 2.0 * sine.atan2(w.abs()) * w.signum();
        let part = if sine > 0.0 { angle / sine } else { 0.0 };
        [x, y, z].map(|component| component * part)
    }
}

fn product([w, x, y, z]: [f64; 4], [a, b, c, d]: [f64; 4]) -> [f64; 4] {
    [
        w * a - x * b - y * c - z * d,
        w * b + x * a + y * d - z * c,
        w * c - x * d + y * a + z * b,
        w * d + x * c - y * b + z * a,
    ]
}
