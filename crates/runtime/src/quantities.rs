//! Between payloads and the quantities of the mathematics. What comes from another process is checked here.

use attitude::{
    Complex, Vector3, course::Reference, gnss::Fix, gyro::Motion, point, point::Point, state::Attitude, turn::Turn,
};
use messages::{AccelPoint, Chart, CourseReference, FusedState, GnssFix, GyroStep, MagSample};

/// The motion of a step; `None` when a number is not finite, a chart unknown or the turn not a rotation.
pub fn motion(step: &GyroStep, dt_s: f64) -> Option<Motion> {
    let turn = Turn { p: complex(step.p), s: complex(step.s) };
    let unit = (0.5..2.0).contains(&(turn.p.norm_sqr() + turn.s.norm_sqr()));
    let rate_rad_s = finite(step.rate_rad_s)?;
    unit.then_some(Motion { attitude: state(step.w, step.z_rad, step.chart)?, turn, rate_rad_s, dt_s })
}

/// Where up seems to be; `None` when a number is not finite or the chart unknown.
pub fn up(point: &AccelPoint) -> Option<Point> {
    plane_point(point.w, point.chart)
}

/// The attitude of a fused state; `None` when a number is not finite or the chart unknown.
pub fn attitude(state: &FusedState) -> Option<Attitude> {
    self::state(state.w, state.z_rad, state.chart)
}

/// The field, µT; `None` when a component is not finite.
pub fn field_ut(sample: &MagSample) -> Option<Vector3<f64>> {
    finite(sample.field_ut)
}

/// The fix; `None` when the velocity is not finite.
pub fn fix(message: &GnssFix) -> Option<Fix> {
    let told = |value: f64| value.is_finite().then_some(value);
    Some(Fix {
        velocity_m_s: finite(message.velocity_m_s)?,
        sd_m_s: told(message.velocity_sd_m_s),
        age_s: told(message.age_s),
        latitude_rad: told(message.latitude_rad),
    })
}

/// A vector of three; `None` when a component is not finite.
pub fn finite(components: [f64; 3]) -> Option<Vector3<f64>> {
    components.iter().all(|x| x.is_finite()).then(|| components.into())
}

/// A chart, for a message.
pub fn chart_of(chart: point::Chart) -> Chart {
    match chart {
        point::Chart::Upright => Chart::UPRIGHT,
        point::Chart::Inverted => Chart::INVERTED,
    }
}

/// What a course refers to, for a message.
pub fn course_reference_of(reference: Reference) -> CourseReference {
    match reference {
        Reference::Arbitrary => CourseReference::ARBITRARY,
        Reference::Magnetic => CourseReference::MAGNETIC,
        Reference::True => CourseReference::TRUE,
    }
}

/// What the course of a message refers to.
pub fn course_reference(reference: CourseReference) -> Reference {
    match reference {
        CourseReference::MAGNETIC => Reference::Magnetic,
        CourseReference::TRUE => Reference::True,
        _ => Reference::Arbitrary,
    }
}

/// u and v of a point, for a message.
pub fn pair(w: Complex<f64>) -> [f64; 2] {
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
    Some(Point { w: complex(w), chart }).filter(|point| point.w.re.is_finite() && point.w.im.is_finite())
}

fn complex([re, im]: [f64; 2]) -> Complex<f64> {
    Complex::new(re, im)
}
