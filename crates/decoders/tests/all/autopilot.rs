//! Selection of messages and systems of an autopilot.

use decoders::{
    Framed, Measurement, Value,
    mavlink::{FixMessage, ImuMessage, Mavlink, MavlinkSettings, RawScale, frame::crc_extra},
};
use mavlink::Message as _;
use mavlink::dialects::common::{
    GPS_RAW_INT_DATA, GpsFixType, HIGHRES_IMU_DATA, HighresImuUpdatedFlags, MavMessage, RAW_IMU_DATA, SCALED_IMU_DATA,
};

use crate::streams::{decoded, in_mavlink_2};

fn decode(settings: MavlinkSettings, messages: &[MavMessage]) -> Vec<Measurement> {
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
fn raw_imu_is_read_only_if_selected_with_scale() {
    assert_eq!(decode(MavlinkSettings::default(), &[raw()]), []);
    let scale = Some(RawScale { rate_rad_s: 0.5, force_m_s2: 0.1, field_ut: 2.0 });
    assert_eq!(
        decode(MavlinkSettings { raw_scale: scale, ..MavlinkSettings::default() }, &[raw()]),
        [],
        "not selected"
    );
    let found = decode(
        MavlinkSettings { raw_scale: scale, imu: Some(ImuMessage::RawImu), ..MavlinkSettings::default() },
        &[raw(), scaled()],
    );
    let value =
        Value::Imu { rate_rad_s: [0.0, 1.0, 0.0], force_m_s2: [0.0, 0.0, 10.0], field_ut: Some([14.0, 0.0, 0.0]) };
    assert_eq!(found.iter().map(|found| found.value).collect::<Vec<_>>(), [value]);
}

#[test]
fn selected_or_first_imu_message_is_read() {
    let kinds = |imu| {
        decode(MavlinkSettings { imu, ..MavlinkSettings::default() }, &[scaled(), highres(0), scaled(), highres(0)])
    };
    let forces = |found: Vec<Measurement>| -> Vec<f64> {
        let force = |found: &Measurement| match found.value {
            Value::Imu { force_m_s2: [_, _, z], .. } => z,
            _ => f64::NAN,
        };
        found.iter().map(force).collect()
    };
    assert_eq!(forces(kinds(None)), [9.80665; 2]);
    assert_eq!(forces(kinds(Some(ImuMessage::HighresImu))), [f64::from(9.8f32); 2]);
    assert_eq!(decode(MavlinkSettings::default(), &[highres(1)]), [], "another IMU decode the same autopilot");
}

#[test]
fn only_selected_system_is_read() {
    let measurement_count =
        |system| decode(MavlinkSettings { system_id: Some(system), ..MavlinkSettings::default() }, &[highres(0)]).len();
    assert_eq!((measurement_count(1), measurement_count(2)), (1, 0));
}

#[test]
fn gps_raw_without_fix_or_course_yields_no_fix() {
    let fix = |fix_type, cog, vel_acc| {
        MavMessage::GPS_RAW_INT(GPS_RAW_INT_DATA { fix_type, vel: 1000, cog, vel_acc, ..Default::default() })
    };
    let good = GpsFixType::GPS_FIX_TYPE_3D_FIX;
    assert_eq!(
        decode(MavlinkSettings::default(), &[fix(GpsFixType::GPS_FIX_TYPE_NO_FIX, 0, 0), fix(good, u16::MAX, 0)]),
        []
    );
    let disabled = MavlinkSettings { fix: FixMessage::Disabled, ..MavlinkSettings::default() };
    assert_eq!(decode(disabled, &[fix(good, 0, 0)]), []);
    for (vel_acc, sd) in [(0, 1.0), (300, 1.0), (4000, 4.0)] {
        let found = decode(MavlinkSettings::default(), &[fix(good, 27_000, vel_acc)]);
        let Value::Fix { velocity_m_s: [east, north, up], sd_m_s, .. } = found[0].value else { panic!("{found:?}") };
        assert!((east + 10.0).abs() < 1e-9 && north.abs() < 1e-9 && up == 0.0, "{found:?}");
        assert_eq!(sd_m_s, Some(sd));
        assert_eq!(found[0].time, None, "time_usec of 0 means no clock");
    }
}

#[test]
fn crc_seeds_match_crate_mavlink() {
    // Identifiers of MAVLink 2 have 24 bits. The dialects assign none above 65,535.
    let known: Vec<u32> = (0..=0xffff).filter(|id| MavMessage::default_message_from_id(*id).is_some()).collect();
    assert!(known.len() > 200, "{}", known.len());
    for id in known {
        assert_eq!(crc_extra(id), Some(MavMessage::extra_crc(id)), "message {id}");
    }
}
