//! Fields of the ArduPilot messages, and conversion to native axes and units.

use attitude::frames::{self, Body, Earth};
use mapping::is_rotation;
use recording::Reference;

use super::field::Field;
use crate::{row_writer::Attitude, source::ReceiverFix};

const UT_PER_MGAUSS: f64 = 0.1;
/// Lowest GPS status for which all three velocity components are available.
const MIN_STATUS_3D: f64 = 3.0;
/// Exclusive upper limit for times in a recording, ns.
const MAX_TIME_NS: i64 = 9_000_000_000_000_000_000;

/// Attitude estimator of the autopilot. The variants are in order of preference.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Estimator {
    /// Attitude of the filter EKF3, logged as a quaternion.
    Ekf3,
    /// Attitude of the filter EKF2, logged as a quaternion.
    Ekf2,
    /// Attitude of the estimator that the autopilot used, logged as Euler angles.
    InUse,
    /// Attitude of the filter EKF3, logged as Euler angles.
    Ekf3Angles,
    /// Attitude of the filter EKF2, logged as Euler angles.
    Ekf2Angles,
    /// Attitude of the secondary estimator, which ran in parallel with the one that was used.
    Secondary,
}

impl Estimator {
    pub(super) const ALL: [(Self, &str); 6] = [
        (Self::Ekf3, "XKQ"),
        (Self::Ekf2, "NKQ"),
        (Self::InUse, "ATT"),
        (Self::Ekf3Angles, "XKF1"),
        (Self::Ekf2Angles, "NKF1"),
        (Self::Secondary, "AHR2"),
    ];
}

/// Content of a message in native axes and units.
#[derive(Debug, Clone, Copy)]
pub(super) enum Measurement {
    Inertial {
        t_ns: i64,
        rate_rad_s: [f64; 3],
        force_m_s2: [f64; 3],
        /// `true` unless the autopilot marks gyro or accelerometer as unhealthy.
        is_healthy: bool,
    },
    Field {
        t_ns: i64,
        field_ut: [f64; 3],
        /// `true` unless the autopilot marks the magnetometer as unhealthy.
        is_healthy: bool,
    },
    Fix(ReceiverFix),
    Attitude(Attitude),
}

/// Kind of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Kind {
    Inertial,
    Field,
    Fix,
    Attitude(Estimator),
}

/// Layout of the fields of a message type.
pub(super) struct Layout {
    pub(super) kind: Kind,
    time: Time,
    /// Field with the sensor or estimator number; `None` if the message type has no such field.
    instance: Option<Field>,
    /// Sensor number from the name of the message type, such as 1 for `IMU2`. Used if `instance` is
    /// `None`.
    type_instance: u8,
    fields: Fields,
}

enum Time {
    Us(Field),
    Ms(Field),
}

enum Fields {
    Inertial { rate: [Field; 3], force: [Field; 3], health: [Option<Field>; 2] },
    Field { field: [Field; 3], health: Option<Field> },
    Fix { status: Field, speed: Field, course: Field, down: Field, position: Option<[Field; 3]> },
    Quaternion([Field; 4]),
    Angles([Field; 3]),
}

impl Layout {
    /// Creates the layout of the type `name`; `None` if the type is not supported or a field is
    /// missing.
    pub(super) fn new(name: &[u8], find: &dyn Fn(&str) -> Option<Field>) -> Option<Self> {
        let find_vector = |[x, y, z]: [&str; 3]| Some([find(x)?, find(y)?, find(z)?]);
        let quaternion = || Some(Fields::Quaternion([find("Q1")?, find("Q2")?, find("Q3")?, find("Q4")?]));
        let angles = || find_vector(["Roll", "Pitch", "Yaw"]).map(Fields::Angles);
        let (name, type_instance) = numbered_type(name);
        let (kind, instance, fields) = match name {
            b"IMU" => {
                let [rate, force] = [["GyrX", "GyrY", "GyrZ"], ["AccX", "AccY", "AccZ"]].map(find_vector);
                let health = [find("GH"), find("AH")];
                (Kind::Inertial, "I", Fields::Inertial { rate: rate?, force: force?, health })
            }
            b"MAG" => {
                let field = find_vector(["MagX", "MagY", "MagZ"])?;
                (Kind::Field, "I", Fields::Field { field, health: find("Health") })
            }
            b"GPS" => {
                let [speed, course, down] = find_vector(["Spd", "GCrs", "VZ"])?;
                let position = find_vector(["Lat", "Lng", "Alt"]);
                (Kind::Fix, "I", Fields::Fix { status: find("Status")?, speed, course, down, position })
            }
            b"XKQ" | b"XKQ1" => (Kind::Attitude(Estimator::Ekf3), "C", quaternion()?),
            b"NKQ" | b"NKQ1" => (Kind::Attitude(Estimator::Ekf2), "C", quaternion()?),
            b"ATT" => (Kind::Attitude(Estimator::InUse), "", angles()?),
            b"XKF1" => (Kind::Attitude(Estimator::Ekf3Angles), "C", angles()?),
            b"NKF1" => (Kind::Attitude(Estimator::Ekf2Angles), "C", angles()?),
            b"AHR2" => (Kind::Attitude(Estimator::Secondary), "", quaternion().or_else(angles)?),
            _ => return None,
        };
        // In old logs, `TimeMS` of GPS is the time in the GPS week. `T` is the time on the
        // autopilot's clock.
        let is_old_gps = name == b"GPS" && find("TimeUS").is_none();
        let board_time = find("T").filter(|_| is_old_gps).map(Time::Ms);
        let time = board_time.or_else(|| find("TimeUS").map(Time::Us)).or_else(|| find("TimeMS").map(Time::Ms))?;
        Some(Self { kind, time, instance: find(instance), type_instance, fields })
    }

