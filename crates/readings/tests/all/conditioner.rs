//! Tests each row of the table in `attitude::conditioner`, and random timestamps and values.
use attitude::gnss::Fix;
use launch::{GyroSamples, Launch};
use messages::{Flags, ImuSample};
use readings::{conditioner::Conditioner, source::Reading};

const RATE_HZ: f64 = 200.0;
const INTERVAL_NS: i64 = 5_000_000;
const SECOND_NS: i64 = 1_000_000_000;
const HOUR_NS: i64 = 3600 * SECOND_NS;
const YEAR_NS: i64 = 365 * 24 * HOUR_NS;
const NO_INDICES: [usize; 0] = [];

fn conditioner(kind: GyroSamples) -> Conditioner {
    Conditioner::new(&Launch::default().ingest, RATE_HZ, kind).unwrap()
}

/// Returns a valid reading with different values for each count.
fn reading(count: i64) -> Reading {
    let x = count as f64 * 1e-3;
    Reading {
        t_ns: count * INTERVAL_NS,
        rate_rad_s: [x, -x, 0.1],
        force_m_s2: [0.1, x, 9.8],
        field_ut: None,
        fix: None,
        reference: None,
    }
}

fn readings(count: i64) -> Vec<Reading> {
    (0..count).map(reading).collect()
}

/// Conditions all readings. Checks the times, ticks and values of the samples, and the counts of
/// accepted and rejected readings.
fn conditioned(readings: &[Reading]) -> Vec<Option<ImuSample>> {
    let mut conditioner = conditioner(GyroSamples::Means);
    let samples: Vec<_> =
        readings.iter().map(|reading| conditioner.condition(reading).map(|sample| sample.imu)).collect();
    let accepted: Vec<_> = samples.iter().flatten().copied().collect();
    assert_valid(&accepted);
    assert_eq!(conditioner.ticks(), accepted.len() as u64);
    assert_eq!(conditioner.rejected(), (samples.len() - accepted.len()) as u64);
    samples
}

fn assert_valid(samples: &[ImuSample]) {
    for (tick, sample) in (0..).zip(samples) {
        assert_eq!(sample.header.tick, tick);
        assert!(sample.rate_rad_s.iter().chain(&sample.force_m_s2).all(|x| x.is_finite()), "{sample:?}");
    }
    for pair in samples.windows(2) {
        assert_eq!(pair[1].header.t_start_ns, pair[0].header.t_end_ns);
        assert!(pair[1].header.t_end_ns > pair[1].header.t_start_ns, "{pair:?}");
    }
}

/// Returns the samples. Every reading must have been accepted.
fn all_accepted(readings: &[Reading]) -> Vec<ImuSample> {
    conditioned(readings).into_iter().map(Option::unwrap).collect()
}

fn rejected(samples: &[Option<ImuSample>]) -> Vec<usize> {
    (0..samples.len()).filter(|i| samples[*i].is_none()).collect()
}

/// Returns the indices and flags of the flagged samples.
fn flagged(samples: &[Option<ImuSample>]) -> Vec<(usize, Flags)> {
    let flags = |i: usize| samples[i].map_or(Flags::NONE, |sample| sample.header.flags);
    (0..samples.len()).map(|i| (i, flags(i))).filter(|(_, flags)| *flags != Flags::NONE).collect()
}

fn duration_ns(sample: &Option<ImuSample>) -> i64 {
    let header = sample.unwrap().header;
    header.t_end_ns - header.t_start_ns
}

#[test]
fn valid_readings_pass_unchanged() {
    let readings = readings(1000);
    for (reading, sample) in readings.iter().zip(all_accepted(&readings)) {
        assert_eq!((sample.header.t_end_ns, sample.header.flags), (reading.t_ns, Flags::NONE));
        assert_eq!((sample.rate_rad_s, sample.force_m_s2), (reading.rate_rad_s, reading.force_m_s2));
    }
}

