//! Properties of the sensors and choice of the stages.

use core::ffi::c_char;
use std::alloc::{self, Layout};

use attitude::{
    Matrix3, Vector3,
    fuser::{Fuser, multiple_model::MultipleModel},
};
use plumbline_ahrs::{Ahrs, AhrsBuilder, Body, BuildError, Calibration, Mounting, Parameter, RateKind, Sensor, Slot};

use crate::{
    PlumblineStatus,
    boundary::{exclusive, numbers, shared, text, write},
};

/// Axes of a body or of sensors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum PlumblineBody {
    /// Right, forward, up. This is the native order.
    Rfu = 0,
    /// Forward, left, up.
    Flu = 1,
    /// Forward, right, down.
    Frd = 2,
}

/// Slot that a stage fills.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum PlumblineSlot {
    /// Integrates the rate.
    Gyro = 0,
    /// Computes the up direction from the force.
    Accel = 1,
    /// Fuses the sensors.
    Fuser = 2,
    /// Computes the angles and the heading.
    Course = 3,
}

/// Sensor that can be calibrated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum PlumblineSensor {
    /// Gyro.
    Gyro = 0,
    /// Accelerometer.
    Accel = 1,
    /// Magnetometer.
    Mag = 2,
}

/// Relation of a gyro sample to the interval before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum PlumblineGyroSamples {
    /// Mean over the interval.
    Mean = 0,
    /// Value at the end of the interval.
    Instant = 1,
}

/// Adjustable parameter of a stage. The texts end with a zero byte.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(C)]
pub struct PlumblineParameter {
    /// Name, with the unit as its suffix.
    pub name: [c_char; 64],
    /// Unit; empty for a dimensionless number.
    pub unit: [c_char; 16],
    /// Meaning of the parameter.
    pub description: [c_char; 512],
    /// Default value, in the unit of the parameter.
    pub default_value: f64,
    /// Minimum allowed value.
    pub min: f64,
    /// Maximum allowed value.
    pub max: f64,
}

impl From<&Parameter> for PlumblineParameter {
    fn from(parameter: &Parameter) -> Self {
        fn chars<const N: usize>(text: &str) -> [c_char; N] {
            let mut bytes = [0; N];
            crate::text::write_text(text, &mut bytes);
            bytes.map(|byte| byte as c_char)
        }
        let Parameter { name, unit, default, min, max, description } = *parameter;
        Self { name: chars(name), unit: chars(unit), description: chars(description), default_value: default, min, max }
    }
}

/// Properties of the sensors and the stages of a filter.
///
/// Every property has a default, and an ideal sensor needs none of them.
pub struct PlumblineBuilder {
    builder: AhrsBuilder<Fuser>,
}

impl PlumblineBuilder {
    fn new() -> Self {
        Self { builder: AhrsBuilder::new().fuser(Fuser::MultipleModel(MultipleModel::default())) }
    }

    /// Applies a change. If it fails, the builder is unchanged.
    fn change(
        &mut self,
        change: impl FnOnce(AhrsBuilder<Fuser>) -> Result<AhrsBuilder<Fuser>, BuildError>,
    ) -> Result<(), PlumblineStatus> {
        self.builder = change(self.builder.clone())?;
        Ok(())
    }

    /// Builds the filter that a builder describes, or the default filter for `None`.
    pub(crate) fn build(builder: Option<&Self>) -> Ahrs<Fuser> {
        builder.map_or_else(|| Self::new().builder.build(), |builder| builder.builder.clone().build())
    }
}

/// Allocates memory and initialises it. Returns null if memory is exhausted.
pub(crate) fn allocate<T>(value: impl FnOnce() -> T) -> *mut T {
    const { assert!(size_of::<T>() > 0) };
    // SAFETY: the size is not 0.
    let place = unsafe { alloc::alloc(Layout::new::<T>()) }.cast::<T>();
    if place.is_null() {
        _ = PlumblineStatus::OutOfMemory.with("memory allocation failed");
        return place;
    }
    // SAFETY: the memory is new, and has the layout of `T`.
    unsafe { place.write(value()) };
    place
}

