//! The filter: creation, updates, attitude and snapshots.

use core::ffi::c_void;

use attitude::fuser::Fuser;
use plumbline_ahrs::{Ahrs, Frame, GnssFix};

use crate::{
    PlumblineAttitude, PlumblineBuilder, PlumblineStatus,
    boundary::{exclusive, null, numbers, shared, write},
    builder::{allocate, free},
};

/// Frame of an attitude.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum PlumblineFrame {
    /// Reference east, north, up; body right, forward, up. This is the native frame.
    EnuRfu = 0,
    /// Reference east, north, up; body forward, left, up: ROS.
    EnuFlu = 1,
    /// Reference north, west, up; body forward, left, up.
    NwuFlu = 2,
    /// Reference north, east, down; body forward, right, down: PX4, ArduPilot, MAVLink.
    NedFrd = 3,
}

/// Velocity over ground from a satellite receiver. An unknown value is NaN.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(C)]
pub struct PlumblineFix {
    /// Velocity, m/s: east, north, up.
    pub velocity_m_s: [f64; 3],
    /// Standard deviation of each component, m/s, or NaN.
    pub velocity_sd_m_s: f64,
    /// Age of the velocity when it arrives, s, or NaN.
    pub age_s: f64,
    /// Geodetic latitude, rad, north positive, or NaN.
    pub latitude_rad: f64,
}

/// Attitude and heading reference system.
pub struct PlumblineAhrs {
    ahrs: Ahrs<Fuser>,
}

/// Asserts that a filter needs no destructor, because the caller of plumbline_ahrs_init() releases
/// the memory without calling one.
const _: () = assert!(!core::mem::needs_drop::<PlumblineAhrs>());

impl PlumblineAhrs {
    /// Returns an error if a stage has failed permanently. Called after each update.
    fn status(&self) -> Result<(), PlumblineStatus> {
        match self.ahrs.failure() {
            None => Ok(()),
            Some(failure) => Err(PlumblineStatus::StageFailed.with(failure)),
        }
    }
}

/// Creates a filter with the properties of a builder, or with the defaults if it is null. Returns
/// null if memory is exhausted.
///
/// Free the filter with plumbline_ahrs_free(). The builder can be freed before it.
///
/// # Safety
///
/// `builder` is null or a builder.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_ahrs_new(builder: *const PlumblineBuilder) -> *mut PlumblineAhrs {
    // SAFETY: required of the caller.
    let builder = unsafe { builder.as_ref() };
    allocate(|| PlumblineAhrs { ahrs: PlumblineBuilder::build(builder) })
}

/// Frees a filter created by plumbline_ahrs_new(). A null pointer has no effect.
///
/// # Safety
///
/// `ahrs` is null, or was returned by `plumbline_ahrs_new` and has not been freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_ahrs_free(ahrs: *mut PlumblineAhrs) {
    // SAFETY: required of the caller.
    unsafe { free(ahrs) }
}

/// Returns the size of a filter, bytes.
#[unsafe(no_mangle)]
pub extern "C" fn plumbline_ahrs_size() -> usize {
    size_of::<PlumblineAhrs>()
}

/// Returns the alignment of a filter, bytes.
#[unsafe(no_mangle)]
pub extern "C" fn plumbline_ahrs_align() -> usize {
    align_of::<PlumblineAhrs>()
}

/// Creates a filter in memory provided by the caller and writes its address to `ahrs`.
///
/// `memory` has at least plumbline_ahrs_size() bytes with the alignment plumbline_ahrs_align(). The
/// caller may release or reuse it at any time after the last call with the filter.
///
/// # Safety
///
/// `builder` is null or a builder. `memory` is null or valid for writes of `size` bytes that only
/// the filter uses. `ahrs` is null or valid for writes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_ahrs_init(
    builder: *const PlumblineBuilder,
    memory: *mut c_void,
    size: usize,
    ahrs: *mut *mut PlumblineAhrs,
) -> PlumblineStatus {
    let place = memory.cast::<PlumblineAhrs>();
    let (needed, align) = (plumbline_ahrs_size(), plumbline_ahrs_align());
    if place.is_null() {
        return null("memory");
    }
    if size < needed || !place.is_aligned() {
        return PlumblineStatus::InvalidMemory.with(format_args!(
            "expected {needed} bytes at a multiple of {align}, found {size} bytes at {memory:?}; use \
             plumbline_ahrs_size() and plumbline_ahrs_align()"
        ));
    }
    // SAFETY: required of the caller; size and alignment were checked.
    unsafe {
        place.write(PlumblineAhrs { ahrs: PlumblineBuilder::build(builder.as_ref()) });
        write(ahrs, place);
    }
    PlumblineStatus::Ok
}

