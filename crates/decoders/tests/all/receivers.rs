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
    assert_eq!(found, [], "the layout before u-blox 8 is not decoded");
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