/// Frees an object created by [`allocate`]. A null pointer has no effect.
///
/// # Safety
///
/// The pointer is null, or was returned by `allocate` and has not been freed.
pub(crate) unsafe fn free<T>(pointer: *mut T) {
    if !pointer.is_null() {
        // SAFETY: `allocate` has used the same allocator and layout as a box.
        drop(unsafe { Box::from_raw(pointer) });
    }
}

fn unknown_constant(name: &str, value: u32) -> PlumblineStatus {
    PlumblineStatus::InvalidArgument.with(format_args!("{name}: unknown constant {value}; use one of the header"))
}

fn slot_of(slot: u32) -> Result<Slot, PlumblineStatus> {
    const { assert!(PlumblineSlot::Course as usize == Slot::Course as usize) };
    Slot::ALL.get(slot as usize).copied().ok_or_else(|| unknown_constant("slot", slot))
}

/// Applies a change to a builder. If it fails, the builder is unchanged.
///
/// # Safety
///
/// `builder` is null or a builder.
unsafe fn change(
    builder: *mut PlumblineBuilder,
    change: impl FnOnce(AhrsBuilder<Fuser>) -> Result<AhrsBuilder<Fuser>, BuildError>,
) -> PlumblineStatus {
    // SAFETY: required of the caller.
    PlumblineStatus::of(unsafe { exclusive(builder, "builder") }.and_then(|builder| builder.change(change)))
}

/// Creates a builder for ideal sensors and the default stages. Returns null if memory is exhausted.
///
/// Free the builder with plumbline_builder_free().
#[unsafe(no_mangle)]
pub extern "C" fn plumbline_builder_new() -> *mut PlumblineBuilder {
    allocate(PlumblineBuilder::new)
}

/// Frees a builder. A null pointer has no effect.
///
/// # Safety
///
/// `builder` is null, or was returned by `plumbline_builder_new` and has not been freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_builder_free(builder: *mut PlumblineBuilder) {
    // SAFETY: required of the caller.
    unsafe { free(builder) }
}

/// Sets the nominal sampling rate of gyro and accelerometer, 0.1 to 100000 Hz; default 100.
///
/// # Safety
///
/// `builder` is null or a builder.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_builder_sample_rate_hz(
    builder: *mut PlumblineBuilder,
    rate_hz: f64,
) -> PlumblineStatus {
    // SAFETY: required of the caller.
    unsafe { change(builder, |builder| builder.sample_rate_hz(rate_hz)) }
}

/// Sets the range of the gyro, 1 to 100000 degrees per second; default 2000.
///
/// # Safety
///
/// `builder` is null or a builder.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_builder_gyro_range_deg_s(
    builder: *mut PlumblineBuilder,
    range_deg_s: f64,
) -> PlumblineStatus {
    // SAFETY: required of the caller.
    unsafe { change(builder, |builder| builder.gyro_range_deg_s(range_deg_s)) }
}

/// Sets the range of the accelerometer, 0.1 to 10000 g; default 16.
///
/// # Safety
///
/// `builder` is null or a builder.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_builder_accel_range_g(
    builder: *mut PlumblineBuilder,
    range_g: f64,
) -> PlumblineStatus {
    // SAFETY: required of the caller.
    unsafe { change(builder, |builder| builder.accel_range_g(range_g)) }
}

/// Sets the range of the magnetometer, 1 to 1000000 microtesla; default 2000.
///
/// # Safety
///
/// `builder` is null or a builder.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_builder_mag_range_ut(
    builder: *mut PlumblineBuilder,
    range_ut: f64,
) -> PlumblineStatus {
    // SAFETY: required of the caller.
    unsafe { change(builder, |builder| builder.mag_range_ut(range_ut)) }
}

