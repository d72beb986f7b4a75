//! Clock fit on simulated devices: times increase, keep the device's intervals and follow the host.
use driver::clock_fit::{ClockFit, ClockHealth, Stamp};
use proptest::prelude::*;

const MS: i64 = 1_000_000;
const S: i64 = 1_000_000_000;

/// Simulated device that sends a sample every `interval_ns` on the device's clock, with a delay.
#[derive(Debug, Clone)]
struct Device {
    interval_ns: i64,
    /// Rate of the host's clock relative to the device's, minus 1.
    drift: f64,
    start_ns: u64,
    period_ns: Option<u64>,
    /// Delay of each sample, as a fraction of the maximum delay.
    delays: Vec<f64>,
    max_delay_ns: i64,
    /// `true` for each sample that is lost.
    lost: Vec<bool>,
}

/// Result for one sample.
#[derive(Debug, Clone, Copy)]
struct Sample {
    device_ns: i64,
    true_ns: i64,
    t_ns: i64,
}

impl Device {
    fn run(&self, fit: &mut ClockFit) -> Vec<Sample> {
        let (mut samples, mut arrived_ns) = (Vec::new(), 0);
        for (i, delay) in self.delays.iter().enumerate() {
            let device_ns = i as i64 * self.interval_ns;
            let true_ns = 10 * S + (device_ns as f64 * (1.0 + self.drift)) as i64;
            // Samples arrive in order, because they share one serial line.
            arrived_ns = arrived_ns.max(true_ns + (delay * self.max_delay_ns as f64) as i64);
            if self.lost[i] {
                continue;
            }
            let count_ns = self.start_ns + device_ns as u64;
            let count_ns = self.period_ns.map_or(count_ns, |period_ns| count_ns % period_ns);
            let t_ns = fit.push(Some(Stamp { count_ns, period_ns: self.period_ns }), arrived_ns);
            samples.push(Sample { device_ns, true_ns, t_ns });
        }
        samples
    }
}

fn device() -> impl Strategy<Value = Device> {
    let delays = proptest::collection::vec((0.0..1.0, proptest::bool::weighted(0.05)), 1500..2500);
    (2 * MS..12 * MS, -100e-6..100e-6, 0..1_u64 << 40, 0..5 * MS, delays).prop_map(
        |(interval_ns, drift, start_ns, max_delay_ns, delays)| {
            let (delays, lost) = delays.into_iter().unzip();
            Device { interval_ns, drift, start_ns, period_ns: None, delays, max_delay_ns, lost }
        },
    )
}