#[test]
fn instantaneous_rates_are_flagged() {
    let sample = conditioner(GyroSamples::Instants).condition(&reading(0)).unwrap();
    assert_eq!(sample.imu.header.flags, Flags::RATE_INSTANT);
}

#[test]
fn invalid_values_become_last_valid_ones_with_flag() {
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e300, f64::MAX] {
        let mut readings = readings(10);
        readings[4].rate_rad_s[1] = bad;
        readings[7].force_m_s2[2] = bad;
        let samples = conditioned(&readings);
        assert_eq!(flagged(&samples), [(4, Flags::RATE_INVALID), (7, Flags::FORCE_INVALID)], "{bad}");
        assert_eq!(samples[4].unwrap().rate_rad_s, readings[3].rate_rad_s);
        assert_eq!(samples[4].unwrap().force_m_s2, readings[4].force_m_s2);
        assert_eq!(samples[7].unwrap().force_m_s2, readings[6].force_m_s2);
        assert_eq!(samples[8].unwrap().force_m_s2, readings[8].force_m_s2);
    }
}

#[test]
fn invalid_values_at_start_become_zero() {
    let mut readings = readings(2);
    readings[0].rate_rad_s = [f64::NAN; 3];
    readings[0].force_m_s2 = [f64::INFINITY; 3];
    let samples = all_accepted(&readings);
    assert_eq!((samples[0].rate_rad_s, samples[0].force_m_s2), ([0.0; 3], [0.0; 3]));
    assert_eq!(samples[0].header.flags, Flags::RATE_INVALID | Flags::FORCE_INVALID);
    assert_eq!(samples[1].header.flags, Flags::NONE);
}

#[test]
fn rate_missing_longer_than_gap_becomes_zero() {
    let mut readings = readings(200);
    readings[100..150].iter_mut().for_each(|reading| reading.rate_rad_s[0] = f64::NAN);
    let samples = all_accepted(&readings);
    assert!(samples[100..150].iter().all(|sample| sample.header.flags == Flags::RATE_INVALID));
    assert!(samples[100..120].iter().all(|sample| sample.rate_rad_s == readings[99].rate_rad_s), "0.1 s");
    assert!(samples[120..150].iter().all(|sample| sample.rate_rad_s == [0.0; 3]));
    assert_eq!((samples[150].rate_rad_s, samples[150].header.flags), (readings[150].rate_rad_s, Flags::NONE));
}

#[test]
fn clipped_values_pass_with_flag() {
    let mut readings = readings(10);
    readings[3].rate_rad_s[2] = -2000f64.to_radians();
    readings[5].force_m_s2[0] = 16.0 * attitude::GRAVITY_M_S2;
    let samples = conditioned(&readings);
    assert_eq!(flagged(&samples), [(3, Flags::RATE_CLIPPED), (5, Flags::FORCE_CLIPPED)]);
    assert_eq!(samples[3].unwrap().rate_rad_s, readings[3].rate_rad_s);
    assert_eq!(samples[5].unwrap().force_m_s2, readings[5].force_m_s2);
}

#[test]
fn force_near_zero_passes_unchanged() {
    let mut readings = readings(10);
    readings[3].force_m_s2 = [0.0, 1e-300, -0.0];
    assert_eq!(all_accepted(&readings)[3].force_m_s2, readings[3].force_m_s2);
}

#[test]
fn vector_constant_for_half_a_second_is_flagged_stuck() {
    let mut readings = readings(400);
    readings[100..300].iter_mut().for_each(|it| it.rate_rad_s = reading(100).rate_rad_s);
    readings[150..350].iter_mut().for_each(|it| it.force_m_s2 = reading(150).force_m_s2);
    let samples = all_accepted(&readings);
    for (i, sample) in samples.iter().enumerate() {
        let expected =
            Flags::RATE_STUCK.when((200..300).contains(&i)) | Flags::FORCE_STUCK.when((250..350).contains(&i));
        assert_eq!(sample.header.flags, expected, "reading {i}");
        assert_eq!(sample.rate_rad_s, readings[i].rate_rad_s);
    }
}

