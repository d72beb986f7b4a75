//! CPU time per update of the bare stages.
//!
//! Input: checked samples in memory.
//!
//! Output: the time from a sample to the fused attitude, which is one step each of gyro, accel and
//! fuser.
//!
//! Time: CPU time of the current thread over complete passes, and of the programs of external
//! stages. It excludes other load on the machine, although that load still affects the caches.
//!
//! The compared chains are timed alternately, so that a slow phase of the machine affects all of
//! them. Each round yields a mean time per update; the result is the median of these means.

use std::hint::black_box;

use attitude::{
    Vector3,
    fuser::FuserInput,
    gnss::Fix,
    gyro::{RateKind, RateSample},
    stage::Stage,
};
use messages::Flags;
use readings::conditioner::Sample;
use runtime::convert;
use rustix::time::{ClockId, clock_gettime};

use crate::chain::StageChain;

/// Maximum number of samples at the start of a trial that are kept in memory for timing.
pub const MAX_SAMPLES: usize = 30_000;
/// Maximum number of samples for timing a chain with an external program, which may be slow.
const MAX_PROGRAM_SAMPLES: usize = 1_000;
/// Number of passes over the samples per chain.
const ROUNDS: usize = 7;

/// Input of the stages at one tick.
#[derive(Debug, Clone, Copy)]
pub struct StageInput {
    rate: RateSample,
    force_m_s2: Vector3<f64>,
    field_ut: Option<Vector3<f64>>,
    fix: Option<Fix>,
    is_force_good: bool,
    is_rate_good: bool,
}

impl StageInput {
    /// Converts a checked sample.
    pub fn new(sample: &Sample) -> Self {
        let Sample { imu, mag, gnss, .. } = sample;
        let flags = imu.header.flags;
        let kind = if flags.any(Flags::RATE_INSTANT) { RateKind::Instant } else { RateKind::Mean };
        Self {
            rate: RateSample { rate_rad_s: imu.rate_rad_s.into(), dt_s: imu.header.dt_s(), kind },
            force_m_s2: imu.force_m_s2.into(),
            field_ut: mag.as_ref().and_then(convert::field_ut),
            fix: gnss.as_ref().and_then(convert::fix),
            is_force_good: !flags.any(Flags::FORCE_INVALID),
            is_rate_good: !flags.any(Flags::RATE_INVALID | Flags::RATE_STUCK | Flags::RATE_CLIPPED),
        }
    }
}

/// Returns the time per update in ns for each chain in `compared`.
///
/// A time is `None` without samples, or if the kernel does not report the CPU time of an
/// external program.
pub fn ns_per_update(steps: &[StageInput], compared: &[StageChain]) -> Vec<Option<f64>> {
    let mut rounds_ns = vec![[f64::NAN; ROUNDS]; compared.len()];
    for round in 0..ROUNDS {
        for (stages, rounds_ns) in compared.iter().zip(&mut rounds_ns) {
            let limit = if stages.are_in_process() { MAX_SAMPLES } else { MAX_PROGRAM_SAMPLES };
            let steps = steps.get(..limit).unwrap_or(steps);
            rounds_ns[round] = mean_ns_per_step(steps, stages.clone()).unwrap_or(f64::NAN);
        }
    }
    rounds_ns.into_iter().map(median).map(|ns| ns.is_finite().then_some(ns)).collect()
}

/// Returns the mean CPU time in ns per step of this thread and the programs of external stages.
fn mean_ns_per_step(steps: &[StageInput], mut stages: StageChain) -> Option<f64> {
    let start_ns = cpu_ns() + stages.program_cpu_ns()?;
    for step in steps {
        let motion = stages.gyro.step(&step.rate);
        let inclination = stages.accel.step(&step.force_m_s2);
        let fused = stages.fuser.step(&FuserInput {
            motion: Some(motion),
            inclination: Some(inclination).filter(|_| step.is_force_good),
            field_ut: step.field_ut,
            fix: step.fix,
            rest_credible: step.is_force_good,
            rate_credible: step.is_rate_good,
        });
        black_box(fused);
    }
    Some((cpu_ns() + stages.program_cpu_ns()? - start_ns) / steps.len() as f64)
}

/// Returns the CPU time of the current thread, ns.
fn cpu_ns() -> f64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec as f64 * 1e9 + time.tv_nsec as f64
}

fn median(mut values: [f64; ROUNDS]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[ROUNDS / 2]
}

#[cfg(test)]
mod tests {
    use super::*;
    use launch::Launch;

    #[test]
    fn each_chain_is_timed_unless_no_samples() {
        let compared = vec![StageChain::from_launch(&Launch::default()).unwrap(); 2];
        let sample = Sample { imu: bytemuck::Zeroable::zeroed(), mag: None, gnss: None, reference: None };
        let times = ns_per_update(&[StageInput::new(&sample); 100], &compared);
        assert!(times.len() == 2 && times.iter().all(|ns| ns.is_some_and(|ns| ns > 0.0)), "{times:?}");
        assert_eq!(ns_per_update(&[], &compared), [None, None]);
    }
}
