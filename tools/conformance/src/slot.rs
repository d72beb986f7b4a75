//! Properties of each slot that the conformance checks need.

use attitude::{
    Complex, GRAVITY_M_S2, Quaternion, Vector3,
    accel::{Accelerometer, Inclination, MIN_FORCE_M_S2},
    course::{Course, CourseEstimate, CourseInput, CourseReading, CourseReference, LastReading},
    fuser::{Estimate, Fused, Fuser, FuserInput, GyroScale, HardIron, LeakyVelocity},
    gyro::{Gyro, Motion, RateKind, RateSample},
    point::{Chart, Point},
    stage::Stage,
    state::Attitude,
};
use launch::Slot;

use crate::{
    fault::MAX_INTERVAL_S,
    script::{Script, Tick},
};

/// Stage that can fill the slot `L`.
pub(crate) trait SlotStage<L: SlotSpec>:
    Stage<Input = L::Input, Output = L::Output, Common = L::Common> + Clone
{
}

impl<L: SlotSpec, S: Stage<Input = L::Input, Output = L::Output, Common = L::Common> + Clone> SlotStage<L> for S {}

/// Inputs, outputs and requirements of a slot.
pub(crate) trait SlotSpec: Sized {
    type Input: Copy;
    type Output;
    type Common: Copy;
    /// Built-in stages of the slot.
    type BuiltIn: SlotStage<Self>;

    const SLOT: Slot;
    /// `true` if the sign of the output's quaternion must be continuous.
    const HAS_CONTINUOUS_SIGN: bool = false;
    /// `true` if a stage must report the exact inclination when its sensors are exact.
    const HAS_EXACT_LEVEL: bool;

    fn from_name(name: &str) -> Option<Self::BuiltIn>;

    /// Returns the inputs of the slot for a script, each with the index of its tick.
    fn inputs(script: &Script) -> Vec<(usize, Self::Input)>;

