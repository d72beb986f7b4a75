//! Compares the decoders with pymavlink, pyubx2 and pynmeagps as encoders, and with Python packages
//! that read WitMotion and BNO08x.

use std::{fs, path::Path, process::Command};

use decoders::{
    Counts, Decoder, DeviceTime, Framed, Measurement, Position, Value,
    mavlink::{FixMessage, Mavlink, MavlinkSettings},
    nmea::Nmea,
    rvc::Rvc,
    ubx::Ubx,
    witmotion::WitMotion,
};

use crate::{
    python::python,
    streams::{WITMOTION_RANGES, decoded},
};

/// Returns the bytes of `kind` and the expected measurements, or `None` if Python is unavailable.
/// An expected measurement that is `None` is not compared.
fn encoded(kind: &str) -> Option<(Vec<u8>, Vec<Option<Measurement>>)> {
    let python = python()?;
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/all/third_party.py");
    let file = tempfile::NamedTempFile::new().unwrap();
    let output = Command::new(python).arg(script).arg(kind).arg(file.path()).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    Some((fs::read(file.path()).unwrap(), text.lines().map(parse_measurement).collect()))
}

fn parse_measurement(line: &str) -> Option<Measurement> {
    let words: Vec<_> = line.split(' ').collect();
    if words[0] == "skip" {
        return None;
    }
    let now_ns = words[2].parse().unwrap();
    let time = match words[1] {
        "boot" => Some(DeviceTime::SinceBoot { now_ns }),
        "unix" => Some(DeviceTime::Unix { now_ns }),
        "counter" => Some(DeviceTime::Counter { now_ns, period_ns: 2_560_000_000 }),
        _ => None,
    };
    let numbers: Vec<f64> = words[3..].iter().map(|word| word.parse().unwrap()).collect();
    let three = |at: usize| [numbers[at], numbers[at + 1], numbers[at + 2]];
    let known = |number: f64| Some(number).filter(|number| !number.is_nan());
    let value = match words[0] {
        "imu" => Value::Imu {
            rate_rad_s: three(0),
            force_m_s2: three(3),
            field_ut: Some(three(6)).filter(|field| !field[0].is_nan()),
        },
        "field" => Value::Field(three(0)),
        _ => Value::Fix {
            velocity_m_s: three(0),
            sd_m_s: known(numbers[3]),
            position: position(known(numbers[4]), known(numbers[5]), known(numbers[6])),
        },
    };
    Some(Measurement { time, value })
}

fn position(latitude_rad: Option<f64>, longitude_rad: Option<f64>, altitude_m: Option<f64>) -> Position {
    Position { latitude_rad, longitude_rad, altitude_m }
}

/// Returns all numbers in a value. Unknown ones are NaN.
fn numbers(value: &Value) -> Vec<f64> {
    let unknown = [f64::NAN; 3];
    match *value {
        Value::Imu { rate_rad_s, force_m_s2, field_ut } => {
            [rate_rad_s, force_m_s2, field_ut.unwrap_or(unknown)].concat()
        }
        Value::Field(field_ut) => field_ut.to_vec(),
        Value::Fix { velocity_m_s, sd_m_s, position } => {
            let rest = [sd_m_s, position.latitude_rad, position.longitude_rad, position.altitude_m];
            [&velocity_m_s[..], &rest.map(|part| part.unwrap_or(f64::NAN))].concat()
        }
    }
}

fn check(kind: &str, decoder: impl Decoder + 'static) -> Option<Counts> {
    let (bytes, wanted) = encoded(kind)?;
    let (found, counts) = decoded(Box::new(decoder), bytes.chunks(61));
    assert_eq!(found.len(), wanted.len(), "{kind}: {counts:?}");
    let compared = found.iter().zip(&wanted).filter_map(|(found, wanted)| Some((found, wanted.as_ref()?)));
    for (found, wanted) in compared {
        let is_near = |(a, b): (f64, f64)| (a.is_nan() && b.is_nan()) || (a - b).abs() <= 1e-9 * b.abs().max(1.0);
        let same = numbers(&found.value).into_iter().zip(numbers(&wanted.value)).all(is_near)
            && std::mem::discriminant(&found.value) == std::mem::discriminant(&wanted.value);
        assert!(found.time == wanted.time && same, "{kind}: {found:?} instead of {wanted:?}");
    }
    assert_eq!(counts.rejected, 0, "{kind}: {counts:?}");
    Some(counts)
}

#[test]
fn mavlink_1_2_and_signed_match_pymavlink() {
    for kind in ["mavlink-1", "mavlink-2", "mavlink-signed"] {
        let Some(counts) = check(kind, Framed::new(Mavlink::new(MavlinkSettings::default()))) else { return };
        // Six messages in each round, and one more in every tenth round.
        assert_eq!((counts.frames, counts.skipped_bytes), (300 * 6 + 30, 0), "{kind}");
    }
}

#[test]
fn scaled_imu_and_global_position_match_pymavlink() {
    let settings = MavlinkSettings { fix: FixMessage::GlobalPositionInt, ..MavlinkSettings::default() };
    let Some(counts) = check("scaled", Framed::new(Mavlink::new(settings))) else { return };
    assert_eq!((counts.frames, counts.skipped_bytes), (400, 0));
}

#[test]
fn every_ardupilot_message_counts_as_frame() {
    let Some(counts) = check("mavlink-all", Framed::new(Mavlink::new(MavlinkSettings::default()))) else { return };
    assert_eq!((counts.frames, counts.skipped_bytes), (301, 0));
}

#[test]
fn witmotion_matches_python_package() {
    let Some(counts) = check("witmotion", Framed::new(WitMotion::new(WITMOTION_RANGES))) else {
        return;
    };
    assert_eq!((counts.frames, counts.skipped_bytes), (1200, 0));
}

#[test]
fn rvc_matches_python_package() {
    let Some(counts) = check("rvc", Framed::new(Rvc::default())) else { return };
    assert_eq!((counts.frames, counts.skipped_bytes), (300, 0));
}

#[test]
fn nav_pvt_matches_pyubx2() {
    let Some(counts) = check("ubx", Framed::new(Ubx)) else { return };
    assert_eq!((counts.frames, counts.skipped_bytes), (600, 0));
}

#[test]
fn rmc_and_vtg_match_pynmeagps() {
    let Some(counts) = check("nmea", Framed::new(Nmea::default())) else { return };
    // The two bytes of each line end are skipped.
    assert_eq!((counts.frames, counts.skipped_bytes), (901, 1802));
}
