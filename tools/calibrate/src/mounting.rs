//! How the unit sits in the body: by gravity in two poses of the body, level and nose down.
//!
//! Level, gravity's reaction points along the body's up ζ. Nose down by an angle that nobody needs to know, it points between up and
//! back: what is across ζ of it is −η, forward's opposite. Right is ξ = η × ζ. The rows of the matrix sensor → body are ξ, η, ζ in the
//! sensor's axes.

use attitude::{
    Matrix3, Vector3,
    angles::Angles,
    calibration::{Calibration, Mounting as Turn},
    state::Attitude,
};
use nalgebra::{Rotation3, UnitQuaternion};

use crate::{
    Kind, Known, Sample,
    report::{Coverage, Refusal, Report, Residual, Value, array},
    rest::{MeanNoise, Rest, RestFinder},
};

/// How long each pose must last, s.
const POSE_S: f64 = 2.0;
/// By how much the poses must differ, and may at most, degrees.
const DIFFERENCE_DEG: (f64, f64) = (20.0, 150.0);
/// A mounting so close to one of the 24 along the axes is told with its name, degrees.
const NAMED_DEG: f64 = 10.0;

/// Takes readings.
#[derive(Debug, Clone)]
pub struct Mounting {
    rests: RestFinder,
    accel: Calibration,
}

/// The two poses in their order.
struct Poses {
    level: Rest,
    nose_down: Rest,
}

impl Mounting {
    pub(crate) fn new(known: &Known) -> Self {
        Self { rests: RestFinder::default(), accel: known.accel }
    }

    pub(crate) fn take(&mut self, sample: &Sample) {
        self.rests.take(&Sample { force_m_s2: self.accel.apply(sample.force_m_s2), ..*sample });
    }

    pub(crate) fn coverage(&self) -> Coverage {
        self.told().1
    }

    fn told(&self) -> (Option<Poses>, Coverage) {
        let rests: Vec<_> = self.rests.rests().into_iter().filter(Rest::feels_gravity).collect();
        let longest = |of: &dyn Fn(&Rest) -> bool| {
            let long = rests.iter().filter(|rest| of(rest));
            long.max_by(|a, b| a.duration_s().total_cmp(&b.duration_s())).cloned()
        };
        let one = longest(&|_| true);
        let other = one.as_ref().and_then(|one| {
            let (least, most) = DIFFERENCE_DEG;
            longest(&|rest| (least..=most).contains(&degrees_between(&one.force_m_s2(), &rest.force_m_s2())))
        });
        let seconds = |pose: &Option<Rest>| pose.as_ref().map_or(0.0, Rest::duration_s);
        let share = |pose: &Option<Rest>| 0.5 * (seconds(pose) / POSE_S).min(1.0);
        let mut missing = Vec::new();
        if share(&one) < 0.5 {
            missing.push(format!("a level pose; hold the body level and still for {POSE_S:.0} s"));
        }
        if share(&other) < 0.5 {
            missing.push(format!(
                "a second pose; turn the body nose down by {:.0}° to 90°, without roll, and hold it still for {POSE_S:.0} s",
                DIFFERENCE_DEG.0
            ));
        }
        let covered = share(&one) + share(&other);
        let poses = one.zip(other).map(|(one, other)| match one.from_s < other.from_s {
            true => Poses { level: one, nose_down: other },
            false => Poses { level: other, nose_down: one },
        });
        let found = match &poses {
            Some(Poses { level, nose_down }) => format!(
                "level from {:.1} to {:.1} s, nose down by {:.1}° from {:.1} to {:.1} s",
                level.from_s,
                level.until_s,
                degrees_between(&level.force_m_s2(), &nose_down.force_m_s2()),
                nose_down.from_s,
                nose_down.until_s
            ),
            None => format!("{} rests, no two of them in poses that differ", rests.len()),
        };
        (poses, Coverage { share: covered, found, missing })
    }