    /// Passes each number of an output, with its name, to `visit`.
    fn visit_numbers(output: &Self::Output, visit: &mut dyn FnMut(&'static str, f64));

    /// Returns the reason why an output of finite numbers is invalid, or `None` if it is valid.
    fn validation_error(output: &Self::Output) -> Option<&'static str>;

    /// Returns the first error of an output: a non-finite number or a validation error.
    fn output_error(output: &Self::Output) -> Option<String> {
        let mut error = None;
        Self::visit_numbers(output, &mut |name, value| {
            if !value.is_finite() && error.is_none() {
                error = Some(format!("{name} is {value}"));
            }
        });
        error.or_else(|| Self::validation_error(output).map(String::from))
    }

    /// Returns the reference direction of an output's heading; `None` if it has no heading.
    fn heading_reference(output: &Self::Output) -> Option<CourseReference>;

    /// Returns the attitude of an output, body → reference.
    fn quaternion(output: &Self::Output) -> Quaternion<f64>;

    /// Returns common states that every stage must reject, with their descriptions.
    fn invalid_common_states() -> Vec<(&'static str, Self::Common)>;
}

pub(crate) struct GyroSlot;
pub(crate) struct AccelSlot;
pub(crate) struct FuserSlot;
pub(crate) struct CourseSlot;

impl SlotSpec for GyroSlot {
    type Input = RateSample;
    type Output = Motion;
    type Common = Attitude;
    type BuiltIn = Gyro;

    const SLOT: Slot = Slot::Gyro;
    const HAS_EXACT_LEVEL: bool = false;

    fn from_name(name: &str) -> Option<Gyro> {
        Gyro::from_name(name)
    }

    fn inputs(script: &Script) -> Vec<(usize, RateSample)> {
        let mut elapsed_s = 0.0;
        let sample = |(i, tick): (usize, &Tick)| {
            elapsed_s += tick.dt_s;
            let rate_rad_s = tick.rate_rad_s?;
            let dt_s = std::mem::take(&mut elapsed_s);
            let dt_s = if dt_s.is_finite() && dt_s > MAX_INTERVAL_S { 0.0 } else { dt_s };
            Some((i, RateSample { rate_rad_s, dt_s, kind: RateKind::Instant }))
        };
        script.ticks.iter().enumerate().filter_map(sample).collect()
    }

    fn visit_numbers(output: &Motion, visit: &mut dyn FnMut(&'static str, f64)) {
        visit_attitude(output.attitude, visit);
        let [d0, d1, d2, d3] = [output.rotation.p.re, output.rotation.s.re, output.rotation.s.im, output.rotation.p.im];
        visit_all(["d0", "d1", "d2", "d3"], [d0, d1, d2, d3], visit);
        visit_all(["rate_x_rad_s", "rate_y_rad_s", "rate_z_rad_s"], output.rate_rad_s.into(), visit);
        visit("dt_s", output.dt_s);
    }

    fn validation_error(output: &Motion) -> Option<&'static str> {
        let size2 = output.rotation.p.norm_sqr() + output.rotation.s.norm_sqr();
        attitude_error(output.attitude)
            .or(((size2 - 1.0).abs() > 1e-9).then_some("a rotation that is not of unit length"))
    }

    fn heading_reference(_: &Motion) -> Option<CourseReference> {
        Some(CourseReference::Arbitrary)
    }

    fn quaternion(output: &Motion) -> Quaternion<f64> {
        output.attitude.quaternion()
    }

    fn invalid_common_states() -> Vec<(&'static str, Attitude)> {
        invalid_attitudes()
    }
}

impl SlotSpec for AccelSlot {
    type Input = Vector3<f64>;
    type Output = Inclination;
    type Common = Point;
    type BuiltIn = Accelerometer;

    const SLOT: Slot = Slot::Accel;
    const HAS_EXACT_LEVEL: bool = true;

    fn from_name(name: &str) -> Option<Accelerometer> {
        Accelerometer::from_name(name)
    }

    fn inputs(script: &Script) -> Vec<(usize, Vector3<f64>)> {
        script.ticks.iter().enumerate().filter_map(|(i, tick)| Some((i, tick.force_m_s2?))).collect()
    }

    fn visit_numbers(output: &Inclination, visit: &mut dyn FnMut(&'static str, f64)) {
        visit_point(output.up, visit);
        visit_all(["force_x_m_s2", "force_y_m_s2", "force_z_m_s2"], output.force_m_s2.into(), visit);
        visit("norm_m_s2", output.norm_m_s2);
        visit("trust", output.trust);
    }

    fn validation_error(output: &Inclination) -> Option<&'static str> {
        let valid_trust = (0.0..=1.0).contains(&output.trust);
        attitude_error(Attitude::from_up(output.up)).or((!valid_trust).then_some("a trust outside 0 to 1"))
    }

    fn heading_reference(_: &Inclination) -> Option<CourseReference> {
        None
    }

    fn quaternion(output: &Inclination) -> Quaternion<f64> {
        Attitude::from_up(output.up).quaternion()
    }

    fn invalid_common_states() -> Vec<(&'static str, Point)> {
        invalid_attitudes()
            .into_iter()
            .filter(|(description, _)| description.contains("point"))
            .map(|(description, attitude)| (description, attitude.up))
            .collect()
    }
}

/// Inclination of a level body at rest.
const LEVEL_AT_REST: Inclination = Inclination {
    up: Point { w: Complex::new(0.0, 0.0), chart: Chart::Upright },
    force_m_s2: Vector3::new(0.0, 0.0, GRAVITY_M_S2),
    norm_m_s2: GRAVITY_M_S2,
    trust: 1.0,
};

fn is_finite(vector: &Vector3<f64>) -> bool {
    vector.iter().all(|component| component.is_finite())
}

/// Copies a rate or an interval from the tick to a motion if the value is not finite. This
/// simulates an upstream stage that passes on such values without checking them.
fn with_non_finite_values(motion: Motion, tick: &Tick) -> Motion {
    let rate_rad_s = tick.rate_rad_s.filter(|rate| !is_finite(rate)).unwrap_or(motion.rate_rad_s);
    Motion { rate_rad_s, dt_s: if tick.dt_s.is_finite() { motion.dt_s } else { tick.dt_s }, ..motion }
}

impl SlotSpec for FuserSlot {
    type Input = FuserInput;
    type Output = Fused;
    type Common = Estimate;
    type BuiltIn = Fuser;

    const SLOT: Slot = Slot::Fuser;
    const HAS_EXACT_LEVEL: bool = true;

    fn from_name(name: &str) -> Option<Fuser> {
        Fuser::from_name(name)
    }

    fn inputs(script: &Script) -> Vec<(usize, FuserInput)> {
        let (mut gyro, mut projector) = (Gyro::from_name("mobius"), Accelerometer::from_name("projector"));
        let mut motions = GyroSlot::inputs(script).into_iter().peekable();
        let mut input = |(i, tick): (usize, &Tick)| {
            let sample = motions.next_if(|(index, _)| *index == i);
            let motion = gyro.as_mut().zip(sample).map(|(gyro, (_, sample))| gyro.step(&sample));
            let motion = motion.filter(|motion| GyroSlot::output_error(motion).is_none());
            let motion = motion.map(|motion| with_non_finite_values(motion, tick));
            let usable = tick.force_m_s2.filter(|force| force.norm() >= MIN_FORCE_M_S2 && force.norm().is_finite());
            let inclination = projector.as_mut().zip(usable).map(|(projector, force)| projector.step(&force));
            let non_finite = tick.force_m_s2.filter(|force| !is_finite(force));
            let inclination = inclination.or_else(|| Some(Inclination { force_m_s2: non_finite?, ..LEVEL_AT_REST }));
            let input = FuserInput {
                motion,
                inclination,
                field_ut: tick.field_ut,
                fix: tick.fix,
                rest_credible: tick.rest_credible,
                rate_credible: tick.rate_credible,
            };
            (i, input)
        };
        script.ticks.iter().enumerate().map(&mut input).collect()
    }

    fn visit_numbers(output: &Fused, visit: &mut dyn FnMut(&'static str, f64)) {
        visit_attitude(output.attitude, visit);
        visit_all(["rate_x_rad_s", "rate_y_rad_s", "rate_z_rad_s"], output.rate_rad_s.into(), visit);
        visit_all(["bias_x_rad_s", "bias_y_rad_s", "bias_z_rad_s"], output.bias_rad_s.into(), visit);
        visit("innovation_rad", output.innovation_rad);
        visit("inclination_sd_rad", output.inclination_sd_rad);
        visit("heading_sd_rad", output.heading_sd_rad);
        visit("reference", f64::from(output.reference as u8));
        let c = output.corrections;
        let used = [c.tilt, c.bias, c.magnetic, c.velocity, c.disturbed, c.rest, c.aligned];
        visit("corrections", used.iter().rev().fold(0.0, |sum, used| 2.0 * sum + f64::from(u8::from(*used))));
    }

    fn validation_error(output: &Fused) -> Option<&'static str> {
        let sds = [output.innovation_rad, output.inclination_sd_rad, output.heading_sd_rad];
        let has_negative = sds.iter().any(|sd| *sd < 0.0);
        attitude_error(output.attitude).or(has_negative.then_some("a negative standard deviation or innovation"))
    }

    fn heading_reference(output: &Fused) -> Option<CourseReference> {
        Some(output.reference)
    }

    fn quaternion(output: &Fused) -> Quaternion<f64> {
        output.attitude.quaternion()
    }

    fn invalid_common_states() -> Vec<(&'static str, Estimate)> {
        let valid = Estimate {
            attitude: Attitude::default(),
            reference: CourseReference::Arbitrary,
            bias_rad_s: Vector3::zeros(),
            inclination_sd_rad: 0.01,
            heading_sd_rad: 0.1,
            bias_sd_rad_s: 1e-3,
            gyro_scale: GyroScale::UNKNOWN,
            hard_iron: HardIron::UNKNOWN,
            leaky_velocity: LeakyVelocity::UNKNOWN,
        };
        let mut invalid: Vec<_> = invalid_attitudes()
            .into_iter()
            .map(|(description, attitude)| (description, Estimate { attitude, ..valid }))
            .collect();
        for bias in [f64::NAN, f64::INFINITY, 1e6] {
            let bias_rad_s = Vector3::new(0.0, bias, 0.0);
            invalid.push(("an invalid bias", Estimate { bias_rad_s, ..valid }));
        }
        for field_ut in [f64::NAN, f64::INFINITY, 1e6] {
            let hard_iron = HardIron { field_ut: Vector3::new(field_ut, 0.0, 0.0), sd_ut: 1.0 };
            invalid.push(("an invalid hard iron", Estimate { hard_iron, ..valid }));
        }
        for error in [f64::NAN, f64::INFINITY, 1.0] {
            let gyro_scale = GyroScale { error: Vector3::new(0.0, error, 0.0), sd: Vector3::repeat(1e-3) };
            invalid.push(("an invalid scale", Estimate { gyro_scale, ..valid }));
        }
        for east_m_s in [f64::NAN, f64::INFINITY, 1e6] {
            let leaky_velocity = LeakyVelocity { velocity_m_s: Complex::new(east_m_s, 0.0), sd_m_s: 1.0 };
            invalid.push(("an invalid velocity", Estimate { leaky_velocity, ..valid }));
        }
        for sd in [f64::NAN, -1.0] {
            let gyro_scale = GyroScale { sd: Vector3::new(1e-3, sd, 1e-3), ..GyroScale::UNKNOWN };
            invalid.push(("an invalid standard deviation of the scale", Estimate { gyro_scale, ..valid }));
            invalid.push((
                "an invalid standard deviation of the inclination",
                Estimate { inclination_sd_rad: sd, ..valid },
            ));
            invalid.push(("an invalid standard deviation of the heading", Estimate { heading_sd_rad: sd, ..valid }));
            invalid.push(("an invalid standard deviation of the bias", Estimate { bias_sd_rad_s: sd, ..valid }));
            let hard_iron = HardIron { sd_ut: sd, ..HardIron::UNKNOWN };
            invalid.push(("an invalid standard deviation of the hard iron", Estimate { hard_iron, ..valid }));
            let leaky_velocity = LeakyVelocity { sd_m_s: sd, ..LeakyVelocity::UNKNOWN };
            invalid.push(("an invalid standard deviation of the velocity", Estimate { leaky_velocity, ..valid }));
        }
        invalid
    }
}

impl SlotSpec for CourseSlot {
    type Input = CourseInput;
    type Output = CourseReading;
    type Common = LastReading;
    type BuiltIn = Course;

    const SLOT: Slot = Slot::Course;
    const HAS_CONTINUOUS_SIGN: bool = true;
    const HAS_EXACT_LEVEL: bool = true;

    fn from_name(name: &str) -> Option<Course> {
        Course::from_name(name)
    }

    fn inputs(script: &Script) -> Vec<(usize, CourseInput)> {
        let input = |tick: &Tick| CourseInput {
            attitude: tick.truth,
            reference: CourseReference::Magnetic,
            heading_sd_rad: 0.02,
            fix: tick.fix,
            dt_s: tick.dt_s,
        };
        script.ticks.iter().map(input).enumerate().collect()
    }

    fn visit_numbers(output: &CourseReading, visit: &mut dyn FnMut(&'static str, f64)) {
        let q = output.quaternion;
        visit_all(["qw", "qx", "qy", "qz"], [q.w, q.i, q.j, q.k], visit);
        visit("yaw_rad", output.angles.yaw_rad);
        visit("pitch_rad", output.angles.pitch_rad);
        visit("roll_rad", output.angles.roll_rad);
        visit("course_rad", output.course_rad);
        visit("reference", f64::from(output.reference as u8));
        visit("course_sd_rad", output.course_sd_rad);
        visit("near_gimbal", f64::from(u8::from(output.near_gimbal)));
        visit("aligned", f64::from(u8::from(output.aligned)));
    }

    fn validation_error(output: &CourseReading) -> Option<&'static str> {
        if (output.quaternion.norm() - 1.0).abs() > 1e-9 {
            return Some("a quaternion that is not of unit length");
        }
        if !(0.0..std::f64::consts::TAU).contains(&output.course_rad) {
            return Some("a course outside 0 to 2π");
        }
        (output.course_sd_rad < 0.0).then_some("a negative standard deviation")
    }

    fn heading_reference(_: &CourseReading) -> Option<CourseReference> {
        Some(CourseReference::Arbitrary)
    }

    fn quaternion(output: &CourseReading) -> Quaternion<f64> {
        output.quaternion
    }

    fn invalid_common_states() -> Vec<(&'static str, LastReading)> {
        let quaternion =
            |w: f64, x: f64, y: f64| LastReading { quaternion: Quaternion::new(w, x, y, 0.0), course: None };
        let course = |course_rad: f64, sd_rad: f64| {
            let estimate = Some(CourseEstimate { course_rad, reference: CourseReference::True, sd_rad });
            LastReading { course: estimate, ..quaternion(1.0, 0.0, 0.0) }
        };
        vec![
            ("a quaternion of zero", quaternion(0.0, 0.0, 0.0)),
            ("a quaternion of length 2", quaternion(0.0, 2.0, 0.0)),
            ("a NaN quaternion", quaternion(1.0, 0.0, f64::NAN)),
            ("an infinite quaternion", quaternion(f64::INFINITY, 0.0, 0.0)),
            ("a NaN course", course(f64::NAN, 0.1)),
            ("a course of 400°", course(7.0, 0.1)),
            ("a negative standard deviation", course(1.0, -0.1)),
            ("a NaN standard deviation", course(1.0, f64::NAN)),
        ]
    }
}

fn invalid_attitudes() -> Vec<(&'static str, Attitude)> {
    let point = |re: f64, chart| Attitude { up: Point { w: Complex::new(re, 0.1), chart }, z_rad: 0.3 };
    let rotated = |z_rad| Attitude { z_rad, ..Attitude::default() };
    vec![
        ("a NaN point", point(f64::NAN, Chart::Upright)),
        ("an infinite point", point(f64::INFINITY, Chart::Inverted)),
        ("a point outside its chart", point(1e6, Chart::Upright)),
        ("a point outside its inverted chart", point(-3.0, Chart::Inverted)),
        ("a NaN rotation about the vertical", rotated(f64::NAN)),
        ("a rotation about the vertical beyond π", rotated(100.0)),
    ]
}

/// Returns the reason why an attitude is invalid, or `None` if it is valid.
///
/// The chart coordinate w of the up vector must not exceed 1.2 in magnitude, because the chart
/// changes at this value. All limits allow for rounding.
fn attitude_error(attitude: Attitude) -> Option<&'static str> {
    if attitude.up.w.norm_sqr() > 1.44 + 1e-9 {
        return Some("a point outside its chart");
    }
    if attitude.z_rad.abs() > std::f64::consts::PI {
        return Some("a rotation about the vertical outside −π to π");
    }
    ((attitude.quaternion().norm() - 1.0).abs() > 1e-9).then_some("a quaternion that is not of unit length")
}

fn visit_attitude(attitude: Attitude, visit: &mut dyn FnMut(&'static str, f64)) {
    visit_point(attitude.up, visit);
    visit("z_rad", attitude.z_rad);
}

fn visit_point(point: Point, visit: &mut dyn FnMut(&'static str, f64)) {
    visit("u", point.w.re);
    visit("v", point.w.im);
    visit("inverted", f64::from(u8::from(point.chart == Chart::Inverted)));
}

fn visit_all<const N: usize>(names: [&'static str; N], values: [f64; N], visit: &mut dyn FnMut(&'static str, f64)) {
    names.into_iter().zip(values).for_each(|(name, value)| visit(name, value));
}
