//! Noise of simulated units at rest, compared with the truth, and rejected recordings.
use std::f64::consts::{PI, TAU};

use attitude::{GRAVITY_M_S2, Vector3};
use calibrate::{
    Rejection, Sample,
    noise::{AxisNoise, Estimate, NoiseCalibrator, NoiseReport},
};

use crate::unit::Noise;

const FUSER: &str = "multiple-model";
const RATE_HZ: f64 = 10.0;

/// Noise of an axis: random walk N, bias instability B and bias walk K.
type Truth = [f64; 3];

/// Gyro noise, °/√s, °/s and °/s/√s. An hour of readings determines every coefficient.
const GYRO: Truth = [0.005, 0.004, 0.001];
/// Accelerometer noise, m/s/√s, m/s² and m/s²/√s. An hour of readings determines every coefficient.
const ACCEL: Truth = [0.002, 0.0012, 0.0003];

/// Replaces complex numbers with their discrete Fourier transform. The length must be a power of
/// two.
fn fourier(values: &mut [(f64, f64)]) {
    let n = values.len();
    let bits = n.trailing_zeros();
    for i in 0..n {
        let j = i.reverse_bits() >> (usize::BITS - bits);
        if i < j {
            values.swap(i, j);
        }
    }
    let mut half = 1;
    while half < n {
        let factors: Vec<_> = (0..half).map(|k| (PI * k as f64 / half as f64).sin_cos()).collect();
        for block in values.chunks_mut(2 * half) {
            let (low, high) = block.split_at_mut(half);
            for ((a, b), (sin, cos)) in low.iter_mut().zip(high).zip(&factors) {
                let turned = (b.0 * cos + b.1 * sin, b.1 * cos - b.0 * sin);
                *b = (a.0 - turned.0, a.1 - turned.1);
                *a = (a.0 + turned.0, a.1 + turned.1);
            }
        }
        half *= 2;
    }
}

/// Returns two independent signals of flicker noise with the power spectral density B²/(2πf) and
/// B = 1.
fn flicker(count: usize, noise: &mut Noise) -> Vec<(f64, f64)> {
    // The signal is periodic. To hide the period, a longer signal is generated and truncated.
    let n = (3 * count).next_power_of_two();
    let mut spectrum: Vec<_> = (0..n)
        .map(|k| {
            let frequency_hz = k.min(n - k) as f64 * RATE_HZ / n as f64;
            // The sum over n frequencies of E|c|² is the variance of the complex signal.
            let density = if k == 0 { 0.0 } else { 1.0 / (TAU * frequency_hz) };
            let sd = (density * RATE_HZ / n as f64).sqrt();
            (sd * noise.normal(), sd * noise.normal())
        })
        .collect();
    fourier(&mut spectrum);
    spectrum.truncate(count);
    spectrum
}

/// Returns a signal with the noise `truth`.
fn signal(truth: &Truth, flicker: impl Iterator<Item = f64>, noise: &mut Noise) -> Vec<f64> {
    let mut bias = 0.0;
    let values = flicker.map(|flicker| {
        bias += truth[2] / RATE_HZ.sqrt() * noise.normal();
        truth[0] * RATE_HZ.sqrt() * noise.normal() + truth[1] * flicker + bias
    });
    values.collect()
}

/// Returns the readings of a unit at rest.
fn resting(duration_s: f64, gyro: &Truth, accel: &Truth, seed: u64) -> Vec<Sample> {
    let mut noise = Noise::new(seed);
    let mut axes = Vec::new();
    for [first, second] in [[gyro, gyro], [gyro, accel], [accel, accel]] {
        let flicker = flicker((duration_s * RATE_HZ) as usize, &mut noise);
        axes.push(signal(first, flicker.iter().map(|pair| pair.0), &mut noise));
        axes.push(signal(second, flicker.iter().map(|pair| pair.1), &mut noise));
    }
    (0..axes[0].len())
        .map(|i| Sample {
            t_ns: (i as f64 * 1e9 / RATE_HZ) as i64,
            rate_rad_s: Vector3::from_fn(|axis, _| axes[axis][i].to_radians()),
            force_m_s2: Vector3::from_fn(|axis, _| axes[3 + axis][i]) + Vector3::z() * GRAVITY_M_S2,
            field_ut: None,
        })
        .collect()
}

