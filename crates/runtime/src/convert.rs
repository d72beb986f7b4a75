//! Conversion between payloads and mathematical types. Data from other processes is validated.

use attitude::{
    Complex, Vector3, course, gnss::Fix, gyro::Motion, point, point::Point, rotation::Rotation, state::Attitude,
};
use messages::{AccelPoint, Chart, CourseReference, FusedState, GnssFix, GyroStep, MagSample};

/// Converts a gyro step to a motion.
///
/// Returns `None` if a value is not finite, the chart is unknown, or the pair (p, s) is not a
/// rotation.
pub fn motion(step: &GyroStep, dt_s: f64) -> Option<Motion> {
    let rotation = Rotation { p: complex_from_payload(step.p), s: complex_from_payload(step.s) };
    let is_rotation = (0.5..2.0).contains(&(rotation.p.norm_sqr() + rotation.s.norm_sqr()));
    let rate_rad_s = finite_vector(step.rate_rad_s)?;
    is_rotation.then_some(Motion { attitude: state(step.w, step.z_rad, step.chart)?, rotation, rate_rad_s, dt_s })
}

/// Returns the up direction, or `None` if a value is not finite or the chart is unknown.
pub fn up(point: &AccelPoint) -> Option<Point> {
    plane_point(point.w, point.chart)
}

/// Returns the attitude in a fused state, or `None` if a value is not finite or the chart is
/// unknown.
pub fn attitude(state: &FusedState) -> Option<Attitude> {
    self::state(state.w, state.z_rad, state.chart)
}

/// Returns the magnetic field, µT, or `None` if a component is not finite.
pub fn field_ut(sample: &MagSample) -> Option<Vector3<f64>> {
    finite_vector(sample.field_ut)
}

/// Returns the satellite fix, or `None` if its velocity is not finite.
pub fn fix(message: &GnssFix) -> Option<Fix> {
    let if_finite = |value: f64| value.is_finite().then_some(value);
    Some(Fix {
        velocity_m_s: finite_vector(message.velocity_m_s)?,
        sd_m_s: if_finite(message.velocity_sd_m_s),
        age_s: if_finite(message.age_s),
        latitude_rad: if_finite(message.latitude_rad),
    })
}

/// Returns a vector, or `None` if a component is not finite.
pub fn finite_vector(components: [f64; 3]) -> Option<Vector3<f64>> {
    components.iter().all(|x| x.is_finite()).then(|| components.into())
}

/// Converts a chart to its payload code.
pub fn chart_to_payload(chart: point::Chart) -> Chart {
    match chart {
        point::Chart::Upright => Chart::UPRIGHT,
        point::Chart::Inverted => Chart::INVERTED,
    }
}

/// Converts a course reference to its payload code.
pub fn course_reference_to_payload(reference: course::CourseReference) -> CourseReference {
    match reference {
        course::CourseReference::Arbitrary => CourseReference::ARBITRARY,
        course::CourseReference::Magnetic => CourseReference::MAGNETIC,
        course::CourseReference::True => CourseReference::TRUE,
    }
}

/// Converts the payload code of a course reference. An unknown code is converted to `Arbitrary`.
pub fn course_reference_from_payload(reference: CourseReference) -> course::CourseReference {
    match reference {
        CourseReference::MAGNETIC => course::CourseReference::Magnetic,
        CourseReference::TRUE => course::CourseReference::True,
        _ => course::CourseReference::Arbitrary,
    }
}

/// Returns the components u and v of a point.
pub fn complex_to_payload(w: Complex<f64>) -> [f64; 2] {
    [w.re, w.im]
}

fn state(w: [f64; 2], z_rad: f64, chart: Chart) -> Option<Attitude> {
    Some(Attitude { up: plane_point(w, chart)?, z_rad }).filter(|_| z_rad.is_finite())
}

fn plane_point(w: [f64; 2], chart: Chart) -> Option<Point> {
    let chart = match chart {
        Chart::UPRIGHT => point::Chart::Upright,
        Chart::INVERTED => point::Chart::Inverted,
        _ => return None,
    };
    Some(Point { w: complex_from_payload(w), chart }).filter(|point| point.w.re.is_finite() && point.w.im.is_finite())
}

fn complex_from_payload([re, im]: [f64; 2]) -> Complex<f64> {
    Complex::new(re, im)
}