    pub(crate) fn finish(&self) -> Result<Report, Refusal> {
        let (poses, coverage) = self.told();
        let Some(poses) = poses.filter(|_| coverage.share >= 1.0) else {
            return Err(Refusal::thin(Kind::Mounting, coverage));
        };
        let Poses { level, nose_down } = &poses;
        let (up, tipped) = (level.force_m_s2(), nose_down.force_m_s2());
        let zeta = up.normalize();
        let eta = -(tipped - zeta * zeta.dot(&tipped)).normalize();
        let xi = eta.cross(&zeta);
        let matrix = Matrix3::from_rows(&[xi.transpose(), eta.transpose(), zeta.transpose()]);
        let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix));
        // Sensor → body is a turn about an axis; towards w ≥ 0 it is told in one way.
        let turn = if turn.w < 0.0 { UnitQuaternion::new_unchecked(-turn.into_inner()) } else { turn };
        let deviations = deviations_deg(&poses, &eta, &xi);
        let mut notes = vec![
            "the earlier of the two poses is taken as the level one; the mounting is as exact as the poses were".into(),
        ];
        notes.extend(nearest(&matrix));
        Ok(Report {
            kind: "mounting",
            values: vec![
                Value {
                    name: "quaternion",
                    value: vec![turn.w, turn.i, turn.j, turn.k],
                    // Half an angle is a part of a quaternion.
                    sd: vec![0.5 * deviations.norm().to_radians(); 4],
                    unit: "(w, x, y, z)",
                },
                Value::vector("pitch, roll, yaw", angles_deg(&turn), deviations, "°"),
            ],
            residual: Residual {
                of: "unsteadiness of the poses; up from ζ at first",
                before: degrees_between(&up, &Vector3::z()),
                after: unsteady_deg(level).max(unsteady_deg(nose_down)),
                unit: "°",
            },
            coverage,
            notes,
            replaces: "[ingest.mounting]",
            block: format!("[ingest.mounting]\nquaternion = {}\n", array(&[turn.w, turn.i, turn.j, turn.k])),
        })
    }
}

/// Of the turns about ξ, η and ζ, degrees, by the noise of the poses' means.
fn deviations_deg(poses: &Poses, eta: &Vector3<f64>, xi: &Vector3<f64>) -> Vector3<f64> {
    let Poses { level, nose_down } = poses;
    let noise = MeanNoise::of(&[&level.forces_m_s2, &nose_down.forces_m_s2]);
    let along = |rest: &Rest, axis: &Vector3<f64>| noise.sd(rest.forces_m_s2.len()).component_mul(axis).norm();
    let (up, tipped) = (level.force_m_s2(), nose_down.force_m_s2());
    let across = up.cross(&tipped).norm() / up.norm();
    let about_zeta = along(nose_down, xi).hypot(along(level, xi) * tipped.dot(&up) / up.norm_squared()) / across;
    Vector3::new(along(level, eta) / up.norm(), along(level, xi) / up.norm(), about_zeta).map(f64::to_degrees)
}

/// Pitch, roll and yaw of the sensor in the body, as `[ingest.mounting]` has them.
fn angles_deg(turn: &UnitQuaternion<f64>) -> Vector3<f64> {
    let Angles { yaw_rad, pitch_rad, roll_rad } = Attitude::from_quaternion(turn.into_inner()).angles();
    Vector3::new(pitch_rad, roll_rad, yaw_rad).map(f64::to_degrees)
}

/// What name comes close, and by how much.
fn nearest(matrix: &Matrix3<f64>) -> Option<String> {
    let directions = Turn::DIRECTIONS;
    let names = directions.iter().flat_map(|x| directions.iter().map(move |y| format!("x-{x}-y-{y}")));
    let off_deg = |name: &str| {
        let cos = ((matrix * Turn::from_name(name).ok()?.matrix().transpose()).trace() - 1.0) * 0.5;
        Some(cos.clamp(-1.0, 1.0).acos().to_degrees())
    };
    let named = names.filter_map(|name| Some((off_deg(&name)?, name)));
    let (off_deg, name) = named.min_by(|(a, _), (b, _)| a.total_cmp(b))?;
    (off_deg <= NAMED_DEG).then(|| format!("axes = \"{name}\" is {off_deg:.1}° off"))
}

fn degrees_between(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    a.cross(b).norm().atan2(a.dot(b)).to_degrees()
}

/// Root mean square of the angles of a quarter of a second from the mean of the pose.
fn unsteady_deg(rest: &Rest) -> f64 {
    let mean = rest.force_m_s2();
    let squares = rest.forces_m_s2.iter().map(|force| degrees_between(force, &mean).powi(2));
    (squares.sum::<f64>() / rest.forces_m_s2.len() as f64).sqrt()
}
