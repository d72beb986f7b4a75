//! Receiver cases that third-party encoders do not cover.

use decoders::{DeviceTime, Framed, Measurement, Value, nmea::Nmea, ubx::Ubx};

use crate::streams::{decoded, nmea_sentence, ubx_frame};

fn decode(sentences: &[&str]) -> Vec<Measurement> {
    let bytes: Vec<u8> = sentences.iter().flat_map(|inside| nmea_sentence(inside)).collect();
    decoded(Box::new(Framed::new(Nmea::default())), [&bytes[..]]).0
}

#[test]
fn standard_example_sentence_is_read() {
    let example = b"$GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W*6A\r\n";
    let (found, counts) = decoded(Box::new(Framed::new(Nmea::default())), [&example[..]]);
    let Value::Fix { velocity_m_s: [east, north, up], sd_m_s, position } = found[0].value else { panic!("{found:?}") };
    assert!((east.hypot(north) - 11.5236).abs() < 1e-4 && up == 0.0, "{found:?}");
    assert!((east.atan2(north).to_degrees() - 84.4).abs() < 1e-9, "{found:?}");
    assert!((position.latitude_rad.unwrap().to_degrees() - 48.1173).abs() < 1e-9, "{found:?}");
    assert!((position.longitude_rad.unwrap().to_degrees() - (11.0 + 31.0 / 60.0)).abs() < 1e-9, "{found:?}");
    assert_eq!((sd_m_s, position.altitude_m), (Some(1.0), None));
    assert_eq!(found[0].time, Some(DeviceTime::Unix { now_ns: 764_426_119_000_000_000 }));
    assert_eq!((counts.frames, counts.rejected, counts.skipped_bytes), (1, 0, 2));
}

#[test]
fn missing_course_is_accepted_only_when_stationary() {
    let fix = |speed| decode(&[&format!("GPRMC,000000,A,4800.0,N,01100.0,E,{speed},,010126,,,A")]);
    let found = fix("0.02");
    assert!(matches!(found[0].value, Value::Fix { velocity_m_s, .. } if velocity_m_s == [0.0; 3]), "{found:?}");
    assert_eq!(fix("3.0"), []);
    assert_eq!(fix(""), []);
    assert_eq!(fix("-1.0"), []);
    assert_eq!(fix("nan"), []);
}

#[test]
fn latitude_beyond_pole_is_unknown() {
    let latitude = |text: &str| {
        let found = decode(&[&format!("GPRMC,000000,A,{text},N,01100.0,E,1.0,90.0,010126,,,A")]);
        let Value::Fix { position, .. } = found[0].value else { panic!("{found:?}") };
        position.latitude_rad.map(|rad| rad.to_degrees().round())
    };
    assert_eq!([latitude("9000.0"), latitude("9001.0"), latitude("")], [Some(90.0), None, None]);
}

#[test]
fn invalid_date_or_time_leaves_fix_without_timestamp() {
    for (time, date) in [("250000", "010126"), ("120000", "320126"), ("", ""), ("1200", "010126"), ("12000+", "010126")]
    {
        let found = decode(&[&format!("GPRMC,{time},A,4800.0,N,01100.0,E,1.0,90.0,{date},,,A")]);
        assert_eq!(found.iter().map(|found| found.time).collect::<Vec<_>>(), [None], "{time} {date}");
    }
}

#[test]
fn wrong_nmea_checksum_is_rejected() {
    let (found, counts) = decoded(Box::new(Framed::new(Nmea::default())), [&b"$GPRMC,1,A*00\r\n$GPR$GPGGA*56\r\n"[..]]);
    assert_eq!(found, []);
    // One sentence has a wrong checksum, one is not terminated, and one is valid.
    assert_eq!((counts.frames, counts.rejected), (1, 2), "{counts:?}");
}

#[test]
fn ubx_between_nmea_is_read_and_bad_length_rejected() {
    let other = ubx_frame(1, 7, &[0; 84]);
    let endless = [0xb5, 0x62, 1, 7, 0xff, 0xff];
    let bytes = [&b"$GNGGA,1*00\r\n"[..], &other, &endless, &other].concat();
    let (found, counts) = decoded(Box::new(Framed::new(Ubx)), [&bytes[..]]);
    assert_eq!(found, [], "no fix");
    assert_eq!((counts.frames, counts.rejected, counts.skipped_bytes), (2, 1, 13 + 6), "{counts:?}");
}

#[test]
fn corrupted_ubx_length_does_not_delay_next_fix() {
    let mut payload = [0; 92];
    (payload[20], payload[21]) = (3, 1);
    let good = ubx_frame(1, 7, &payload);
    let mut changed = good.clone();
    changed[5] = 8;
    let (found, counts) = decoded(Box::new(Framed::new(Ubx)), [&changed[..], &good]);
    assert_eq!((found.len(), counts.frames, counts.rejected), (1, 1, 1), "{counts:?}");
}

