//! What a run shows, tick by tick, thinned.

use attitude::{
    Quaternion, Vector3,
    point::{Chart, Point},
    state::{Attitude, wrapped_rad},
};
use messages::{AttitudeOutput, FusedState, ImuSample};
use runtime::{RuntimeError, ServiceConfig};

use super::{
    Plots,
    curve::{BINS, Curve},
};
use crate::{
    sensors::Sensors,
    tally::{Moment, Truth},
};

/// |w| beyond which it is not drawn: the body is all but upside down.
const W_LIMIT: f64 = 3.0;

/// Whose attitude it is. In the order in which they are drawn, one over the other.
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

/// What is shown of a source; angles in degrees, biases in °/s.
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

const QUANTITIES: usize = Quantity::BiasZError as usize + 1;
const BIAS: [Quantity; 3] = [Quantity::BiasX, Quantity::BiasY, Quantity::BiasZ];
const BIAS_ERROR: [Quantity; 3] = [Quantity::BiasXError, Quantity::BiasYError, Quantity::BiasZError];

/// What is shown of one source over time.
pub(crate) struct Curves([Curve; QUANTITIES]);

/// Every source over time.
pub(crate) struct Record {
    plots: Plots,
    sensors: Sensors,
    first_ns: Option<i64>,
    end_s: f64,
    /// Where a heading that is counted from nowhere was first.
    first_turn_deg: Option<f64>,
    ticks: u64,
    ticks_per_point: u64,
    curves: [Curves; Source::ALL.len()],
    /// The fused up vector in body axes.
    pub(crate) path: Vec<Vector3<f64>>,
}

impl Record {
    /// Of a run with `config` over so many rows. The gyro's and the accelerometer's slot run here once more.
    pub(crate) fn new(plots: &Plots, config: &ServiceConfig, rows: u64) -> Result<Self, RuntimeError> {
        let span_s = plots.to_s.map_or(f64::INFINITY, |to_s| to_s - plots.from_s);
        let shown = rows.min((span_s * config.rate_hz) as u64 + 1);
        let curves = || Curves(std::array::from_fn(|_| Curve::new(shown)));
        Ok(Self {
            plots: plots.clone(),
            sensors: Sensors::new(config)?,
            first_ns: None,
            end_s: 0.0,
            first_turn_deg: None,
            ticks: 0,
            ticks_per_point: shown.div_ceil(4 * BINS).max(1),
            curves: std::array::from_fn(|_| curves()),
            path: Vec::new(),
        })
    }

    pub(crate) fn of(&self, source: Source) -> &Curves {
        &self.curves[source as usize]
    }

    /// Takes one tick.
    pub(crate) fn take(
        &mut self,
        sample: &ImuSample,
        truth: Option<(&Truth, &Moment)>,
        output: &AttitudeOutput,
        fused: &FusedState,
    ) {
        let t_ns = sample.header.t_end_ns;
        let t_s = t_ns.saturating_sub(*self.first_ns.get_or_insert(t_ns)) as f64 * 1e-9;
        self.end_s = t_s;
        let (open_loop, seen) = self.sensors.take(sample);
        if !self.plots.shows(t_s) {
            return;
        }
        let [of_accel, of_gyro, of_fused, of_reference] = &mut self.curves;
        of_accel.point(t_s, seen);
        of_gyro.attitude(t_s, open_loop);
        let estimate = attitude(output.quaternion);
        of_fused.attitude(t_s, Some(estimate));
        of_fused.push(Quantity::Course, t_s, output.course_rad.to_degrees());
        of_fused.bias(t_s, Some(fused.bias_rad_s));
        let known = truth.map(|(truth, _)| attitude(truth.quaternion));
        of_reference.attitude(t_s, known);
        let course_deg = known.map_or(f64::NAN, |known| (-known.angles().yaw_rad).to_degrees().rem_euclid(360.0));
        of_reference.push(Quantity::Course, t_s, course_deg);
        of_reference.bias(t_s, truth.and_then(|(truth, _)| truth.gyro_bias_rad_s));
        of_fused.errors(t_s, truth.map(|(_, moment)| moment), &mut self.first_turn_deg);
        if self.ticks.is_multiple_of(self.ticks_per_point) {
            self.path.push(estimate.up.direction());
        }
        self.ticks += 1;
    }

    /// When the run ended, s, where no sample of it is to be shown.
    pub(crate) fn shows_nothing_until_s(&self) -> Option<f64> {
        (self.ticks == 0).then_some(self.end_s)
    }

