//! Whatever a device's clock and the way to the host do: the times grow, keep the device's intervals, and are those of the host.
use driver::clock_fit::{ClockFit, ClockHealth, Stamp};
use proptest::prelude::*;

const MS: i64 = 1_000_000;
const S: i64 = 1_000_000_000;

/// A device that measures each `interval_ns` of its own time, and whose samples reach the host after a delay.
#[derive(Debug, Clone)]
struct Device {
    interval_ns: i64,
    /// How much slower its clock is than the host's, relative.
    drift: f64,
    begins_ns: u64,
    period_ns: Option<u64>,
    /// Of each sample, from 0 to 1: the delay, as a part of the largest.
    delays: Vec<f64>,
    delay_max_ns: i64,
    /// Samples that do not arrive.
    lost: Vec<bool>,
}

/// What became of a sample.
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
            // What is sent on one line arrives in order.
            arrived_ns = arrived_ns.max(true_ns + (delay * self.delay_max_ns as f64) as i64);
            if self.lost[i] {
                continue;
            }
            let count_ns = self.begins_ns + device_ns as u64;
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
        |(interval_ns, drift, begins_ns, delay_max_ns, delays)| {
            let (delays, lost) = delays.into_iter().unzip();
            Device { interval_ns, drift, begins_ns, period_ns: None, delays, delay_max_ns, lost }
        },
    )
}

