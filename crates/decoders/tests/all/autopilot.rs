//! What is read of an autopilot, and what is not.

use decoders::{
    Framed, Measurement, Value,
    mavlink::{FixMessage, ImuMessage, Mavlink, RawScale, Settings},
};
use mavlink::dialects::ardupilotmega::{
    GPS_RAW_INT_DATA, GpsFixType, HIGHRES_IMU_DATA, HighresImuUpdatedFlags, MavMessage, RAW_IMU_DATA, SCALED_IMU_DATA,
};

use crate::streams::{decoded, in_mavlink_2};

fn of(settings: Settings, messages: &[MavMessage]) -> Vec<Measurement> {
    let bytes: Vec<_> = messages.iter().map(|message| in_mavlink_2(message, 0)).collect();
    decoded(Box::new(Framed::new(Mavlink::new(settings))), bytes.iter().map(|bytes| &bytes[..])).0
}

fn raw() -> MavMessage {
    MavMessage::RAW_IMU(RAW_IMU_DATA { time_usec: 5, xgyro: 2, zacc: -100, ymag: 7, ..Default::default() })
}

fn scaled() -> MavMessage {
    MavMessage::SCALED_IMU(SCALED_IMU_DATA { zacc: -1000, xgyro: 1000, ..Default::default() })
}

fn highres(id: u8) -> MavMessage {
    let fields_updated = HighresImuUpdatedFlags::from_bits_retain(0x3f);
    MavMessage::HIGHRES_IMU(HIGHRES_IMU_DATA { fields_updated, zacc: -9.8, id, ..Default::default() })
}

#[test]
fn raw_numbers_are_read_only_where_their_scale_is_named() {
    assert_eq!(of(Settings::default(), &[raw()]), []);
    let scale = Some(RawScale { rate_rad_s: 0.5, force_m_s2: 0.1, field_ut: 2.0 });
    assert_eq!(of(Settings { raw: scale, ..Settings::default() }, &[raw()]), [], "nor where it is not named itself");
    let found = of(Settings { raw: scale, imu: Some(ImuMessage::RawImu), ..Settings::default() }, &[raw(), scaled()]);
    let value =
        Value::Imu { rate_rad_s: [0.0, 1.0, 0.0], force_m_s2: [0.0, 0.0, 10.0], field_ut: Some([14.0, 0.0, 0.0]) };
    assert_eq!(found.iter().map(|found| found.value).collect::<Vec<_>>(), [value]);
}

#[test]
fn of_two_kinds_of_imu_the_named_one_is_read_or_the_first() {
    let kinds = |imu| of(Settings { imu, ..Settings::default() }, &[scaled(), highres(0), scaled(), highres(0)]);
    let forces = |found: Vec<Measurement>| -> Vec<f64> {
        let force = |found: &Measurement| match found.value {
            Value::Imu { force_m_s2: [_, _, z], .. } => z,
            _ => f64::NAN,
        };
        found.iter().map(force).collect()
    };
    assert_eq!(forces(kinds(None)), [9.80665; 2]);
    assert_eq!(forces(kinds(Some(ImuMessage::HighresImu))), [f64::from(9.8f32); 2]);
    assert_eq!(of(Settings::default(), &[highres(1)]), [], "another IMU of the same autopilot");
}

#[test]
fn a_system_that_is_named_is_heard_alone() {
    let heard = |system| of(Settings { system: Some(system), ..Settings::default() }, &[highres(0)]).len();
    assert_eq!((heard(1), heard(2)), (1, 0));
}

#[test]
fn a_receiver_without_a_fix_or_a_course_says_nothing() {
    let fix = |fix_type, cog, vel_acc| {
        MavMessage::GPS_RAW_INT(GPS_RAW_INT_DATA { fix_type, vel: 1000, cog, vel_acc, ..Default::default() })
    };
    let good = GpsFixType::GPS_FIX_TYPE_3D_FIX;
    assert_eq!(of(Settings::default(), &[fix(GpsFixType::GPS_FIX_TYPE_NO_FIX, 0, 0), fix(good, u16::MAX, 0)]), []);
    let nothing = Settings { fix: FixMessage::Nothing, ..Settings::default() };
    assert_eq!(of(nothing, &[fix(good, 0, 0)]), []);
    for (vel_acc, sd) in [(0, 1.0), (300, 1.0), (4000, 4.0)] {
        let found = of(Settings::default(), &[fix(good, 27_000, vel_acc)]);
        let Value::Fix { velocity_m_s: [east, north, up], sd_m_s, .. } = found[0].value else { panic!("{found:?}") };
        assert!((east + 10.0).abs() < 1e-9 && north.abs() < 1e-9 && up == 0.0, "{found:?}");
        assert_eq!(sd_m_s, Some(sd));
        assert_eq!(found[0].time, None, "a time of 0 is none");
    }
}
