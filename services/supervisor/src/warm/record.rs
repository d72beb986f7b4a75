//! What is in a state file, and whether that is of use now.
//!
//! One line that says what it is, with the checksum of what follows; then one line of JSON.

use launch::{Ingest, Source};
use messages::{HASH_START, hash};
use runtime::Prior;
use serde::{Deserialize, Serialize};

use super::moment::{Moment, Since};

/// What every state file begins with.
const MAGIC: &str = "plumbline state ";
/// Of what follows.
const VERSION: &str = "2";

/// What follows the first line.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Record {
    /// Of [`sensors`].
    sensors: u64,
    kept: Moment,
    prior: Prior,
}

/// Why a state is of no use.
#[derive(Debug, PartialEq, thiserror::Error)]
pub(super) enum Unusable {
    #[error("it is no state file")]
    NoState,
    #[error("it is of another version of this program (format {0}, this one reads {VERSION})")]
    OtherVersion(String),
    #[error("it is damaged")]
    Damaged,
    #[error("it is of other sensors: source, calibration or mounting were changed since")]
    OtherSensors,
    #[error("it is {} old, and by then the sensors may have become others", age(*.0))]
    TooOld(f64),
    #[error("it is from the future, by {}; look at this machine's clock", age(*.0))]
    FromTheFuture(f64),
    #[error(
        "its age is unknown: the machine was started again, and neither the network nor a clock with a battery has set the time"
    )]
    UnknownAge,
}