fn measure(samples: &[Sample]) -> Result<NoiseReport, Rejection> {
    let mut calibrator = NoiseCalibrator::default();
    samples.iter().for_each(|sample| calibrator.push(sample));
    calibrator.finish(FUSER)
}

/// Checks that the readings are rejected, and that the message contains `expected`.
fn assert_rejected(samples: &[Sample], expected: &[&str]) {
    let text = measure(samples).unwrap_err().to_string();
    expected.iter().for_each(|part| assert!(text.contains(part), "no {part:?} in:\n{text}"));
}

fn estimates(axis: &AxisNoise) -> [Estimate; 3] {
    [axis.random_walk, axis.bias_instability, axis.bias_walk]
}

/// Counts over all estimates of one noise type.
#[derive(Debug, Default, Clone, Copy)]
struct Counts {
    within: usize,
    determined: usize,
    /// Number of upper limits that are below the truth.
    low_limits: usize,
    all: usize,
    log_error: f64,
}

/// Counts, over seeds and axes, how often the estimated intervals contain the truth.
fn count(duration_s: f64, gyro: &Truth, accel: &Truth, seeds: u64) -> [Counts; 3] {
    let mut counts = [Counts::default(); 3];
    for seed in 0..seeds {
        let report = measure(&resting(duration_s, gyro, accel, seed)).unwrap();
        for (sensor, truth) in report.sensors.iter().zip([gyro, accel]) {
            for axis in &sensor.axes {
                for ((counts, estimate), truth) in counts.iter_mut().zip(estimates(axis)).zip(truth) {
                    counts.all += 1;
                    match estimate {
                        Estimate::Determined { value, interval: [low, high] } => {
                            assert!(low < value && value < high);
                            counts.determined += 1;
                            counts.within += usize::from((low..=high).contains(truth));
                            counts.log_error += (value / truth.max(1e-12)).ln();
                        }
                        Estimate::NotDetermined { below, .. } => counts.low_limits += usize::from(below < *truth),
                    }
                }
            }
        }
    }
    println!("{duration_s} s: {counts:#?}");
    counts
}

#[test]
fn intervals_contain_the_truth_as_often_as_stated() {
    // With 180 estimates of each type, an expected share of 68 % has a standard deviation of 3.5 %.
    let counts = count(3600.0, &GYRO, &ACCEL, 30);
    for Counts { within, determined, all, log_error, .. } in counts {
        let share = within as f64 / determined as f64;
        assert!(determined as f64 > 0.9 * all as f64, "{counts:?}");
        assert!((0.58..0.78).contains(&share), "{counts:?}");
        assert!((log_error / determined as f64).abs() < 0.05, "{counts:?}");
    }
}

#[test]
fn noise_that_is_not_shown_has_an_upper_limit() {
    // White noise with weak noise of the other types, which ten minutes of readings do not
    // determine.
    let counts = count(600.0, &[0.01, 0.001, 1e-5], &[0.002, 0.0002, 2e-6], 20);
    let [white, flicker, walk] = counts;
    assert!(white.determined == white.all && white.within as f64 > 0.58 * white.all as f64, "{counts:?}");
    for Counts { determined, all, low_limits, .. } in [flicker, walk] {
        assert!(determined as f64 <= 0.1 * all as f64 && low_limits as f64 <= 0.1 * all as f64, "{counts:?}");
    }
}

#[test]
fn needed_time_of_unseen_noise_suffices() {
    // Ten minutes do not determine the bias walk, but a rest of four times that duration would.
    let truth = [0.005, 0.0, 0.0002];
    let report = measure(&resting(600.0, &truth, &ACCEL, 3)).unwrap();
    let axis = &report.sensors[0].axes[1];
    let Estimate::NotDetermined { below, needs_min: Some(needs_min) } = axis.bias_walk else { panic!("{axis:?}") };
    assert!((20.0..=640.0).contains(&needs_min) && below > 0.0002, "{report}");
    assert!(report.to_string().contains(&format!("needs {needs_min} minutes")), "{report}");
    let walk = [truth[0], 0.0, below];
    let longer = measure(&resting(60.0 * needs_min, &walk, &ACCEL, 4)).unwrap();
    assert!(matches!(longer.sensors[0].axes[1].bias_walk, Estimate::Determined { .. }), "{longer}");
}

