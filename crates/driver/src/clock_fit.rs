//! Conversion of a device's timestamps to the host's clock. The results increase strictly and keep
//! the device's intervals.
//!
//! Input: the arrival time of each sample on the host, and its timestamp on the device's clock (a
//! wrapping counter, time since boot, or UNIX time). If a device has a known rate but no
//! timestamps, its samples are counted instead.
//!
//! Output: the time of the measurement on the host's clock. The interval between two results
//! differs from the device's interval by at most a tenth.
//!
//! Time: supplied by the caller.
//!
//! Failure: the conversion adapts to device restarts and to jumps and backward steps of the
//! device's clock, and counts them.
//!
//! The host's time is modelled as a linear function of the device's time, fitted by least squares
//! to the newest points (device, host). Samples arrive with a varying delay, so the result is late
//! by the mean delay but free of jitter. While the points span less than [`MIN_SLOPE_SPAN_NS`], the
//! slope of the line is 1.

use std::collections::VecDeque;

/// Maximum number of points that the line is fitted to.
const MAX_POINTS: usize = 512;
/// Minimum interval between two points, ns. It ensures that the points span several seconds at any
/// rate.
const MIN_POINT_INTERVAL_NS: i64 = 10_000_000;
/// Minimum span of the points for the slope to be estimated, ns.
pub const MIN_SLOPE_SPAN_NS: i64 = 2_000_000_000;
/// Maximum relative clock drift. No oscillator is worse.
const MAX_CLOCK_DRIFT: f64 = 0.02;
/// Maximum relative deviation of a sample rate from its nominal value.
const MAX_RATE_DRIFT: f64 = 0.5;
/// Discrepancy above which the device's clock counts as reset, ns. It is the difference between the
/// lengths of an interval on the two clocks, or between a result and the fitted line. If the
/// samples pause for longer than this, the measurement of the sample interval restarts.
const RESET_THRESHOLD_NS: i64 = 1_000_000_000;
/// Number of intervals from which the rate of a device without timestamps is measured.
const MIN_MEASURED_SAMPLES: u64 = 20;
/// Span of the samples from which the rate is measured, ns.
const MIN_MEASURED_SPAN_NS: i64 = 2_000_000_000;
/// Maximum correction of an interval towards the line, as a fraction of the interval.
const MAX_CORRECTION: f64 = 0.1;

/// Timestamp on a device's clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stamp {
    /// Reading of the device's clock, ns.
    pub count_ns: u64,
    /// Period after which the count wraps to 0, ns. `None` if it does not wrap.
    pub period_ns: Option<u64>,
}

/// Estimated state of a device's clock.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ClockHealth {
    /// Host clock minus device clock, ns. 0 before the first timestamp.
    pub offset_ns: i64,
    /// Rate of the host's clock relative to the device's, minus 1, parts per million.
    pub drift_ppm: f64,
    /// Standard deviation of the arrival times about the line, ns.
    pub jitter_ns: f64,
    /// Number of times the count wrapped.
    pub wraps: u64,
    /// Number of timestamps that were not later than their predecessor.
    pub backsteps: u64,
    /// Number of times the device restarted or its clock was set.
    pub resets: u64,
}

/// Converter of the timestamps of one device to the host's clock.
#[derive(Debug, Clone, Default)]
pub struct ClockFit {
    /// Sample interval for devices without timestamps, nominal or measured.
    interval_ns: Option<u64>,
    /// Arrival time of the first sample in the measurement of the interval, ns.
    measured_from_ns: Option<i64>,
    /// Number of samples without a timestamp.
    count: u64,
    points: VecDeque<Point>,
    last: Option<LastSample>,
    /// Time assigned to the last sample, on the host's clock.
    t_ns: Option<i64>,
    health: ClockHealth,
}

/// Unwrapped device time and host arrival time of a sample.
#[derive(Debug, Clone, Copy)]
struct Point {
    device_ns: i64,
    arrival_ns: i64,
}

#[derive(Debug, Clone, Copy)]
struct LastSample {
    stamp: Option<Stamp>,
    is_counted: bool,
    point: Point,
}

/// Fitted line: `arrival = mean_arrival + slope · (device − mean_device)`.
#[derive(Debug, Clone, Copy)]
struct Line {
    mean_device_ns: f64,
    mean_arrival_ns: f64,
    slope: f64,
    /// Point that both means are relative to, so that large times lose no precision.
    origin: Point,
}

