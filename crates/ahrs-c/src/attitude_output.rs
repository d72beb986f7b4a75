//! Attitude as a C structure.

use plumbline_ahrs::{Attitude, CourseReference, Frame};

/// Direction in which the heading is zero.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum PlumblineHeadingReference {
    /// Arbitrary direction, because no sensor observes north.
    Arbitrary = 0,
    /// Magnetic north.
    Magnetic = 1,
    /// True north.
    True = 2,
}

/// Attitude after a sample, with heading, gyro bias, standard deviations and flags.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(C)]
pub struct PlumblineAttitude {
    /// Unit quaternion from body to reference axes, w x y z: v_ref = q v_body q*. In the native
    /// frame, its sign is continuous with that of the previous attitude.
    pub quaternion: [f64; 4],
    /// Yaw by the convention of the frame, rad. In the native frame counter-clockwise from above.
    pub yaw_rad: f64,
    /// Pitch by the convention of the frame, rad. In the native frame nose up.
    pub pitch_rad: f64,
    /// Roll by the convention of the frame, rad. In the native frame right side down.
    pub roll_rad: f64,
    /// Heading in every frame, rad, clockwise from above, [0, 2 pi).
    pub heading_rad: f64,
    /// Standard deviation of the heading, rad; pi if the heading is unknown.
    pub heading_sd_rad: f64,
    /// Standard deviation of the inclination, rad.
    pub inclination_sd_rad: f64,
    /// Declination that the heading includes, rad, east positive.
    pub declination_rad: f64,
    /// Body rate with the bias removed, rad/s, body axes of the frame.
    pub rate_rad_s: [f64; 3],
    /// Estimated gyro bias, rad/s, body axes of the frame; zero if the stage does not estimate it.
    pub gyro_bias_rad_s: [f64; 3],
    /// Angle between the up directions of accelerometer and attitude, rad.
    pub innovation_rad: f64,
    /// Newest jump of the attitude as a rotation, w x y z, body axes of the frame.
    pub jump: [f64; 4],
    /// Number of jumps of the attitude or the heading since the first alignment.
    pub reset_counter: u64,
    /// Faults and events of the sample: bits PLUMBLINE_FLAG_...
    pub flags: u64,
    /// Number of accepted samples before this one.
    pub tick: u64,
    /// Time of the attitude, ns: the sample timestamp, corrected for jumps of the sensor clock.
    pub t_ns: i64,
    /// PlumblineHeadingReference: direction in which the heading is zero.
    pub heading_reference: u32,
}

impl PlumblineAttitude {
    /// Converts an attitude to a frame.
    pub(crate) fn new(attitude: &Attitude, frame: Frame) -> Self {
        let angles = attitude.angles_in(frame);
        let reference = match attitude.heading_reference() {
            CourseReference::Arbitrary => PlumblineHeadingReference::Arbitrary,
            CourseReference::Magnetic => PlumblineHeadingReference::Magnetic,
            CourseReference::True => PlumblineHeadingReference::True,
        };
        Self {
            quaternion: attitude.quaternion_in(frame),
            yaw_rad: angles.yaw_rad,
            pitch_rad: angles.pitch_rad,
            roll_rad: angles.roll_rad,
            heading_rad: attitude.heading_rad(),
            heading_sd_rad: attitude.heading_sd_rad(),
            inclination_sd_rad: attitude.inclination_sd_rad(),
            declination_rad: attitude.declination_rad(),
            rate_rad_s: attitude.rate_rad_s_in(frame),
            gyro_bias_rad_s: attitude.gyro_bias_rad_s_in(frame),
            innovation_rad: attitude.innovation_rad(),
            jump: frame.body().rotation(attitude.jump()),
            reset_counter: attitude.reset_counter(),
            flags: attitude.flags().0,
            tick: attitude.tick(),
            t_ns: attitude.t_ns(),
            heading_reference: reference as u32,
        }
    }
}
