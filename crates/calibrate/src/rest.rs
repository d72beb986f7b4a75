//! Detection of periods of rest, and uncertainty of the mean readings in them.
//!
//! Readings are grouped into blocks of a quarter of a second. A block is quiet if its standard
//! deviations of rate and force are at most a few times the 10th percentiles of these deviations
//! over all blocks.
//!
//! A rest is a run of quiet blocks with constant mean rate and mean force. A steady turn is not a
//! rest, because the direction of gravity changes in sensor axes. The first and the last block of a
//! run are discarded, because the unit is usually still being put down or already being picked up.

use attitude::{GRAVITY_M_S2, Vector3};

use crate::input::Sample;

/// Length of a block, ns.
const BLOCK_NS: i64 = 250_000_000;
/// Minimum number of readings in a block.
const MIN_BLOCK_SAMPLES: u32 = 5;
/// Maximum number of blocks kept: 14 hours. Later readings are ignored.
const MAX_BLOCKS: usize = 200_000;
/// Longest interval between readings within a rest, ns.
const MAX_GAP_NS: i64 = 500_000_000;
/// Minimum number of blocks in a rest: one second. The first and the last block of the run are not
/// counted.
const MIN_REST_BLOCKS: usize = 4;

/// Maximum ratio of the standard deviation of a quiet block to the 10th percentile of the standard
/// deviations of all blocks.
const QUIET_FACTOR: f64 = 3.0;
/// Minimum and maximum of the limit for the rate's standard deviation in a quiet block, rad/s.
const RATE_SD_RANGE_RAD_S: (f64, f64) = (0.005, 0.06);
/// Minimum and maximum of the limit for the force's standard deviation in a quiet block, m/s².
const FORCE_SD_RANGE_M_S2: (f64, f64) = (0.05, 0.6);
/// Largest rate that can be a bias, rad/s. This is 20 °/s, as allowed by data sheets of consumer
/// gyros.
const MAX_BIAS_RAD_S: f64 = 0.35;
/// Maximum deviation of a block's mean rate from the mean rate of its rest, rad/s. Four standard
/// deviations of the block's mean are added to this limit.
const MAX_RATE_DRIFT_RAD_S: f64 = 0.003;
/// Maximum deviation of the mean force of a block from that of the whole rest, m/s². It corresponds
/// to a tilt of 0.3°. Four standard deviations of the block's mean are added to this limit.
const MAX_FORCE_DRIFT_M_S2: f64 = 0.05;

/// Minimum number of differences for an Allan variance.
const MIN_DIFFERENCES: usize = 8;

/// Statistics of the readings in a quarter of a second.
#[derive(Debug, Clone, Copy)]
struct Block {
    t_start_ns: i64,
    t_end_ns: i64,
    /// `true` if the block follows the previous one without a gap.
    is_contiguous: bool,
    count: u32,
    rate_rad_s: RunningStats,
    force_m_s2: RunningStats,
}

/// Mean and sum of squared deviations by Welford's method.
#[derive(Debug, Clone, Copy, Default)]
struct RunningStats {
    mean: Vector3<f64>,
    squares: Vector3<f64>,
}

impl RunningStats {
    fn push(&mut self, value: &Vector3<f64>, count: u32) {
        let deviation = value - self.mean;
        self.mean += deviation / f64::from(count);
        self.squares += deviation.component_mul(&(value - self.mean));
    }

    /// Returns the standard deviation of a reading on the noisiest axis.
    fn sd(&self, count: u32) -> f64 {
        (self.squares.max() / f64::from(count.max(2) - 1)).sqrt()
    }
}

/// Rest detector that processes the readings as they arrive.
#[derive(Debug, Clone, Default)]
pub(crate) struct RestFinder {
    current: Option<Block>,
    blocks: Vec<Block>,
    start_ns: Option<i64>,
}

/// Interval in which the unit did not move. Times are in seconds since the first reading.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Rest {
    pub(crate) start_s: f64,
    pub(crate) end_s: f64,
    /// Mean rate of each block, in time order.
    pub(crate) rates_rad_s: Vec<Vector3<f64>>,
    /// Mean force of each block, in time order.
    pub(crate) forces_m_s2: Vec<Vector3<f64>>,
}

impl Rest {
    pub(crate) fn duration_s(&self) -> f64 {
        self.end_s - self.start_s
    }

    pub(crate) fn force_m_s2(&self) -> Vector3<f64> {
        mean(&self.forces_m_s2)
    }

    /// Returns `true` if the magnitude of the mean force is 0.5 to 2 times that of gravity.
    pub(crate) fn is_plausible_gravity(&self) -> bool {
        (0.5..2.0).contains(&(self.force_m_s2().norm() / GRAVITY_M_S2))
    }
}

