//! Flags as C constants and as text.

use core::ffi::c_char;

use plumbline_ahrs::Flags;

use crate::text::write_text;

/// The rate is not finite and was replaced by the last valid one.
pub const PLUMBLINE_FLAG_RATE_INVALID: u64 = 1 << 0;
/// The specific force is not finite; the last valid one is forwarded but not used.
pub const PLUMBLINE_FLAG_FORCE_INVALID: u64 = 1 << 1;
/// A component of the rate is at the limit of the sensor's range.
pub const PLUMBLINE_FLAG_RATE_CLIPPED: u64 = 1 << 2;
/// A component of the specific force is at the limit of the sensor's range.
pub const PLUMBLINE_FLAG_FORCE_CLIPPED: u64 = 1 << 3;
/// The gyro has repeated the same value for too long and is considered stuck.
pub const PLUMBLINE_FLAG_RATE_STUCK: u64 = 1 << 4;
/// The accelerometer has repeated the same value for too long; it is considered stuck and not
/// used.
pub const PLUMBLINE_FLAG_FORCE_STUCK: u64 = 1 << 5;
/// The specific force is near zero. It has no direction then, and is not used.
pub const PLUMBLINE_FLAG_FORCE_SMALL: u64 = 1 << 6;
/// The interval before this sample exceeds the gap limit.
pub const PLUMBLINE_FLAG_GAP: u64 = 1 << 7;
/// The sensor's clock jumped or ran backwards; time was continued with the usual interval.
pub const PLUMBLINE_FLAG_CLOCK_LEAP: u64 = 1 << 8;
/// Earlier readings were rejected because they were duplicated or out of order.
pub const PLUMBLINE_FLAG_REFUSED_BEFORE: u64 = 1 << 9;
/// The rate is the value at the end of the interval, not its mean.
pub const PLUMBLINE_FLAG_RATE_INSTANT: u64 = 1 << 10;
/// The output of the gyro service did not arrive, so the attitude was held.
pub const PLUMBLINE_FLAG_GYRO_MISSING: u64 = 1 << 11;
/// The output of the accel service did not arrive, so the attitude followed the gyro.
pub const PLUMBLINE_FLAG_ACCEL_MISSING: u64 = 1 << 12;
/// Ticks before this one were lost in transit.
pub const PLUMBLINE_FLAG_LOST_BEFORE: u64 = 1 << 13;
/// The attitude was re-initialised at this tick.
pub const PLUMBLINE_FLAG_ALIGNED: u64 = 1 << 14;
/// The estimate was not finite and was reset.
pub const PLUMBLINE_FLAG_RESET: u64 = 1 << 15;
/// The body was detected to be at rest.
pub const PLUMBLINE_FLAG_AT_REST: u64 = 1 << 16;
/// The nose is near the vertical, where yaw and roll cannot be distinguished.
pub const PLUMBLINE_FLAG_NEAR_GIMBAL: u64 = 1 << 17;
/// No accelerometer sample has arrived yet; the attitude is only an initial value.
pub const PLUMBLINE_FLAG_UNALIGNED: u64 = 1 << 18;
/// The topic `mag` has a magnetic field sample for this tick.
pub const PLUMBLINE_FLAG_FIELD: u64 = 1 << 19;
/// The topic `gnss` has a fix for this tick.
pub const PLUMBLINE_FLAG_FIX: u64 = 1 << 20;
/// The magnetic field was out of range or not finite and was discarded.
pub const PLUMBLINE_FLAG_FIELD_INVALID: u64 = 1 << 21;
/// The fix was invalid and was discarded.
pub const PLUMBLINE_FLAG_FIX_INVALID: u64 = 1 << 22;
/// The magnetic field differs from that of the location; the heading follows the gyro.
pub const PLUMBLINE_FLAG_FIELD_DISTURBED: u64 = 1 << 23;
/// A magnetic field sample or a fix did not arrive.
pub const PLUMBLINE_FLAG_AIDING_MISSING: u64 = 1 << 24;
/// The fault script of the launch file altered this tick, or dropped a reading before it.
pub const PLUMBLINE_FLAG_FAULT_INJECTED: u64 = 1 << 25;
/// Another stage runs in a slot from this tick on.
pub const PLUMBLINE_FLAG_SWAPPED: u64 = 1 << 26;

/// Writes the names of the flags that are set, such as "rate-invalid, gap", with a terminating
/// zero. A text that does not fit is truncated. Returns the length of the whole text without the
/// zero.
///
/// # Safety
///
/// `buffer` is null, or valid for writes of `size` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_flags_text(flags: u64, buffer: *mut c_char, size: usize) -> usize {
    let buffer: &mut [u8] = if buffer.is_null() {
        &mut []
    } else {
        // SAFETY: required of the caller.
        unsafe {
            buffer.write_bytes(0, size);
            core::slice::from_raw_parts_mut(buffer.cast(), size)
        }
    };
    let (mut len, mut written) = (0, 0);
    for name in Flags(flags).names() {
        let separator = if len == 0 { "" } else { ", " };
        for part in [separator, name] {
            // If a part was truncated, no later part fits, because only the terminating zero is
            // left.
            if written == len {
                written += write_text(part, &mut buffer[written..]);
            }
            len += part.len();
        }
    }
    len
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn constants_are_those_of_the_flags() {
        let source = include_str!("flags.rs");
        for (flag, name) in Flags::NAMES {
            let constant = name.replace('-', "_").to_uppercase();
            let bit = flag.0.trailing_zeros();
            let line = format!("pub const PLUMBLINE_FLAG_{constant}: u64 = 1 << {bit};");
            assert!(source.contains(&line), "missing: {line}");
        }
    }

    #[test]
    fn flags_text_is_cut_to_the_buffer() {
        let flags = PLUMBLINE_FLAG_RATE_INVALID | PLUMBLINE_FLAG_GAP;
        let mut buffer = [1; 16];
        // SAFETY: the size is that of the buffer.
        let len = unsafe { plumbline_flags_text(flags, buffer.as_mut_ptr().cast(), buffer.len()) };
        assert_eq!((len, &buffer[..]), ("rate-invalid, gap".len(), &b"rate-invalid, g\0"[..]));
        // SAFETY: a null pointer is allowed.
        assert_eq!(unsafe { plumbline_flags_text(flags, core::ptr::null_mut(), 0) }, len);
    }
}