#[test]
fn repeated_reading_is_rejected() {
    let mut readings = readings(10);
    readings.insert(5, reading(4));
    readings.insert(6, reading(4));
    let samples = conditioned(&readings);
    assert_eq!(rejected(&samples), [5, 6]);
    assert_eq!(flagged(&samples), [(7, Flags::REFUSED_BEFORE)]);
    assert_eq!(duration_ns(&samples[7]), INTERVAL_NS);
}

#[test]
fn repeated_reading_with_nan_is_rejected() {
    let mut readings = readings(4);
    readings[2].rate_rad_s[0] = f64::NAN;
    readings[3] = readings[2];
    assert_eq!(rejected(&conditioned(&readings)), [3]);
}

#[test]
fn same_stamp_with_new_values_gets_typical_interval() {
    let mut readings = readings(10);
    readings[5].t_ns = readings[4].t_ns;
    let samples = conditioned(&readings);
    assert_eq!(rejected(&samples), NO_INDICES);
    assert_eq!(flagged(&samples)[0], (5, Flags::CLOCK_LEAP));
    assert_eq!(duration_ns(&samples[5]), INTERVAL_NS);
    assert_eq!(samples[9].unwrap().header.t_end_ns, reading(9).t_ns);
}

#[test]
fn stopped_sensor_clock_does_not_stop_time() {
    let mut readings = readings(400);
    readings[100..300].iter_mut().for_each(|it| it.t_ns = reading(100).t_ns);
    let samples = conditioned(&readings);
    assert_eq!(rejected(&samples), NO_INDICES);
    assert!(samples[101..300].iter().all(|it| duration_ns(it) == INTERVAL_NS));
    assert!(samples[101..300].iter().all(|it| it.unwrap().header.flags.any(Flags::CLOCK_LEAP)));
    assert_eq!(samples[399].unwrap().header.t_end_ns, reading(399).t_ns);
}

#[test]
fn coarse_sensor_clock_does_not_shift_time() {
    let mut readings = readings(1000);
    readings.iter_mut().for_each(|it| it.t_ns = it.t_ns / (2 * INTERVAL_NS) * (2 * INTERVAL_NS));
    let samples = conditioned(&readings);
    assert_eq!(rejected(&samples), NO_INDICES);
    assert_eq!(samples[999].unwrap().header.t_end_ns, reading(999).t_ns);
}

#[test]
fn coarse_clock_with_wrong_rate_does_not_shift_time() {
    let mut readings = readings(1000);
    readings.iter_mut().for_each(|it| it.t_ns = it.t_ns / (5 * INTERVAL_NS) * (5 * INTERVAL_NS));
    let mut conditioner = Conditioner::new(&Launch::default().ingest, 0.4 * RATE_HZ, GyroSamples::Means).unwrap();
    let samples: Vec<_> = readings.iter().map(|reading| conditioner.condition(reading).unwrap().imu).collect();
    let error_ns = |count: usize| samples[count].header.t_end_ns - reading(count as i64).t_ns;
    assert!(error_ns(999).abs() < INTERVAL_NS, "{} ns", error_ns(999));
    let intervals_ns = samples[500..].iter().map(|sample| sample.header.t_end_ns - sample.header.t_start_ns);
    assert!(
        intervals_ns.clone().all(|dt_ns| (dt_ns - INTERVAL_NS).abs() < INTERVAL_NS / 4),
        "{:?}",
        intervals_ns.max()
    );
}

#[test]
fn earlier_stamp_is_rejected_and_keeps_time() {
    let mut readings = readings(10);
    readings[5].t_ns -= 3 * INTERVAL_NS;
    let samples = conditioned(&readings);
    assert_eq!(rejected(&samples), [5]);
    assert_eq!(flagged(&samples), [(6, Flags::REFUSED_BEFORE)]);
    assert_eq!(samples[9].unwrap().header.t_end_ns, reading(9).t_ns);
}

