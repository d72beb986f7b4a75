//! Properties of the sensors and choice of the stages.

use core::fmt;

use attitude::{
    accel::Accelerometer,
    calibration::{Calibration, Mounting},
    conditioner::{Conditioner, Limits, SensorModel},
    course::{Course, SupervisedCourse},
    frames::Body,
    fuser::{Fuser, FuserStage, SupervisedFuser, multiple_model::MultipleModel},
    gyro::{Gyro, RateKind, SupervisedGyro},
    parameters::{ParameterError, Parameters, settings},
    slot::Slot,
    stage::Stage as _,
    validated_stage::ValidatedStage,
};

use crate::{Ahrs, Attitude};

settings! {
    /// Sampling of the sensors.
    struct Sampling {
        /// Nominal sampling rate of gyro and accelerometer.
        sample_rate_hz: 100.0 in 0.1 .. 100_000.0, "Hz";
    }
}

/// Sensor that can be calibrated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sensor {
    /// Gyro, calibrated to rad/s.
    Gyro,
    /// Accelerometer, calibrated to m/s².
    Accel,
    /// Magnetometer, calibrated to µT.
    Mag,
}

/// Sets the properties of the sensors and the stages of an [`Ahrs`].
///
/// Every property has a default. For ideal sensors, no property needs to be set.
///
/// ```
/// use plumbline_ahrs::{Ahrs, Body};
///
/// let ahrs = Ahrs::builder()
///     .axes(Body::Frd)
///     .gyro_range_deg_s(500.0)?
///     .accel_range_g(8.0)?
///     .declination_deg(4.5)?
///     .build();
/// # Ok::<(), plumbline_ahrs::BuildError>(())
/// ```
#[derive(Debug, Clone)]
pub struct AhrsBuilder<F = MultipleModel> {
    sensors: SensorModel,
    sampling: Sampling,
    gyro: Gyro,
    accel: Accelerometer,
    fuser: F,
    course: Course,
}

impl Default for AhrsBuilder {
    fn default() -> Self {
        Self::new()
    }
}

impl AhrsBuilder {
    /// Creates a builder for ideal sensors and the default stages.
    pub fn new() -> Self {
        Self {
            sensors: SensorModel::default(),
            sampling: Sampling::default(),
            gyro: Gyro::default(),
            accel: Accelerometer::default(),
            fuser: MultipleModel::default(),
            course: Course::default(),
        }
    }
}

impl Ahrs {
    /// Creates a filter with the default stages.
    pub fn new() -> Self {
        AhrsBuilder::new().build()
    }

    /// Returns a builder with the default stages.
    pub fn builder() -> AhrsBuilder {
        AhrsBuilder::new()
    }
}

impl Ahrs<Fuser> {
    /// Creates a filter with the fuser stage of the given name, such as `"wz"` or `"vqf"`.
    ///
    /// # Errors
    ///
    /// Returns [`BuildError::UnknownStage`] with the names of all stages if there is no such stage.
    pub fn with_stage(name: &str) -> Result<Self, BuildError> {
        Ok(AhrsBuilder::new().fuser_stage(name)?.build())
    }
}

impl Default for Ahrs {
    fn default() -> Self {
        Self::new()
    }
}

impl AhrsBuilder<Fuser> {
    /// Chooses the stage of a slot by name. [`Slot::stages`] lists the names.
    ///
    /// # Errors
    ///
    /// Returns [`BuildError::UnknownStage`] if there is no such stage.
    pub fn stage(self, slot: Slot, name: &str) -> Result<Self, BuildError> {
        match slot {
            Slot::Gyro => self.gyro_stage(name),
            Slot::Accel => self.accel_stage(name),
            Slot::Fuser => self.fuser_stage(name),
            Slot::Course => self.course_stage(name),
        }
    }
}

impl<F: FuserStage> AhrsBuilder<F> {
    /// Sets the nominal sampling rate of gyro and accelerometer, 0.1 to 100,000 Hz; default 100.
    ///
    /// The nominal rate is used only for samples with an unusable timestamp, and only until the
    /// true rate has been measured from other samples.
    ///
    /// # Errors
    ///
    /// Returns [`BuildError::OutOfRange`] if the value is out of range.
    pub fn sample_rate_hz(mut self, rate_hz: f64) -> Result<Self, BuildError> {
        self.sampling.set("sample_rate_hz", rate_hz)?;
        self.sensors.rate_hz = self.sampling.sample_rate_hz;
        Ok(self)
    }

    /// Sets the range of the gyro, 1 to 100,000 °/s; default 2000. A rate at the limit counts as
    /// clipped.
    ///
    /// # Errors
    ///
    /// Returns [`BuildError::OutOfRange`] if the value is out of range.
    pub fn gyro_range_deg_s(self, range_deg_s: f64) -> Result<Self, BuildError> {
        self.limit("rate_max_deg_s", range_deg_s)
    }

