//! Parts of a recording in which the unit does not move.
//!
//! Readings are grouped into blocks of about one second. A block is in motion if its standard
//! deviation on an axis exceeds five times the 10th percentile of the standard deviations of all
//! blocks. It is also in motion if its mean differs from that of the previous block by more than
//! noise explains. The same applies if its mean differs from that of the first block of its rest so
//! much that the unit must have turned. The neighbours of a block in motion are not used. Vibration
//! that lasts as long as the recording counts as noise of the sensor.

use super::rows::{AXES, Axis, Row, seconds};

/// Duration of a block, s.
const BLOCK_S: f64 = 1.0;
/// Shortest interval between readings that ends a rest, s. A shorter gap is negligible compared
/// with the shortest τ of the fit, 1 s.
const MIN_GAP_S: f64 = 0.1;
/// Shortest interval between readings that ends a rest, in multiples of the median interval.
const MIN_GAP_INTERVALS: f64 = 5.0;
/// Minimum duration of a rest that is used, s.
pub(super) const MIN_REST_S: f64 = 10.0;
/// Maximum ratio of the 90th to the 10th percentile of the rate. Above it, the rate is not
/// constant.
const MAX_RATE_RATIO: f64 = 1.25;
/// Relative deviation from the median above which an interval is counted as irregular.
const IRREGULAR_SHARE: f64 = 0.5;

/// Multiple of the typical standard deviation of a block above which the block is in motion.
///
/// The typical value is the 10th percentile of the standard deviations of all blocks.
const QUIET_FACTOR: f64 = 5.0;
/// Maximum change of the mean between two successive blocks at rest.
///
/// The unit is the standard deviation of the changes of the mean.
const STEP_FACTOR: f64 = 10.0;
/// Median absolute value of a normally distributed number, in standard deviations.
const NORMAL_MEDIAN: f64 = 0.6745;
/// Maximum change of the mean that is attributed to noise.
///
/// The unit is the standard deviation of the mean of a block.
const NOISE_FACTOR: f64 = 12.0;

/// Limits of a sensor at rest, in the unit of the sensor.
struct Limits {
    /// Range to which the limit of the standard deviation is clamped.
    sd: (f64, f64),
    /// Range to which the limit of the change of the mean is clamped. An allowance for noise is
    /// added to the upper end.
    step: (f64, f64),
    /// Maximum difference between the mean of a block and that of the first block of its rest.
    turn: f64,
    /// Largest mean at rest that is attributed to a bias; infinite for the accelerometer.
    mean: f64,
}

/// Limits of the gyro, rad/s. If the mean rate differs from that at the start of the rest by more
/// than 0.02 rad/s, the unit turns.
const GYRO: Limits = Limits { sd: (2e-4, 0.06), step: (3e-4, 0.003), turn: 0.02, mean: 0.35 };
/// Limits of the accelerometer, m/s². A tilt of 2° changes the mean by 0.3 m/s².
const ACCEL: Limits = Limits { sd: (2e-3, 0.6), step: (3e-3, 0.05), turn: 0.3, mean: f64::INFINITY };

/// Part of the recording at rest.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Rest {
    /// Index of the first reading.
    pub(super) first: usize,
    /// Index after the last reading.
    pub(super) end: usize,
}

/// Motion, described by its first block that exceeds a limit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Motion {
    /// Start, s since the first reading.
    pub(super) start_s: f64,
    /// End, s since the first reading.
    pub(super) end_s: f64,
    pub(super) axis: Axis,
    pub(super) sign: MotionSign,
    /// Value that exceeds `limit`, in the unit of the sensor.
    pub(super) value: f64,
    pub(super) limit: f64,
}

/// Quantity by which a motion is detected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum MotionSign {
    Spread,
    Step,
    Turn,
    Mean,
}

/// Times of the readings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Timing {
    pub(super) median_s: f64,
    /// Number of intervals that deviate from the median by more than half of it.
    pub(super) irregular: usize,
    pub(super) intervals: usize,
    /// Number of gaps that end a rest.
    pub(super) gaps: usize,
    pub(super) longest_gap_s: f64,
    /// 10th and 90th percentile of the rate, Hz.
    pub(super) rates_hz: (f64, f64),
}

