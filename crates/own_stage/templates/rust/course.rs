//! The stage `@name@` for the slot course: angles and course, from the fused attitude.
//!
//! Input: the attitude and what its heading is counted from. Output: yaw, pitch, roll, the course and the quaternion. Time: none.
//! Failure: near the vertical yaw and roll lose their meaning, and the output says so.

use std::f64::consts::{PI, TAU};

use attitude::{
    Quaternion,
    course::{Bearing, CourseInput, LastReading, Reading, Reference},
    parameters::{Parameter, ParameterError},
    stage::{RestoreError, Stage},
};

/// The name by which it is chosen.
pub const NAME: &str = "@name@";

/// Nearer to the vertical yaw and roll are not told apart, rad: 89°.
const GIMBAL_RAD: f64 = 1.553_343;

const PARAMETERS: &[Parameter] = &[Parameter {
    name: "declination_deg",
    unit: "°",
    default: 0.0,
    least: -180.0,
    most: 180.0,
    about: "Magnetic declination, east positive: makes a magnetic course a true one.",
}];

/// The course is the fuser's heading, counted clockwise, and the declination where that is magnetic.
#[derive(Debug, Clone)]
pub struct @Class@ {
    declination_deg: f64,
    last: LastReading,
}

impl Default for @Class@ {
    fn default() -> Self {
        let last = LastReading { quaternion: Quaternion::new(1.0, 0.0, 0.0, 0.0), bearing: None };
        Self { declination_deg: PARAMETERS[0].default, last }
    }
}

impl Stage for @Class@ {
    type Input = CourseInput;
    type Output = Reading;
    type Common = LastReading;

    fn name(&self) -> &'static str {
        NAME
    }

    fn parameters(&self) -> &'static [Parameter] {
        PARAMETERS
    }

    fn set(&mut self, name: &str, value: f64) -> Result<(), ParameterError> {
        let known = PARAMETERS.iter().find(|parameter| parameter.name == name);
        let parameter = known.ok_or(ParameterError::Unknown { known: PARAMETERS })?;
        if !(parameter.least..=parameter.most).contains(&value) {
            return Err(ParameterError::OutOfRange { parameter, value });
        }
        self.declination_deg = value;
        Ok(())
    }

    fn step(&mut self, input: &CourseInput) -> Reading {
        let angles = input.attitude.angles();
        let (turn_rad, reference) = match input.reference {
            Reference::Magnetic if self.declination_deg != 0.0 => (self.declination_deg.to_radians(), Reference::True),
            reference => (0.0, reference),
        };
        let course_rad = (turn_rad - angles.yaw_rad).rem_euclid(TAU) % TAU;
        let sd_rad = if input.heading_sd_rad >= 0.0 { input.heading_sd_rad.min(PI) } else { PI };
        let quaternion = input.attitude.quaternion();
        // The other sign is the same attitude, and a jump for whoever interpolates.
        let quaternion = if quaternion.dot(&self.last.quaternion) < 0.0 { -quaternion } else { quaternion };
        let aligned = self.last.bearing.is_some_and(|before| before.reference != reference);
        self.last = LastReading { quaternion, bearing: Some(Bearing { course_rad, reference, sd_rad }) };
        Reading {
            angles,
            course_rad,
            reference,
            course_sd_rad: sd_rad,
            quaternion,
            near_gimbal: angles.pitch_rad.abs() > GIMBAL_RAD,
            aligned,
        }
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let none = Bearing { course_rad: 0.0, reference: Reference::Arbitrary, sd_rad: PI };
        let mut told = f64::from(u8::from(self.last.bearing.is_some()));
        let Bearing { mut course_rad, reference, mut sd_rad } = self.last.bearing.unwrap_or(none);
        let mut counted_from = match reference {
            Reference::Arbitrary => 0.0,
            Reference::Magnetic => 1.0,
            Reference::True => 2.0,
        };
        self.last.quaternion.coords.iter_mut().for_each(&mut *visit);
        [&mut told, &mut course_rad, &mut counted_from, &mut sd_rad].into_iter().for_each(visit);
        let reference = match counted_from {
            x if x > 1.5 => Reference::True,
            x if x > 0.5 => Reference::Magnetic,
            _ => Reference::Arbitrary,
        };
        self.last.bearing = (told > 0.5).then_some(Bearing { course_rad, reference, sd_rad });
    }

    fn flaw(&self) -> Option<&'static str> {
        flaw(&self.last)
    }

    fn common(&self) -> LastReading {
        self.last
    }

    fn adopt(&mut self, common: &LastReading) -> Result<(), RestoreError> {
        flaw(common).map_or(Ok(()), |flaw| Err(RestoreError::Flaw { flaw }))?;
        self.last = *common;
        Ok(())
    }
}

/// What is wrong with a reading; what is not a number is inside nothing.
fn flaw(last: &LastReading) -> Option<&'static str> {
    let unit = (last.quaternion.norm_squared() - 1.0).abs() <= 1e-6;
    let bearing = last.bearing.is_none_or(|bearing| (0.0..TAU).contains(&bearing.course_rad) && bearing.sd_rad >= 0.0);
    (!(unit && bearing)).then_some("a reading that is none")
}
