//! Tests the selection of an autopilot among MAVLink systems, and of its messages.

use std::time::Duration;

use decoders::{
    Decoder, Framed, Measurement, Value,
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

/// Returns a HIGHRES_IMU frame of a component.
fn highres_from(system_id: u8, component_id: u8) -> Vec<u8> {
    let mut frame = mavlink::MAVLinkV2MessageRaw::new();
    frame.serialize_message(mavlink::MavHeader { system_id: system_id.into(), component_id, sequence: 0 }, &highres(0));
    frame.raw_bytes().to_vec()
}

/// Decodes frames, each with its arrival time in ms. Returns whether each frame yields a
/// measurement, and the number of foreign frames.
fn decode_at(settings: MavlinkSettings, frames: &[(u64, Vec<u8>)]) -> (Vec<bool>, u64) {
    let mut decoder = Framed::new(Mavlink::new(settings));
    let used = frames.iter().map(|(ms, bytes)| {
        let mut found = Vec::new();
        decoder.set_time(Duration::from_millis(*ms));
        decoder.push(bytes, &mut found);
        !found.is_empty()
    });
    (used.collect(), decoder.counts().foreign)
}

#[test]
fn choice_of_system_lapses_after_two_silent_seconds() {
    let frames = [(0, (99, 1)), (1_000, (1, 1)), (2_100, (1, 1)), (2_200, (99, 1))];
    let frames = frames.map(|(ms, (system, component))| (ms, highres_from(system, component)));
    assert_eq!(decode_at(MavlinkSettings::default(), &frames), (vec![true, false, true, false], 2));
    let selected = MavlinkSettings { system_id: Some(1), ..MavlinkSettings::default() };
    assert_eq!(decode_at(selected, &frames), (vec![false, true, true, false], 2));
}

#[test]
fn only_one_component_is_read() {
    let frames: Vec<_> = (0..10).map(|i| (i, highres_from(1, if i % 2 == 0 { 1 } else { 100 }))).collect();
    let (used, foreign) = decode_at(MavlinkSettings::default(), &frames);
    assert_eq!((used.iter().filter(|used| **used).count(), used[0], foreign), (5, true, 5));
}

#[test]
fn choice_of_imu_message_lapses_after_two_silent_seconds() {
    let frames = [(0, scaled()), (1_900, highres(0)), (2_000, highres(0)), (2_100, scaled())];
    let frames = frames.map(|(ms, message)| (ms, in_mavlink_2(&message, 0)));
    assert_eq!(decode_at(MavlinkSettings::default(), &frames), (vec![true, false, true, false], 0));
}

#[test]
fn fix_does_not_choose_its_sender() {
    let fix = MavMessage::GPS_RAW_INT(GPS_RAW_INT_DATA {
        fix_type: GpsFixType::GPS_FIX_TYPE_3D_FIX,
        vel: 1000,
        cog: 0,
        ..Default::default()
    });
    let frames = [(0, in_mavlink_2(&fix, 0)), (10, highres_from(2, 1)), (20, in_mavlink_2(&fix, 0))];
    assert_eq!(decode_at(MavlinkSettings::default(), &frames), (vec![true, true, false], 1));
}
