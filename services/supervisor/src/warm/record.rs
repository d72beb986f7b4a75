//! Content of a state file and its validation.
//!
//! The first line contains the format and the checksum of the text that follows. The second line is
//! JSON.

use launch::{Ingest, Source};
use messages::{HASH_START, hash};
use runtime::{ImplausibleValue, Prior};
use serde::{Deserialize, Serialize};

use super::clock::{Age, Timestamp};

/// Start of every state file.
const MAGIC: &str = "plumbline state ";
/// Version of the format.
const VERSION: &str = "2";

/// JSON content of a state file, which follows the first line.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct StateRecord {
    /// Fingerprint of the sensors, see [`sensor_fingerprint`].
    sensors: u64,
    kept: Timestamp,
    prior: Prior,
}

/// Reason why a state is not used.
#[derive(Debug, PartialEq, thiserror::Error)]
pub(super) enum StateError {
    #[error("it is not a state file")]
    NotStateFile,
    #[error("it has format {0}, but this version of the program reads format {VERSION}")]
    OtherVersion(String),
    #[error("it is damaged")]
    Damaged,
    #[error("{0}")]
    Implausible(ImplausibleValue),
    #[error("it is from other sensors: source, calibration or mounting changed since it was written")]
    OtherSensors,
    #[error("it is {} old, too old for the sensor errors to be valid", format_age(*.0))]
    TooOld(f64),
    #[error("it is from the future by {}; check the system clock", format_age(*.0))]
    FromTheFuture(f64),
    #[error(
        "its age is unknown: the machine was rebooted, and neither the network nor a real-time clock has set the time"
    )]
    UnknownAge,
}

/// Returns the fingerprint of the sensors: source, calibration and mounting.
pub(super) fn sensor_fingerprint(ingest: &Ingest) -> u64 {
    let Ingest { source, sim, bus, live, calibration, mounting, .. } = ingest;
    let source = match source {
        Source::Sim => serde_json::json!({ "sim": sim }),
        Source::Replay | Source::Stdin | Source::Bus => serde_json::json!({ "bus": bus }),
        Source::Iio => serde_json::json!({ "iio": live.iio }),
        Source::Udp | Source::Tcp | Source::Serial | Source::Mavlink => {
            serde_json::json!([ingest.port(), ingest.stream()])
        }
    };
    hash(HASH_START, serde_json::json!([source, calibration, mounting]).to_string().as_bytes())
}

/// Returns the text of a state file.
pub(super) fn encode(prior: Prior, sensors: u64, kept: Timestamp) -> Result<String, serde_json::Error> {
    let body = serde_json::to_string(&StateRecord { sensors, kept, prior })? + "\n";
    Ok(format!("{MAGIC}{VERSION} {:016x}\n{body}", hash(HASH_START, body.as_bytes())))
}

/// Returns the prior in a state file, aged to `now`, and the age of the file, s.
///
/// # Errors
///
/// Returns an error if the text is damaged, implausible, from other sensors, too old or of unknown
/// age.
pub(super) fn decode(text: &str, sensors: u64, now: &Timestamp) -> Result<(Prior, f64), StateError> {
    let (head, body) =
        text.strip_prefix(MAGIC).and_then(|rest| rest.split_once('\n')).ok_or(StateError::NotStateFile)?;
    let (version, checksum) = head.split_once(' ').ok_or(StateError::Damaged)?;
    if version != VERSION {
        return Err(StateError::OtherVersion(version.into()));
    }
    if checksum != format!("{:016x}", hash(HASH_START, body.as_bytes())) {
        return Err(StateError::Damaged);
    }
    let record: StateRecord = serde_json::from_str(body).map_err(|_| StateError::Damaged)?;
    if record.sensors != sensors {
        return Err(StateError::OtherSensors);
    }
    let (age_s, power_lost) = match now.age_of(&record.kept) {
        Age::SameBoot(age_s) => (age_s, false),
        Age::OtherBoot(age_s) => (age_s, true),
        Age::Unknown => return Err(StateError::UnknownAge),
    };
    if age_s < 0.0 {
        return Err(StateError::FromTheFuture(-age_s));
    }
    if !record.prior.is_valid() {
        return Err(StateError::Damaged);
    }
    if let Some(value) = record.prior.implausible_value() {
        return Err(StateError::Implausible(value));
    }
    let prior = record.prior.aged(age_s, power_lost);
    if prior.has_estimate() { Ok((prior, age_s)) } else { Err(StateError::TooOld(age_s)) }
}

