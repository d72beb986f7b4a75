//! The filter: checks of the samples, followed by the stages of the four slots.

use core::fmt;

use attitude::{
    accel::Accelerometer,
    conditioner::Conditioner,
    course::{Course, SupervisedCourse},
    fuser::{Estimate, FuserStage, SupervisedFuser, multiple_model::MultipleModel},
    gnss::{Fix, ReceiverFix},
    gyro::{Gyro, SupervisedGyro},
    stage::RestoreError,
    validated_stage::{StageFailure, ValidatedStage},
};

use crate::{
    Attitude,
    parts::{CheckedSample, DeferredAttitude, Fusion, Parts, Sensors, complete_attitude, next_ns},
};

/// Velocity over ground from a satellite receiver.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct GnssFix {
    /// Velocity, m/s: east, north, up.
    pub velocity_m_s: [f64; 3],
    /// Standard deviation of each component, m/s, if the receiver reports it.
    pub velocity_sd_m_s: Option<f64>,
    /// Age of the velocity when it arrives, s, if known.
    pub age_s: Option<f64>,
    /// Geodetic latitude, rad, north positive, if known.
    pub latitude_rad: Option<f64>,
}

/// Attitude and heading reference system.
///
/// `F` is the stage that fuses the sensors; see [`stages`](crate::stages). The default stage
/// suits every combination of sensors.
///
/// A filter takes about 65 kB and has no state elsewhere, so a clone continues independently.
#[derive(Clone)]
pub struct Ahrs<F = MultipleModel> {
    pub(crate) conditioner: Conditioner,
    pub(crate) gyro: SupervisedGyro<Gyro>,
    pub(crate) accel: ValidatedStage<Accelerometer>,
    pub(crate) fuser: SupervisedFuser<F>,
    pub(crate) course: SupervisedCourse<Course>,
    /// Sensor time of the newest reading, ns.
    pub(crate) t_ns: i64,
    /// Magnetic field from `update_mag` that takes effect with the next reading, µT.
    pub(crate) pending_field_ut: Option<[f64; 3]>,
    /// Fix from `update_gnss` that takes effect with the next reading.
    pub(crate) pending_fix: Option<ReceiverFix>,
    pub(crate) attitude: Attitude,
}

impl<F: FuserStage> Ahrs<F> {
    /// Processes a sample of all sensors and returns the new attitude.
    ///
    /// - `gyro_rad_s`: body rate, rad/s.
    /// - `accel_m_s2`: specific force, m/s²; points up at rest.
    /// - `field_ut`: magnetic field, µT, or `None` for the newest field that `update_mag` has
    ///   stored since the previous sample, if any. A field that equals the previous one counts as
    ///   repeated and is not used twice.
    /// - `dt_s`: time since the previous sample, s. A value that is 0, negative or not finite marks
    ///   a late or repeated sample. The first sample only starts the clock.
    ///
    /// If the sample is rejected, the attitude is unchanged, including its
    /// [`tick`](Attitude::tick).
    pub fn update(
        &mut self,
        gyro_rad_s: [f64; 3],
        accel_m_s2: [f64; 3],
        field_ut: Option<[f64; 3]>,
        dt_s: f64,
    ) -> Attitude {
        self.update_at(gyro_rad_s, accel_m_s2, field_ut, next_ns(self.t_ns, dt_s))
    }

    /// Processes a timestamped sample of all sensors and returns the new attitude.
    ///
    /// `t_ns` is the end of the sample's interval on the clock of the sensors, ns. The other
    /// arguments are those of [`update`](Self::update).
    pub fn update_at(
        &mut self,
        gyro_rad_s: [f64; 3],
        accel_m_s2: [f64; 3],
        field_ut: Option<[f64; 3]>,
        t_ns: i64,
    ) -> Attitude {
        if let Some(attitude) = self.process(gyro_rad_s, accel_m_s2, field_ut, t_ns) {
            self.attitude = attitude;
        }
        self.attitude
    }

    /// Stores a magnetometer sample, µT. It takes effect with the next gyro and accelerometer
    /// sample.
    pub fn update_mag(&mut self, field_ut: [f64; 3]) {
        self.pending_field_ut = Some(field_ut);
    }

