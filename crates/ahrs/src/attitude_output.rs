//! Output of the filter.

use attitude::{
    Quaternion,
    angles::Angles,
    course::{CourseReading, CourseReference},
    flags::Flags,
    frames::Frame,
    fuser::Fused,
};

/// Attitude after a sample, with heading, gyro bias, standard deviations and flags.
///
/// Methods without a frame return values in the frame of Plumbline: reference axes east, north, up
/// and body axes right, forward, up ([`Frame::EnuRfu`]).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Attitude {
    pub(crate) tick: u64,
    pub(crate) t_ns: i64,
    pub(crate) flags: Flags,
    pub(crate) fused: Fused,
    pub(crate) reading: CourseReading,
    pub(crate) reset_counter: u64,
    pub(crate) jump: [f64; 4],
}

impl Attitude {
    /// Returns the attitude before the first sample.
    pub(crate) fn unaligned() -> Self {
        let reading = CourseReading {
            quaternion: Quaternion::new(1.0, 0.0, 0.0, 0.0),
            course_sd_rad: core::f64::consts::PI,
            ..CourseReading::default()
        };
        let pi = core::f64::consts::PI;
        Self {
            tick: 0,
            t_ns: 0,
            flags: Flags::UNALIGNED,
            fused: Fused { inclination_sd_rad: pi, heading_sd_rad: pi, ..Fused::default() },
            reading,
            reset_counter: 0,
            jump: [1.0, 0.0, 0.0, 0.0],
        }
    }

    /// Returns the unit quaternion from body to reference axes, w x y z: v_ref = q v_body q*.
    ///
    /// The sign is chosen such that successive quaternions are close to each other.
    pub fn quaternion(&self) -> [f64; 4] {
        let q = self.reading.quaternion;
        [q.w, q.i, q.j, q.k]
    }

    /// Returns the unit quaternion from body to reference axes of `frame`, w x y z.
    ///
    /// ```
    /// use plumbline_ahrs::{Ahrs, Frame};
    ///
    /// let attitude = Ahrs::new().update([0.0; 3], [0.0, 0.0, 9.81], None, 0.01);
    /// let [w, x, y, z] = attitude.quaternion_in(Frame::EnuFlu); // ROS
    /// assert!((w * w + x * x + y * y + z * z - 1.0).abs() < 1e-12);
    /// ```
    pub fn quaternion_in(&self, frame: Frame) -> [f64; 4] {
        frame.quaternion(self.quaternion())
    }

    /// Returns yaw, pitch and roll: yaw counter-clockwise from above, pitch nose up, roll right
    /// side down.
    pub fn angles(&self) -> Angles {
        self.reading.angles
    }

    /// Returns yaw, pitch and roll by the conventions of `frame`.
    pub fn angles_in(&self, frame: Frame) -> Angles {
        frame.angles(self.reading.angles)
    }

    /// Returns the heading, rad, clockwise from above, [0, 2π). It is zero in the direction
    /// [`heading_reference`](Self::heading_reference).
    ///
    /// With the course stage `track`, the heading is the direction of travel.
    #[doc(alias = "course")]
    pub fn heading_rad(&self) -> f64 {
        self.reading.course_rad
    }

    /// Returns the direction in which the heading is zero.
    ///
    /// The direction is magnetic north, true north, or arbitrary if no sensor observes north.
    pub fn heading_reference(&self) -> CourseReference {
        self.reading.reference
    }

    /// Returns the standard deviation of the heading, rad; π if the heading is unknown.
    pub fn heading_sd_rad(&self) -> f64 {
        self.reading.course_sd_rad
    }

    /// Returns the declination that the heading includes, rad, east positive.
    pub fn declination_rad(&self) -> f64 {
        self.reading.declination_rad
    }

    /// Returns the standard deviation of the inclination, rad.
    pub fn inclination_sd_rad(&self) -> f64 {
        self.fused.inclination_sd_rad
    }

    /// Returns the body rate in body axes with the bias removed, rad/s.
    pub fn rate_rad_s(&self) -> [f64; 3] {
        self.fused.rate_rad_s.into()
    }

    /// Returns the body rate in the body axes of `frame` with the bias removed, rad/s.
    pub fn rate_rad_s_in(&self, frame: Frame) -> [f64; 3] {
        frame.body().vector(self.rate_rad_s())
    }

    /// Returns the estimated gyro bias in body axes, rad/s; zero if the stage does not estimate it.
    pub fn gyro_bias_rad_s(&self) -> [f64; 3] {
        self.fused.bias_rad_s.into()
    }

    /// Returns the estimated gyro bias in the body axes of `frame`, rad/s.
    pub fn gyro_bias_rad_s_in(&self, frame: Frame) -> [f64; 3] {
        frame.body().vector(self.gyro_bias_rad_s())
    }

    /// Returns the angle between the up directions of accelerometer and attitude, rad.
    pub fn innovation_rad(&self) -> f64 {
        self.fused.innovation_rad
    }

    /// Returns the faults and events of the sample.
    ///
    /// ```
    /// use plumbline_ahrs::{Ahrs, Flags};
    ///
    /// let attitude = Ahrs::new().update([f64::NAN; 3], [0.0, 0.0, 9.81], None, 0.01);
    /// assert!(attitude.flags().any(Flags::RATE_INVALID));
    /// ```
    pub fn flags(&self) -> Flags {
        self.flags
    }

    /// Returns `true` once a force has aligned the attitude. Before that, it is arbitrary.
    pub fn is_aligned(&self) -> bool {
        !self.flags.any(Flags::UNALIGNED)
    }

    /// Returns the number of jumps of the attitude or the heading since the first alignment.
    ///
    /// If the number has changed, a controller must not treat the change of the attitude as a
    /// rotation of the body.
    pub fn reset_counter(&self) -> u64 {
        self.reset_counter
    }

    /// Returns the newest jump of the attitude as a quaternion w x y z in body axes.
    ///
    /// The jump is the rotation from the expected to the new attitude.
    pub fn jump(&self) -> [f64; 4] {
        self.jump
    }

    /// Returns the number of accepted samples before this one.
    pub fn tick(&self) -> u64 {
        self.tick
    }

    /// Returns the time of the attitude, ns: the sample timestamp, corrected for jumps of the
    /// sensor clock.
    pub fn t_ns(&self) -> i64 {
        self.t_ns
    }
}