/// Describes the known sensor errors and their uncertainty.
pub(super) fn describe(prior: &Prior) -> String {
    let bias = prior.bias_rad_s.map(|known| format!("gyro bias within {:.3} °/s", known.sd.to_degrees()));
    let hard_iron = prior.hard_iron_ut.map(|known| format!("hard iron within {:.1} µT", known.sd));
    let scale = prior.gyro_scale.map(|_| "gyro scale".into());
    let mut known: Vec<_> = [bias, hard_iron, scale].into_iter().flatten().collect();
    let last = known.pop().unwrap_or_default();
    if known.is_empty() { last } else { format!("{} and {last}", known.join(", ")) }
}

/// Formats a duration in a suitable unit.
pub(super) fn format_age(age_s: f64) -> String {
    match age_s {
        ..120.0 => format!("{age_s:.0} s"),
        ..7200.0 => format!("{:.0} min", age_s / 60.0),
        ..172_800.0 => format!("{:.0} h", age_s / 3600.0),
        _ => format!("{:.0} days", age_s / 86_400.0),
    }
}

#[cfg(test)]
mod tests {
    use launch::Launch;

    use super::*;
    use runtime::PriorEstimate;

    const PRIOR: Prior = Prior {
        bias_rad_s: Some(PriorEstimate { mean: [0.001, -0.002, 0.003], sd: 2e-4 }),
        hard_iron_ut: Some(PriorEstimate { mean: [20.0, 0.0, -7.5], sd: 0.5 }),
        gyro_scale: Some(PriorEstimate { mean: [0.002, -0.004, 0.0], sd: 5e-4 }),
    };
    const SENSORS: u64 = 7;

    fn timestamp(boot: &str, since_boot_s: f64, unix_s: f64, is_set: bool) -> Timestamp {
        Timestamp { boot: boot.into(), since_boot_s, unix_s, is_set }
    }

    fn state_text() -> String {
        encode(PRIOR, SENSORS, timestamp("a", 1000.0, 1.7e9, true)).unwrap()
    }

    /// Creates a state file with the given body and its correct checksum.
    fn with_body(body: &str) -> String {
        format!("{MAGIC}{VERSION} {:016x}\n{body}", hash(HASH_START, body.as_bytes()))
    }

    #[test]
    fn fingerprint_of_a_source_does_not_change() {
        let fingerprint = |source: &str| {
            let mut launch = Launch::default();
            launch.set_source(source).unwrap();
            format!("{:016x}", sensor_fingerprint(&launch.ingest))
        };
        for (source, expected) in [
            ("/dev/imu?format=xsens&baud=9600", "7cb7812dbd93ffbe"),
            ("mavlink:serial:/dev/ttyACM0", "3b58757c7e6276af"),
            ("udp", "da426acb81a2be80"),
            ("tcp:a:1", "b7939c0196d6eb01"),
            ("iio:bmi160", "1f5a0646c16cd0bb"),
        ] {
            assert_eq!(fingerprint(source), expected, "{source}");
        }
    }

