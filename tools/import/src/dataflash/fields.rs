//! What the messages of ArduPilot say, in our axes and units.

use attitude::frames::{self, Body, Earth};
use mapping::is_rotation;
use recording::Reference;

use super::messages::Field;
use crate::{row_writer::Attitude, source::Fixed};

const UT_PER_MGAUSS: f64 = 0.1;
/// Least status of a fix whose velocity has all three components.
const STATUS_3D: f64 = 3.0;
/// What no recording can hold.
const TIME_END_NS: i64 = 9_000_000_000_000_000_000;

/// Who estimated an attitude; those before are taken before those after.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Estimator {
    /// Quaternions of the third extended Kalman filter.
    Ekf3,
    /// Quaternions of the second.
    Ekf2,
    /// The attitude that the vehicle flew by.
    Used,
    /// Angles of the third filter.
    Ekf3Angles,
    /// Angles of the second.
    Ekf2Angles,
    /// The estimator that runs beside them.
    Secondary,
}

impl Estimator {
    pub(super) const ALL: [(Self, &str); 6] = [
        (Self::Ekf3, "XKQ"),
        (Self::Ekf2, "NKQ"),
        (Self::Used, "ATT"),
        (Self::Ekf3Angles, "XKF1"),
        (Self::Ekf2Angles, "NKF1"),
        (Self::Secondary, "AHR2"),
    ];
}

/// What a message says.
#[derive(Debug, Clone, Copy)]
pub(super) enum Said {
    Inertial { t_ns: i64, rate_rad_s: [f64; 3], force_m_s2: [f64; 3] },
    Field { t_ns: i64, field_ut: [f64; 3] },
    Fix(Fixed),
    Attitude(Attitude),
}

/// Of which kind a message is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Kind {
    Inertial,
    Field,
    Fix,
    Attitude(Estimator),
}

/// Where the fields of a type of message are.
pub(super) struct Layout {
    pub(super) kind: Kind,
    time: Time,
    /// Which of several sensors or estimators.
    instance: Option<Field>,
    fields: Fields,
}

enum Time {
    Us(Field),
    Ms(Field),
}

enum Fields {
    Inertial { rate: [Field; 3], force: [Field; 3] },
    Field([Field; 3]),
    Fix { status: Field, speed: Field, course: Field, down: Field, place: Option<[Field; 3]> },
    Quaternion([Field; 4]),
    Angles([Field; 3]),
}

impl Layout {
    /// Where the fields of the type `name` are; `None` of one that nothing is read of.
    pub(super) fn of(name: &[u8], find: &dyn Fn(&str) -> Option<Field>) -> Option<Self> {
        let all = |[x, y, z]: [&str; 3]| Some([find(x)?, find(y)?, find(z)?]);
        let quaternion = || Some(Fields::Quaternion([find("Q1")?, find("Q2")?, find("Q3")?, find("Q4")?]));
        let angles = || all(["Roll", "Pitch", "Yaw"]).map(Fields::Angles);
        let (kind, instance, fields) = match name {
            b"IMU" => {
                let [rate, force] = [["GyrX", "GyrY", "GyrZ"], ["AccX", "AccY", "AccZ"]].map(all);
                (Kind::Inertial, "I", Fields::Inertial { rate: rate?, force: force? })
            }
            b"MAG" => (Kind::Field, "I", Fields::Field(all(["MagX", "MagY", "MagZ"])?)),
            b"GPS" => {
                let [speed, course, down] = all(["Spd", "GCrs", "VZ"])?;
                let place = all(["Lat", "Lng", "Alt"]);
                (Kind::Fix, "I", Fields::Fix { status: find("Status")?, speed, course, down, place })
            }
            b"XKQ" | b"XKQ1" => (Kind::Attitude(Estimator::Ekf3), "C", quaternion()?),
            b"NKQ" | b"NKQ1" => (Kind::Attitude(Estimator::Ekf2), "C", quaternion()?),
            b"ATT" => (Kind::Attitude(Estimator::Used), "", angles()?),
            b"XKF1" => (Kind::Attitude(Estimator::Ekf3Angles), "C", angles()?),
            b"NKF1" => (Kind::Attitude(Estimator::Ekf2Angles), "C", angles()?),
            b"AHR2" => (Kind::Attitude(Estimator::Secondary), "", quaternion().or_else(angles)?),
            _ => return None,
        };
        let time = find("TimeUS").map(Time::Us).or_else(|| find("TimeMS").map(Time::Ms))?;
        Some(Self { kind, time, instance: find(instance), fields })
    }

