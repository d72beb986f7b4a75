//! Recordings of BROAD with errors added: calibrated, they score as they did without.
use std::path::{Path, PathBuf};

use attitude::{Vector3, gyro::RateKind};
use calibrate::{Kind, Known, Sample};
use ingest::source::Reading;
use launch::{Launch, Source};
use messages::Reference;
use pipeline::Collector;
use runtime::{Pace, Role, ServiceConfig};
use score::trial::{Options, Trial};

use crate::{
    simulated::calibrated,
    unit::{Errors, Noise},
};

/// A sensor as it comes out of the box, and worse: 3 °/s, 0.05 g, 3 %, 30 µT, 10 %.
fn errors() -> Errors {
    let mut noise = Noise::new(20);
    let soft_iron = noise.symmetric(0.1, 0.05);
    Errors {
        gyro_bias_rad_s: Vector3::new(0.03, -0.05, 0.04),
        accel_bias_m_s2: Vector3::new(0.3, -0.5, 0.4),
        accel: noise.symmetric(0.03, 0.01),
        hard_iron_ut: Vector3::new(25.0, -15.0, 30.0),
        soft_iron: soft_iron / soft_iron.determinant().cbrt(),
        delay_s: 0.0,
    }
}

/// A recording; none where there are no recordings.
fn trial(begins: &str) -> Option<Trial> {
    let data = std::env::var_os("PLUMBLINE_DATA")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data"), PathBuf::from);
    let Ok(folder) = std::fs::read_dir(data.join("broad")) else {
        println!("skipped: no recordings in {}", data.display());
        return None;
    };
    let file = folder.flatten().find(|entry| entry.file_name().to_string_lossy().starts_with(begins)).unwrap();
    Some(Trial::open(file.path().to_str().unwrap(), &Options::default()).unwrap())
}

fn readings(trial: &Trial) -> Vec<Reading> {
    trial.readings().unwrap().map(Result::unwrap).collect()
}

fn sample(reading: &Reading) -> Sample {
    let Reading { t_ns, rate_rad_s, force_m_s2, field_ut, .. } = *reading;
    Sample { t_ns, rate_rad_s: rate_rad_s.into(), force_m_s2: force_m_s2.into(), field_ut: field_ut.map(Into::into) }
}

fn samples(readings: &[Reading]) -> Vec<Sample> {
    readings.iter().map(sample).collect()
}

fn spoilt(readings: &[Reading], errors: &Errors) -> Vec<Reading> {
    let spoil = |reading: &Reading| {
        let Sample { rate_rad_s, force_m_s2, field_ut, .. } = errors.spoil(&sample(reading));
        Reading {
            rate_rad_s: rate_rad_s.into(),
            force_m_s2: force_m_s2.into(),
            field_ut: field_ut.map(Into::into),
            ..*reading
        }
    };
    readings.iter().map(spoil).collect()
}

/// Total error of the default fuser with the field, root mean square, degrees, in a system whose launch file has this piece.
fn score_deg(trial: &Trial, readings: &[Reading], piece: &str) -> f64 {
    let mut launch = Launch::parse("launch.toml", piece).unwrap_or_else(|error| panic!("{piece}\n{error}"));
    launch.ingest.source = Source::Replay;
    let config = ServiceConfig {
        launch,
        rate_hz: trial.rate_hz,
        pace: Pace::Max,
        max_ticks: None,
        incarnation: 0,
        epoch: runtime::service_config::FIRST_EPOCH,
        role: Role::Owner { from_tick: 0 },
        prior: None,
        resume: None,
        publishes_readings: false,
        supervisor_pid: std::process::id(),
    };
    let mut conditioner = ingest::conditioner(&config).unwrap();
    let mut path = pipeline::Path::new(&config).unwrap();
    let mut collector = Collector::new(None).unwrap();
    for reading in readings {
        let Some(sample) = conditioner.condition(reading) else { continue };
        if let Some(truth) = sample.reference {
            let (tick, scored) = (sample.imu.header.tick, truth.scored.into());
            collector.reference(Reference { tick, scored, quaternion: truth.quaternion });
        }
        path.offer(sample, &mut |output| collector.attitude(&output)).unwrap();
    }
    collector.finish().unwrap();
    collector.accuracy().rmse().unwrap().total_deg
}

