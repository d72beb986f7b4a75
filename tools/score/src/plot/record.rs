//! Decimated curves of one chain's run for the figures.

use attitude::{
    Quaternion, Vector3,
    point::{Chart, Point},
    state::{Attitude, wrapped_rad},
};
use messages::{AttitudeOutput, FusedState, ImuSample};
use pipeline::compared_attitude;
use runtime::{RuntimeError, ServiceConfig};

use super::{
    curve::{BINS, Curve},
    options::PlotOptions,
};
use crate::{
    error_stats::{TickErrors, Truth},
    sensors::SensorSlots,
};

/// Largest |w| that is drawn. At larger values the body is nearly upside down.
const MAX_DRAWN_W: f64 = 3.0;

/// Sources of an attitude, in drawing order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Source {
    Accel,
    Gyro,
    Fused,
    Reference,
}

impl Source {
    pub(crate) const ALL: [Self; 4] = [Self::Accel, Self::Gyro, Self::Fused, Self::Reference];

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Accel => "accelerometer",
            Self::Gyro => "gyro, open loop",
            Self::Fused => "fused",
            Self::Reference => "reference",
        }
    }
}

/// Quantities of a source; angles in degrees, biases in °/s.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Quantity {
    U,
    V,
    Z,
    Yaw,
    Pitch,
    Roll,
    Course,
    BiasX,
    BiasY,
    BiasZ,
    InclinationError,
    HeadingError,
    TotalError,
    RollError,
    PitchError,
    YawError,
    CourseError,
    BiasXError,
    BiasYError,
    BiasZError,
}

const QUANTITY_COUNT: usize = Quantity::BiasZError as usize + 1;
const BIAS: [Quantity; 3] = [Quantity::BiasX, Quantity::BiasY, Quantity::BiasZ];
const BIAS_ERROR: [Quantity; 3] = [Quantity::BiasXError, Quantity::BiasYError, Quantity::BiasZError];

/// Curves of all quantities of one source.
pub(crate) struct Curves([Curve; QUANTITY_COUNT]);

/// Curves of all sources of a run.
pub(crate) struct PlotRecord {
    plots: PlotOptions,
    sensors: SensorSlots,
    first_ns: Option<i64>,
    end_s: f64,
    /// First heading error of a run, if the zero direction of the heading is arbitrary. Later
    /// errors are drawn relative to this error.
    first_heading_error_deg: Option<f64>,
    ticks: u64,
    ticks_per_point: u64,
    curves: [Curves; Source::ALL.len()],
    /// Fused up vector in body axes.
    pub(crate) up_path: Vec<Vector3<f64>>,
}

impl PlotRecord {
    /// Creates an empty record for about `rows` samples, with its own gyro and accelerometer slots.
    pub(crate) fn new(plots: &PlotOptions, config: &ServiceConfig, rows: u64) -> Result<Self, RuntimeError> {
        let in_window = plots.to_s.map(|to_s| ((to_s - plots.from_s) * config.rate_hz) as u64);
        let shown = in_window.map_or(rows, |samples| rows.min(samples.saturating_add(1)));
        let curves = || Curves(std::array::from_fn(|_| Curve::new(shown)));
        Ok(Self {
            plots: plots.clone(),
            sensors: SensorSlots::new(config)?,
            first_ns: None,
            end_s: 0.0,
            first_heading_error_deg: None,
            ticks: 0,
            ticks_per_point: shown.div_ceil(4 * BINS).max(1),
            curves: std::array::from_fn(|_| curves()),
            up_path: Vec::new(),
        })
    }

    pub(crate) fn source_curves(&self, source: Source) -> &Curves {
        &self.curves[source as usize]
    }

    /// Adds one tick.
    pub(crate) fn update(
        &mut self,
        sample: &ImuSample,
        truth: Option<(&Truth, &TickErrors)>,
        output: &AttitudeOutput,
        fused: &FusedState,
    ) {
        let t_ns = sample.header.t_end_ns;
        let t_s = t_ns.saturating_sub(*self.first_ns.get_or_insert(t_ns)) as f64 * 1e-9;
        self.end_s = t_s;
        let (open_loop, up) = self.sensors.update(sample);
        if !self.plots.includes(t_s) {
            return;
        }
        let [accel_curves, gyro_curves, fused_curves, reference_curves] = &mut self.curves;
        accel_curves.push_point(t_s, up);
        gyro_curves.push_attitude(t_s, open_loop);
        let estimate = Attitude::from_quaternion(compared_attitude(output));
        fused_curves.push_attitude(t_s, Some(estimate));
        fused_curves.push(Quantity::Course, t_s, output.course_rad.to_degrees());
        fused_curves.push_bias(t_s, Some(fused.bias_rad_s));
        let reference = truth.map(|(truth, _)| to_attitude(truth.quaternion));
        reference_curves.push_attitude(t_s, reference);
        let course_deg =
            reference.map_or(f64::NAN, |reference| (-reference.angles().yaw_rad).to_degrees().rem_euclid(360.0));
        reference_curves.push(Quantity::Course, t_s, course_deg);
        reference_curves.push_bias(t_s, truth.and_then(|(truth, _)| truth.gyro_bias_rad_s));
        fused_curves.push_errors(t_s, truth.map(|(_, errors)| errors), &mut self.first_heading_error_deg);
        if self.ticks.is_multiple_of(self.ticks_per_point) {
            self.up_path.push(estimate.up.direction());
        }
        self.ticks += 1;
    }