    /// Stores a velocity from the satellite receiver. It takes effect with the next gyro and
    /// accelerometer sample.
    pub fn update_gnss(&mut self, fix: &GnssFix) {
        let GnssFix { velocity_m_s, velocity_sd_m_s, age_s, latitude_rad } = *fix;
        let fix = Fix { velocity_m_s: velocity_m_s.into(), sd_m_s: velocity_sd_m_s, age_s, latitude_rad };
        self.pending_fix = Some(fix.into());
    }

    /// Returns the newest attitude. Before the first sample it is level, and flagged as unaligned.
    pub fn attitude(&self) -> Attitude {
        self.attitude
    }

    /// Returns the number of rejected samples so far.
    pub fn rejected(&self) -> u64 {
        self.conditioner.rejected()
    }

    /// Returns the cause of a permanent stage failure, or `None` if no stage has failed. After a
    /// failure the attitude no longer changes.
    ///
    /// The stages of this crate do not fail. A user-defined stage fails if its output is invalid
    /// even after a reset.
    pub fn failure(&self) -> Option<StageFailure<'_>> {
        self.gyro
            .validated
            .failure()
            .or_else(|| self.accel.failure())
            .or_else(|| self.fuser.failure())
            .or_else(|| self.course.validated.failure())
    }

    /// Returns the fuser stage.
    pub fn fuser(&self) -> &F {
        self.fuser.stage()
    }

    /// Returns the estimate that a filter with another fuser stage can adopt.
    ///
    /// The estimate contains the attitude and the sensor errors, with their standard deviations.
    pub fn estimate(&self) -> Estimate {
        self.fuser.stage().common()
    }

    /// Starts with sensor errors that an earlier run has estimated: gyro bias, gyro scale and hard
    /// iron. The attitude of `prior` is not used.
    ///
    /// # Errors
    ///
    /// Returns an error if `prior` is invalid. The filter is then unchanged.
    pub fn seed_sensor_errors(&mut self, prior: &Estimate) -> Result<(), RestoreError> {
        self.fuser.stage_mut().seed_sensor_errors(prior)
    }
}

impl<F: FuserStage> Ahrs<F> {
    /// Returns the parts of the filter.
    ///
    /// The samples that the parts process change [`attitude`](Self::attitude) at
    /// [`Fusion::finish`].
    #[inline]
    pub fn parts(&mut self) -> Parts<'_, F> {
        let Self { conditioner, gyro, accel, fuser, course, t_ns, pending_field_ut, pending_fix, attitude } = self;
        let (inputs, fuser) = fuser.parts();
        let sensors = Sensors { conditioner, gyro, accel, inputs, t_ns, pending_field_ut, pending_fix };
        let fusion = Fusion { fuser, course, newest: DeferredAttitude::from_attitude(attitude), attitude };
        Parts { sensors, fusion }
    }

    /// Processes a timestamped sample.
    ///
    /// Returns `None` if the sample is rejected, and once a stage has failed.
    #[inline(always)]
    fn process(
        &mut self,
        gyro_rad_s: [f64; 3],
        accel_m_s2: [f64; 3],
        field_ut: Option<[f64; 3]>,
        sample_ns: i64,
    ) -> Option<Attitude> {
        let Self { conditioner, gyro, accel, fuser, course, t_ns, pending_field_ut, pending_fix, attitude: _ } = self;
        let (inputs, mut fuser) = fuser.parts();
        let mut sensors = Sensors { conditioner, gyro, accel, inputs, t_ns, pending_field_ut, pending_fix };
        let mut sample = CheckedSample::default();
        sensors.check(gyro_rad_s, accel_m_s2, field_ut, sample_ns, &mut sample)?;
        complete_attitude(&mut fuser, course, &sample)
    }
}

impl<F: FuserStage> fmt::Debug for Ahrs<F> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Ahrs")
            .field("fuser", &self.fuser.stage().name())
            .field("attitude", &self.attitude)
            .finish_non_exhaustive()
    }
}
