//! From a device's clock to the host's: times that grow with every sample and keep the device's intervals.
//!
//! Input: what a device says of when it measured (a counter that wraps, time since boot, UNIX time), or how many samples there were of one that
//! says nothing but has a rate; and when the host had it. Output: the time
//! of the measurement on the host's clock, later than the one before by a tenth less to a tenth more than the device's clock says. Time: that
//! of the caller. Failure: a device that begins again, leaps or steps back is followed and counted.
//!
//! The host's times are the device's plus a line fitted to the newest points, (device, host), by least squares; arrival is late by a delay that
//! changes from sample to sample, so the time of the result is late by the mean delay, and even. While the points span less than
//! [`SLOPE_SPAN_NS`] the line has slope 1.

use std::collections::VecDeque;

/// Points that the line is fitted to, at most.
const POINTS_MAX: usize = 512;
/// From one point to the next at least, so that they span some seconds at any rate, ns.
const POINT_INTERVAL_NS: i64 = 10_000_000;
/// What the points must span before the line's slope is believed, ns.
pub const SLOPE_SPAN_NS: i64 = 2_000_000_000;
/// No oscillator is worse, relative.
const DRIFT_MAX: f64 = 0.02;
/// The same of a rate, which is nominal.
const RATE_DRIFT_MAX: f64 = 0.5;
/// The two clocks disagree by more about one interval, or the result is farther from the line: the device's clock was set, ns.
const LEAP_NS: i64 = 1_000_000_000;
/// Of an interval, by how much its end is moved towards the line at most.
const STEERING_MAX: f64 = 0.1;

/// A time as a device tells it, ns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stamp {
    /// The device's count.
    pub count_ns: u64,
    /// After which the count begins again at 0; none where it does not.
    pub period_ns: Option<u64>,
}

/// What is known of a device's clock.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ClockHealth {
    /// The host's clock less the device's, ns; 0 before the first stamp.
    pub offset_ns: i64,
    /// How much faster the host's clock runs, parts per million.
    pub drift_ppm: f64,
    /// Standard deviation of the arrivals about the line, ns.
    pub jitter_ns: f64,
    /// Times the count began again at its period.
    pub wraps: u64,
    /// Stamps that were not later than the one before.
    pub backsteps: u64,
    /// Times the device began again or its clock was set.
    pub resets: u64,
}

/// Turns the stamps of one device into times of the host.
#[derive(Debug, Clone, Default)]
pub struct ClockFit {
    /// Of samples without a stamp, where there is a rate.
    interval_ns: Option<u64>,
    /// Samples without a stamp.
    count: u64,
    points: VecDeque<Point>,
    last: Option<Last>,
    /// Of the last sample, ns on the host's clock.
    t_ns: Option<i64>,
    health: ClockHealth,
}

/// A sample: when, on the device's clock without wraps, and when the host had it.
#[derive(Debug, Clone, Copy)]
struct Point {
    device_ns: i64,
    arrival_ns: i64,
}

#[derive(Debug, Clone, Copy)]
struct Last {
    stamp: Option<Stamp>,
    is_counted: bool,
    point: Point,
}

/// `arrival = mean_arrival + slope (device − mean_device)`.
#[derive(Debug, Clone, Copy)]
struct Line {
    mean_device_ns: f64,
    mean_arrival_ns: f64,
    slope: f64,
    /// The point that both means are counted from: whole numbers, so that no digit is lost.
    origin: Point,
}

impl ClockFit {
    /// Of a device that has said nothing yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Of a device that measures `rate_hz` times a second: of samples without a stamp the count is taken for a clock. The true rate may be
    /// half to one and a half of it.
    pub fn with_rate(rate_hz: f64) -> Self {
        Self { interval_ns: Some((1e9 / rate_hz) as u64).filter(|interval_ns| *interval_ns > 0), ..Self::default() }
    }