#[test]
fn second_of_two_swapped_readings_is_rejected() {
    let mut readings = readings(10);
    readings.swap(4, 5);
    let samples = conditioned(&readings);
    assert_eq!(rejected(&samples), [5]);
    assert_eq!(flagged(&samples), [(6, Flags::REFUSED_BEFORE)]);
    assert_eq!(duration_ns(&samples[4]), 2 * INTERVAL_NS);
}

#[test]
fn clock_set_back_by_an_hour_costs_one_reading() {
    let mut readings = readings(200);
    readings[100..].iter_mut().for_each(|it| it.t_ns -= HOUR_NS);
    let samples = conditioned(&readings);
    assert_eq!(rejected(&samples), [100]);
    assert_eq!(flagged(&samples), [(101, Flags::CLOCK_LEAP | Flags::REFUSED_BEFORE)]);
    assert_eq!(duration_ns(&samples[101]), 2 * INTERVAL_NS, "the rejected interval is included");
    assert!(samples[102..].iter().all(|it| duration_ns(it) == INTERVAL_NS));
    assert_eq!(samples[199].unwrap().header.t_end_ns, reading(199).t_ns);
}

#[test]
fn backward_running_clock_does_not_stop_samples() {
    let mut readings = readings(300);
    readings[100..].iter_mut().for_each(|it| it.t_ns = 200 * INTERVAL_NS - it.t_ns);
    let samples = conditioned(&readings);
    let accepted: Vec<_> = samples[101..].iter().flatten().collect();
    assert!(accepted.len() >= 199 / 11, "{}", accepted.len());
    assert!(accepted.iter().all(|it| it.header.flags.any(Flags::CLOCK_LEAP)));
    let end_ns = accepted.last().unwrap().header.t_end_ns;
    assert!((reading(289).t_ns..=reading(299).t_ns).contains(&end_ns), "{end_ns}");
}

#[test]
fn later_stamp_is_flagged_as_gap() {
    for gap_ns in [SECOND_NS / 2, 5 * SECOND_NS, 10 * SECOND_NS] {
        let mut readings = readings(10);
        readings[5..].iter_mut().for_each(|it| it.t_ns += gap_ns - INTERVAL_NS);
        let samples = conditioned(&readings);
        assert_eq!(flagged(&samples), [(5, Flags::GAP)]);
        assert_eq!(duration_ns(&samples[5]), gap_ns);
        assert_eq!(duration_ns(&samples[6]), INTERVAL_NS);
    }
}

#[test]
fn forward_leap_becomes_typical_interval() {
    for leap_ns in [10 * SECOND_NS + 1, 10 * YEAR_NS] {
        let mut readings = readings(10);
        readings[5..].iter_mut().for_each(|it| it.t_ns += leap_ns);
        let samples = conditioned(&readings);
        assert_eq!(rejected(&samples), NO_INDICES);
        assert_eq!(flagged(&samples), [(5, Flags::CLOCK_LEAP)]);
        assert!(samples[1..].iter().all(|it| duration_ns(it) == INTERVAL_NS));
    }
}

#[test]
fn single_stamp_far_ahead_costs_one_reading() {
    let mut readings = readings(10);
    readings[5].t_ns += 10 * YEAR_NS;
    let samples = conditioned(&readings);
    assert_eq!(rejected(&samples), [6]);
    assert_eq!(samples[9].unwrap().header.t_end_ns, reading(9).t_ns);
}

#[test]
fn typical_interval_follows_readings() {
    let mut readings = readings(400);
    readings.iter_mut().for_each(|it| it.t_ns *= 2);
    readings[300..].iter_mut().for_each(|it| it.t_ns += YEAR_NS);
    let interval_ns = duration_ns(&conditioned(&readings)[300]);
    assert!((interval_ns - 2 * INTERVAL_NS).abs() < INTERVAL_NS / 100, "{interval_ns}");
}