    /// Sets the range of the accelerometer, 0.1 to 10,000 g; default 16. A force at the limit
    /// counts as clipped.
    ///
    /// # Errors
    ///
    /// Returns [`BuildError::OutOfRange`] if the value is out of range.
    pub fn accel_range_g(self, range_g: f64) -> Result<Self, BuildError> {
        self.limit("force_max_g", range_g)
    }

    /// Sets the range of the magnetometer, 1 to 1,000,000 µT; default 2000. A magnetic field at the
    /// limit is not used.
    ///
    /// # Errors
    ///
    /// Returns [`BuildError::OutOfRange`] if the value is out of range.
    pub fn mag_range_ut(self, range_ut: f64) -> Result<Self, BuildError> {
        self.limit("field_max_ut", range_ut)
    }

    /// Sets the interval between samples above which a gap is flagged, 0.001 to 10 s; default 0.1.
    ///
    /// # Errors
    ///
    /// Returns [`BuildError::OutOfRange`] if the value is out of range.
    pub fn gap_s(self, gap_s: f64) -> Result<Self, BuildError> {
        self.limit("gap_s", gap_s)
    }

    /// Sets the time after which a repeated value counts as frozen, 0.01 to 60 s; default 0.5.
    ///
    /// # Errors
    ///
    /// Returns [`BuildError::OutOfRange`] if the value is out of range.
    pub fn frozen_after_s(self, frozen_s: f64) -> Result<Self, BuildError> {
        self.limit("stuck_s", frozen_s)
    }

    /// Sets the meaning of a rate sample.
    ///
    /// A rate is either the mean over its interval (the default) or the value at the end of its
    /// interval.
    #[must_use]
    pub fn gyro_samples(mut self, kind: RateKind) -> Self {
        self.sensors.rate_kind = kind;
        self
    }

    /// Sets the axes of the sensors; default [`Body::Rfu`].
    #[must_use]
    pub fn axes(self, axes: Body) -> Self {
        self.mounting(Mounting::from_axes(axes))
    }

    /// Sets the orientation of the sensors in the body.
    #[must_use]
    pub fn mounting(mut self, mounting: Mounting) -> Self {
        self.sensors.mounting = mounting;
        self
    }

    /// Sets the calibration of a sensor, in the axes of the sensor.
    #[must_use]
    pub fn calibration(mut self, sensor: Sensor, calibration: Calibration) -> Self {
        let place = match sensor {
            Sensor::Gyro => &mut self.sensors.gyro,
            Sensor::Accel => &mut self.sensors.accel,
            Sensor::Mag => &mut self.sensors.mag,
        };
        *place = calibration;
        self
    }

    /// Sets the magnetic declination, −180° to 180°, east positive. It converts a magnetic heading
    /// to a true heading. Yaw and quaternion stay magnetic. With 0, the default, the heading stays
    /// magnetic.
    ///
    /// Choose the course stage first, because the declination is a parameter of the stage.
    ///
    /// # Errors
    ///
    /// Returns [`BuildError::OutOfRange`] if the value is out of range.
    pub fn declination_deg(self, declination_deg: f64) -> Result<Self, BuildError> {
        self.parameter(Slot::Course, "declination_deg", declination_deg)
    }

    /// Chooses the fuser stage by type, such as [`Wz`](crate::stages::Wz).
    pub fn fuser<G: FuserStage>(self, stage: G) -> AhrsBuilder<G> {
        let Self { sensors, sampling, gyro, accel, fuser: _, course } = self;
        AhrsBuilder { sensors, sampling, gyro, accel, fuser: stage, course }
    }

    /// Chooses the fuser stage by name, such as `"wz"`. [`Slot::stages`] lists the names.
    ///
    /// # Errors
    ///
    /// Returns [`BuildError::UnknownStage`] if there is no such stage.
    pub fn fuser_stage(self, name: &str) -> Result<AhrsBuilder<Fuser>, BuildError> {
        Ok(self.fuser(Fuser::from_name(name).ok_or_else(|| unknown(Slot::Fuser, name))?))
    }

    /// Chooses the gyro stage by name, such as `"mobius-coning"` for a body that vibrates.
    ///
    /// # Errors
    ///
    /// Returns [`BuildError::UnknownStage`] if there is no such stage.
    pub fn gyro_stage(mut self, name: &str) -> Result<Self, BuildError> {
        self.gyro = Gyro::from_name(name).ok_or_else(|| unknown(Slot::Gyro, name))?;
        Ok(self)
    }

    /// Chooses the accel stage by name.
    ///
    /// # Errors
    ///
    /// Returns [`BuildError::UnknownStage`] if there is no such stage.
    pub fn accel_stage(mut self, name: &str) -> Result<Self, BuildError> {
        self.accel = Accelerometer::from_name(name).ok_or_else(|| unknown(Slot::Accel, name))?;
        Ok(self)
    }