#[test]
fn with_errors_added_the_score_comes_back() {
    /// How much worse than without the errors a calibrated recording may be, degrees.
    const MARGIN_DEG: f64 = 0.15;
    let errors = errors();
    // The people of BROAD let the unit rest on one side only; they turned it slowly in this one.
    let Some(slow) = trial("02") else { return };
    let slowly = samples(&spoilt(&readings(&slow), &errors));
    for (scored, turned) in [("02", "02"), ("04", "04"), ("24", "24"), ("07", "02")] {
        let (Some(scored), Some(turned)) = (trial(scored), trial(turned)) else { return };
        let exact = readings(&scored);
        let raw = spoilt(&exact, &errors);
        let about = samples(&spoilt(&readings(&turned), &errors));
        let here = samples(&raw);
        let of_gyro = Launch::parse("launch.toml", &calibrated(Kind::Gyro, &Known::default(), &slowly).unwrap().block);
        let known = Known { gyro: of_gyro.unwrap().ingest.calibration.gyro.to_calibration().unwrap(), ..Known::default() };
        let of_accel = calibrated(Kind::Accel, &known, &slowly).unwrap();
        assert!(of_accel.notes.iter().any(|note| note.contains("found in motion")), "{of_accel}");
        let of_rest = [(Kind::Gyro, &here), (Kind::Mag, &about)]
            .map(|(kind, samples)| calibrated(kind, &Known::default(), samples).unwrap().block);
        let [gyro, mag] = of_rest;
        let pieces = [gyro, of_accel.block, mag];
        let (without_deg, raw_deg) = (score_deg(&scored, &exact, ""), score_deg(&scored, &raw, ""));
        let calibrated_deg = score_deg(&scored, &raw, &pieces.concat());
        let one_left_out = |left_out: usize| {
            let rest: String = (0..3).filter(|i| *i != left_out).map(|i| pieces[i].as_str()).collect();
            score_deg(&scored, &raw, &rest)
        };
        let [no_gyro, no_accel, no_mag] = [0, 1, 2].map(one_left_out);
        println!(
            "{}: {without_deg:.3}° as it is, {raw_deg:.1}° with errors, {calibrated_deg:.3}° calibrated; without the piece of \
             gyro {no_gyro:.2}°, accel {no_accel:.2}°, mag {no_mag:.2}°",
            scored.name
        );
        assert!(raw_deg > 5.0 * without_deg, "{}: errors that do no harm", scored.name);
        assert!(calibrated_deg < without_deg + MARGIN_DEG, "{}: {without_deg} → {calibrated_deg}", scored.name);
    }
}

#[test]
fn what_is_found_is_what_was_added() {
    let errors = errors();
    let Some(trial) = trial("02") else { return };
    let (exact, raw) = (readings(&trial), spoilt(&readings(&trial), &errors));
    let value = |kind: Kind, readings: &[Reading]| {
        let report = calibrated(kind, &Known::default(), &samples(readings)).unwrap();
        Vector3::from_column_slice(&report.values[0].value)
    };
    let added = value(Kind::Gyro, &raw) - value(Kind::Gyro, &exact);
    assert!((added - errors.gyro_bias_rad_s).amax() < 2e-4, "{added}");
    // M⁻¹ (m − b) + h has its centre at M⁻¹ b + h.
    let centre = errors.soft_iron.try_inverse().unwrap() * value(Kind::Mag, &exact) + errors.hard_iron_ut;
    assert!((value(Kind::Mag, &raw) - centre).amax() < 0.5, "{} {centre}", value(Kind::Mag, &raw));
}

#[test]
fn the_magnetometers_of_broad_are_as_late_as_others_found_and_later_where_they_are_made_so() {
    let Some(trial) = trial("07") else { return };
    let mut readings = readings(&trial);
    let delay_ms = |readings: &[Reading]| {
        let known = Known { rate_kind: RateKind::Mean, ..Known::default() };
        let report = calibrated(Kind::Clock, &known, &samples(readings)).unwrap();
        assert!(report.values[0].sd[0] < 0.3, "{report}");
        report.values[0].value[0]
    };
    let as_it_is = delay_ms(&readings);
    assert!((as_it_is - 13.0).abs() < 1.0, "{as_it_is} ms");
    // Three rows of 3.5 ms.
    for row in (3..readings.len()).rev() {
        readings[row].field_ut = readings[row - 3].field_ut;
    }
    let later = delay_ms(&readings);
    assert!((later - as_it_is - 10.5).abs() < 0.3, "{as_it_is} ms, {later} ms");
}