#[test]
fn extreme_stamps_do_not_stop_time() {
    for first in [i64::MIN, i64::MIN + 1, -1, i64::MAX - 1, i64::MAX] {
        for extreme in [i64::MIN, i64::MAX] {
            let mut readings = readings(100);
            readings[0].t_ns = first;
            readings[50].t_ns = extreme;
            let samples = conditioned(&readings);
            assert!(rejected(&samples).len() <= 2, "{first} {extreme}: rejected {:?}", rejected(&samples));
            assert!(samples[53..].iter().all(|it| duration_ns(it) == INTERVAL_NS), "{first} {extreme}");
        }
    }
}

/// Generator of random timestamps and values, using splitmix64 (Steele, Lea, Flood 2014).
struct FuzzRng(u64);

impl FuzzRng {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn below(&mut self, limit: u64) -> u64 {
        self.next() % limit
    }

    fn stamp(&mut self, last_ns: i64, percent: u64) -> i64 {
        if self.below(100) >= percent {
            return last_ns.wrapping_add(INTERVAL_NS);
        }
        let scale = self.below(63);
        let far_ns = (self.next() >> scale) as i64;
        match self.below(6) {
            0 => last_ns,
            1 => last_ns.wrapping_add(far_ns),
            2 => last_ns.wrapping_sub(far_ns),
            3 => i64::MAX - (far_ns & 0xff),
            4 => i64::MIN + (far_ns & 0xff),
            _ => far_ns,
        }
    }

    fn values(&mut self, valid: [f64; 3], percent: u64) -> [f64; 3] {
        valid.map(|x| {
            if self.below(100) >= percent {
                return x;
            }
            match self.below(6) {
                0 => f64::NAN,
                1 => f64::INFINITY,
                2 => f64::NEG_INFINITY,
                3 => 0.0,
                4 => x * 1e4,
                _ => f64::from_bits(self.next()),
            }
        })
    }
}

#[test]
fn fuzzed_readings_give_finite_samples_in_time_order() {
    for seed in 0..600 {
        let mut rng = FuzzRng(seed);
        let percent = [1, 10, 50, 100][seed as usize % 4];
        let mut t_ns = if seed % 3 == 0 { rng.next() as i64 } else { 0 };
        let readings: Vec<_> = (0..2000)
            .map(|count| {
                let valid = reading(count);
                t_ns = rng.stamp(t_ns, percent);
                let rate_rad_s = rng.values(valid.rate_rad_s, percent);
                Reading { t_ns, rate_rad_s, force_m_s2: rng.values(valid.force_m_s2, percent), ..valid }
            })
            .collect();
        let accepted = conditioned(&readings).iter().flatten().count();
        assert!(accepted >= readings.len() / 12, "seed {seed}: {accepted} samples of {} readings", readings.len());
    }
}

/// Returns, for each sample, whether it has a magnetic field, whether it has a fix, and which of
/// the flags for the field and the fix are set.
fn aiding(readings: &[Reading]) -> Vec<(bool, bool, Flags)> {
    let mut conditioner = conditioner(GyroSamples::Means);
    let relevant = Flags::FIELD | Flags::FIX | Flags::FIELD_INVALID | Flags::FIX_INVALID;
    let samples = readings.iter().filter_map(|reading| conditioner.condition(reading));
    samples.map(|s| (s.mag.is_some(), s.gnss.is_some(), Flags(s.imu.header.flags.0 & relevant.0))).collect()
}

#[test]
fn field_is_passed_once_and_only_if_valid() {
    let fields = [None, Some([20.0, 0.0, -40.0]), Some([20.0, 0.0, -40.0]), Some([f64::NAN, 0.0, 0.0]), Some([2e3; 3])];
    let readings: Vec<_> = (0..).zip(fields).map(|(count, field_ut)| Reading { field_ut, ..reading(count) }).collect();
    let expected = [Flags::NONE, Flags::FIELD, Flags::NONE, Flags::FIELD_INVALID, Flags::FIELD_INVALID];
    assert_eq!(aiding(&readings), expected.map(|flags| (flags == Flags::FIELD, false, flags)));
}