    /// Returns the end of the run in seconds if no sample is in the time window.
    pub(crate) fn end_s_if_empty(&self) -> Option<f64> {
        (self.ticks == 0).then_some(self.end_s)
    }

    /// Completes all curves.
    pub(crate) fn finish(&mut self) {
        self.curves.iter_mut().flat_map(|Curves(curves)| curves).for_each(Curve::finish);
    }
}

impl Curves {
    pub(crate) fn curve(&self, quantity: Quantity) -> &Curve {
        &self.0[quantity as usize]
    }

    fn push(&mut self, quantity: Quantity, t_s: f64, value: f64) {
        self.0[quantity as usize].push(t_s, value);
    }

    fn push_point(&mut self, t_s: f64, up: Option<Point>) {
        let w = up.map(|up| up.w_in_chart(Chart::Upright, 1e3)).filter(|w| w.norm_sqr() < MAX_DRAWN_W * MAX_DRAWN_W);
        self.push(Quantity::U, t_s, w.map_or(f64::NAN, |w| w.re));
        self.push(Quantity::V, t_s, w.map_or(f64::NAN, |w| w.im));
    }

    fn push_attitude(&mut self, t_s: f64, attitude: Option<Attitude>) {
        self.push_point(t_s, attitude.map(|attitude| attitude.up));
        let deg = |rad: Option<f64>| rad.map_or(f64::NAN, f64::to_degrees);
        let angles = attitude.map(Attitude::angles);
        self.push(Quantity::Z, t_s, deg(attitude.map(z_rad)));
        self.push(Quantity::Yaw, t_s, deg(angles.map(|angles| angles.yaw_rad)));
        self.push(Quantity::Pitch, t_s, deg(angles.map(|angles| angles.pitch_rad)));
        self.push(Quantity::Roll, t_s, deg(angles.map(|angles| angles.roll_rad)));
    }

    fn push_bias(&mut self, t_s: f64, bias_rad_s: Option<[f64; 3]>) {
        let deg_s = bias_rad_s.map_or([f64::NAN; 3], |bias| bias.map(f64::to_degrees));
        BIAS.into_iter().zip(deg_s).for_each(|(axis, deg_s)| self.push(axis, t_s, deg_s));
    }

    fn push_errors(&mut self, t_s: f64, errors: Option<&TickErrors>, first_heading_error_deg: &mut Option<f64>) {
        let deg = |of: &dyn Fn(&TickErrors) -> Option<f64>| errors.and_then(of).unwrap_or(f64::NAN);
        let drift_deg =
            errors.filter(|errors| !errors.heading_is_known).map(|TickErrors { heading_error_deg, .. }| {
                let from_deg = *first_heading_error_deg.get_or_insert(*heading_error_deg);
                wrapped_rad((heading_error_deg - from_deg).to_radians()).to_degrees()
            });
        let angles = |of: fn(&attitude::metrics::AngleError) -> f64| {
            errors.and_then(|errors| errors.angles.as_ref()).map_or(f64::NAN, of)
        };
        self.push(Quantity::InclinationError, t_s, deg(&|errors| Some(errors.attitude.inclination_deg)));
        let known = |errors: &TickErrors, deg: f64| errors.heading_is_known.then_some(deg);
        self.push(Quantity::HeadingError, t_s, deg(&|errors| known(errors, errors.attitude.heading_deg)));
        self.push(Quantity::TotalError, t_s, deg(&|errors| known(errors, errors.attitude.total_deg)));
        self.push(Quantity::RollError, t_s, angles(|angles| angles.roll_deg));
        self.push(Quantity::PitchError, t_s, angles(|angles| angles.pitch_deg));
        self.push(Quantity::YawError, t_s, drift_deg.unwrap_or_else(|| angles(|angles| angles.yaw_deg)));
        let course_is_known = errors.is_some_and(|errors| errors.course_is_known);
        let course_deg = if course_is_known { angles(|angles| angles.course_deg) } else { f64::NAN };
        self.push(Quantity::CourseError, t_s, course_deg);
        let bias = errors.and_then(|errors| errors.gyro_bias_deg_s).map_or([f64::NAN; 3], Into::into);
        BIAS_ERROR.into_iter().zip(bias).for_each(|(axis, deg_s)| self.push(axis, t_s, deg_s));
    }
}

/// Returns z in the upright chart, even if the attitude uses the other chart.
///
/// With α = q0 + j q3, z = 2 arg α.
fn z_rad(attitude: Attitude) -> f64 {
    let q = attitude.quaternion();
    wrapped_rad(2.0 * q.k.atan2(q.w))
}

fn to_attitude([w, x, y, z]: [f64; 4]) -> Attitude {
    Attitude::from_quaternion(Quaternion::new(w, x, y, z))
}