pub(crate) fn mean(vectors: &[Vector3<f64>]) -> Vector3<f64> {
    vectors.iter().sum::<Vector3<f64>>() / vectors.len().max(1) as f64
}

impl RestFinder {
    pub(crate) fn push(&mut self, sample: &Sample) {
        let t_ns = sample.t_ns;
        self.start_ns.get_or_insert(t_ns);
        let mut is_contiguous = !self.blocks.is_empty();
        if let Some(block) = self.current {
            let is_gap = t_ns - block.t_end_ns > MAX_GAP_NS;
            let is_full = t_ns - block.t_start_ns >= BLOCK_NS && block.count >= MIN_BLOCK_SAMPLES;
            if is_full && self.blocks.len() < MAX_BLOCKS {
                self.blocks.push(block);
            }
            is_contiguous = !is_gap;
            if is_full || is_gap {
                self.current = None;
            }
        }
        let new_block = Block {
            t_start_ns: t_ns,
            t_end_ns: t_ns,
            is_contiguous,
            count: 0,
            rate_rad_s: RunningStats::default(),
            force_m_s2: RunningStats::default(),
        };
        let block = self.current.get_or_insert(new_block);
        block.t_end_ns = t_ns;
        block.count += 1;
        block.rate_rad_s.push(&sample.rate_rad_s, block.count);
        block.force_m_s2.push(&sample.force_m_s2, block.count);
    }

    /// Returns the rests found so far.
    pub(crate) fn rests(&self) -> Vec<Rest> {
        let limit = |(min, max): (f64, f64), sd: &dyn Fn(&Block) -> f64| {
            let mut sds: Vec<_> = self.blocks.iter().map(sd).collect();
            let decile = sds.len() / 10;
            let quiet = if sds.is_empty() { 0.0 } else { *sds.select_nth_unstable_by(decile, f64::total_cmp).1 };
            (QUIET_FACTOR * quiet).clamp(min, max)
        };
        let (rate_sd, force_sd) = (|b: &Block| b.rate_rad_s.sd(b.count), |b: &Block| b.force_m_s2.sd(b.count));
        let (rate_limit, force_limit) = (limit(RATE_SD_RANGE_RAD_S, &rate_sd), limit(FORCE_SD_RANGE_M_S2, &force_sd));
        let is_quiet = |block: &Block| {
            rate_sd(block) <= rate_limit
                && force_sd(block) <= force_limit
                && block.rate_rad_s.mean.amax() <= MAX_BIAS_RAD_S
        };
        let mut rests = Vec::new();
        let mut run = Run::default();
        for block in &self.blocks {
            if !(is_quiet(block) && block.is_contiguous && run.continues_with(block)) {
                rests.extend(self.rest(&std::mem::take(&mut run)));
            }
            if is_quiet(block) {
                run.push(block);
            }
        }
        rests.extend(self.rest(&run));
        rests
    }

    /// Returns the rest in a run of quiet blocks, or `None` if the run is too short.
    fn rest(&self, run: &Run<'_>) -> Option<Rest> {
        let inner = run.blocks.get(1..run.blocks.len().checked_sub(1)?)?;
        let (first, last) = (inner.first()?, inner.last()?);
        let since_s = |t_ns: i64| (t_ns - self.start_ns.unwrap_or(t_ns)) as f64 * 1e-9;
        (inner.len() >= MIN_REST_BLOCKS).then(|| Rest {
            start_s: since_s(first.t_start_ns),
            end_s: since_s(last.t_end_ns),
            rates_rad_s: inner.iter().map(|block| block.rate_rad_s.mean).collect(),
            forces_m_s2: inner.iter().map(|block| block.force_m_s2.mean).collect(),
        })
    }
}

/// Run of quiet blocks with a constant mean.
#[derive(Default)]
struct Run<'a> {
    blocks: Vec<&'a Block>,
    rate_rad_s: Vector3<f64>,
    force_m_s2: Vector3<f64>,
}

impl<'a> Run<'a> {
    fn push(&mut self, block: &'a Block) {
        self.blocks.push(block);
        let share = 1.0 / self.blocks.len() as f64;
        self.rate_rad_s += (block.rate_rad_s.mean - self.rate_rad_s) * share;
        self.force_m_s2 += (block.force_m_s2.mean - self.force_m_s2) * share;
    }

    fn continues_with(&self, block: &Block) -> bool {
        let noise = |stats: &RunningStats| 4.0 * stats.sd(block.count) / f64::from(block.count).sqrt();
        self.blocks.is_empty()
            || (block.rate_rad_s.mean - self.rate_rad_s).amax() <= MAX_RATE_DRIFT_RAD_S + noise(&block.rate_rad_s)
                && (block.force_m_s2.mean - self.force_m_s2).amax() <= MAX_FORCE_DRIFT_M_S2 + noise(&block.force_m_s2)
    }
}

