//! Orientation of the unit in the body, from gravity in a level and a nose-down pose of the body.
//!
//! In the level pose, the specific force points along the body's up axis ζ. With the nose down by
//! any angle, it points between up and back, so its component perpendicular to ζ points along −η
//! (backward). The right axis is ξ = η × ζ. The rows of the matrix from sensor to body are ξ, η and
//! ζ in sensor axes.

use attitude::{
    Matrix3, Vector3,
    angles::Angles,
    calibration::{Calibration, Mounting},
    state::Attitude,
};
use nalgebra::{Rotation3, UnitQuaternion};

use crate::{
    input::{Kind, Prior, Sample},
    report::{Coverage, Rejection, Report, Residual, Value, array, pluralize},
    rest::{MeanNoise, Rest, RestFinder},
};

/// Minimum duration of each pose, s.
const MIN_POSE_S: f64 = 2.0;
/// Allowed range of the angle between the two poses, degrees.
const POSE_ANGLE_RANGE_DEG: (f64, f64) = (20.0, 150.0);
/// Maximum angle between the estimated mounting and a named one, degrees. The nearest named
/// mounting is reported if it is within this angle. In a named mounting, the axes of the unit are
/// parallel to those of the body.
const MAX_NAMED_ANGLE_DEG: f64 = 10.0;
/// Angle between the vertical and the nearest axis of the unit, degrees, above which a pose is
/// unlikely to be the level one.
const MAX_LEVEL_AXIS_DEG: f64 = 15.0;

/// Mounting calibrator.
#[derive(Debug, Clone)]
pub struct MountingCalibrator {
    rests: RestFinder,
    accel: Calibration,
}

/// The two poses, in order of time.
struct Poses {
    level: Rest,
    nose_down: Rest,
}

impl MountingCalibrator {
    pub(crate) fn new(prior: &Prior) -> Self {
        Self { rests: RestFinder::default(), accel: prior.accel }
    }

    pub(crate) fn push(&mut self, sample: &Sample) {
        self.rests.push(&Sample { force_m_s2: self.accel.apply(sample.force_m_s2), ..*sample });
    }

    pub(crate) fn coverage(&self) -> Coverage {
        self.assess(is_upright_pair).1
    }

    /// Finds a level and a nose-down pose that `is_pair` accepts, and describes what is missing.
    fn assess(&self, is_pair: fn(&Rest, &Rest) -> bool) -> (Option<Poses>, Coverage) {
        let rests: Vec<_> = self.rests.rests().into_iter().filter(Rest::is_plausible_gravity).collect();
        let held: Vec<_> = rests.iter().filter(|rest| rest.duration_s() >= MIN_POSE_S).collect();
        let poses = find_poses(&held, is_pair);
        let mut missing = Vec::new();
        let share = match (&poses, held.last()) {
            (Some(_), _) => 1.0,
            (None, Some(level)) => {
                missing.push(format!(
                    "a second pose; turn the body nose down by {:.0}° to 90°, without roll, and hold it still for {MIN_POSE_S:.0} s; level pose taken at {:.1} s",
                    POSE_ANGLE_RANGE_DEG.0,
                    level.start_s,
                ));
                0.5 + 0.5 * rests.last().map_or(0.0, |rest| if is_pair(level, rest) { held_share(rest) } else { 0.0 })
            }
            (None, None) => {
                missing.push(format!("a level pose; hold the body level and still for {MIN_POSE_S:.0} s"));
                missing.push(format!(
                    "a second pose; turn the body nose down by {:.0}° to 90°, without roll",
                    POSE_ANGLE_RANGE_DEG.0
                ));
                0.5 * rests.last().map_or(0.0, held_share)
            }
        };
        let summary = match &poses {
            Some(Poses { level, nose_down }) => format!(
                "level pose from {:.1} to {:.1} s, nose-down pose ({:.1}°) from {:.1} to {:.1} s",
                level.start_s,
                level.end_s,
                degrees_between(&level.force_m_s2(), &nose_down.force_m_s2()),
                nose_down.start_s,
                nose_down.end_s
            ),
            None => format!("{}, no two distinct poses", pluralize(rests.len(), "rest")),
        };
        (poses, Coverage { share, summary, missing })
    }

    pub(crate) fn finish(&self) -> Result<Report, Rejection> {
        let (mut poses, mut coverage) = self.assess(is_upright_pair);
        let is_doubtful = poses.is_none();
        if is_doubtful {
            (poses, coverage) = self.assess(is_pair);
        }
        let Some(poses) = poses else {
            return Err(Rejection::incomplete(Kind::Mounting, coverage));
        };
        let Poses { level, nose_down } = &poses;
        let (up, tipped) = (level.force_m_s2(), nose_down.force_m_s2());
        let zeta = up.normalize();
        let eta = -(tipped - zeta * zeta.dot(&tipped)).normalize();
        let xi = eta.cross(&zeta);
        let matrix = Matrix3::from_rows(&[xi.transpose(), eta.transpose(), zeta.transpose()]);
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix));
        // q and −q are the same rotation. The condition w ≥ 0 makes the result unique.
        let rotation = if rotation.w < 0.0 { UnitQuaternion::new_unchecked(-rotation.into_inner()) } else { rotation };
        let quaternion = [rotation.w, rotation.i, rotation.j, rotation.k];
        let sd_deg = rotation_sd_deg(&poses, &eta, &xi);
        let mut notes = vec![
            "the pose before the nose-down one is taken as level; the mounting is as accurate as the poses".into(),
        ];
        if is_doubtful {
            notes.push(
                "only the later pose has an axis of the unit near the vertical; if it was the level one, repeat \
                 with the level pose first"
                    .into(),
            );
        }
        notes.extend(nearest_named(&matrix));
        Ok(Report {
            kind: "mounting",
            values: vec![
                Value {
                    name: "quaternion",
                    value: quaternion.to_vec(),
                    // A small rotation changes each quaternion component by at most half the
                    // rotation angle.
                    sd: vec![0.5 * sd_deg.norm().to_radians(); 4],
                    unit: "(w, x, y, z)",
                },
                Value::vector("pitch, roll, yaw", angles_deg(&rotation), sd_deg, "°"),
            ],
            residual: Residual {
                quantity: "angle from sensor z to up (before), unsteadiness of the poses (after)",
                before: degrees_between(&up, &Vector3::z()),
                after: unsteadiness_deg(level).max(unsteadiness_deg(nose_down)),
                unit: "°",
            },
            coverage,
            notes,
            replaces: "[ingest.mounting]",
            block: format!("[ingest.mounting]\nquaternion = {}\n", array(&quaternion)),
        })
    }
}

