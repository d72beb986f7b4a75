//! What the kit must know of a slot to test whatever stage fills it.

use attitude::{
    Complex, GRAVITY_M_S2, Quaternion, Vector3,
    accel::{Accelerometer, MIN_FORCE_M_S2, Inclination},
    course::{CourseEstimate, Course, CourseInput, LastReading, CourseReading, CourseReference},
    fuser::{Estimate, Fused, Fuser, FuserInput, GyroScale, HardIron, LeakyVelocity},
    gyro::{Gyro, Motion, RateKind, RateSample},
    point::{Chart, Point},
    stage::Stage,
    state::Attitude,
};

use crate::{
    fault::BRIDGE_S,
    script::{Script, Tick},
};

/// A stage that fills the slot `L`.
pub(crate) trait Fills<L: Slot>:
    Stage<Input = L::Input, Output = L::Output, Common = L::Common> + Clone
{
}

impl<L: Slot, S: Stage<Input = L::Input, Output = L::Output, Common = L::Common> + Clone> Fills<L> for S {}

/// A slot as the kit sees it.
pub(crate) trait Slot: Sized {
    type Input: Copy;
    type Output;
    type Common: Copy;
    /// What Plumbline's own stages of the slot are.
    type Own: Fills<Self>;

    const NAME: &'static str;
    const NAMES: &'static [&'static str];
    /// The sign of the output's quaternion must not jump.
    const SIGNED: bool = false;
    /// The inclination of a stage that hears exact sensors is exact.
    const LEVELS: bool;

    fn named(name: &str) -> Option<Self::Own>;

    /// What the slot offers on this script, each with the place of its tick.
    fn inputs(script: &Script) -> Vec<(usize, Self::Input)>;

    /// Every number of an output, with its name.
    fn visit(output: &Self::Output, visit: &mut dyn FnMut(&'static str, f64));

    /// What is wrong with an output of finite numbers.
    fn flaw(output: &Self::Output) -> Option<&'static str>;

    /// The first thing wrong with an output: a number that is none, or a flaw.
    fn unsound(output: &Self::Output) -> Option<String> {
        let mut bad = None;
        Self::visit(output, &mut |name, value| {
            if !value.is_finite() && bad.is_none() {
                bad = Some(format!("{name} is {value}"));
            }
        });
        bad.or_else(|| Self::flaw(output).map(String::from))
    }

    /// What the heading of an output is counted from; `None` where it has none.
    fn heading(output: &Self::Output) -> Option<CourseReference>;

    /// The attitude that an output tells, body → reference.
    fn quaternion(output: &Self::Output) -> Quaternion<f64>;

    /// What no stage may take over, with the reason.
    fn garbage() -> Vec<(&'static str, Self::Common)>;
}

pub(crate) struct GyroSlot;
pub(crate) struct AccelSlot;
pub(crate) struct FuserSlot;
pub(crate) struct CourseSlot;

impl Slot for GyroSlot {
    type Input = RateSample;
    type Output = Motion;
    type Common = Attitude;
    type Own = Gyro;

    const NAME: &'static str = "gyro";
    const NAMES: &'static [&'static str] = &Gyro::NAMES;
    const LEVELS: bool = false;

    fn named(name: &str) -> Option<Gyro> {
        Gyro::from_name(name)
    }

    fn inputs(script: &Script) -> Vec<(usize, RateSample)> {
        let mut waited_s = 0.0;
        let sample = |(i, tick): (usize, &Tick)| {
            waited_s += tick.dt_s;
            let rate_rad_s = tick.rate_rad_s?;
            let dt_s = std::mem::take(&mut waited_s);
            let dt_s = if dt_s.is_finite() && dt_s > BRIDGE_S { 0.0 } else { dt_s };
            Some((i, RateSample { rate_rad_s, dt_s, kind: RateKind::Instant }))
        };
        script.ticks.iter().enumerate().filter_map(sample).collect()
    }

    fn visit(output: &Motion, visit: &mut dyn FnMut(&'static str, f64)) {
        visit_attitude(output.attitude, visit);
        let [d0, d1, d2, d3] = [output.rotation.p.re, output.rotation.s.re, output.rotation.s.im, output.rotation.p.im];
        visit_all(["d0", "d1", "d2", "d3"], [d0, d1, d2, d3], visit);
        visit_all(["rate_x_rad_s", "rate_y_rad_s", "rate_z_rad_s"], output.rate_rad_s.into(), visit);
        visit("dt_s", output.dt_s);
    }

    fn flaw(output: &Motion) -> Option<&'static str> {
        let size2 = output.rotation.p.norm_sqr() + output.rotation.s.norm_sqr();
        attitude_flaw(output.attitude).or(((size2 - 1.0).abs() > 1e-9).then_some("a turn that is not of unit length"))
    }

    fn heading(_: &Motion) -> Option<CourseReference> {
        Some(CourseReference::Arbitrary)
    }

    fn quaternion(output: &Motion) -> Quaternion<f64> {
        output.attitude.quaternion()
    }

    fn garbage() -> Vec<(&'static str, Attitude)> {
        attitudes_of_garbage()
    }
}

impl Slot for AccelSlot {
    type Input = Vector3<f64>;
    type Output = Inclination;
    type Common = Point;
    type Own = Accelerometer;

    const NAME: &'static str = "accel";
    const NAMES: &'static [&'static str] = &Accelerometer::NAMES;
    const LEVELS: bool = true;

    fn named(name: &str) -> Option<Accelerometer> {
        Accelerometer::from_name(name)
    }

    fn inputs(script: &Script) -> Vec<(usize, Vector3<f64>)> {
        script.ticks.iter().enumerate().filter_map(|(i, tick)| Some((i, tick.force_m_s2?))).collect()
    }

    fn visit(output: &Inclination, visit: &mut dyn FnMut(&'static str, f64)) {
        visit_point(output.up, visit);
        visit_all(["force_x_m_s2", "force_y_m_s2", "force_z_m_s2"], output.force_m_s2.into(), visit);
        visit("norm_m_s2", output.norm_m_s2);
        visit("trust", output.trust);
    }

    fn flaw(output: &Inclination) -> Option<&'static str> {
        let trusted = (0.0..=1.0).contains(&output.trust);
        attitude_flaw(Attitude::from_up(output.up)).or((!trusted).then_some("a trust outside 0 to 1"))
    }

    fn heading(_: &Inclination) -> Option<CourseReference> {
        None
    }

    fn quaternion(output: &Inclination) -> Quaternion<f64> {
        Attitude::from_up(output.up).quaternion()
    }

    fn garbage() -> Vec<(&'static str, Point)> {
        attitudes_of_garbage()
            .into_iter()
            .filter(|(what, _)| what.contains("point"))
            .map(|(what, it)| (what, it.up))
            .collect()
    }
}