#[test]
fn fix_of_rejected_reading_goes_with_next_tick() {
    let fix = |speed: f64| {
        Some(Fix { velocity_m_s: [speed, 0.0, 0.0].into(), sd_m_s: None, age_s: None, latitude_rad: None }.into())
    };
    let mut readings = readings(5);
    readings[1].fix = fix(30.0);
    readings[2] = Reading { fix: fix(31.0), ..readings[1] };
    readings[4].fix = fix(f64::INFINITY);
    let samples = aiding(&readings);
    let flags: Vec<_> = samples.iter().map(|(_, fix, flags)| (*fix, *flags)).collect();
    let (none, fix, invalid) = ((false, Flags::NONE), (true, Flags::FIX), (false, Flags::FIX_INVALID));
    assert_eq!(flags, [none, fix, fix, invalid], "the third reading is a duplicate and gives no tick");
}

#[test]
fn readings_are_calibrated_then_rotated_to_body_axes() {
    let text = r#"
        [ingest]
        mounting.axes = "x-forward-y-left"
        calibration.gyro.bias = [0.5, 0, 0]
        calibration.accel.scale = [1, 2, 1]
        calibration.mag.matrix = [[1, 0, 0], [0, 1, 0], [0, 0, 3]]
    "#;
    let ingest = Launch::parse("launch.toml", text).unwrap().ingest;
    let mut conditioner = Conditioner::new(&ingest, RATE_HZ, GyroSamples::Means).unwrap();
    let raw = [1.0, 2.0, 3.0];
    let reading = Reading { rate_rad_s: raw, force_m_s2: raw, field_ut: Some(raw), ..reading(0) };
    let sample = conditioner.condition(&reading).unwrap();
    assert_eq!(sample.imu.rate_rad_s, [-2.0, 0.5, 3.0]);
    assert_eq!(sample.imu.force_m_s2, [-4.0, 1.0, 3.0]);
    assert_eq!(sample.mag.unwrap().field_ut, [-2.0, 1.0, 9.0]);
}

#[test]
fn limits_of_raw_counts_apply_after_calibration() {
    let text = "[ingest.calibration.gyro]\nscale = [0.001, 0.001, 0.001]\n[ingest.calibration.accel]\nscale = [0.005, 0.005, 0.005]\n";
    let ingest = Launch::parse("launch.toml", text).unwrap().ingest;
    let mut conditioner = Conditioner::new(&ingest, RATE_HZ, GyroSamples::Means).unwrap();
    let counts = |count: i64, az: f64| Reading { force_m_s2: [count as f64, 0.0, az], ..reading(count) };
    let flags = |conditioner: &mut Conditioner, reading: Reading| conditioner.condition(&reading).unwrap().imu;
    let accepted = flags(&mut conditioner, counts(1, 2048.0));
    assert_eq!((accepted.header.flags, accepted.force_m_s2[2]), (Flags::NONE, 10.24));
    let clipped = flags(&mut conditioner, counts(2, 32_000.0));
    assert_eq!(clipped.header.flags, Flags::FORCE_CLIPPED, "160 m/s² is more than 16 g");
    let invalid = flags(&mut conditioner, counts(3, 400_000.0));
    assert_eq!((invalid.header.flags, invalid.force_m_s2[2]), (Flags::FORCE_INVALID, 160.0));
    // If the calibration does not convert the unit, the limits apply before the calibration.
    let text = "[ingest.calibration.accel]\nscale = [0.98, 0.98, 0.98]\n";
    let ingest = Launch::parse("launch.toml", text).unwrap().ingest;
    let mut conditioner = Conditioner::new(&ingest, RATE_HZ, GyroSamples::Means).unwrap();
    let clipped = flags(&mut conditioner, counts(1, 16.0 * 9.80665));
    assert_eq!(clipped.header.flags, Flags::FORCE_CLIPPED);
}