    /// The time of a sample, ns on the host's clock, later than every one before. Without a stamp and a rate it is that of its arrival.
    pub fn push(&mut self, stamp: Option<Stamp>, arrival_ns: i64) -> i64 {
        let is_counted = stamp.is_none() && self.interval_ns.is_some();
        let stamp = stamp.or_else(|| self.counted());
        let soonest_ns = self.t_ns.map_or(i64::MIN, |t_ns| t_ns.saturating_add(1));
        let last = self.last.filter(|last| last.is_counted == is_counted);
        let (Some(now), Some(Last { stamp: Some(before), point: last, .. }), Some(last_ns)) = (stamp, last, self.t_ns)
        else {
            return self.begin(stamp, is_counted, arrival_ns, arrival_ns.max(soonest_ns));
        };
        let host_ns = arrival_ns.saturating_sub(last.arrival_ns);
        let (elapsed_ns, wraps) = elapsed(before, now, host_ns);
        if elapsed_ns.abs_diff(host_ns) > LEAP_NS.unsigned_abs() {
            self.health.resets += 1;
            return self.begin(stamp, is_counted, arrival_ns, arrival_ns.max(soonest_ns));
        }
        if elapsed_ns <= 0 {
            self.health.backsteps += 1;
            if elapsed_ns < 0 {
                return self.begin(stamp, is_counted, arrival_ns, soonest_ns);
            }
            self.t_ns = Some(soonest_ns);
            return soonest_ns;
        }
        self.health.wraps += wraps;
        let point = Point { device_ns: last.device_ns.saturating_add(elapsed_ns), arrival_ns };
        self.add(point);
        let line = self.fit(point, if is_counted { RATE_DRIFT_MAX } else { DRIFT_MAX });
        let expected_ns = last_ns.saturating_add((elapsed_ns as f64 * line.slope) as i64);
        let behind_ns = line.at(point.device_ns).saturating_sub(expected_ns);
        if behind_ns.unsigned_abs() > LEAP_NS.unsigned_abs() {
            self.health.resets += 1;
            return self.begin(stamp, is_counted, arrival_ns, arrival_ns.max(soonest_ns));
        }
        let most_ns = (elapsed_ns as f64 * STEERING_MAX) as i64;
        let t_ns = expected_ns.saturating_add(behind_ns.clamp(-most_ns, most_ns)).max(soonest_ns);
        self.note(Last { stamp, is_counted, point }, t_ns)
    }

    /// Samples may be missing before the next one: the line begins anew with it.
    pub fn interrupt(&mut self) {
        self.last = None;
    }

    /// What is known of the device's clock.
    pub fn health(&self) -> ClockHealth {
        self.health
    }

    /// The line begins anew with a sample, which has the time `t_ns`.
    fn begin(&mut self, stamp: Option<Stamp>, is_counted: bool, arrival_ns: i64, t_ns: i64) -> i64 {
        let device_ns = stamp.map_or(arrival_ns, |stamp| stamp.count_ns.cast_signed());
        let point = Point { device_ns, arrival_ns };
        self.points.clear();
        self.points.push_back(point);
        (self.health.drift_ppm, self.health.jitter_ns) = (0.0, 0.0);
        self.health.offset_ns = if stamp.is_some() { arrival_ns.wrapping_sub(device_ns) } else { 0 };
        self.note(Last { stamp, is_counted, point }, t_ns)
    }

    /// The count of samples without a stamp as one.
    fn counted(&mut self) -> Option<Stamp> {
        self.count += 1;
        self.interval_ns.map(|interval_ns| Stamp { count_ns: self.count.wrapping_mul(interval_ns), period_ns: None })
    }

    fn note(&mut self, last: Last, t_ns: i64) -> i64 {
        (self.last, self.t_ns) = (Some(last), Some(t_ns));
        t_ns
    }

    fn add(&mut self, point: Point) {
        let is_due = |newest: &Point| point.device_ns.saturating_sub(newest.device_ns) >= POINT_INTERVAL_NS;
        if self.points.back().is_none_or(is_due) {
            self.points.push_back(point);
        }
        if self.points.len() > POINTS_MAX {
            self.points.pop_front();
        }
    }

    /// The line through the points, and what it says of the clock at `now`.
    fn fit(&mut self, now: Point, drift_max: f64) -> Line {
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
        let spans = self.points.back().map_or(0, |newest| newest.device_ns.saturating_sub(origin.device_ns));
        let slope = if spans < SLOPE_SPAN_NS { 1.0 } else { (xy / xx).clamp(1.0 - drift_max, 1.0 + drift_max) };
        let line = Line { mean_device_ns, mean_arrival_ns, slope, origin };
        let rest = yy - 2.0 * slope * xy + slope * slope * xx;
        self.health.jitter_ns = (rest.max(0.0) / count).sqrt();
        self.health.drift_ppm = (slope - 1.0) * 1e6;
        self.health.offset_ns = line.at(now.device_ns).wrapping_sub(now.device_ns);
        line
    }
}

impl Line {
    /// The host's time of a time of the device.
    fn at(&self, device_ns: i64) -> i64 {
        let device_ns = device_ns.saturating_sub(self.origin.device_ns) as f64;
        let arrival_ns = self.mean_arrival_ns + self.slope * (device_ns - self.mean_device_ns);
        self.origin.arrival_ns.saturating_add(arrival_ns as i64)
    }
}

/// The device's time from one stamp to the next, and how often its count has begun again meanwhile: as often as fits the host's time best.
fn elapsed(before: Stamp, now: Stamp, host_ns: i64) -> (i64, u64) {
    let difference_ns = i128::from(now.count_ns) - i128::from(before.count_ns);
    let limited = |ns: i128| ns.clamp(i128::from(i64::MIN), i128::from(i64::MAX)) as i64;
    let Some(period_ns) = now.period_ns.filter(|period_ns| *period_ns > 0).map(i128::from) else {
        return (limited(difference_ns), 0);
    };
    let missing_ns = i128::from(host_ns) - difference_ns;
    let periods = (missing_ns + period_ns / 2).div_euclid(period_ns);
    (limited(difference_ns + periods * period_ns), u64::try_from(periods).unwrap_or(0))
}