    /// The run is over.
    pub(crate) fn finish(&mut self) {
        self.curves.iter_mut().flat_map(|Curves(of)| of).for_each(Curve::finish);
    }
}

impl Curves {
    pub(crate) fn of(&self, quantity: Quantity) -> &Curve {
        &self.0[quantity as usize]
    }

    fn push(&mut self, quantity: Quantity, t_s: f64, value: f64) {
        self.0[quantity as usize].push(t_s, value);
    }

    fn point(&mut self, t_s: f64, up: Option<Point>) {
        let w = up.map(|up| up.w_in_chart(Chart::Upright, 1e3)).filter(|w| w.norm_sqr() < W_LIMIT * W_LIMIT);
        self.push(Quantity::U, t_s, w.map_or(f64::NAN, |w| w.re));
        self.push(Quantity::V, t_s, w.map_or(f64::NAN, |w| w.im));
    }

    fn attitude(&mut self, t_s: f64, attitude: Option<Attitude>) {
        self.point(t_s, attitude.map(|attitude| attitude.up));
        let deg = |rad: Option<f64>| rad.map_or(f64::NAN, f64::to_degrees);
        let angles = attitude.map(Attitude::angles);
        self.push(Quantity::Z, t_s, deg(attitude.map(z_rad)));
        self.push(Quantity::Yaw, t_s, deg(angles.map(|angles| angles.yaw_rad)));
        self.push(Quantity::Pitch, t_s, deg(angles.map(|angles| angles.pitch_rad)));
        self.push(Quantity::Roll, t_s, deg(angles.map(|angles| angles.roll_rad)));
    }

    fn bias(&mut self, t_s: f64, bias_rad_s: Option<[f64; 3]>) {
        let deg_s = bias_rad_s.map_or([f64::NAN; 3], |bias| bias.map(f64::to_degrees));
        BIAS.into_iter().zip(deg_s).for_each(|(axis, deg_s)| self.push(axis, t_s, deg_s));
    }

    fn errors(&mut self, t_s: f64, moment: Option<&Moment>, first_turn_deg: &mut Option<f64>) {
        let deg = |of: &dyn Fn(&Moment) -> Option<f64>| moment.and_then(of).unwrap_or(f64::NAN);
        let drift_deg = moment.filter(|moment| !moment.heading_is_known).map(|Moment { turn_deg, .. }| {
            let from_deg = *first_turn_deg.get_or_insert(*turn_deg);
            wrapped_rad((turn_deg - from_deg).to_radians()).to_degrees()
        });
        let angles = |of: fn(&attitude::metrics::AngleError) -> f64| {
            moment.and_then(|moment| moment.angles.as_ref()).map_or(f64::NAN, of)
        };
        self.push(Quantity::InclinationError, t_s, deg(&|moment| Some(moment.attitude.inclination_deg)));
        let known = |moment: &Moment, deg: f64| moment.heading_is_known.then_some(deg);
        self.push(Quantity::HeadingError, t_s, deg(&|moment| known(moment, moment.attitude.heading_deg)));
        self.push(Quantity::TotalError, t_s, deg(&|moment| known(moment, moment.attitude.total_deg)));
        self.push(Quantity::RollError, t_s, angles(|angles| angles.roll_deg));
        self.push(Quantity::PitchError, t_s, angles(|angles| angles.pitch_deg));
        self.push(Quantity::YawError, t_s, drift_deg.unwrap_or_else(|| angles(|angles| angles.yaw_deg)));
        let course_is_known = moment.is_some_and(|moment| moment.course_is_known);
        let course_deg = if course_is_known { angles(|angles| angles.course_deg) } else { f64::NAN };
        self.push(Quantity::CourseError, t_s, course_deg);
        let bias = moment.and_then(|moment| moment.gyro_bias_deg_s).map_or([f64::NAN; 3], Into::into);
        BIAS_ERROR.into_iter().zip(bias).for_each(|(axis, deg_s)| self.push(axis, t_s, deg_s));
    }
}

/// z of the upright chart, whichever chart the attitude is in: 2 arg α, α = q0 + j q3.
fn z_rad(attitude: Attitude) -> f64 {
    let q = attitude.quaternion();
    wrapped_rad(2.0 * q.k.atan2(q.w))
}

fn attitude([w, x, y, z]: [f64; 4]) -> Attitude {
    Attitude::from_quaternion(Quaternion::new(w, x, y, z))
}