fn assert_even(samples: &[Sample]) {
    for pair in samples.windows(2) {
        let (device_ns, host_ns) = (pair[1].device_ns - pair[0].device_ns, pair[1].t_ns - pair[0].t_ns);
        let off = (host_ns - device_ns).abs() as f64 / device_ns as f64;
        assert!(host_ns > 0 && off < 0.125, "an interval of {device_ns} ns is {host_ns} ns");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn jitter_drift_and_loss_leave_the_intervals_even_and_the_time_late_by_less_than_the_longest_delay(device in device()) {
        let mut fit = ClockFit::new();
        let samples = device.run(&mut fit);
        assert_even(&samples);
        let half = &samples[samples.len() / 2..];
        for sample in half {
            let late_ns = sample.t_ns - sample.true_ns;
            prop_assert!((-MS..device.delay_max_ns + MS).contains(&late_ns), "{late_ns} ns late");
        }
        // The mean of the delay is not known to the host; how even it is in time is what counts.
        let lates = half.iter().map(|sample| sample.t_ns - sample.true_ns);
        let spread_ns = lates.clone().max().unwrap() - lates.min().unwrap();
        prop_assert!(spread_ns < device.delay_max_ns / 4 + MS / 10, "{spread_ns} of {}", device.delay_max_ns);
        let ClockHealth { drift_ppm, jitter_ns, wraps, backsteps, resets, .. } = fit.health();
        prop_assert_eq!([wraps, backsteps, resets], [0; 3]);
        prop_assert!(jitter_ns <= device.delay_max_ns as f64, "{}", jitter_ns);
        let off_ppm = drift_ppm - device.drift * 1e6;
        prop_assert!(off_ppm.abs() < 10.0 + device.delay_max_ns as f64 * 1e-4, "{} ppm off", off_ppm);
    }

    #[test]
    fn a_counter_that_wraps_gives_the_times_of_one_that_does_not(device in device(), period_ns in 20 * MS as u64..2 * S as u64) {
        let wrapping = Device { period_ns: Some(period_ns), ..device.clone() };
        let [mut whole, mut wrapped] = [ClockFit::new(), ClockFit::new()];
        let times = |samples: Vec<Sample>| samples.into_iter().map(|sample| sample.t_ns).collect::<Vec<_>>();
        prop_assert_eq!(times(device.run(&mut whole)), times(wrapping.run(&mut wrapped)));
        let last = device.lost.iter().rposition(|lost| !lost).unwrap_or(0) as u64 * device.interval_ns as u64;
        let first = device.lost.iter().position(|lost| !lost).unwrap_or(0) as u64 * device.interval_ns as u64;
        let wraps = (device.begins_ns + last) / period_ns - (device.begins_ns + first) / period_ns;
        prop_assert_eq!(wrapped.health().wraps, wraps);
        prop_assert_eq!([wrapped.health().resets, wrapped.health().backsteps], [0; 2]);
    }

    #[test]
    fn whatever_comes_the_times_grow(
        stamps in proptest::collection::vec((any::<u64>(), proptest::option::of(any::<u64>()), any::<bool>(), any::<i64>()), 1..200)
    ) {
        let (mut fit, mut last) = (ClockFit::new(), None);
        for (count_ns, period_ns, is_told, arrival_ns) in stamps {
            let arrival_ns = arrival_ns >> 2;
            let t_ns = fit.push(is_told.then_some(Stamp { count_ns, period_ns }), arrival_ns);
            prop_assert!(last.is_none_or(|last| t_ns > last), "{t_ns} after {last:?}");
            prop_assert!(fit.health().jitter_ns.is_finite() && fit.health().drift_ppm.is_finite());
            last = Some(t_ns);
        }
    }
}

/// 4 s at 100 Hz that arrive at once, with the device's count as `count` has it of the time.
fn counted(count: impl Fn(i64) -> i64) -> (Vec<(i64, i64)>, ClockHealth) {
    let mut fit = ClockFit::new();
    let times = (0..400).map(|i| 10 * MS * i).map(|t_ns| {
        let stamp = Stamp { count_ns: count(t_ns) as u64, period_ns: None };
        (t_ns + S, fit.push(Some(stamp), t_ns + S))
    });
    (times.collect(), fit.health())
}

#[test]
fn a_device_that_begins_again_is_followed_at_once_and_counted() {
    let (times, health) = counted(|t_ns| if t_ns < 2 * S { 7_000 * S + t_ns } else { t_ns - 2 * S });
    assert!(times.iter().all(|(true_ns, t_ns)| (true_ns - t_ns).abs() < MS), "{times:?}");
    assert_eq!((health.resets, health.backsteps), (1, 0));
}

#[test]
fn a_clock_that_steps_back_a_little_is_followed_and_counted_and_no_interval_is_lost() {
    let (times, health) = counted(|t_ns| 100 * S + if t_ns < 2 * S { t_ns } else { t_ns - 50 * MS });
    for pair in times.windows(2) {
        assert!(pair[1].1 > pair[0].1);
    }
    let (true_ns, t_ns) = times[times.len() - 1];
    assert!((true_ns - t_ns).abs() < 2 * MS, "{}", true_ns - t_ns);
    assert_eq!((health.resets, health.backsteps), (0, 1));
}

#[test]
fn a_stamp_that_is_repeated_is_counted_and_the_next_is_where_it_belongs() {
    let (times, health) = counted(|t_ns| t_ns / (20 * MS) * 20 * MS);
    assert_eq!(health.backsteps, 200);
    let (true_ns, t_ns) = times[times.len() - 1];
    assert!((true_ns - t_ns).abs() < 21 * MS, "{}", true_ns - t_ns);
}

#[test]
fn without_stamps_the_time_is_that_of_arrival() {
    let mut fit = ClockFit::new();
    let times = [5, 9, 9, 20].map(|arrival_ns| fit.push(None, arrival_ns));
    assert_eq!((times, fit.health()), ([5, 9, 10, 20], ClockHealth::default()));
}

#[test]
fn the_offset_is_that_of_the_clocks() {
    let (_, health) = counted(|t_ns| 100 * S + t_ns);
    assert!((health.offset_ns + 99 * S).abs() < 2, "{}", health.offset_ns);
}

/// Samples without a stamp at 120 Hz of a device that was said to have 100, read eight at a time.
fn unstamped(fit: &mut ClockFit, from: i64, count: i64) -> Vec<(i64, i64)> {
    const TRUE_NS: i64 = S / 120;
    let read_ns = |i: i64| (i / 8 + 1) * 8 * TRUE_NS;
    (from..from + count).map(|i| (i * TRUE_NS, fit.push(None, read_ns(i)))).collect()
}

#[test]
fn samples_without_a_stamp_that_come_together_are_spread_evenly_at_the_rate_that_is_found() {
    let mut fit = ClockFit::with_rate(100.0);
    let times = unstamped(&mut fit, 0, 120 * 20);
    let settled = &times[120 * 10..];
    for pair in settled.windows(2) {
        let interval_ms = (pair[1].1 - pair[0].1) as f64 * 1e-6;
        assert!((interval_ms - 1000.0 / 120.0).abs() < 0.9, "{interval_ms} ms");
    }
    let worst = settled.iter().map(|(true_ns, t_ns)| (t_ns - true_ns).abs()).max();
    assert!(worst < Some(8 * S / 120), "{worst:?} ns late");
    assert!((fit.health().drift_ppm + 1e6 / 6.0).abs() < 2000.0, "{} ppm", fit.health().drift_ppm);
}

#[test]
fn after_an_interruption_the_time_is_that_of_arrival_again() {
    let mut fit = ClockFit::with_rate(120.0);
    let before = unstamped(&mut fit, 0, 120 * 3);
    fit.interrupt();
    let after = unstamped(&mut fit, 120 * 3 + 60, 16);
    assert!(after[0].1 - before[before.len() - 1].1 > 400 * MS, "half a second is missing");
    assert!(after.windows(2).all(|pair| pair[1].1 > pair[0].1));
}