    #[test]
    fn decoded_bias_is_exact_and_its_sd_grows_with_age() {
        let soon = decode(&state_text(), SENSORS, &timestamp("a", 1001.0, 0.0, false)).unwrap();
        let bias = |(prior, _): (Prior, f64)| prior.bias_rad_s.unwrap();
        assert_eq!((bias(soon).mean, soon.1), (PRIOR.bias_rad_s.unwrap().mean, 1.0));
        assert_eq!(soon.0.hard_iron_ut.unwrap().mean, PRIOR.hard_iron_ut.unwrap().mean);
        assert!((bias(soon).sd - 2e-4f64.hypot(3e-5)).abs() < 1e-12);
        let hour = decode(&state_text(), SENSORS, &timestamp("a", 4600.0, 0.0, false)).unwrap();
        assert!((bias(hour).sd - 2e-4f64.hypot(3e-5 * 60.0)).abs() < 1e-12);
        // The bias of a gyro that was powered off is less certain; the hard iron is not affected.
        let started_again = decode(&state_text(), SENSORS, &timestamp("b", 5.0, 1.7e9 + 60.0, true)).unwrap();
        assert_eq!(started_again.1, 60.0);
        assert!(bias(started_again).sd > 1e-3 && started_again.0.hard_iron_ut.unwrap().sd < 0.6);
        // After a night the bias is too uncertain to be used, but the hard iron is not.
        let night = decode(&state_text(), SENSORS, &timestamp("b", 5.0, 1.7e9 + 36_000.0, true)).unwrap();
        assert_eq!(
            (night.0.bias_rad_s, night.0.gyro_scale, night.1),
            (None, PRIOR.aged(36_000.0, true).gyro_scale, 36_000.0)
        );
        assert_eq!(describe(&night.0), "hard iron within 0.6 µT and gyro scale");
        assert_eq!(describe(&PRIOR), "gyro bias within 0.011 °/s, hard iron within 0.5 µT and gyro scale");
    }

    #[test]
    fn state_of_unknown_or_excessive_age_is_rejected() {
        let rejection = |now| decode(&state_text(), SENSORS, &now).unwrap_err();
        let days_s = 100.0 * 86_400.0;
        assert_eq!(rejection(timestamp("a", 1000.0 + days_s, 1.7e9, true)), StateError::TooOld(days_s));
        assert_eq!(rejection(timestamp("b", 10.0, 1.7e9 + days_s, true)), StateError::TooOld(days_s));
        assert_eq!(rejection(timestamp("a", 940.0, 1.7e9 + 9.0, true)), StateError::FromTheFuture(60.0));
        assert_eq!(rejection(timestamp("b", 10.0, 1.7e9 - 60.0, true)), StateError::FromTheFuture(60.0));
        assert_eq!(rejection(timestamp("b", 10.0, 1.7e9 + 60.0, false)), StateError::UnknownAge);
        let unset = encode(PRIOR, SENSORS, timestamp("a", 1000.0, 1.7e9, false)).unwrap();
        assert_eq!(decode(&unset, SENSORS, &timestamp("b", 10.0, 1.7e9 + 60.0, true)), Err(StateError::UnknownAge));
        assert_eq!(
            StateError::TooOld(days_s).to_string(),
            "it is 100 days old, too old for the sensor errors to be valid"
        );
    }

    #[test]
    fn damaged_state_is_rejected() {
        let (good, now) = (state_text(), timestamp("a", 1001.0, 1.7e9, true));
        let rejection = |text: &str| decode(text, SENSORS, &now).unwrap_err();
        for index in MAGIC.len()..good.len() {
            let mut bytes = good.clone().into_bytes();
            bytes[index] ^= 1;
            let Ok(text) = String::from_utf8(bytes) else { continue };
            assert!(
                matches!(
                    rejection(&text),
                    StateError::Damaged | StateError::OtherVersion(_) | StateError::NotStateFile
                ),
                "{text}"
            );
        }
        for len in 0..good.len() {
            assert!(decode(&good[..len], SENSORS, &now).is_err(), "{len} bytes of it");
        }
        assert_eq!(rejection(""), StateError::NotStateFile);
        assert_eq!(rejection("[ingest]\nsource = \"bus\"\n"), StateError::NotStateFile);
        assert_eq!(rejection(&good.replacen("state 2", "state 1", 1)), StateError::OtherVersion("1".into()));
        let body = good.split_once('\n').unwrap().1;
        assert!(decode(&with_body(body), SENSORS, &now).is_ok());
        for (from, to) in [
            ("0.001", "11.0"),
            ("0.001", "1e999"),
            ("0.001,", ""),
            ("0.0002", "-0.0002"),
            ("0.0002", "0.0"),
            ("0.0002", "null"),
            ("\"since_boot_s\":1000.0", "\"since_boot_s\":null"),
            ("\"sensors\"", "\"more\":1,\"sensors\""),
        ] {
            assert!(body.contains(from), "{from} in {body}");
            assert_eq!(rejection(&with_body(&body.replacen(from, to, 1))), StateError::Damaged, "{from} → {to}");
        }
    }