/// Finds the first pose that forms a pair with an earlier one. Returns it as the nose-down pose,
/// and the last matching earlier pose as the level pose.
fn find_poses(held: &[&Rest], is_pair: fn(&Rest, &Rest) -> bool) -> Option<Poses> {
    held.iter().enumerate().find_map(|(index, nose_down)| {
        let level = held[..index].iter().rev().find(|level| is_pair(level, nose_down))?;
        Some(Poses { level: (*level).clone(), nose_down: (*nose_down).clone() })
    })
}

/// Returns `true` if the angle between the poses is possible for a level and a nose-down pose.
fn is_pair(level: &Rest, nose_down: &Rest) -> bool {
    let (min, max) = POSE_ANGLE_RANGE_DEG;
    (min..=max).contains(&degrees_between(&level.force_m_s2(), &nose_down.force_m_s2()))
}

/// Returns `false` if the poses are not a pair, or if only the later pose has an axis of the unit
/// near the vertical.
///
/// Most units are mounted with such an axis in the level pose. If only the later pose has one, the
/// earlier pose is probably nose-down, and the later pose is the level one.
fn is_upright_pair(level: &Rest, nose_down: &Rest) -> bool {
    let is_reversed = axis_angle_deg(level) > MAX_LEVEL_AXIS_DEG && axis_angle_deg(nose_down) < MAX_NAMED_ANGLE_DEG;
    is_pair(level, nose_down) && !is_reversed
}

/// Returns the angle between the vertical and the nearest axis of the unit, degrees.
fn axis_angle_deg(rest: &Rest) -> f64 {
    let up = rest.force_m_s2().normalize();
    up.amax().min(1.0).acos().to_degrees()
}

/// Returns the fraction of the required duration for which a pose has been held.
fn held_share(rest: &Rest) -> f64 {
    (rest.duration_s() / MIN_POSE_S).min(1.0)
}

/// Returns the standard deviations, in degrees, that the noise of the pose means causes in the
/// rotations about ξ, η and ζ.
fn rotation_sd_deg(poses: &Poses, eta: &Vector3<f64>, xi: &Vector3<f64>) -> Vector3<f64> {
    let Poses { level, nose_down } = poses;
    let noise = MeanNoise::from_series(&[&level.forces_m_s2, &nose_down.forces_m_s2]);
    let along = |rest: &Rest, axis: &Vector3<f64>| noise.sd(rest.forces_m_s2.len()).component_mul(axis).norm();
    let (up, tipped) = (level.force_m_s2(), nose_down.force_m_s2());
    let across = up.cross(&tipped).norm() / up.norm();
    let about_zeta = along(nose_down, xi).hypot(along(level, xi) * tipped.dot(&up) / up.norm_squared()) / across;
    Vector3::new(along(level, eta) / up.norm(), along(level, xi) / up.norm(), about_zeta).map(f64::to_degrees)
}

/// Returns pitch, roll and yaw of the sensor in the body, as defined for `[ingest.mounting]`,
/// degrees.
fn angles_deg(rotation: &UnitQuaternion<f64>) -> Vector3<f64> {
    let Angles { yaw_rad, pitch_rad, roll_rad } = Attitude::from_quaternion(rotation.into_inner()).angles();
    Vector3::new(pitch_rad, roll_rad, yaw_rad).map(f64::to_degrees)
}

/// Returns a note with the nearest named mounting, or `None` if none is near.
fn nearest_named(matrix: &Matrix3<f64>) -> Option<String> {
    let directions = Mounting::DIRECTIONS;
    let names = directions.iter().flat_map(|x| directions.iter().map(move |y| format!("x-{x}-y-{y}")));
    let angle_deg = |name: &str| {
        let cos = ((matrix * Mounting::from_name(name).ok()?.matrix().transpose()).trace() - 1.0) * 0.5;
        Some(cos.clamp(-1.0, 1.0).acos().to_degrees())
    };
    let named = names.filter_map(|name| Some((angle_deg(&name)?, name)));
    let (angle_deg, name) = named.min_by(|(a, _), (b, _)| a.total_cmp(b))?;
    (angle_deg <= MAX_NAMED_ANGLE_DEG)
        .then(|| format!("nearest named mounting: axes = \"{name}\", {angle_deg:.1}° away"))
}

fn degrees_between(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    a.cross(b).norm().atan2(a.dot(b)).to_degrees()
}

/// Returns the root mean square angle between the block means and the mean of a pose, degrees.
fn unsteadiness_deg(rest: &Rest) -> f64 {
    let mean = rest.force_m_s2();
    let squares = rest.forces_m_s2.iter().map(|force| degrees_between(force, &mean).powi(2));
    (squares.sum::<f64>() / rest.forces_m_s2.len() as f64).sqrt()
}