    /// Returns the number of the sensor or estimator that produced a message.
    pub(super) fn instance(&self, message: &[u8]) -> u8 {
        let instance = self.instance.and_then(|instance| instance.unsigned(message));
        instance.and_then(|instance| instance.try_into().ok()).unwrap_or(self.type_instance)
    }

    /// Decodes a message; `None` if it contains an invalid number, fix or rotation.
    pub(super) fn decode(&self, message: &[u8]) -> Option<Measurement> {
        let t_ns = self.t_ns(message)?;
        let finite_vector = |fields: &[Field; 3]| finite(fields.map(|field| field.number(message)));
        Some(match &self.fields {
            Fields::Inertial { rate, force, health } => {
                let [rate_rad_s, force_m_s2] =
                    [Body::Frd.to_native(finite_vector(rate)?), Body::Frd.to_native(finite_vector(force)?)];
                let is_healthy = health.iter().flatten().all(|health| health.unsigned(message) != Some(0));
                Measurement::Inertial { t_ns, rate_rad_s, force_m_s2, is_healthy }
            }
            Fields::Field { field, health } => Measurement::Field {
                t_ns,
                field_ut: Body::Frd.to_native(finite_vector(field)?.map(|part| part * UT_PER_MGAUSS)),
                is_healthy: health.is_none_or(|health| health.unsigned(message) != Some(0)),
            },
            Fields::Fix { status, speed, course, down, position } => {
                let [speed_m_s, course_deg, down_m_s] = finite_vector(&[*speed, *course, *down])?;
                if status.number(message) < MIN_STATUS_3D {
                    return None;
                }
                let (east, north) = course_deg.to_radians().sin_cos();
                let position = position.map_or([f64::NAN; 3], |fields| fields.map(|field| field.number(message)));
                let [latitude_deg, longitude_deg, altitude_m] = position;
                let velocity_m_s = [speed_m_s * east, speed_m_s * north, -down_m_s];
                Measurement::Fix(ReceiverFix { t_ns, velocity_m_s, latitude_deg, longitude_deg, altitude_m })
            }
            Fields::Quaternion(fields) => attitude(t_ns, fields.map(|field| field.number(message)))?,
            Fields::Angles(fields) => attitude(t_ns, quaternion_from_euler_deg(finite_vector(fields)?))?,
        })
    }

    fn t_ns(&self, message: &[u8]) -> Option<i64> {
        let (field, ns) = match &self.time {
            Time::Us(field) => (field, 1_000),
            Time::Ms(field) => (field, 1_000_000),
        };
        let t_ns = i64::try_from(field.unsigned(message)?).ok()?.checked_mul(ns)?;
        Some(t_ns).filter(|t_ns| *t_ns < MAX_TIME_NS)
    }
}

/// Splits the name of a message type of an older log, such as `IMU2`, into `IMU` and the sensor
/// number 1.
///
/// Names without a number belong to sensor 0.
fn numbered_type(name: &[u8]) -> (&[u8], u8) {
    match name {
        [base @ .., digit @ b'2'..=b'9'] if matches!(base, b"IMU" | b"MAG" | b"GPS") => (base, digit - b'1'),
        _ => (name, 0),
    }
}

fn attitude(t_ns: i64, quaternion: [f64; 4]) -> Option<Measurement> {
    let reference =
        Reference { quaternion: frames::quaternion_to_native(Earth::Ned, Body::Frd, quaternion), scored: true };
    is_rotation(quaternion).then_some(Measurement::Attitude(Attitude { t_ns, reference, reset_counter: Some(0) }))
}

/// Converts roll, pitch and yaw to a quaternion w, x, y, z.
///
/// The rotations are applied in the order yaw, pitch, roll.
fn quaternion_from_euler_deg(angles_deg: [f64; 3]) -> [f64; 4] {
    let [(sr, cr), (sp, cp), (sy, cy)] = angles_deg.map(|deg| (deg.to_radians() / 2.0).sin_cos());
    [cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy]
}

fn finite(vector: [f64; 3]) -> Option<[f64; 3]> {
    vector.iter().all(|part| part.is_finite()).then_some(vector)
}
