//! When the unit rests, and how exactly the mean of a rest is known.
//!
//! Readings are taken together in blocks of a quarter of a second. A block is quiet where neither rate nor force spreads by more than a
//! few times what the quietest tenth of all blocks spreads. A rest is a run of quiet blocks with one mean rate and one mean force: a
//! steady turn is no rest, for gravity turns with it. Its first and last block are left out, for a hand is seldom still at once.

use attitude::{GRAVITY_M_S2, Vector3};

use crate::Sample;

/// Length of a block, ns, and the fewest readings of one.
const BLOCK_NS: i64 = 250_000_000;
const MIN_BLOCK_SAMPLES: u32 = 5;
/// Blocks kept: 14 hours of a quarter of a second each. What comes later is not looked at.
const MAX_BLOCKS: usize = 200_000;
/// A longer interval between readings ends a block and a rest, ns.
const GAP_NS: i64 = 500_000_000;
/// Blocks of a rest, without its first and last: a second.
const MIN_REST_BLOCKS: usize = 4;

/// A quiet block spreads by no more than this many times the quietest tenth.
const QUIET_FACTOR: f64 = 3.0;
/// Nor is it asked to spread by less than the first, nor allowed to by more than the second: rad/s, and m/s².
const RATE_SPREAD_RAD_S: (f64, f64) = (0.005, 0.06);
const FORCE_SPREAD_M_S2: (f64, f64) = (0.05, 0.6);
/// The largest rate that may be a bias, rad/s: 20 °/s, as data sheets of consumer gyros allow.
const MAX_BIAS_RAD_S: f64 = 0.35;
/// How far the mean of a block may be from that of its rest beyond noise: rad/s, and m/s² (0.3° of a tilt).
const RATE_STEADY_RAD_S: f64 = 0.003;
const FORCE_STEADY_M_S2: f64 = 0.05;

/// Differences that a variance must be made of.
const MIN_DIFFERENCES: usize = 8;

/// A quarter of a second.
#[derive(Debug, Clone, Copy)]
struct Block {
    t_start_ns: i64,
    t_end_ns: i64,
    /// It goes on where the one before ended.
    follows: bool,
    count: u32,
    rate_rad_s: Spread,
    force_m_s2: Spread,
}

/// Mean and sum of squares about it, by Welford.
#[derive(Debug, Clone, Copy, Default)]
struct Spread {
    mean: Vector3<f64>,
    squares: Vector3<f64>,
}

impl Spread {
    fn take(&mut self, value: &Vector3<f64>, count: u32) {
        let off = value - self.mean;
        self.mean += off / f64::from(count);
        self.squares += off.component_mul(&(value - self.mean));
    }

    /// Standard deviation of a reading on the axis with the largest.
    fn sd(&self, count: u32) -> f64 {
        (self.squares.max() / f64::from(count.max(2) - 1)).sqrt()
    }
}

/// Finds rests while readings come.
#[derive(Debug, Clone, Default)]
pub(crate) struct RestFinder {
    open: Option<Block>,
    blocks: Vec<Block>,
    start_ns: Option<i64>,
}

/// The unit did not move.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Rest {
    /// Since the first reading, s.
    pub(crate) from_s: f64,
    pub(crate) until_s: f64,
    /// Means of the blocks, in their order.
    pub(crate) rates_rad_s: Vec<Vector3<f64>>,
    pub(crate) forces_m_s2: Vec<Vector3<f64>>,
}

impl Rest {
    pub(crate) fn duration_s(&self) -> f64 {
        self.until_s - self.from_s
    }

    pub(crate) fn force_m_s2(&self) -> Vector3<f64> {
        mean(&self.forces_m_s2)
    }

    /// What it feels can be gravity: half of it to twice as much.
    pub(crate) fn feels_gravity(&self) -> bool {
        (0.5..2.0).contains(&(self.force_m_s2().norm() / GRAVITY_M_S2))
    }
}

/// The mean of vectors.
pub(crate) fn mean(vectors: &[Vector3<f64>]) -> Vector3<f64> {
    vectors.iter().sum::<Vector3<f64>>() / vectors.len().max(1) as f64
}