    /// Chooses the course stage by name: `"angles"`, the default, or `"track"`.
    ///
    /// The stage `"track"` uses the track over ground as the heading.
    ///
    /// # Errors
    ///
    /// Returns [`BuildError::UnknownStage`] if there is no such stage.
    pub fn course_stage(mut self, name: &str) -> Result<Self, BuildError> {
        self.course = Course::from_name(name).ok_or_else(|| unknown(Slot::Course, name))?;
        Ok(self)
    }

    /// Returns the parameters of the stage in a slot, with unit, default, range and description.
    pub fn parameters(&self, slot: Slot) -> &'static [attitude::parameters::Parameter] {
        match slot {
            Slot::Gyro => self.gyro.parameters(),
            Slot::Accel => self.accel.parameters(),
            Slot::Fuser => self.fuser.parameters(),
            Slot::Course => self.course.parameters(),
        }
    }

    /// Sets a parameter of the stage in a slot. Choose the stage first.
    ///
    /// # Errors
    ///
    /// Returns [`BuildError::UnknownParameter`] if the stage has no such parameter and
    /// [`BuildError::OutOfRange`] if the value is out of range.
    pub fn parameter(mut self, slot: Slot, name: &str, value: f64) -> Result<Self, BuildError> {
        let set = match slot {
            Slot::Gyro => self.gyro.set(name, value),
            Slot::Accel => self.accel.set(name, value),
            Slot::Fuser => self.fuser.set(name, value),
            Slot::Course => self.course.set(name, value),
        };
        match set {
            Err(ParameterError::Unknown { known }) => {
                Err(BuildError::UnknownParameter { slot, name: Name::new(name), known })
            }
            other => Ok(other.map(|()| self)?),
        }
    }

    /// Creates the filter.
    pub fn build(self) -> Ahrs<F> {
        let Self { sensors, sampling: _, gyro, accel, fuser, course } = self;
        Ahrs {
            conditioner: Conditioner::new(&sensors),
            gyro: SupervisedGyro::new(gyro),
            accel: ValidatedStage::new(accel),
            fuser: SupervisedFuser::new(fuser),
            course: SupervisedCourse::new(course),
            t_ns: 0,
            pending_field_ut: None,
            pending_fix: None,
            attitude: Attitude::unaligned(),
        }
    }

    fn limit(mut self, name: &str, value: f64) -> Result<Self, BuildError> {
        Limits::set(&mut self.sensors.limits, name, value)?;
        Ok(self)
    }
}

fn unknown(slot: Slot, name: &str) -> BuildError {
    BuildError::UnknownStage { slot, name: Name::new(name) }
}

/// Rejected stage or parameter name in a [`BuildError`], truncated to 32 bytes.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Name {
    bytes: [u8; 32],
    len: usize,
}

impl Name {
    fn new(name: &str) -> Self {
        let mut bytes = [0; 32];
        let len = name.floor_char_boundary(bytes.len());
        bytes.iter_mut().zip(name[..len].bytes()).for_each(|(place, byte)| *place = byte);
        Self { bytes, len }
    }

    /// Returns the name as text.
    pub fn as_str(&self) -> &str {
        self.bytes.get(..self.len).and_then(|bytes| core::str::from_utf8(bytes).ok()).unwrap_or_default()
    }
}

impl fmt::Debug for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(self.as_str(), f)
    }
}

/// Error of an [`AhrsBuilder`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum BuildError {
    /// A value is outside its range or not a number.
    OutOfRange {
        /// Parameter with its allowed range.
        parameter: &'static attitude::parameters::Parameter,
        /// Rejected value.
        value: f64,
    },
    /// The slot has no stage of this name.
    UnknownStage {
        /// Slot of the requested stage.
        slot: Slot,
        /// Rejected stage name.
        name: Name,
    },
    /// The stage has no parameter of this name.
    UnknownParameter {
        /// Slot that contains the stage.
        slot: Slot,
        /// Rejected parameter name.
        name: Name,
        /// Parameters that the stage has.
        known: &'static [attitude::parameters::Parameter],
    },
}

impl From<ParameterError> for BuildError {
    fn from(error: ParameterError) -> Self {
        match error {
            ParameterError::OutOfRange { parameter, value } => Self::OutOfRange { parameter, value },
            ParameterError::Unknown { known } => {
                Self::UnknownParameter { slot: Slot::Fuser, name: Name::new(""), known }
            }
        }
    }
}

impl fmt::Display for BuildError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::OutOfRange { parameter, value } => ParameterError::OutOfRange { parameter, value: *value }.fmt(f),
            Self::UnknownStage { slot, name } => {
                write!(f, "slot {} has no stage `{}`; choose one of", slot.name(), name.as_str())?;
                let mut names = slot.stages().iter().enumerate();
                names.try_for_each(|(i, name)| write!(f, "{} {name}", if i == 0 { "" } else { "," }))
            }
            Self::UnknownParameter { slot, name, known } => {
                write!(f, "{} `{}`: ", slot.name(), name.as_str())?;
                ParameterError::Unknown { known }.fmt(f)
            }
        }
    }
}

impl core::error::Error for BuildError {}