fn assert_even(samples: &[Sample]) {
    for pair in samples.windows(2) {
        let (device_ns, host_ns) = (pair[1].device_ns - pair[0].device_ns, pair[1].t_ns - pair[0].t_ns);
        let deviation = (host_ns - device_ns).abs() as f64 / device_ns as f64;
        assert!(host_ns > 0 && deviation < 0.125, "an interval of {device_ns} ns is {host_ns} ns");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn intervals_stay_even_despite_jitter_drift_and_loss(device in device()) {
        let mut fit = ClockFit::new();
        let samples = device.run(&mut fit);
        assert_even(&samples);
        let half = &samples[samples.len() / 2..];
        for sample in half {
            let late_ns = sample.t_ns - sample.true_ns;
            prop_assert!((-MS..device.max_delay_ns + MS).contains(&late_ns), "{late_ns} ns late");
        }
        // The host cannot observe the mean delay, but variations of the delay must be removed.
        let latenesses = half.iter().map(|sample| sample.t_ns - sample.true_ns);
        let spread_ns = latenesses.clone().max().unwrap() - latenesses.min().unwrap();
        prop_assert!(spread_ns < device.max_delay_ns / 4 + MS / 10, "{spread_ns} of {}", device.max_delay_ns);
        let ClockHealth { drift_ppm, jitter_ns, wraps, backsteps, resets, .. } = fit.health();
        prop_assert_eq!([wraps, backsteps, resets], [0; 3]);
        prop_assert!(jitter_ns <= device.max_delay_ns as f64, "{}", jitter_ns);
        let error_ppm = drift_ppm - device.drift * 1e6;
        prop_assert!(error_ppm.abs() < 10.0 + device.max_delay_ns as f64 * 1e-4, "{} ppm off", error_ppm);
    }

    #[test]
    fn wrapping_counter_gives_same_times_as_unwrapped_one(device in device(), period_ns in 20 * MS as u64..2 * S as u64) {
        let wrapping = Device { period_ns: Some(period_ns), ..device.clone() };
        let [mut unwrapped, mut wrapped] = [ClockFit::new(), ClockFit::new()];
        let times = |samples: Vec<Sample>| samples.into_iter().map(|sample| sample.t_ns).collect::<Vec<_>>();
        prop_assert_eq!(times(device.run(&mut unwrapped)), times(wrapping.run(&mut wrapped)));
        let last = device.lost.iter().rposition(|lost| !lost).unwrap_or(0) as u64 * device.interval_ns as u64;
        let first = device.lost.iter().position(|lost| !lost).unwrap_or(0) as u64 * device.interval_ns as u64;
        let wraps = (device.start_ns + last) / period_ns - (device.start_ns + first) / period_ns;
        prop_assert_eq!(wrapped.health().wraps, wraps);
        prop_assert_eq!([wrapped.health().resets, wrapped.health().backsteps], [0; 2]);
    }

    #[test]
    fn times_increase_for_arbitrary_input(
        stamps in proptest::collection::vec((any::<u64>(), proptest::option::of(any::<u64>()), any::<bool>(), any::<i64>()), 1..200)
    ) {
        let (mut fit, mut last) = (ClockFit::new(), None);
        for (count_ns, period_ns, has_stamp, arrival_ns) in stamps {
            let arrival_ns = arrival_ns >> 2;
            let t_ns = fit.push(has_stamp.then_some(Stamp { count_ns, period_ns }), arrival_ns);
            prop_assert!(last.is_none_or(|last| t_ns > last), "{t_ns} after {last:?}");
            prop_assert!(fit.health().jitter_ns.is_finite() && fit.health().drift_ppm.is_finite());
            last = Some(t_ns);
        }
    }
}

/// Runs a fit for 4 s at 100 Hz without delay and with `count` as the device's clock.
fn times_of_counter(count: impl Fn(i64) -> i64) -> (Vec<(i64, i64)>, ClockHealth) {
    let mut fit = ClockFit::new();
    let times = (0..400).map(|i| 10 * MS * i).map(|t_ns| {
        let stamp = Stamp { count_ns: count(t_ns) as u64, period_ns: None };
        (t_ns + S, fit.push(Some(stamp), t_ns + S))
    });
    (times.collect(), fit.health())
}

#[test]
fn device_restart_is_followed_and_counted() {
    let (times, health) = times_of_counter(|t_ns| if t_ns < 2 * S { 7_000 * S + t_ns } else { t_ns - 2 * S });
    assert!(times.iter().all(|(true_ns, t_ns)| (true_ns - t_ns).abs() < MS), "{times:?}");
    assert_eq!((health.resets, health.backsteps), (1, 0));
}

#[test]
fn small_backstep_is_followed_and_counted() {
    let (times, health) = times_of_counter(|t_ns| 100 * S + if t_ns < 2 * S { t_ns } else { t_ns - 50 * MS });
    for pair in times.windows(2) {
        assert!(pair[1].1 > pair[0].1);
    }
    let (true_ns, t_ns) = times[times.len() - 1];
    assert!((true_ns - t_ns).abs() < 2 * MS, "{}", true_ns - t_ns);
    assert_eq!((health.resets, health.backsteps), (0, 1));
}

#[test]
fn repeated_stamp_is_counted_without_lasting_error() {
    let (times, health) = times_of_counter(|t_ns| t_ns / (20 * MS) * 20 * MS);
    assert_eq!(health.backsteps, 200);
    let (true_ns, t_ns) = times[times.len() - 1];
    assert!((true_ns - t_ns).abs() < 21 * MS, "{}", true_ns - t_ns);
}

#[test]
fn samples_without_stamps_get_arrival_time() {
    let mut fit = ClockFit::new();
    let times = [5, 9, 9, 20].map(|arrival_ns| fit.push(None, arrival_ns));
    assert_eq!((times, fit.health()), ([5, 9, 10, 20], ClockHealth::default()));
}

#[test]
fn reported_offset_is_clock_difference() {
    let (_, health) = times_of_counter(|t_ns| 100 * S + t_ns);
    assert!((health.offset_ns + 99 * S).abs() < 2, "{}", health.offset_ns);
}

/// Feeds samples without stamps at 120 Hz, read eight at a time, from a device declared as 100 Hz.
fn unstamped(fit: &mut ClockFit, from: i64, count: i64) -> Vec<(i64, i64)> {
    const TRUE_NS: i64 = S / 120;
    let read_ns = |i: i64| (i / 8 + 1) * 8 * TRUE_NS;
    (from..from + count).map(|i| (i * TRUE_NS, fit.push(None, read_ns(i)))).collect()
}

#[test]
fn unstamped_batches_are_spread_at_estimated_rate() {
    assert_is_spread(ClockFit::with_rate(100.0), 1e6 / 6.0);
}

#[test]
fn unknown_rate_is_measured_from_the_first_arrivals() {
    assert_is_spread(ClockFit::new(), 0.0);
}

/// Asserts that batches of samples without stamps are spread evenly in time, and that the measured
/// clock drift is the opposite of `drift_ppm`.
fn assert_is_spread(mut fit: ClockFit, drift_ppm: f64) {
    let times = unstamped(&mut fit, 0, 120 * 20);
    let settled = &times[120 * 10..];
    for pair in settled.windows(2) {
        let interval_ms = (pair[1].1 - pair[0].1) as f64 * 1e-6;
        assert!((interval_ms - 1000.0 / 120.0).abs() < 0.9, "{interval_ms} ms");
    }
    let worst = settled.iter().map(|(true_ns, t_ns)| (t_ns - true_ns).abs()).max();
    assert!(worst < Some(8 * S / 120), "{worst:?} ns late");
    let limit_ppm = if drift_ppm > 0.0 { 2000.0 } else { 40_000.0 };
    assert!((fit.health().drift_ppm + drift_ppm).abs() < limit_ppm, "{} ppm", fit.health().drift_ppm);
}

#[test]
fn times_restart_at_arrival_after_gap() {
    let mut fit = ClockFit::with_rate(120.0);
    let before = unstamped(&mut fit, 0, 120 * 3);
    fit.mark_gap();
    let after = unstamped(&mut fit, 120 * 3 + 60, 16);
    assert!(after[0].1 - before[before.len() - 1].1 > 400 * MS, "half a second is missing");
    assert!(after.windows(2).all(|pair| pair[1].1 > pair[0].1));
}