/// At rest, level.
const UP: Inclination = Inclination {
    up: Point { w: Complex::new(0.0, 0.0), chart: Chart::Upright },
    force_m_s2: Vector3::new(0.0, 0.0, GRAVITY_M_S2),
    norm_m_s2: GRAVITY_M_S2,
    trust: 1.0,
};

fn is_finite(vector: &Vector3<f64>) -> bool {
    vector.iter().all(|component| component.is_finite())
}

/// The motion with what the tick has that is not a number: what a careless stage before would hand on.
fn as_read(motion: Motion, tick: &Tick) -> Motion {
    let rate_rad_s = tick.rate_rad_s.filter(|rate| !is_finite(rate)).unwrap_or(motion.rate_rad_s);
    Motion { rate_rad_s, dt_s: if tick.dt_s.is_finite() { motion.dt_s } else { tick.dt_s }, ..motion }
}

impl Slot for FuserSlot {
    type Input = FuserInput;
    type Output = Fused;
    type Common = Estimate;
    type Own = Fuser;

    const NAME: &'static str = "fuser";
    const NAMES: &'static [&'static str] = &Fuser::NAMES;
    const LEVELS: bool = true;

    fn named(name: &str) -> Option<Fuser> {
        Fuser::from_name(name)
    }

    fn inputs(script: &Script) -> Vec<(usize, FuserInput)> {
        let (mut gyro, mut projector) = (Gyro::from_name("mobius"), Accelerometer::from_name("projector"));
        let mut motions = GyroSlot::inputs(script).into_iter().peekable();
        let mut input = |(i, tick): (usize, &Tick)| {
            let sample = motions.next_if(|(place, _)| *place == i);
            let motion = gyro.as_mut().zip(sample).map(|(gyro, (_, sample))| gyro.step(&sample));
            let motion = motion.filter(|motion| GyroSlot::unsound(motion).is_none());
            let motion = motion.map(|motion| as_read(motion, tick));
            let usable = tick.force_m_s2.filter(|force| force.norm() >= MIN_FORCE_M_S2 && force.norm().is_finite());
            let inclination = projector.as_mut().zip(usable).map(|(projector, force)| projector.step(&force));
            let bad = tick.force_m_s2.filter(|force| !is_finite(force));
            let inclination = inclination.or_else(|| Some(Inclination { force_m_s2: bad?, ..UP }));
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

    fn visit(output: &Fused, visit: &mut dyn FnMut(&'static str, f64)) {
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

    fn flaw(output: &Fused) -> Option<&'static str> {
        let sds = [output.innovation_rad, output.inclination_sd_rad, output.heading_sd_rad];
        let negative = sds.iter().any(|sd| *sd < 0.0);
        attitude_flaw(output.attitude).or(negative.then_some("a standard deviation or innovation below zero"))
    }

    fn heading(output: &Fused) -> Option<CourseReference> {
        Some(output.reference)
    }

    fn quaternion(output: &Fused) -> Quaternion<f64> {
        output.attitude.quaternion()
    }

    fn garbage() -> Vec<(&'static str, Estimate)> {
        let good = Estimate {
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
        let mut garbage: Vec<_> =
            attitudes_of_garbage().into_iter().map(|(what, attitude)| (what, Estimate { attitude, ..good })).collect();
        for bias in [f64::NAN, f64::INFINITY, 1e6] {
            let bias_rad_s = Vector3::new(0.0, bias, 0.0);
            garbage.push(("a bias that is none", Estimate { bias_rad_s, ..good }));
        }
        for field_ut in [f64::NAN, f64::INFINITY, 1e6] {
            let hard_iron = HardIron { field_ut: Vector3::new(field_ut, 0.0, 0.0), sd_ut: 1.0 };
            garbage.push(("a hard iron that is none", Estimate { hard_iron, ..good }));
        }
        for error in [f64::NAN, f64::INFINITY, 1.0] {
            let gyro_scale = GyroScale { error: Vector3::new(0.0, error, 0.0), sd: Vector3::repeat(1e-3) };
            garbage.push(("a scale that is none", Estimate { gyro_scale, ..good }));
        }
        for east_m_s in [f64::NAN, f64::INFINITY, 1e6] {
            let leaky_velocity = LeakyVelocity { velocity_m_s: Complex::new(east_m_s, 0.0), sd_m_s: 1.0 };
            garbage.push(("a velocity that is none", Estimate { leaky_velocity, ..good }));
        }
        for sd in [f64::NAN, -1.0] {
            let gyro_scale = GyroScale { sd: Vector3::new(1e-3, sd, 1e-3), ..GyroScale::UNKNOWN };
            garbage.push(("a bad standard deviation of the scale", Estimate { gyro_scale, ..good }));
            garbage.push(("a bad standard deviation of the inclination", Estimate { inclination_sd_rad: sd, ..good }));
            garbage.push(("a bad standard deviation of the heading", Estimate { heading_sd_rad: sd, ..good }));
            garbage.push(("a bad standard deviation of the bias", Estimate { bias_sd_rad_s: sd, ..good }));
            let hard_iron = HardIron { sd_ut: sd, ..HardIron::UNKNOWN };
            garbage.push(("a bad standard deviation of the hard iron", Estimate { hard_iron, ..good }));
            let leaky_velocity = LeakyVelocity { sd_m_s: sd, ..LeakyVelocity::UNKNOWN };
            garbage.push(("a bad standard deviation of the velocity", Estimate { leaky_velocity, ..good }));
        }
        garbage
    }
}

impl Slot for CourseSlot {
    type Input = CourseInput;
    type Output = CourseReading;
    type Common = LastReading;
    type Own = Course;

    const NAME: &'static str = "course";
    const NAMES: &'static [&'static str] = &Course::NAMES;
    const SIGNED: bool = true;
    const LEVELS: bool = true;

    fn named(name: &str) -> Option<Course> {
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

    fn visit(output: &CourseReading, visit: &mut dyn FnMut(&'static str, f64)) {
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

    fn flaw(output: &CourseReading) -> Option<&'static str> {
        if (output.quaternion.norm() - 1.0).abs() > 1e-9 {
            return Some("a quaternion that is not of unit length");
        }
        if !(0.0..std::f64::consts::TAU).contains(&output.course_rad) {
            return Some("a course outside 0 to 2π");
        }
        (output.course_sd_rad < 0.0).then_some("a standard deviation below zero")
    }

    fn heading(_: &CourseReading) -> Option<CourseReference> {
        Some(CourseReference::Arbitrary)
    }

    fn quaternion(output: &CourseReading) -> Quaternion<f64> {
        output.quaternion
    }

    fn garbage() -> Vec<(&'static str, LastReading)> {
        let quaternion =
            |w: f64, x: f64, y: f64| LastReading { quaternion: Quaternion::new(w, x, y, 0.0), course: None };
        let bearing = |course_rad: f64, sd_rad: f64| {
            let bearing = Some(CourseEstimate { course_rad, reference: CourseReference::True, sd_rad });
            LastReading { course: bearing, ..quaternion(1.0, 0.0, 0.0) }
        };
        vec![
            ("a quaternion of zero", quaternion(0.0, 0.0, 0.0)),
            ("a quaternion of length 2", quaternion(0.0, 2.0, 0.0)),
            ("a quaternion that is not a number", quaternion(1.0, 0.0, f64::NAN)),
            ("a quaternion that is infinite", quaternion(f64::INFINITY, 0.0, 0.0)),
            ("a course that is not a number", bearing(f64::NAN, 0.1)),
            ("a course of 400°", bearing(7.0, 0.1)),
            ("a standard deviation below zero", bearing(1.0, -0.1)),
            ("a standard deviation that is not a number", bearing(1.0, f64::NAN)),
        ]
    }
}

fn attitudes_of_garbage() -> Vec<(&'static str, Attitude)> {
    let point = |re: f64, chart| Attitude { up: Point { w: Complex::new(re, 0.1), chart }, z_rad: 0.3 };
    let turn = |z_rad| Attitude { z_rad, ..Attitude::default() };
    vec![
        ("a point that is not a number", point(f64::NAN, Chart::Upright)),
        ("a point that is infinite", point(f64::INFINITY, Chart::Inverted)),
        ("a point outside its chart", point(1e6, Chart::Upright)),
        ("a point outside its inverted chart", point(-3.0, Chart::Inverted)),
        ("a turn that is not a number", turn(f64::NAN)),
        ("a turn beyond π", turn(100.0)),
    ]
}

/// The chart is left at |w| = 1.2; the rest is rounding.
fn attitude_flaw(attitude: Attitude) -> Option<&'static str> {
    if attitude.up.w.norm_sqr() > 1.44 + 1e-9 {
        return Some("a point outside its chart");
    }
    if attitude.z_rad.abs() > std::f64::consts::PI {
        return Some("a turn outside −π to π");
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