/// Sets the interval between samples above which a gap is flagged, 0.001 to 10 s; default 0.1.
///
/// # Safety
///
/// `builder` is null or a builder.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_builder_gap_s(builder: *mut PlumblineBuilder, gap_s: f64) -> PlumblineStatus {
    // SAFETY: required of the caller.
    unsafe { change(builder, |builder| builder.gap_s(gap_s)) }
}

/// Sets the time after which a sensor that repeats its value counts as frozen, 0.01 to 60 s;
/// default 0.5.
///
/// # Safety
///
/// `builder` is null or a builder.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_builder_frozen_after_s(
    builder: *mut PlumblineBuilder,
    frozen_s: f64,
) -> PlumblineStatus {
    // SAFETY: required of the caller.
    unsafe { change(builder, |builder| builder.frozen_after_s(frozen_s)) }
}

/// Sets the magnetic declination, -180 to 180 degrees, east positive; default 0. It converts a
/// magnetic heading to a true heading. Choose the course stage first.
///
/// # Safety
///
/// `builder` is null or a builder.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_builder_declination_deg(
    builder: *mut PlumblineBuilder,
    declination_deg: f64,
) -> PlumblineStatus {
    // SAFETY: required of the caller.
    unsafe { change(builder, |builder| builder.declination_deg(declination_deg)) }
}

/// Sets whether a gyro sample is the mean over the interval before it or the value at its end.
/// `kind` is a PlumblineGyroSamples. The default is the mean.
///
/// # Safety
///
/// `builder` is null or a builder.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_builder_gyro_samples(builder: *mut PlumblineBuilder, kind: u32) -> PlumblineStatus {
    // SAFETY: required of the caller.
    let builder = unsafe { exclusive(builder, "builder") };
    PlumblineStatus::of(builder.and_then(|builder| {
        let kind = match kind {
            0 => RateKind::Mean,
            1 => RateKind::Instant,
            _ => return Err(unknown_constant("kind", kind)),
        };
        builder.change(|to| Ok(to.gyro_samples(kind)))
    }))
}

/// Sets the axes of the sensors: a PlumblineBody; default right, forward, up.
///
/// # Safety
///
/// `builder` is null or a builder.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_builder_axes(builder: *mut PlumblineBuilder, axes: u32) -> PlumblineStatus {
    // SAFETY: required of the caller.
    let builder = unsafe { exclusive(builder, "builder") };
    PlumblineStatus::of(builder.and_then(|builder| {
        let axes = match axes {
            0 => Body::Rfu,
            1 => Body::Flu,
            2 => Body::Frd,
            _ => return Err(unknown_constant("axes", axes)),
        };
        builder.change(|to| Ok(to.axes(axes)))
    }))
}

/// Sets the orientation of the sensors in the body: the 9 numbers of a rotation matrix M, row by
/// row, v_body = M v_sensor.
///
/// # Safety
///
/// `builder` is null or a builder. `matrix` is null or points to 9 numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_builder_mounting(
    builder: *mut PlumblineBuilder,
    matrix: *const f64,
) -> PlumblineStatus {
    // SAFETY: required of the caller.
    let (builder, matrix) = unsafe { (exclusive(builder, "builder"), numbers::<9>(matrix, "matrix")) };
    PlumblineStatus::of(builder.and_then(|builder| {
        let mounting = Mounting::from_matrix(Matrix3::from_row_slice(&matrix?))?;
        builder.change(|to| Ok(to.mounting(mounting)))
    }))
}

/// Sets the calibration of a sensor, a PlumblineSensor, in its own axes: out = M (raw - bias).
///
/// `matrix` has the 9 numbers of M, row by row, and `bias` 3 numbers in raw units.
///
/// # Safety
///
/// `builder` is null or a builder. `matrix` is null or points to 9 numbers, `bias` to 3.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_builder_calibration(
    builder: *mut PlumblineBuilder,
    sensor: u32,
    matrix: *const f64,
    bias: *const f64,
) -> PlumblineStatus {
    // SAFETY: required of the caller.
    let builder = unsafe { exclusive(builder, "builder") };
    // SAFETY: required of the caller.
    let (matrix, bias) = unsafe { (numbers::<9>(matrix, "matrix"), numbers::<3>(bias, "bias")) };
    PlumblineStatus::of(builder.and_then(|builder| {
        let sensor = match sensor {
            0 => Sensor::Gyro,
            1 => Sensor::Accel,
            2 => Sensor::Mag,
            _ => return Err(unknown_constant("sensor", sensor)),
        };
        let calibration = Calibration::new(Vector3::from(bias?), Matrix3::from_row_slice(&matrix?))?;
        builder.change(|to| Ok(to.calibration(sensor, calibration)))
    }))
}