impl RestFinder {
    pub(crate) fn take(&mut self, sample: &Sample) {
        let t_ns = sample.t_ns;
        self.start_ns.get_or_insert(t_ns);
        let mut follows = !self.blocks.is_empty();
        if let Some(open) = self.open {
            let is_gap = t_ns - open.t_end_ns > GAP_NS;
            let is_full = t_ns - open.t_start_ns >= BLOCK_NS && open.count >= MIN_BLOCK_SAMPLES;
            if is_full && self.blocks.len() < MAX_BLOCKS {
                self.blocks.push(open);
            }
            follows = !is_gap;
            if is_full || is_gap {
                self.open = None;
            }
        }
        let begun = Block {
            t_start_ns: t_ns,
            t_end_ns: t_ns,
            follows,
            count: 0,
            rate_rad_s: Spread::default(),
            force_m_s2: Spread::default(),
        };
        let open = self.open.get_or_insert(begun);
        open.t_end_ns = t_ns;
        open.count += 1;
        open.rate_rad_s.take(&sample.rate_rad_s, open.count);
        open.force_m_s2.take(&sample.force_m_s2, open.count);
    }

    /// The rests so far.
    pub(crate) fn rests(&self) -> Vec<Rest> {
        let limit = |(least, most): (f64, f64), sd: &dyn Fn(&Block) -> f64| {
            let mut sds: Vec<_> = self.blocks.iter().map(sd).collect();
            let tenth = sds.len() / 10;
            let quiet = if sds.is_empty() { 0.0 } else { *sds.select_nth_unstable_by(tenth, f64::total_cmp).1 };
            (QUIET_FACTOR * quiet).clamp(least, most)
        };
        let (rate_sd, force_sd) = (|b: &Block| b.rate_rad_s.sd(b.count), |b: &Block| b.force_m_s2.sd(b.count));
        let (rate_limit, force_limit) = (limit(RATE_SPREAD_RAD_S, &rate_sd), limit(FORCE_SPREAD_M_S2, &force_sd));
        let is_quiet = |block: &Block| {
            rate_sd(block) <= rate_limit
                && force_sd(block) <= force_limit
                && block.rate_rad_s.mean.amax() <= MAX_BIAS_RAD_S
        };
        let mut rests = Vec::new();
        let mut run = Run::default();
        for block in &self.blocks {
            if !(is_quiet(block) && block.follows && run.goes_on_with(block)) {
                rests.extend(self.rest(&std::mem::take(&mut run)));
            }
            if is_quiet(block) {
                run.take(block);
            }
        }
        rests.extend(self.rest(&run));
        rests
    }

    /// The rest in a run of quiet blocks.
    fn rest(&self, run: &Run<'_>) -> Option<Rest> {
        let inner = run.blocks.get(1..run.blocks.len().checked_sub(1)?)?;
        let (first, last) = (inner.first()?, inner.last()?);
        let since_s = |t_ns: i64| (t_ns - self.start_ns.unwrap_or(t_ns)) as f64 * 1e-9;
        (inner.len() >= MIN_REST_BLOCKS).then(|| Rest {
            from_s: since_s(first.t_start_ns),
            until_s: since_s(last.t_end_ns),
            rates_rad_s: inner.iter().map(|block| block.rate_rad_s.mean).collect(),
            forces_m_s2: inner.iter().map(|block| block.force_m_s2.mean).collect(),
        })
    }
}

/// Quiet blocks with one mean.
#[derive(Default)]
struct Run<'a> {
    blocks: Vec<&'a Block>,
    rate_rad_s: Vector3<f64>,
    force_m_s2: Vector3<f64>,
}

impl<'a> Run<'a> {
    fn take(&mut self, block: &'a Block) {
        self.blocks.push(block);
        let share = 1.0 / self.blocks.len() as f64;
        self.rate_rad_s += (block.rate_rad_s.mean - self.rate_rad_s) * share;
        self.force_m_s2 += (block.force_m_s2.mean - self.force_m_s2) * share;
    }