impl ClockFit {
    /// Creates a fit for a device with timestamps, or for one without timestamps and with an
    /// unknown rate.
    ///
    /// If the samples have no timestamps, the rate is measured from the first samples, and then
    /// their count serves as the device's clock.
    pub fn new() -> Self {
        Self::default()
    }

    /// Creates a fit for a device that sends samples, possibly without timestamps, at about
    /// `rate_hz`.
    ///
    /// If the samples have no timestamps, their count serves as the device's clock. The true rate
    /// may be 0.5 to 1.5 times `rate_hz`.
    pub fn with_rate(rate_hz: f64) -> Self {
        Self { interval_ns: Some((1e9 / rate_hz) as u64).filter(|interval_ns| *interval_ns > 0), ..Self::default() }
    }

    /// Returns the time of a sample on the host's clock, ns. It is always later than the time of
    /// the previous sample.
    ///
    /// If there is neither a timestamp nor a rate yet, the result is the arrival time.
    pub fn push(&mut self, stamp: Option<Stamp>, arrival_ns: i64) -> i64 {
        let is_counted = stamp.is_none() && self.interval_ns.is_some();
        if stamp.is_none() && !is_counted {
            self.measure_interval(arrival_ns);
        }
        let stamp = stamp.or_else(|| self.next_count_stamp());
        let earliest_ns = self.t_ns.map_or(i64::MIN, |t_ns| t_ns.saturating_add(1));
        let last = self.last.filter(|last| last.is_counted == is_counted);
        let (Some(now), Some(LastSample { stamp: Some(previous), point: last, .. }), Some(last_ns)) =
            (stamp, last, self.t_ns)
        else {
            return self.restart(stamp, is_counted, arrival_ns, arrival_ns.max(earliest_ns));
        };
        let host_ns = arrival_ns.saturating_sub(last.arrival_ns);
        let (elapsed_ns, wraps) = elapsed(previous, now, host_ns);
        if elapsed_ns.abs_diff(host_ns) > RESET_THRESHOLD_NS.unsigned_abs() {
            self.health.resets += 1;
            return self.restart(stamp, is_counted, arrival_ns, arrival_ns.max(earliest_ns));
        }
        if elapsed_ns <= 0 {
            self.health.backsteps += 1;
            if elapsed_ns < 0 {
                return self.restart(stamp, is_counted, arrival_ns, earliest_ns);
            }
            self.t_ns = Some(earliest_ns);
            return earliest_ns;
        }
        self.health.wraps += wraps;
        let point = Point { device_ns: last.device_ns.saturating_add(elapsed_ns), arrival_ns };
        self.add(point);
        let line = self.fit(point, if is_counted { MAX_RATE_DRIFT } else { MAX_CLOCK_DRIFT });
        let expected_ns = last_ns.saturating_add((elapsed_ns as f64 * line.slope) as i64);
        let correction_ns = line.host_time_ns(point.device_ns).saturating_sub(expected_ns);
        if correction_ns.unsigned_abs() > RESET_THRESHOLD_NS.unsigned_abs() {
            self.health.resets += 1;
            return self.restart(stamp, is_counted, arrival_ns, arrival_ns.max(earliest_ns));
        }
        let max_correction_ns = (elapsed_ns as f64 * MAX_CORRECTION) as i64;
        let t_ns =
            expected_ns.saturating_add(correction_ns.clamp(-max_correction_ns, max_correction_ns)).max(earliest_ns);
        self.record(LastSample { stamp, is_counted, point }, t_ns)
    }

    /// Restarts the fit at the next sample, because samples may have been lost before it.
    pub fn mark_gap(&mut self) {
        self.last = None;
    }

    /// Returns the estimated state of the device's clock.
    pub fn health(&self) -> ClockHealth {
        self.health
    }

    /// Measures the sample interval from the arrivals of the first samples.
    fn measure_interval(&mut self, arrival_ns: i64) {
        let has_paused = |last_ns: i64| arrival_ns.saturating_sub(last_ns) > RESET_THRESHOLD_NS;
        if self.last.is_none() || self.t_ns.is_some_and(has_paused) {
            (self.measured_from_ns, self.count) = (None, 0);
        }
        let span_ns = arrival_ns.saturating_sub(*self.measured_from_ns.get_or_insert(arrival_ns));
        if self.count >= MIN_MEASURED_SAMPLES && span_ns >= MIN_MEASURED_SPAN_NS {
            self.interval_ns = u64::try_from(span_ns).ok().map(|span_ns| span_ns / self.count);
        }
    }