/// Chooses the stage of a slot, a PlumblineSlot, by name, such as "wz". Its parameters have their
/// defaults.
///
/// # Safety
///
/// `builder` is null or a builder. `name` is null or a text that ends with a zero byte.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_builder_set_stage(
    builder: *mut PlumblineBuilder,
    slot: u32,
    name: *const c_char,
) -> PlumblineStatus {
    // SAFETY: required of the caller.
    let (builder, name) = unsafe { (exclusive(builder, "builder"), text(name, "name")) };
    PlumblineStatus::of(builder.and_then(|builder| {
        let (slot, name) = (slot_of(slot)?, name?);
        builder.change(|to| match slot {
            Slot::Gyro => to.gyro_stage(name),
            Slot::Accel => to.accel_stage(name),
            Slot::Fuser => to.fuser_stage(name),
            Slot::Course => to.course_stage(name),
        })
    }))
}

/// Sets a parameter of the stage in a slot, a PlumblineSlot. Choose the stage first.
///
/// # Safety
///
/// `builder` is null or a builder. `name` is null or a text that ends with a zero byte.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_builder_set_parameter(
    builder: *mut PlumblineBuilder,
    slot: u32,
    name: *const c_char,
    value: f64,
) -> PlumblineStatus {
    // SAFETY: required of the caller.
    let (builder, name) = unsafe { (exclusive(builder, "builder"), text(name, "name")) };
    PlumblineStatus::of(builder.and_then(|builder| {
        let (slot, name) = (slot_of(slot)?, name?);
        builder.change(|to| to.parameter(slot, name, value))
    }))
}

/// Returns the number of parameters of the stage in a slot, or 0 after an error.
///
/// # Safety
///
/// `builder` is null or a builder.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_builder_parameter_count(builder: *const PlumblineBuilder, slot: u32) -> usize {
    // SAFETY: required of the caller.
    let builder = unsafe { shared(builder, "builder") };
    let count = builder.and_then(|builder| Ok(builder.builder.parameters(slot_of(slot)?).len()));
    count.unwrap_or_default()
}

/// Writes one parameter of a slot's stage to `parameter`. The index counts from 0.
///
/// # Safety
///
/// `builder` is null or a builder. `parameter` is null or valid for writes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_builder_parameter_at(
    builder: *const PlumblineBuilder,
    slot: u32,
    index: usize,
    parameter: *mut PlumblineParameter,
) -> PlumblineStatus {
    // SAFETY: required of the caller.
    let builder = unsafe { shared(builder, "builder") };
    PlumblineStatus::of(builder.and_then(|builder| {
        let parameters = builder.builder.parameters(slot_of(slot)?);
        let found = parameters.get(index).ok_or_else(|| {
            PlumblineStatus::NotFound.with(format_args!("no parameter {index}; the stage has {}", parameters.len()))
        })?;
        // SAFETY: required of the caller.
        unsafe { write(parameter, found.into()) };
        Ok(())
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_of_all_parameters_fit() {
        for stage in Slot::Fuser.stages() {
            let builder = AhrsBuilder::new().fuser_stage(stage).unwrap();
            for parameter in builder.parameters(Slot::Fuser) {
                let lengths = [parameter.name.len(), parameter.unit.len(), parameter.description.len()];
                assert!(lengths[0] < 64 && lengths[1] < 16 && lengths[2] < 512, "{}", parameter.name);
            }
        }
    }
}