    fn goes_on_with(&self, block: &Block) -> bool {
        let noise = |spread: &Spread| 4.0 * spread.sd(block.count) / f64::from(block.count).sqrt();
        self.blocks.is_empty()
            || (block.rate_rad_s.mean - self.rate_rad_s).amax() <= RATE_STEADY_RAD_S + noise(&block.rate_rad_s)
                && (block.force_m_s2.mean - self.force_m_s2).amax() <= FORCE_STEADY_M_S2 + noise(&block.force_m_s2)
    }
}

/// How far the mean of a series of blocks may be from the truth, by the Allan deviations of the blocks.
///
/// White noise makes the mean of K blocks σ(m) √(m/K) uncertain for every m. Where the deviations of longer means fall more slowly, as
/// flicker and drift make them, the largest of these holds. (IEEE 952-1997, annex C.)
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct MeanNoise {
    /// Allan variances of means of 1, 2, 4, … blocks, each axis.
    variances: Vec<Vector3<f64>>,
}

impl MeanNoise {
    /// By all series together.
    pub(crate) fn of(series: &[&[Vector3<f64>]]) -> Self {
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

    /// Standard deviation of the mean of so many blocks, each axis.
    pub(crate) fn sd(&self, blocks: usize) -> Vector3<f64> {
        let scales = (0..).map(|power| (1u64 << power) as f64);
        let of_scale = |(variance, scale): (&Vector3<f64>, f64)| variance * (scale / blocks.max(1) as f64).min(1.0);
        self.variances.iter().zip(scales).map(of_scale).fold(Vector3::zeros(), |a, b| a.sup(&b)).map(f64::sqrt)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Readings at 100 Hz of what `at` says of each time.
    fn found(duration_s: f64, at: impl Fn(f64) -> (Vector3<f64>, Vector3<f64>)) -> Vec<Rest> {
        let mut finder = RestFinder::default();
        for i in 0..(100.0 * duration_s) as i64 {
            let (rate_rad_s, force_m_s2) = at(i as f64 * 0.01);
            finder.take(&Sample { t_ns: i * 10_000_000, rate_rad_s, force_m_s2, field_ut: None });
        }
        finder.rests()
    }

    #[test]
    fn a_rest_is_found_between_motions_and_not_in_a_steady_turn() {
        let up = Vector3::new(0.0, 0.0, 9.8);
        let bias = Vector3::new(0.05, -0.1, 0.02);
        let rests = found(20.0, |t_s| match t_s {
            0.0..5.0 => (bias, up),
            5.0..10.0 => (bias + Vector3::x() * (9.0 * t_s).sin(), up + Vector3::y() * (9.0 * t_s).cos()),
            10.0..15.0 => {
                let (sin, cos) = (0.1 * t_s).sin_cos();
                (bias + Vector3::x() * 0.1, Vector3::new(0.0, 9.8 * sin, 9.8 * cos))
            }
            _ => (bias, -up),
        });
        assert_eq!(rests.len(), 2, "{rests:?}");
        assert!(rests[0].from_s < 0.6 && (4.0..5.0).contains(&rests[0].until_s));
        assert!((15.0..15.8).contains(&rests[1].from_s) && rests[1].duration_s() > 3.5);
        assert!((mean(&rests[0].rates_rad_s) - bias).amax() < 1e-12);
    }

    #[test]
    fn a_drifting_mean_is_less_certain_than_white_noise_says() {
        let drift: Vec<_> = (0..64).map(|i| Vector3::repeat(0.01 * f64::from(i))).collect();
        let white: Vec<_> = (0..64).map(|i| Vector3::repeat(if i % 2 == 0 { 0.01 } else { -0.01 })).collect();
        let sd = |blocks: &[Vector3<f64>]| MeanNoise::of(&[blocks]).sd(64).x;
        assert!((sd(&white) - 0.02 / 2f64.sqrt() / 8.0).abs() < 1e-12, "{}", sd(&white));
        assert!(sd(&drift) > 0.005, "{}", sd(&drift));
    }
}
