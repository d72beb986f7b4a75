//! Between payloads and the quantities of the mathematics. What comes from another process is checked here.

use attitude::{
    Complex, Vector3, course::Reference, gnss::Fix, gyro::Motion, point, point::Point, state::Attitude, turn::Turn,
};

use crate::{AccelPoint, Chart, CourseReference, FusedState, GnssFix, GyroStep, MagSample};

impl From<point::Chart> for Chart {
    fn from(chart: point::Chart) -> Self {
        match chart {
            point::Chart::Upright => Self::UPRIGHT,
            point::Chart::Inverted => Self::INVERTED,
        }
    }
}

impl GyroStep {
    /// The motion; `None` when a number is not finite, a chart unknown or the turn not a rotation.
    pub fn motion(&self, dt_s: f64) -> Option<Motion> {
        let turn = Turn { p: self.p.into_complex(), s: self.s.into_complex() };
        let unit = (0.5..2.0).contains(&(turn.p.norm_sqr() + turn.s.norm_sqr()));
        let rate_rad_s = finite(self.rate_rad_s)?;
        unit.then_some(Motion { attitude: attitude(self.w, self.z_rad, self.chart)?, turn, rate_rad_s, dt_s })
    }
}

impl AccelPoint {
    /// The point; `None` when a number is not finite or the chart unknown.
    pub fn point(&self) -> Option<Point> {
        point(self.w, self.chart)
    }
}

impl FusedState {
    /// The attitude; `None` when a number is not finite or the chart unknown.
    pub fn attitude(&self) -> Option<Attitude> {
        attitude(self.w, self.z_rad, self.chart)
    }
}

impl MagSample {
    /// The field, µT; `None` when a component is not finite.
    pub fn field_ut(&self) -> Option<Vector3<f64>> {
        finite(self.field_ut)
    }
}

impl GnssFix {
    /// The fix; `None` when the velocity is not finite.
    pub fn fix(&self) -> Option<Fix> {
        let told = |value: f64| value.is_finite().then_some(value);
        Some(Fix {
            velocity_m_s: finite(self.velocity_m_s)?,
            sd_m_s: told(self.velocity_sd_m_s),
            age_s: told(self.age_s),
            latitude_rad: told(self.latitude_rad),
        })
    }
}

impl From<Reference> for CourseReference {
    fn from(reference: Reference) -> Self {
        match reference {
            Reference::Arbitrary => Self::ARBITRARY,
            Reference::Magnetic => Self::MAGNETIC,
            Reference::True => Self::TRUE,
        }
    }
}

impl From<CourseReference> for Reference {
    fn from(reference: CourseReference) -> Self {
        match reference {
            CourseReference::MAGNETIC => Self::Magnetic,
            CourseReference::TRUE => Self::True,
            _ => Self::Arbitrary,
        }
    }
}

/// A vector of three; `None` when a component is not finite.
pub fn finite(components: [f64; 3]) -> Option<Vector3<f64>> {
    components.iter().all(|x| x.is_finite()).then(|| components.into())
}

/// u and v of a point, for a message.
pub fn pair(w: Complex<f64>) -> [f64; 2] {
    [w.re, w.im]
}

fn attitude(w: [f64; 2], z_rad: f64, chart: Chart) -> Option<Attitude> {
    Some(Attitude { up: point(w, chart)?, z_rad }).filter(|_| z_rad.is_finite())
}

fn point(w: [f64; 2], chart: Chart) -> Option<Point> {
    let chart = match chart {
        Chart::UPRIGHT => point::Chart::Upright,
        Chart::INVERTED => point::Chart::Inverted,
        _ => return None,
    };
    Some(Point { w: w.into_complex(), chart }).filter(|point| point.w.re.is_finite() && point.w.im.is_finite())
}

trait IntoComplex {
    fn into_complex(self) -> Complex<f64>;
}

impl IntoComplex for [f64; 2] {
    fn into_complex(self) -> Complex<f64> {
        Complex::new(self[0], self[1])
    }
}