    /// Which of several sensors or estimators a message is from.
    pub(super) fn instance(&self, message: &[u8]) -> u8 {
        let instance = self.instance.and_then(|instance| instance.whole(message));
        instance.and_then(|instance| instance.try_into().ok()).unwrap_or(0)
    }

    /// `None` of a message that says nothing: no number, no fix, no rotation.
    pub(super) fn said(&self, message: &[u8]) -> Option<Said> {
        let t_ns = self.t_ns(message)?;
        let three = |fields: &[Field; 3]| finite(fields.map(|field| field.number(message)));
        Some(match &self.fields {
            Fields::Inertial { rate, force } => {
                let [rate_rad_s, force_m_s2] = [Body::Frd.to_native(three(rate)?), Body::Frd.to_native(three(force)?)];
                Said::Inertial { t_ns, rate_rad_s, force_m_s2 }
            }
            Fields::Field(field) => {
                Said::Field { t_ns, field_ut: Body::Frd.to_native(three(field)?.map(|part| part * UT_PER_MGAUSS)) }
            }
            Fields::Fix { status, speed, course, down, place } => {
                let [speed_m_s, course_deg, down_m_s] = three(&[*speed, *course, *down])?;
                if status.number(message) < STATUS_3D {
                    return None;
                }
                let (east, north) = course_deg.to_radians().sin_cos();
                let place = place.map_or([f64::NAN; 3], |place| place.map(|field| field.number(message)));
                let [latitude_deg, longitude_deg, altitude_m] = place;
                let velocity_m_s = [speed_m_s * east, speed_m_s * north, -down_m_s];
                Said::Fix(Fixed { t_ns, velocity_m_s, latitude_deg, longitude_deg, altitude_m })
            }
            Fields::Quaternion(fields) => attitude(t_ns, fields.map(|field| field.number(message)))?,
            Fields::Angles(fields) => attitude(t_ns, of_angles_deg(three(fields)?))?,
        })
    }

    fn t_ns(&self, message: &[u8]) -> Option<i64> {
        let (field, ns) = match &self.time {
            Time::Us(field) => (field, 1_000),
            Time::Ms(field) => (field, 1_000_000),
        };
        let t_ns = i64::try_from(field.whole(message)?).ok()?.checked_mul(ns)?;
        Some(t_ns).filter(|t_ns| *t_ns < TIME_END_NS)
    }
}

fn attitude(t_ns: i64, quaternion: [f64; 4]) -> Option<Said> {
    let reference = Reference { quaternion: frames::quaternion_to_native(Earth::Ned, Body::Frd, quaternion), scored: true };
    is_rotation(quaternion).then_some(Said::Attitude(Attitude { t_ns, reference, reset_counter: Some(0) }))
}

/// Roll, pitch, yaw, in this order from the last to the first turn, as w, x, y, z.
fn of_angles_deg(angles_deg: [f64; 3]) -> [f64; 4] {
    let [(sr, cr), (sp, cp), (sy, cy)] = angles_deg.map(|deg| (deg.to_radians() / 2.0).sin_cos());
    [cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy]
}

fn finite(vector: [f64; 3]) -> Option<[f64; 3]> {
    vector.iter().all(|part| part.is_finite()).then_some(vector)
}