/// NAV-PVT encoded by pyubx2 1.4.0: 2026-11-26 16:05:30 −123,456 ns, 37.7754321° S, 11.5761234° E,
/// 520.123 m above sea level, velocity −1.234 m/s north, 5.678 m/s east, −0.09 m/s down, sAcc
/// 0.087 m/s.
#[rustfmt::skip]
const NAV_PVT: [u8; 100] = [
    0xb5, 0x62, 0x01, 0x07, 0x5c, 0x00, 0x10, 0x61, 0x0d, 0x18, 0xea, 0x07, 0x0b, 0x1a, 0x10, 0x05,
    0x1e, 0x07, 0x19, 0x00, 0x00, 0x00, 0xc0, 0x1d, 0xfe, 0xff, 0x03, 0x01, 0x20, 0x11, 0x52, 0x60,
    0xe6, 0x06, 0x2f, 0xed, 0x7b, 0xe9, 0x52, 0xaa, 0x08, 0x00, 0xbb, 0xef, 0x07, 0x00, 0x84, 0x05,
    0x00, 0x00, 0x35, 0x08, 0x00, 0x00, 0x2e, 0xfb, 0xff, 0xff, 0x2e, 0x16, 0x00, 0x00, 0xa6, 0xff,
    0xff, 0xff, 0xb3, 0x16, 0x00, 0x00, 0x50, 0x09, 0x9c, 0x00, 0x57, 0x00, 0x00, 0x00, 0xf0, 0x49,
    0x02, 0x00, 0x79, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
    0x00, 0x00, 0xe2, 0xbd,
];

#[test]
fn short_nav_pvt_yields_the_same_fix() {
    let payload = &NAV_PVT[6..98];
    let [(long, _), (short, _)] =
        [payload, &payload[..84]].map(|payload| decoded(Box::new(Framed::new(Ubx)), [&ubx_frame(1, 7, payload)[..]]));
    assert_eq!((long.len(), &short), (1, &long), "the form of u-blox 7");
}

#[test]
fn nav_pvt_fields_match_reference_frame() {
    let (found, counts) = decoded(Box::new(Framed::new(Ubx)), [&NAV_PVT[..]]);
    let Value::Fix { velocity_m_s, sd_m_s, position } = found[0].value else { panic!("{found:?}") };
    assert_eq!(found[0].time, Some(DeviceTime::Unix { now_ns: 1_795_709_129_999_876_544 }));
    let numbers = [velocity_m_s[0], velocity_m_s[1], velocity_m_s[2], sd_m_s.unwrap(), position.altitude_m.unwrap()];
    assert!(numbers.iter().zip([5.678, -1.234, 0.09, 0.087, 520.123]).all(|(a, b)| (a - b).abs() < 1e-9), "{found:?}");
    let degrees = [position.latitude_rad, position.longitude_rad].map(|angle| angle.unwrap().to_degrees());
    assert!(degrees.iter().zip([-37.7754321, 11.5761234]).all(|(a, b)| (a - b).abs() < 1e-9), "{found:?}");
    assert_eq!((counts.frames, counts.rejected, counts.skipped_bytes), (1, 0, 0), "{counts:?}");
}

#[test]
fn nav_pvt_flags_limit_what_is_used() {
    let fix = |changes: &[(usize, u8)]| {
        let mut payload = NAV_PVT[6..98].to_vec();
        changes.iter().for_each(|(at, byte)| payload[*at] = *byte);
        decoded(Box::new(Framed::new(Ubx)), [&ubx_frame(1, 7, &payload)[..]]).0.first().copied()
    };
    let sd = |found: Option<Measurement>| match found.map(|found| found.value) {
        Some(Value::Fix { sd_m_s, .. }) => sd_m_s,
        _ => None,
    };
    // fixType: none, dead reckoning, two-dimensional, three-dimensional, combined, time only.
    let by_type = [0, 1, 2, 3, 4, 5, 255].map(|kind| sd(fix(&[(20, kind)])));
    assert_eq!(by_type, [None, None, Some(1.0), Some(87.0 * 1e-3), Some(87.0 * 1e-3), None, None]);
    assert_eq!(fix(&[(21, 0xfe)]), None, "gnssFixOK is not set");
    for valid in [0b1101, 0b1110, 0] {
        assert_eq!(fix(&[(11, valid)]).map(|found| found.time), Some(None), "valid = {valid:b}");
    }
    let Some(Value::Fix { position, .. }) = fix(&[(78, 1)]).map(|found| found.value) else { panic!() };
    assert_eq!(position, decoders::Position::default(), "invalidLlh is set");
}