/// What tells one set of sensors from another: where they are read, how they are calibrated and how they sit.
pub(super) fn sensors(ingest: &Ingest) -> u64 {
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

/// The text of a state file.
pub(super) fn text(prior: Prior, sensors: u64, kept: Moment) -> Result<String, serde_json::Error> {
    let body = serde_json::to_string(&Record { sensors, kept, prior })? + "\n";
    Ok(format!("{MAGIC}{VERSION} {:016x}\n{body}", hash(HASH_START, body.as_bytes())))
}

/// What the text of a state file tells now, and how old that is, s.
pub(super) fn prior(text: &str, sensors: u64, now: &Moment) -> Result<(Prior, f64), Unusable> {
    let (head, body) = text.strip_prefix(MAGIC).and_then(|rest| rest.split_once('\n')).ok_or(Unusable::NoState)?;
    let (version, checksum) = head.split_once(' ').ok_or(Unusable::Damaged)?;
    if version != VERSION {
        return Err(Unusable::OtherVersion(version.into()));
    }
    if checksum != format!("{:016x}", hash(HASH_START, body.as_bytes())) {
        return Err(Unusable::Damaged);
    }
    let record: Record = serde_json::from_str(body).map_err(|_| Unusable::Damaged)?;
    if record.sensors != sensors {
        return Err(Unusable::OtherSensors);
    }
    let (age_s, power_lost) = match now.since(&record.kept) {
        Since::SameBoot(age_s) => (age_s, false),
        Since::OtherBoot(age_s) => (age_s, true),
        Since::Unknown => return Err(Unusable::UnknownAge),
    };
    if age_s < 0.0 {
        return Err(Unusable::FromTheFuture(-age_s));
    }
    if !record.prior.is_sound() {
        return Err(Unusable::Damaged);
    }
    let prior = record.prior.aged(age_s, power_lost);
    if prior.tells() { Ok((prior, age_s)) } else { Err(Unusable::TooOld(age_s)) }
}

/// What is known, and how well.
pub(super) fn words(prior: &Prior) -> String {
    let bias = prior.bias_rad_s.map(|known| format!("the gyro's bias within {:.3} °/s", known.sd.to_degrees()));
    let hard_iron = prior.hard_iron_ut.map(|known| format!("hard iron within {:.1} µT", known.sd));
    let scale = prior.gyro_scale.map(|_| "the gyro's scale".into());
    let mut known: Vec<_> = [bias, hard_iron, scale].into_iter().flatten().collect();
    let last = known.pop().unwrap_or_default();
    if known.is_empty() { last } else { format!("{} and {last}", known.join(", ")) }
}

/// A time in its usual unit.
pub(super) fn age(age_s: f64) -> String {
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
    use runtime::Known;

    const PRIOR: Prior = Prior {
        bias_rad_s: Some(Known { mean: [0.001, -0.002, 0.003], sd: 2e-4 }),
        hard_iron_ut: Some(Known { mean: [20.0, 0.0, -7.5], sd: 0.5 }),
        gyro_scale: Some(Known { mean: [0.002, -0.004, 0.0], sd: 5e-4 }),
    };
    const SENSORS: u64 = 7;

    fn at(boot: &str, since_boot_s: f64, unix_s: f64, is_set: bool) -> Moment {
        Moment { boot: boot.into(), since_boot_s, unix_s, is_set }
    }

    fn kept() -> String {
        text(PRIOR, SENSORS, at("a", 1000.0, 1.7e9, true)).unwrap()
    }

    /// A text with another body, whose checksum is right.
    fn with_body(body: &str) -> String {
        format!("{MAGIC}{VERSION} {:016x}\n{body}", hash(HASH_START, body.as_bytes()))
    }

    #[test]
    fn the_bias_comes_back_to_the_last_bit_and_less_sure_by_its_age() {
        let soon = prior(&kept(), SENSORS, &at("a", 1001.0, 0.0, false)).unwrap();
        let bias = |(prior, _): (Prior, f64)| prior.bias_rad_s.unwrap();
        assert_eq!((bias(soon).mean, soon.1), (PRIOR.bias_rad_s.unwrap().mean, 1.0));
        assert_eq!(soon.0.hard_iron_ut.unwrap().mean, PRIOR.hard_iron_ut.unwrap().mean);
        assert!((bias(soon).sd - 2e-4f64.hypot(3e-5)).abs() < 1e-12);
        let hour = prior(&kept(), SENSORS, &at("a", 4600.0, 0.0, false)).unwrap();
        assert!((bias(hour).sd - 2e-4f64.hypot(3e-5 * 60.0)).abs() < 1e-12);
        // A gyro that was without power in between is less sure than one that was not; iron is not.
        let started_again = prior(&kept(), SENSORS, &at("b", 5.0, 1.7e9 + 60.0, true)).unwrap();
        assert_eq!(started_again.1, 60.0);
        assert!(bias(started_again).sd > 1e-3 && started_again.0.hard_iron_ut.unwrap().sd < 0.6);
        // Over night a bias is lost, iron is not.
        let night = prior(&kept(), SENSORS, &at("b", 5.0, 1.7e9 + 36_000.0, true)).unwrap();
        assert_eq!(
            (night.0.bias_rad_s, night.0.gyro_scale, night.1),
            (None, PRIOR.aged(36_000.0, true).gyro_scale, 36_000.0)
        );
        assert_eq!(words(&night.0), "hard iron within 0.6 µT and the gyro's scale");
        assert_eq!(words(&PRIOR), "the gyro's bias within 0.011 °/s, hard iron within 0.5 µT and the gyro's scale");
    }

    #[test]
    fn a_state_is_used_only_as_far_as_its_age_is_known_and_allows() {
        let refused = |now| prior(&kept(), SENSORS, &now).unwrap_err();
        let days_s = 100.0 * 86_400.0;
        assert_eq!(refused(at("a", 1000.0 + days_s, 1.7e9, true)), Unusable::TooOld(days_s));
        assert_eq!(refused(at("b", 10.0, 1.7e9 + days_s, true)), Unusable::TooOld(days_s));
        assert_eq!(refused(at("a", 940.0, 1.7e9 + 9.0, true)), Unusable::FromTheFuture(60.0));
        assert_eq!(refused(at("b", 10.0, 1.7e9 - 60.0, true)), Unusable::FromTheFuture(60.0));
        assert_eq!(refused(at("b", 10.0, 1.7e9 + 60.0, false)), Unusable::UnknownAge);
        let unset = text(PRIOR, SENSORS, at("a", 1000.0, 1.7e9, false)).unwrap();
        assert_eq!(prior(&unset, SENSORS, &at("b", 10.0, 1.7e9 + 60.0, true)), Err(Unusable::UnknownAge));
        assert_eq!(
            Unusable::TooOld(days_s).to_string(),
            "it is 100 days old, and by then the sensors may have become others"
        );
    }

    #[test]
    fn whatever_was_done_to_a_state_it_is_refused() {
        let (good, now) = (kept(), at("a", 1001.0, 1.7e9, true));
        let refused = |text: &str| prior(text, SENSORS, &now).unwrap_err();
        for place in MAGIC.len()..good.len() {
            let mut bytes = good.clone().into_bytes();
            bytes[place] ^= 1;
            let Ok(text) = String::from_utf8(bytes) else { continue };
            assert!(
                matches!(refused(&text), Unusable::Damaged | Unusable::OtherVersion(_) | Unusable::NoState),
                "{text}"
            );
        }
        for len in 0..good.len() {
            assert!(prior(&good[..len], SENSORS, &now).is_err(), "{len} bytes of it");
        }
        assert_eq!(refused(""), Unusable::NoState);
        assert_eq!(refused("[ingest]\nsource = \"bus\"\n"), Unusable::NoState);
        assert_eq!(refused(&good.replacen("state 2", "state 1", 1)), Unusable::OtherVersion("1".into()));
        let body = good.split_once('\n').unwrap().1;
        assert!(prior(&with_body(body), SENSORS, &now).is_ok());
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
            assert_eq!(refused(&with_body(&body.replacen(from, to, 1))), Unusable::Damaged, "{from} → {to}");
        }
    }

    #[test]
    fn other_sensors_are_told_by_source_calibration_and_mounting_and_by_nothing_else() {
        let of = |text: &str| sensors(&Launch::parse("x", text).unwrap().ingest);
        let bus = "ingest.source = \"bus\"\n";
        for other in [
            "ingest.source = \"sim\"",
            "ingest.source = \"bus\"\ningest.bus.rate_hz = 500",
            "ingest.source = \"bus\"\ningest.calibration.gyro.bias = [0, 0, 1e-6]",
            "ingest.source = \"bus\"\ningest.mounting.axes = \"x-forward-y-left\"",
        ] {
            assert_ne!(of(bus), of(other), "{other}");
        }
        assert_ne!(of(""), of("ingest.sim.seed = 2"));
        assert_eq!(
            of(bus),
            of("fuser.stage = \"vqf\"\nbuffer_s = 4\ningest = { source = \"bus\", limits.gap_s = 0.2, sim.seed = 2 }")
        );
        let good = kept();
        assert_eq!(prior(&good, SENSORS + 1, &at("a", 1001.0, 0.0, false)), Err(Unusable::OtherSensors));
    }

    #[test]
    fn a_scale_that_a_run_has_not_found_stays_that_of_the_run_before() {
        let scale = |of: Prior| of.or_scale_of(Some(PRIOR)).gyro_scale;
        assert_eq!(scale(Prior { gyro_scale: None, ..PRIOR }), PRIOR.gyro_scale);
        let found = Some(Known { mean: [0.001; 3], sd: 4e-4 });
        assert_eq!(scale(Prior { gyro_scale: found, ..PRIOR }), found);
        assert_eq!(Prior { gyro_scale: None, ..PRIOR }.or_scale_of(None).gyro_scale, None);
        // As unsure as without it, or nearly.
        assert!((PRIOR.estimate().gyro_scale.sd.x - 5e-4f64.hypot(2e-3)).abs() < 1e-12);
        assert_eq!(Prior::of_numbers(&PRIOR.numbers()), Some(PRIOR));
    }
}