/// Uncertainty of the mean of a series of blocks, computed from the Allan deviations of the blocks
/// (IEEE 952-1997, annex C).
///
/// Let σ(m) be the Allan deviation of means of m blocks. For white noise, the standard deviation of
/// the mean of K blocks is σ(m) √(m/K), whatever m is. With flicker noise and drift, σ(m) decreases
/// more slowly, so the largest value over all m is used.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct MeanNoise {
    /// Allan variances of means of 1, 2, 4, … blocks, per axis.
    variances: Vec<Vector3<f64>>,
}

impl MeanNoise {
    /// Estimates the noise from all series combined.
    pub(crate) fn from_series(series: &[&[Vector3<f64>]]) -> Self {
        let mut variances = Vec::new();
        let mut means: Vec<Vec<Vector3<f64>>> = series.iter().map(|blocks| blocks.to_vec()).collect();
        loop {
            let differences = means.iter().flat_map(|blocks| blocks.windows(2).map(|pair| pair[1] - pair[0]));
            let (mut sum, mut count) = (Vector3::zeros(), 0usize);
            for difference in differences {
                sum += difference.component_mul(&difference);
                count += 1;
            }
            if count < MIN_DIFFERENCES && !variances.is_empty() || count == 0 {
                return Self { variances };
            }
            variances.push(sum / (2.0 * count as f64));
            let halved =
                |blocks: Vec<Vector3<f64>>| blocks.chunks_exact(2).map(|pair| 0.5 * (pair[0] + pair[1])).collect();
            means = means.into_iter().map(halved).collect();
        }
    }

    /// Returns the standard deviation of the mean of `blocks` blocks, per axis.
    pub(crate) fn sd(&self, blocks: usize) -> Vector3<f64> {
        let scales = (0..).map(|power| (1u64 << power) as f64);
        let variance_of_mean =
            |(variance, scale): (&Vector3<f64>, f64)| variance * (scale / blocks.max(1) as f64).min(1.0);
        let largest = self.variances.iter().zip(scales).map(variance_of_mean).fold(Vector3::zeros(), |a, b| a.sup(&b));
        largest.map(f64::sqrt)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the rests in readings at 100 Hz. `reading` returns the rate and the force at a time
    /// in seconds.
    fn find_rests(duration_s: f64, reading: impl Fn(f64) -> (Vector3<f64>, Vector3<f64>)) -> Vec<Rest> {
        let mut finder = RestFinder::default();
        for i in 0..(100.0 * duration_s) as i64 {
            let (rate_rad_s, force_m_s2) = reading(i as f64 * 0.01);
            finder.push(&Sample { t_ns: i * 10_000_000, rate_rad_s, force_m_s2, field_ut: None });
        }
        finder.rests()
    }

    #[test]
    fn rests_found_between_motions_but_not_in_steady_turn() {
        let up = Vector3::new(0.0, 0.0, 9.8);
        let bias = Vector3::new(0.05, -0.1, 0.02);
        let rests = find_rests(20.0, |t_s| match t_s {
            0.0..5.0 => (bias, up),
            5.0..10.0 => (bias + Vector3::x() * (9.0 * t_s).sin(), up + Vector3::y() * (9.0 * t_s).cos()),
            10.0..15.0 => {
                let (sin, cos) = (0.1 * t_s).sin_cos();
                (bias + Vector3::x() * 0.1, Vector3::new(0.0, 9.8 * sin, 9.8 * cos))
            }
            _ => (bias, -up),
        });
        assert_eq!(rests.len(), 2, "{rests:?}");
        assert!(rests[0].start_s < 0.6 && (4.0..5.0).contains(&rests[0].end_s));
        assert!((15.0..15.8).contains(&rests[1].start_s) && rests[1].duration_s() > 3.5);
        assert!((mean(&rests[0].rates_rad_s) - bias).amax() < 1e-12);
    }

    #[test]
    fn mean_sd_grows_with_drift() {
        let drift: Vec<_> = (0..64).map(|i| Vector3::repeat(0.01 * f64::from(i))).collect();
        let white: Vec<_> = (0..64).map(|i| Vector3::repeat(if i % 2 == 0 { 0.01 } else { -0.01 })).collect();
        let sd = |blocks: &[Vector3<f64>]| MeanNoise::from_series(&[blocks]).sd(64).x;
        assert!((sd(&white) - 0.02 / 2f64.sqrt() / 8.0).abs() < 1e-12, "{}", sd(&white));
        assert!(sd(&drift) > 0.005, "{}", sd(&drift));
    }
}