    /// Restarts the fit at a sample and assigns the time `t_ns` to this sample.
    fn restart(&mut self, stamp: Option<Stamp>, is_counted: bool, arrival_ns: i64, t_ns: i64) -> i64 {
        let device_ns = stamp.map_or(arrival_ns, |stamp| stamp.count_ns.cast_signed());
        let point = Point { device_ns, arrival_ns };
        self.points.clear();
        self.points.push_back(point);
        (self.health.drift_ppm, self.health.jitter_ns) = (0.0, 0.0);
        self.health.offset_ns = if stamp.is_some() { arrival_ns.wrapping_sub(device_ns) } else { 0 };
        self.record(LastSample { stamp, is_counted, point }, t_ns)
    }

    /// Returns a timestamp derived from the number of samples.
    fn next_count_stamp(&mut self) -> Option<Stamp> {
        self.count += 1;
        self.interval_ns.map(|interval_ns| Stamp { count_ns: self.count.wrapping_mul(interval_ns), period_ns: None })
    }

    fn record(&mut self, last: LastSample, t_ns: i64) -> i64 {
        (self.last, self.t_ns) = (Some(last), Some(t_ns));
        t_ns
    }

    fn add(&mut self, point: Point) {
        let is_due = |newest: &Point| point.device_ns.saturating_sub(newest.device_ns) >= MIN_POINT_INTERVAL_NS;
        if self.points.back().is_none_or(is_due) {
            self.points.push_back(point);
        }
        if self.points.len() > MAX_POINTS {
            self.points.pop_front();
        }
    }

    /// Fits the line to the points and updates the clock state at `now`.
    fn fit(&mut self, now: Point, max_drift: f64) -> Line {
        let origin = self.points.front().copied().unwrap_or(now);
        let relative = |point: &Point| {
            let device_ns = point.device_ns.saturating_sub(origin.device_ns) as f64;
            (device_ns, point.arrival_ns.saturating_sub(origin.arrival_ns) as f64)
        };
        let count = self.points.len().max(1) as f64;
        let sums = self.points.iter().map(relative).fold((0.0, 0.0), |sum, (x, y)| (sum.0 + x, sum.1 + y));
        let (mean_device_ns, mean_arrival_ns) = (sums.0 / count, sums.1 / count);
        let [mut xx, mut xy, mut yy] = [0.0; 3];
        for (x, y) in self.points.iter().map(relative) {
            let (x, y) = (x - mean_device_ns, y - mean_arrival_ns);
            (xx, xy, yy) = (xx + x * x, xy + x * y, yy + y * y);
        }
        let span_ns = self.points.back().map_or(0, |newest| newest.device_ns.saturating_sub(origin.device_ns));
        let slope = if span_ns < MIN_SLOPE_SPAN_NS { 1.0 } else { (xy / xx).clamp(1.0 - max_drift, 1.0 + max_drift) };
        let line = Line { mean_device_ns, mean_arrival_ns, slope, origin };
        let residual = yy - 2.0 * slope * xy + slope * slope * xx;
        self.health.jitter_ns = (residual.max(0.0) / count).sqrt();
        self.health.drift_ppm = (slope - 1.0) * 1e6;
        self.health.offset_ns = line.host_time_ns(now.device_ns).wrapping_sub(now.device_ns);
        line
    }
}

impl Line {
    /// Converts a device time to host time with the fitted line. Both times are in ns.
    fn host_time_ns(&self, device_ns: i64) -> i64 {
        let device_ns = device_ns.saturating_sub(self.origin.device_ns) as f64;
        let arrival_ns = self.mean_arrival_ns + self.slope * (device_ns - self.mean_device_ns);
        self.origin.arrival_ns.saturating_add(arrival_ns as i64)
    }
}

/// Returns the device time between two stamps, and the number of wraps between them. The number of
/// wraps is chosen so that the device time best fits the host's interval.
fn elapsed(previous: Stamp, now: Stamp, host_ns: i64) -> (i64, u64) {
    let difference_ns = i128::from(now.count_ns) - i128::from(previous.count_ns);
    let saturated = |ns: i128| ns.clamp(i128::from(i64::MIN), i128::from(i64::MAX)) as i64;
    let Some(period_ns) = now.period_ns.filter(|period_ns| *period_ns > 0).map(i128::from) else {
        return (saturated(difference_ns), 0);
    };
    let missing_ns = i128::from(host_ns) - difference_ns;
    let periods = (missing_ns + period_ns / 2).div_euclid(period_ns);
    (saturated(difference_ns + periods * period_ns), u64::try_from(periods).unwrap_or(0))
}
