//! BROAD recordings with added errors. After calibration, they score as well as the originals.
use std::path::{Path, PathBuf};

use attitude::{Vector3, gyro::RateKind};
use calibrate::{Kind, Prior, Sample};
use launch::{Launch, Source};
use messages::{Header, Reference};
use pipeline::Collector;
use readings::source::Reading;
use runtime::{Pace, ServiceConfig};
use score::trial::{Trial, TrialOptions};

use crate::{
    simulated::run_calibration,
    unit::{Errors, Noise},
};

/// Errors larger than those of an uncalibrated sensor: gyro bias 3 °/s, accelerometer bias 0.05 g,
/// accelerometer scale 3 %, hard iron 30 µT, soft iron 10 %.
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

/// Opens the recording with a name that starts with `prefix`; `None` if the data set is not
/// installed.
fn trial(prefix: &str) -> Option<Trial> {
    let data = std::env::var_os("PLUMBLINE_DATA")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data"), PathBuf::from);
    let Ok(folder) = std::fs::read_dir(data.join("broad")) else {
        println!("skipped: no recordings in {}", data.display());
        return None;
    };
    let file = folder.flatten().find(|entry| entry.file_name().to_string_lossy().starts_with(prefix)).unwrap();
    Some(Trial::open(file.path().to_str().unwrap(), &TrialOptions::default()).unwrap())
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

fn distorted(readings: &[Reading], errors: &Errors) -> Vec<Reading> {
    let distort = |reading: &Reading| {
        let Sample { rate_rad_s, force_m_s2, field_ut, .. } = errors.distort(&sample(reading));
        Reading {
            rate_rad_s: rate_rad_s.into(),
            force_m_s2: force_m_s2.into(),
            field_ut: field_ut.map(Into::into),
            ..*reading
        }
    };
    readings.iter().map(distort).collect()
}

/// Returns the root mean square total error, in degrees, of the default fuser with `block` as
/// launch file.
fn score_deg(trial: &Trial, readings: &[Reading], block: &str) -> f64 {
    let mut launch = Launch::parse("launch.toml", block).unwrap_or_else(|error| panic!("{block}\n{error}"));
    launch.ingest.source = Source::Replay;
    let config = ServiceConfig::standalone(launch, trial.rate_hz, Pace::Max);
    let mut conditioner = readings::conditioner(&config).unwrap();
    let mut path = pipeline::Path::new(&config).unwrap();
    let mut collector = Collector::new(None).unwrap();
    for reading in readings {
        let Some(sample) = conditioner.condition(reading) else { continue };
        if let Some(reference) = sample.reference {
            let Header { tick, t_end_ns, .. } = sample.imu.header;
            let (scored, quaternion) = (reference.scored.into(), reference.quaternion);
            collector.record_reference(Reference { tick, t_end_ns, scored, quaternion });
        }
        path.offer(sample, &mut |output| collector.record_attitude(&output)).unwrap();
    }
    collector.finish().unwrap();
    collector.accuracy().rmse().unwrap().total_deg
}

#[recorded::test]
fn calibration_restores_score_after_added_errors() {
    /// Maximum increase of the error compared with the original recording, degrees.
    const MARGIN_DEG: f64 = 0.15;
    let errors = errors();
    // In BROAD, the unit rests on one side only. It rotates slowly in this recording, so that the
    // accelerometer can be calibrated in motion.
    let Some(slow) = trial("02") else { return };
    let slow_samples = samples(&distorted(&readings(&slow), &errors));
    for (scored, mag_source) in [("02", "02"), ("04", "04"), ("24", "24"), ("07", "02")] {
        let (Some(scored), Some(mag_source)) = (trial(scored), trial(mag_source)) else { return };
        let exact = readings(&scored);
        let raw = distorted(&exact, &errors);
        let mag_samples = samples(&distorted(&readings(&mag_source), &errors));
        let own_samples = samples(&raw);
        let gyro_report = run_calibration(Kind::Gyro, &Prior::default(), &slow_samples).unwrap();
        let gyro_launch = Launch::parse("launch.toml", &gyro_report.block).unwrap();
        let prior = Prior { gyro: gyro_launch.ingest.calibration.gyro.to_calibration().unwrap(), ..Prior::default() };
        let accel_report = run_calibration(Kind::Accel, &prior, &slow_samples).unwrap();
        assert!(accel_report.notes.iter().any(|note| note.contains("estimated in motion")), "{accel_report}");
        let [gyro, mag] = [(Kind::Gyro, &own_samples), (Kind::Mag, &mag_samples)]
            .map(|(kind, samples)| run_calibration(kind, &Prior::default(), samples).unwrap().block);
        let blocks = [gyro, accel_report.block, mag];
        let (exact_deg, raw_deg) = (score_deg(&scored, &exact, ""), score_deg(&scored, &raw, ""));
        let calibrated_deg = score_deg(&scored, &raw, &blocks.concat());
        let score_without = |index: usize| {
            let rest: String = (0..3).filter(|i| *i != index).map(|i| blocks[i].as_str()).collect();
            score_deg(&scored, &raw, &rest)
        };
        let [no_gyro, no_accel, no_mag] = [0, 1, 2].map(score_without);
        println!(
            "{}: {exact_deg:.3}° original, {raw_deg:.1}° with errors, {calibrated_deg:.3}° calibrated; without gyro \
             {no_gyro:.2}°, accel {no_accel:.2}°, mag {no_mag:.2}°",
            scored.name
        );
        assert!(raw_deg > 5.0 * exact_deg, "{}: the added errors have no effect", scored.name);
        assert!(calibrated_deg < exact_deg + MARGIN_DEG, "{}: {exact_deg} → {calibrated_deg}", scored.name);
    }
}

#[recorded::test]
fn estimated_errors_match_added_errors() {
    let errors = errors();
    let Some(trial) = trial("02") else { return };
    let (exact, raw) = (readings(&trial), distorted(&readings(&trial), &errors));
    let value = |kind: Kind, readings: &[Reading]| {
        let report = run_calibration(kind, &Prior::default(), &samples(readings)).unwrap();
        Vector3::from_column_slice(&report.values[0].value)
    };
    let added = value(Kind::Gyro, &raw) - value(Kind::Gyro, &exact);
    assert!((added - errors.gyro_bias_rad_s).amax() < 2e-4, "{added}");
    // A distorted reading is M⁻¹ m + h, with the original reading m, the added soft iron M and the
    // added hard iron h. The original readings have a hard iron b, so the distorted readings have
    // the hard iron M⁻¹ b + h.
    let centre = errors.soft_iron.try_inverse().unwrap() * value(Kind::Mag, &exact) + errors.hard_iron_ut;
    assert!((value(Kind::Mag, &raw) - centre).amax() < 0.5, "{} {centre}", value(Kind::Mag, &raw));
}

#[recorded::test]
fn mag_delay_matches_literature_and_added_delay() {
    let Some(trial) = trial("07") else { return };
    let mut readings = readings(&trial);
    let delay_ms = |readings: &[Reading]| {
        let prior = Prior { rate_kind: RateKind::Mean, ..Prior::default() };
        let report = run_calibration(Kind::Clock, &prior, &samples(readings)).unwrap();
        assert!(report.values[0].sd[0] < 0.3, "{report}");
        report.values[0].value[0]
    };
    let original_ms = delay_ms(&readings);
    assert!((original_ms - 13.0).abs() < 1.0, "{original_ms} ms");
    // Delays the magnetic field by three rows of 3.5 ms each.
    for row in (3..readings.len()).rev() {
        readings[row].field_ut = readings[row - 3].field_ut;
    }
    let delayed_ms = delay_ms(&readings);
    assert!((delayed_ms - original_ms - 10.5).abs() < 0.3, "{original_ms} ms, {delayed_ms} ms");
}