/// Processes a sample of all sensors.
///
/// `gyro_rad_s`: body rate, 3 numbers, rad/s. `accel_m_s2`: specific force, 3 numbers, m/s^2.
/// `field_ut`: magnetic field, 3 numbers, microtesla, or null for the newest field that
/// plumbline_ahrs_update_mag() has stored since the previous sample, if any. `dt_s`: time since the
/// previous sample, s; a value that is 0, negative or not finite marks a late or repeated sample.
/// `attitude`: receives the attitude after the sample in the native frame, or is null. A missing
/// value is NaN. If the sample is rejected, the attitude is unchanged.
///
/// # Safety
///
/// `ahrs` is null or a filter. Each of the other pointers is null or valid as described.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_ahrs_update(
    ahrs: *mut PlumblineAhrs,
    gyro_rad_s: *const f64,
    accel_m_s2: *const f64,
    field_ut: *const f64,
    dt_s: f64,
    attitude: *mut PlumblineAttitude,
) -> PlumblineStatus {
    // SAFETY: required of the caller.
    unsafe { update(ahrs, gyro_rad_s, accel_m_s2, field_ut, Time::Interval(dt_s), attitude) }
}

/// Processes a timestamped sample of all sensors.
///
/// `t_ns`: end of the sample's interval on the clock of the sensors, ns. The other arguments are
/// those of plumbline_ahrs_update().
///
/// # Safety
///
/// `ahrs` is null or a filter. Each of the other pointers is null or valid as described.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_ahrs_update_at(
    ahrs: *mut PlumblineAhrs,
    gyro_rad_s: *const f64,
    accel_m_s2: *const f64,
    field_ut: *const f64,
    t_ns: i64,
    attitude: *mut PlumblineAttitude,
) -> PlumblineStatus {
    // SAFETY: required of the caller.
    unsafe { update(ahrs, gyro_rad_s, accel_m_s2, field_ut, Time::Stamp(t_ns), attitude) }
}

/// Stores a magnetometer sample, 3 numbers, microtesla. It takes effect with the next gyro and
/// accelerometer sample.
///
/// # Safety
///
/// `ahrs` is null or a filter. `field_ut` is null or points to 3 numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_ahrs_update_mag(ahrs: *mut PlumblineAhrs, field_ut: *const f64) -> PlumblineStatus {
    // SAFETY: required of the caller.
    let (ahrs, field_ut) = unsafe { (exclusive(ahrs, "ahrs"), numbers(field_ut, "field_ut")) };
    PlumblineStatus::of(ahrs.and_then(|filter| {
        filter.ahrs.update_mag(field_ut?);
        Ok(())
    }))
}

/// Stores a velocity from the satellite receiver. It takes effect with the next gyro and
/// accelerometer sample.
///
/// # Safety
///
/// `ahrs` is null or a filter. `fix` is null or points to a fix.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_ahrs_update_gnss(
    ahrs: *mut PlumblineAhrs,
    fix: *const PlumblineFix,
) -> PlumblineStatus {
    // SAFETY: required of the caller.
    let (ahrs, fix) = unsafe { (exclusive(ahrs, "ahrs"), shared(fix, "fix")) };
    PlumblineStatus::of(ahrs.and_then(|filter| {
        let PlumblineFix { velocity_m_s, velocity_sd_m_s, age_s, latitude_rad } = *fix?;
        let known = |value: f64| (!value.is_nan()).then_some(value);
        filter.ahrs.update_gnss(&GnssFix {
            velocity_m_s,
            velocity_sd_m_s: known(velocity_sd_m_s),
            age_s: known(age_s),
            latitude_rad: known(latitude_rad),
        });
        Ok(())
    }))
}

/// Writes the newest attitude in a frame, a PlumblineFrame, to `attitude`. Before the first sample
/// it is level, and flagged as unaligned.
///
/// # Safety
///
/// `ahrs` is null or a filter. `attitude` is null or valid for writes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_ahrs_attitude(
    ahrs: *const PlumblineAhrs,
    frame: u32,
    attitude: *mut PlumblineAttitude,
) -> PlumblineStatus {
    // SAFETY: required of the caller.
    let ahrs = unsafe { shared(ahrs, "ahrs") };
    PlumblineStatus::of(ahrs.and_then(|filter| {
        let Some((_, frame)) = Frame::NAMES.get(frame as usize) else {
            let message = format_args!("frame: unknown constant {frame}; use a PlumblineFrame");
            return Err(PlumblineStatus::InvalidArgument.with(message));
        };
        // SAFETY: required of the caller.
        unsafe { write(attitude, PlumblineAttitude::new(&filter.ahrs.attitude(), *frame)) };
        Ok(())
    }))
}