impl Timing {
    /// Evaluates the times of the readings. Returns `None` if there are fewer than two readings.
    pub(super) fn new(rows: &[Row]) -> Option<Self> {
        let intervals_s: Vec<f64> = rows.windows(2).map(|pair| seconds(&pair[0], &pair[1])).collect();
        let median_s = percentile(intervals_s.clone(), 50)?;
        let is_irregular = |interval_s: &&f64| (*interval_s - median_s).abs() > IRREGULAR_SHARE * median_s;
        let gap_s = min_gap_s(median_s);
        let count = block_count(median_s);
        let is_contiguous = |block: &&[Row]| block.windows(2).all(|pair| seconds(&pair[0], &pair[1]) < gap_s);
        let spans_s: Vec<f64> =
            rows.chunks_exact(count + 1).filter(is_contiguous).map(|block| seconds(&block[0], &block[count])).collect();
        let rate_hz = |percent| percentile(spans_s.clone(), percent).map_or(1.0 / median_s, |s| count as f64 / s);
        Some(Self {
            median_s,
            irregular: intervals_s.iter().filter(is_irregular).count(),
            intervals: intervals_s.len(),
            gaps: intervals_s.iter().filter(|interval_s| **interval_s >= gap_s).count(),
            longest_gap_s: intervals_s.iter().copied().fold(0.0, f64::max),
            rates_hz: (rate_hz(90), rate_hz(10)),
        })
    }

    pub(super) fn is_constant(&self) -> bool {
        self.rates_hz.1 <= MAX_RATE_RATIO * self.rates_hz.0
    }
}

/// Block of readings.
struct Block {
    first: usize,
    end: usize,
    /// `true` if the block follows the previous one without a gap.
    is_contiguous: bool,
    means: [f64; AXES],
    sds: [f64; AXES],
}

/// Finds the rests and the motions between them.
pub(super) fn find(rows: &[Row], median_s: f64) -> (Vec<Rest>, Vec<Motion>) {
    let blocks = blocks(rows, median_s);
    let since_s = |index: usize| seconds(&rows[0], &rows[index]);
    let motions = block_motions(&blocks, block_count(median_s));
    let is_near_motion = |i: usize| {
        motions[i].is_some() || i > 0 && motions[i - 1].is_some() || motions.get(i + 1).is_some_and(Option::is_some)
    };
    let mut rests: Vec<Rest> = Vec::new();
    let mut found: Vec<Motion> = Vec::new();
    for (i, block) in blocks.iter().enumerate() {
        if let Some((axis, sign, value, limit)) = motions[i] {
            let (start_s, end_s) = (since_s(block.first), since_s(block.end - 1));
            match found.last_mut().filter(|last| start_s - last.end_s < 2.0 * BLOCK_S) {
                Some(last) => last.end_s = end_s,
                None => found.push(Motion { start_s, end_s, axis, sign, value, limit }),
            }
        }
        if is_near_motion(i) {
            continue;
        }
        match rests.last_mut().filter(|rest| block.is_contiguous && rest.end == block.first) {
            Some(rest) => rest.end = block.end,
            None => rests.push(Rest { first: block.first, end: block.end }),
        }
    }
    rests.retain(|rest| since_s(rest.end - 1) - since_s(rest.first) >= MIN_REST_S - BLOCK_S);
    (rests, found)
}

