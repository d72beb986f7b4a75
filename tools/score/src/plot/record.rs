//! What a run shows, tick by tick, thinned.

use accel::AccelWork;
use attitude::{
    Quaternion, Vector3,
    metrics::AttitudeError,
    point::{Chart, Point},
    state::{Attitude, wrapped_rad},
};
use gyro::GyroWork;
use ingest::source::Truth;
use messages::{AttitudeOutput, ImuSample};
use runtime::{EachTick, RuntimeError, ServiceConfig, Slot, quantities};

use super::curve::{BINS, Curve};

/// |w| beyond which it is not drawn: the body is all but upside down.
const W_LIMIT: f64 = 3.0;

/// Whose attitude it is. In the order in which they are drawn, one over the other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Source {
    Accel,
    Gyro,
    Reference,
    Fused,
}

impl Source {
    pub(crate) const ALL: [Self; 4] = [Self::Accel, Self::Gyro, Self::Reference, Self::Fused];

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Accel => "accelerometer",
            Self::Gyro => "gyro, open loop",
            Self::Reference => "reference",
            Self::Fused => "fused",
        }
    }
}

/// One attitude over time.
pub(crate) struct Curves {
    pub(crate) u: Curve,
    pub(crate) v: Curve,
    pub(crate) z_deg: Curve,
    pub(crate) yaw_deg: Curve,
    pub(crate) pitch_deg: Curve,
    pub(crate) roll_deg: Curve,
}

/// Every attitude over time, and the errors.
pub(crate) struct Record {
    gyro: EachTick<GyroWork>,
    accel: EachTick<AccelWork>,
    first_ns: Option<i64>,
    ticks: u64,
    ticks_per_point: u64,
    curves: [Curves; 4],
    pub(crate) inclination_deg: Curve,
    pub(crate) heading_deg: Curve,
    pub(crate) total_deg: Curve,
    /// The fused up vector in body axes.
    pub(crate) path: Vec<Vector3<f64>>,
}

impl Record {
    /// Of a run with `config` over so many rows. The gyro's and the accelerometer's slot run here once more.
    pub(crate) fn new(config: &ServiceConfig, rows: u64) -> Result<Self, RuntimeError> {
        let curve = || Curve::new(rows);
        let curves = || Curves {
            u: curve(),
            v: curve(),
            z_deg: curve(),
            yaw_deg: curve(),
            pitch_deg: curve(),
            roll_deg: curve(),
        };
        Ok(Self {
            gyro: gyro::slot(config)?,
            accel: accel::slot(config)?,
            first_ns: None,
            ticks: 0,
            ticks_per_point: rows.div_ceil(4 * BINS).max(1),
            curves: [curves(), curves(), curves(), curves()],
            inclination_deg: curve(),
            heading_deg: curve(),
            total_deg: curve(),
            path: Vec::new(),
        })
    }

    pub(crate) fn of(&self, source: Source) -> &Curves {
        &self.curves[source as usize]
    }

    /// Takes one tick.
    pub(crate) fn take(&mut self, sample: &ImuSample, truth: Option<Truth>, output: &AttitudeOutput) {
        let t_ns = sample.header.t_end_ns;
        let t_s = t_ns.saturating_sub(*self.first_ns.get_or_insert(t_ns)) as f64 * 1e-9;
        let (mut open_loop, mut seen) = (None, None);
        self.gyro.offer(*sample, &mut |step| open_loop = quantities::motion(&step, 0.0).map(|motion| motion.attitude));
        self.accel.offer(*sample, &mut |point| seen = quantities::up(&point));
        let estimate = quaternion(output.quaternion);
        let fused = Attitude::of_quaternion(estimate);
        let truth = truth.map(|truth| quaternion(truth.quaternion));
        let [of_accel, of_gyro, of_reference, of_fused] = &mut self.curves;
        of_accel.point(t_s, seen);
        of_gyro.attitude(t_s, open_loop);
        of_reference.attitude(t_s, truth.map(Attitude::of_quaternion));
        of_fused.attitude(t_s, Some(fused));
        let error = truth.map(|truth| AttitudeError::between(estimate, truth));
        let deg = |of: fn(&AttitudeError) -> f64| error.as_ref().map_or(f64::NAN, of);
        self.inclination_deg.push(t_s, deg(|error| error.inclination_deg));
        self.heading_deg.push(t_s, deg(|error| error.heading_deg));
        self.total_deg.push(t_s, deg(|error| error.total_deg));
        if self.ticks.is_multiple_of(self.ticks_per_point) {
            self.path.push(fused.up.direction());
        }
        self.ticks += 1;
    }

    /// The run is over.
    pub(crate) fn finish(&mut self) {
        let Self { curves, inclination_deg, heading_deg, total_deg, .. } = self;
        let attitudes = curves
            .iter_mut()
            .flat_map(|of| [&mut of.u, &mut of.v, &mut of.z_deg, &mut of.yaw_deg, &mut of.pitch_deg, &mut of.roll_deg]);
        attitudes.chain([inclination_deg, heading_deg, total_deg]).for_each(Curve::finish);
    }
}

impl Curves {
    fn point(&mut self, t_s: f64, up: Option<Point>) {
        let w = up.map(|up| up.seen_in(Chart::Upright, 1e3)).filter(|w| w.norm_sqr() < W_LIMIT * W_LIMIT);
        self.u.push(t_s, w.map_or(f64::NAN, |w| w.re));
        self.v.push(t_s, w.map_or(f64::NAN, |w| w.im));
    }

    fn attitude(&mut self, t_s: f64, attitude: Option<Attitude>) {
        self.point(t_s, attitude.map(|attitude| attitude.up));
        let deg = |rad: Option<f64>| rad.map_or(f64::NAN, f64::to_degrees);
        let angles = attitude.map(Attitude::angles);
        self.z_deg.push(t_s, deg(attitude.map(z_rad)));
        self.yaw_deg.push(t_s, deg(angles.map(|angles| angles.yaw_rad)));
        self.pitch_deg.push(t_s, deg(angles.map(|angles| angles.pitch_rad)));
        self.roll_deg.push(t_s, deg(angles.map(|angles| angles.roll_rad)));
    }
}

/// z of the upright chart, whichever chart the attitude is in: 2 arg α, α = q0 + j q3.
fn z_rad(attitude: Attitude) -> f64 {
    let q = attitude.quaternion();
    wrapped_rad(2.0 * q.k.atan2(q.w))
}

fn quaternion([w, x, y, z]: [f64; 4]) -> Quaternion<f64> {
    Quaternion::new(w, x, y, z)
}