/// Adds a rotation to the readings between `from_s` and `to_s`, as if the unit had been shaken.
fn shake(samples: &mut [Sample], from_s: f64, to_s: f64) {
    for sample in samples {
        let t_s = sample.t_ns as f64 * 1e-9;
        if (from_s..to_s).contains(&t_s) {
            sample.rate_rad_s.y += 0.3 * (7.0 * t_s).sin();
        }
    }
}

#[test]
fn motion_is_named_and_only_rests_are_used() {
    let still = resting(600.0, &GYRO, &ACCEL, 5);
    let mut samples = still.clone();
    shake(&mut samples, 100.0, 104.0);
    // The unit is tilted by 10° at 400 s.
    let tilt = attitude::Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.985, 0.174, 0.0, -0.174, 0.985);
    samples
        .iter_mut()
        .filter(|sample| sample.t_ns >= 400_000_000_000)
        .for_each(|sample| sample.force_m_s2 = tilt * sample.force_m_s2);
    let (moved, still) = (measure(&samples).unwrap(), measure(&still).unwrap());
    assert_eq!((moved.rests.len(), still.rests.len()), (3, 1));
    assert!(still.notes.iter().all(|note| !note.contains("motion")), "{still}");
    for words in [
        "motion at 100 to 105 s: standard deviation of ",
        "on gyro y, limit ",
        "motion at 400 to 401 s: change of the mean",
        "on accelerometer y",
        "used only the rests at 0 to 99 s, 106 to 399 s, 402 to 600 s",
    ] {
        assert!(moved.to_string().contains(words), "no {words:?} in {moved}");
    }
    // The motion does not change the noise by more than its uncertainty.
    let white = |report: &NoiseReport| match report.sensors[0].axes[1].random_walk {
        Estimate::Determined { value, .. } => value,
        Estimate::NotDetermined { .. } => panic!("{report}"),
    };
    assert!((white(&moved) / white(&still) - 1.0).abs() < 0.1, "{moved}{still}");
}

#[test]
fn recording_in_motion_is_rejected() {
    let mut samples = resting(200.0, &GYRO, &ACCEL, 6);
    shake(&mut samples, 15.0, 200.0);
    assert_rejected(
        &samples,
        &["of what is needed", "missing: ", "rest instead of motion at 15 to 200 s", "gyro y", "°/s"],
    );
    shake(&mut samples, 0.0, 15.0);
    assert_rejected(&samples, &["0 rests, 0.0 s", "30.0 s of rest", "motion at 0 to 200 s"]);
    // A slow turn: gravity moves in sensor axes.
    let mut turned = resting(60.0, &GYRO, &ACCEL, 7);
    for sample in &mut turned {
        let angle = 0.02 * sample.t_ns as f64 * 1e-9;
        sample.force_m_s2 = Vector3::new(GRAVITY_M_S2 * angle.sin(), 0.0, GRAVITY_M_S2 * angle.cos());
    }
    assert_rejected(&turned, &["0 rests", "accelerometer x"]);
    assert_rejected(&samples[..0], &["no readings", "30.0 s of rest"]);
    assert_rejected(&resting(20.0, &GYRO, &ACCEL, 8), &["10.1 s of rest", "do not touch it"]);
}