/// Returns, for each block, the first axis that exceeds a limit.
fn block_motions(blocks: &[Block], count: usize) -> Vec<Option<(Axis, MotionSign, f64, f64)>> {
    let limits: Vec<_> = Axis::ALL.iter().map(|axis| AxisLimits::new(blocks, *axis, count)).collect();
    let mut motions = Vec::with_capacity(blocks.len());
    // Index of the first block of the current rest.
    let mut first = 0;
    for (i, block) in blocks.iter().enumerate() {
        let previous = i.checked_sub(1).map(|i| &blocks[i]).filter(|_| block.is_contiguous);
        if previous.is_none() || motions.last().is_some_and(Option::is_some) {
            first = i;
        }
        let motion = Axis::ALL.iter().zip(&limits).find_map(|(axis, AxisLimits { sensor, sd, step, noise })| {
            let index = axis.index();
            let mean = block.means[index];
            let change = previous.map_or(0.0, |previous| (mean - previous.means[index]).abs());
            let turn = (mean - blocks[first].means[index]).abs();
            [
                (MotionSign::Spread, block.sds[index], *sd),
                (MotionSign::Step, change, *step),
                (MotionSign::Turn, turn, sensor.turn + noise),
                (MotionSign::Mean, mean.abs(), sensor.mean),
            ]
            .into_iter()
            .find(|(_, value, limit)| value > limit)
            .map(|(sign, value, limit)| (*axis, sign, value, limit))
        });
        motions.push(motion);
    }
    motions
}

/// Limits of an axis in a recording.
struct AxisLimits {
    sensor: &'static Limits,
    sd: f64,
    step: f64,
    /// Largest change that white noise causes in the mean of a block.
    noise: f64,
}

impl AxisLimits {
    fn new(blocks: &[Block], axis: Axis, count: usize) -> Self {
        let sensor = if axis.is_gyro() { &GYRO } else { &ACCEL };
        let index = axis.index();
        let quiet_sd = percentile(blocks.iter().map(|block| block.sds[index]).collect(), 10).unwrap_or(0.0);
        let sd = (QUIET_FACTOR * quiet_sd).clamp(sensor.sd.0, sensor.sd.1);
        let changes = blocks.windows(2).filter(|pair| pair[1].is_contiguous);
        let changes = changes.map(|pair| (pair[1].means[index] - pair[0].means[index]).abs()).collect();
        let change_sd = percentile(changes, 50).unwrap_or(0.0) / NORMAL_MEDIAN;
        let noise = NOISE_FACTOR * quiet_sd.min(sensor.sd.1) / (count as f64).sqrt();
        let step = (STEP_FACTOR * change_sd).clamp(sensor.step.0, sensor.step.1 + noise);
        Self { sensor, sd, step, noise }
    }
}

/// Groups the readings into blocks with the same number of readings. The last readings before a gap
/// are not used if they do not fill a block.
fn blocks(rows: &[Row], median_s: f64) -> Vec<Block> {
    let (count, gap_s) = (block_count(median_s), min_gap_s(median_s));
    let mut blocks: Vec<Block> = Vec::new();
    let (mut start, mut is_contiguous) = (0, false);
    for end in 1..=rows.len() {
        if end - start == count {
            blocks.push(block(rows, start, end, is_contiguous));
            (start, is_contiguous) = (end, true);
        }
        if end < rows.len() && seconds(&rows[end - 1], &rows[end]) >= gap_s {
            (start, is_contiguous) = (end, false);
        }
    }
    blocks
}

fn block(rows: &[Row], first: usize, end: usize, is_contiguous: bool) -> Block {
    let rows = &rows[first..end];
    let count = rows.len() as f64;
    let means = std::array::from_fn(|i| rows.iter().map(|row| row.values[i]).sum::<f64>() / count);
    let sds = std::array::from_fn(|i| {
        (rows.iter().map(|row| (row.values[i] - means[i]).powi(2)).sum::<f64>() / (count - 1.0)).sqrt()
    });
    Block { first, end, is_contiguous, means, sds }
}

fn min_gap_s(median_s: f64) -> f64 {
    MIN_GAP_S.max(MIN_GAP_INTERVALS * median_s)
}

fn block_count(median_s: f64) -> usize {
    (BLOCK_S / median_s).round().max(2.0) as usize
}

/// Returns the value below which `percent` per cent of the values lie; `None` if there are no
/// values.
fn percentile(mut values: Vec<f64>, percent: usize) -> Option<f64> {
    let index = values.len().checked_sub(1)? * percent / 100;
    Some(*values.select_nth_unstable_by(index, f64::total_cmp).1)
}