    #[test]
    fn absurd_value_with_correct_checksum_is_rejected() {
        let now = timestamp("a", 1001.0, 1.7e9, true);
        let body = state_text().split_once('\n').unwrap().1.to_owned();
        let decoded = |from: &str, to: &str| {
            assert!(body.contains(from), "{from} in {body}");
            decode(&with_body(&body.replacen(from, to, 1)), SENSORS, &now).map_err(|error| error.to_string())
        };
        for (from, valid, absurd, message) in [
            ("0.001", "0.26", "0.27", "its gyro bias of 15.5 °/s is implausible; the limit is ±15 °/s"),
            ("-0.002", "-0.26", "-5.0", "its gyro bias of -286.5 °/s is implausible; the limit is ±15 °/s"),
            ("-7.5", "-999.0", "-1001.0", "its hard iron of -1001.0 µT is implausible; the limit is ±1000 µT"),
        ] {
            assert!(decoded(from, valid).is_ok(), "{from} → {valid}: {:?}", decoded(from, valid));
            assert_eq!(decoded(from, absurd).unwrap_err(), message);
        }
        assert_eq!(decoded("-0.004", "-0.11").unwrap_err(), StateError::Damaged.to_string());
    }

    #[test]
    fn fingerprint_covers_source_calibration_and_mounting_only() {
        let fingerprint = |text: &str| sensor_fingerprint(&Launch::parse("x", text).unwrap().ingest);
        let bus = "ingest.source = \"bus\"\n";
        for other in [
            "ingest.source = \"sim\"",
            "ingest.source = \"bus\"\ningest.bus.rate_hz = 500",
            "ingest.source = \"bus\"\ningest.calibration.gyro.bias = [0, 0, 1e-6]",
            "ingest.source = \"bus\"\ningest.mounting.axes = \"x-forward-y-left\"",
        ] {
            assert_ne!(fingerprint(bus), fingerprint(other), "{other}");
        }
        assert_ne!(fingerprint(""), fingerprint("ingest.sim.seed = 2"));
        assert_eq!(
            fingerprint(bus),
            fingerprint(
                "fuser.stage = \"vqf\"\nbuffer_s = 4\ningest = { source = \"bus\", limits.gap_s = 0.2, sim.seed = 2 }"
            )
        );
        let good = state_text();
        assert_eq!(decode(&good, SENSORS + 1, &timestamp("a", 1001.0, 0.0, false)), Err(StateError::OtherSensors));
    }

    #[test]
    fn missing_gyro_scale_is_taken_from_previous_run() {
        let scale = |prior: Prior| prior.or_scale_from(Some(PRIOR)).gyro_scale;
        assert_eq!(scale(Prior { gyro_scale: None, ..PRIOR }), PRIOR.gyro_scale);
        let found = Some(PriorEstimate { mean: [0.001; 3], sd: 4e-4 });
        assert_eq!(scale(Prior { gyro_scale: found, ..PRIOR }), found);
        assert_eq!(Prior { gyro_scale: None, ..PRIOR }.or_scale_from(None).gyro_scale, None);
        // The standard deviation of the prior, 5e-4, is combined in quadrature with the minimum
        // standard deviation of a scale, 2e-3.
        assert!((PRIOR.estimate().gyro_scale.sd.x - 5e-4f64.hypot(2e-3)).abs() < 1e-12);
        assert_eq!(Prior::from_named_values(&PRIOR.named_values()), Some(PRIOR));
    }
}