#[test]
fn gaps_and_irregular_intervals_are_reported() {
    let whole = resting(1200.0, &GYRO, &ACCEL, 9);
    let mut samples = whole.clone();
    // Every hundredth reading is lost, and so are 30 s of readings in the middle.
    let mut index = 0;
    samples.retain(|sample| {
        index += 1;
        index % 100 != 0 && !(600_000_000_000..630_000_000_000).contains(&sample.t_ns)
    });
    let report = measure(&samples).unwrap();
    let text = report.to_string();
    assert_eq!(report.rests.len(), 2, "{text}");
    for words in ["1 gap of up to 30.20 s", "intervals deviate from the median by over 50 %"] {
        assert!(text.contains(words), "no {words:?} in {text}");
    }
    let value = |report: &NoiseReport| match report.sensors[1].axes[2].random_walk {
        Estimate::Determined { value, .. } => value,
        Estimate::NotDetermined { .. } => panic!("{report}"),
    };
    assert!((value(&report) / value(&measure(&whole).unwrap()) - 1.0).abs() < 0.05, "{text}");
}

#[test]
fn unusable_rates_and_constant_axes_are_rejected() {
    let samples = resting(120.0, &GYRO, &ACCEL, 10);
    let scaled = |factor: f64| -> Vec<Sample> {
        samples.iter().map(|sample| Sample { t_ns: (sample.t_ns as f64 * factor) as i64, ..*sample }).collect()
    };
    assert_rejected(&scaled(1000.0), &["a rate of 10 Hz to 10 kHz; found 0.010 Hz", "unit of the times"]);
    assert_rejected(&scaled(1e-4), &["found 100000.000 Hz"]);
    let mut faster = samples.clone();
    for (i, sample) in faster.iter_mut().enumerate() {
        sample.t_ns = if i < 600 { i as i64 * 100_000_000 } else { 60_000_000_000 + (i as i64 - 600) * 50_000_000 };
    }
    assert_rejected(&faster, &["a constant rate; it varies from 10.0 to 20.0 Hz"]);
    let stuck: Vec<_> = samples
        .iter()
        .map(|sample| Sample { force_m_s2: Vector3::new(0.1, sample.force_m_s2.y, sample.force_m_s2.z), ..*sample })
        .collect();
    assert_rejected(&stuck, &["values of the accelerometer, axis x, that change"]);
}

#[test]
fn parameters_follow_for_the_fuser() {
    let samples = resting(3600.0, &[0.03, 0.004, 0.002], &ACCEL, 11);
    let mut calibrator = NoiseCalibrator::default();
    samples.iter().for_each(|sample| calibrator.push(sample));
    let block = |stage: &str| calibrator.finish(stage).unwrap().block;
    let launch =
        |text: &str| launch::Launch::parse("launch.toml", text).unwrap_or_else(|error| panic!("{text}\n{error}"));
    let set = launch(&block(FUSER)).fuser.set;
    let near = |name: &str, truth: f64| (set[name] / truth - 1.0).abs() < 0.3;
    assert!(near("gyro_noise_deg_sqrt_s", 0.03) && near("level_noise_deg_sqrt_s", 0.03), "{set:?}");
    assert!(near("gyro_bias_walk_deg_s_sqrt_s", 0.002) && near("accel_noise_m_s_sqrt_s", ACCEL[0]), "{set:?}");
    assert!(near("accel_bias_walk_m_s2_sqrt_s", ACCEL[2]), "{set:?}");
    // The stage wz has only two of the parameters.
    let wz = launch(&block("wz")).fuser;
    let names: Vec<_> = wz.set.keys().map(String::as_str).collect();
    assert_eq!((wz.stage.as_str(), names), ("wz", vec!["gyro_bias_walk_deg_s_sqrt_s", "level_noise_deg_sqrt_s"]));
    for (stage, words) in [("vqf", "has no parameter for noise"), ("mine", "not a built-in stage")] {
        let report = calibrator.finish(stage).unwrap();
        assert!(report.block.is_empty() && report.to_string().contains(words), "{report}");
    }
    // Measured values below the defaults are used only for the white noise.
    let quiet = measure(&resting(3600.0, &[0.005, 0.0005, 3e-4], &[0.002, 0.0001, 1e-5], 12)).unwrap();
    let names: Vec<_> = launch(&quiet.block).fuser.set.into_keys().collect();
    assert_eq!(names, ["accel_noise_m_s_sqrt_s", "gyro_noise_deg_sqrt_s"]);
    assert!(quiet.to_string().contains("kept: level_noise_deg_sqrt_s, gyro_bias_walk_deg_s_sqrt_s"), "{quiet}");
}