/// Returns the number of rejected samples so far; 0 for a null pointer.
///
/// # Safety
///
/// `ahrs` is null or a filter.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_ahrs_rejected(ahrs: *const PlumblineAhrs) -> u64 {
    // SAFETY: required of the caller.
    unsafe { shared(ahrs, "ahrs") }.map_or(0, |filter| filter.ahrs.rejected())
}

/// Returns the size of a snapshot, bytes; 0 for a null pointer.
///
/// # Safety
///
/// `ahrs` is null or a filter.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_ahrs_snapshot_size(ahrs: *const PlumblineAhrs) -> usize {
    // SAFETY: required of the caller.
    unsafe { shared(ahrs, "ahrs") }.map_or(0, |filter| filter.ahrs.snapshot_len())
}

/// Writes a snapshot of the whole state to `buffer`. The properties that the builder has set are
/// not part of the snapshot.
///
/// # Safety
///
/// `ahrs` is null or a filter. `buffer` is null or valid for writes of `size` bytes. The function
/// overwrites all of them.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_ahrs_save(
    ahrs: *const PlumblineAhrs,
    buffer: *mut c_void,
    size: usize,
) -> PlumblineStatus {
    // SAFETY: required of the caller.
    let ahrs = unsafe { shared(ahrs, "ahrs") };
    PlumblineStatus::of(ahrs.and_then(|filter| {
        if buffer.is_null() {
            return Err(null("buffer"));
        }
        // SAFETY: required of the caller. The bytes are set to zero first, because they may be
        // uninitialised.
        let bytes = unsafe {
            buffer.write_bytes(0, size);
            core::slice::from_raw_parts_mut(buffer.cast(), size)
        };
        filter.ahrs.save(bytes)?;
        Ok(())
    }))
}

/// Continues from a snapshot of a filter with the same stages. After an error, the filter is
/// unchanged.
///
/// # Safety
///
/// `ahrs` is null or a filter. `snapshot` is null or valid for reads of `size` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_ahrs_restore(
    ahrs: *mut PlumblineAhrs,
    snapshot: *const c_void,
    size: usize,
) -> PlumblineStatus {
    // SAFETY: required of the caller.
    let ahrs = unsafe { exclusive(ahrs, "ahrs") };
    PlumblineStatus::of(ahrs.and_then(|filter| {
        if snapshot.is_null() {
            return Err(null("snapshot"));
        }
        // SAFETY: required of the caller.
        let bytes = unsafe { core::slice::from_raw_parts(snapshot.cast(), size) };
        filter.ahrs.restore(bytes)?;
        Ok(())
    }))
}

/// Time of a sample.
enum Time {
    /// Time since the previous sample, s.
    Interval(f64),
    /// Timestamp, ns.
    Stamp(i64),
}

/// Processes a sample.
///
/// # Safety
///
/// Each pointer is null, or valid as [`plumbline_ahrs_update`] describes.
unsafe fn update(
    ahrs: *mut PlumblineAhrs,
    gyro_rad_s: *const f64,
    accel_m_s2: *const f64,
    field_ut: *const f64,
    time: Time,
    attitude: *mut PlumblineAttitude,
) -> PlumblineStatus {
    // SAFETY: required of the caller.
    let ahrs = unsafe { exclusive(ahrs, "ahrs") };
    // SAFETY: required of the caller.
    let (rate, force) = unsafe { (numbers(gyro_rad_s, "gyro_rad_s"), numbers(accel_m_s2, "accel_m_s2")) };
    // SAFETY: required of the caller; an array has the alignment of its elements.
    let field = unsafe { field_ut.cast::<[f64; 3]>().as_ref() }.copied();
    PlumblineStatus::of(ahrs.and_then(|filter| {
        let (rate, force) = (rate?, force?);
        let newest = match time {
            Time::Interval(dt_s) => filter.ahrs.update(rate, force, field, dt_s),
            Time::Stamp(t_ns) => filter.ahrs.update_at(rate, force, field, t_ns),
        };
        if !attitude.is_null() {
            // SAFETY: required of the caller.
            unsafe { write(attitude, PlumblineAttitude::new(&newest, Frame::EnuRfu)) };
        }
        filter.status()
    }))
}
