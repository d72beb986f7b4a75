//! Nanoseconds per update of the bare stages.
//!
//! Input: checked samples in memory. Output: the time from a sample to the fused attitude: gyro, accel and fuser step, nothing
//! else. Time: the CPU time of this thread over whole passes. Failure: none; what else runs on the machine still costs caches.
//!
//! The stages that are compared take turns, so that what slows the machine slows them all; of the rounds' means the median is
//! taken.

use std::hint::black_box;

use attitude::{
    Vector3,
    fuser::FuserInput,
    gnss::Fix,
    gyro::{RateKind, RateSample},
    stage::Stage,
};
use ingest::conditioner::Sample;
use messages::Flags;
use runtime::convert;
use rustix::time::{ClockId, clock_gettime};

use crate::chain::Stages;

/// Samples of a trial that are timed, from its start: so many are kept in memory.
pub const MAX_SAMPLES: usize = 30_000;
/// Passes over them.
const ROUNDS: usize = 7;

/// What the stages are given at a tick.
#[derive(Debug, Clone, Copy)]
pub struct Step {
    rate: RateSample,
    force_m_s2: Vector3<f64>,
    field_ut: Option<Vector3<f64>>,
    fix: Option<Fix>,
    is_force_good: bool,
    is_rate_good: bool,
}

impl Step {
    /// Of a checked sample.
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

/// Nanoseconds per update of each of `compared`; `None` of no samples, and where a stage is a process of its own, whose time is not this
/// thread's.
pub fn ns_per_update(steps: &[Step], compared: &[Stages]) -> Vec<Option<f64>> {
    let mut rounds_ns = vec![[f64::NAN; ROUNDS]; compared.len()];
    for round in 0..ROUNDS {
        let timed = compared.iter().zip(&mut rounds_ns).filter(|(stages, _)| stages.are_of_this_process());
        for (stages, rounds_ns) in timed {
            rounds_ns[round] = mean_ns(steps, stages.clone());
        }
    }
    let of_this_process = compared.iter().map(Stages::are_of_this_process);
    rounds_ns
        .into_iter()
        .zip(of_this_process)
        .map(|(rounds_ns, timed)| if timed { median(rounds_ns) } else { f64::NAN })
        .map(|ns| ns.is_finite().then_some(ns))
        .collect()
}

fn mean_ns(steps: &[Step], mut stages: Stages) -> f64 {
    let start_ns = cpu_ns();
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
    (cpu_ns() - start_ns) / steps.len() as f64
}

/// CPU time of this thread.
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
    fn every_stage_compared_has_its_time_and_nothing_timed_has_none() {
        let compared = vec![Stages::of(&Launch::default()).unwrap(); 2];
        let sample = Sample { imu: bytemuck::Zeroable::zeroed(), mag: None, gnss: None, reference: None };
        let times = ns_per_update(&[Step::new(&sample); 100], &compared);
        assert!(times.len() == 2 && times.iter().all(|ns| ns.is_some_and(|ns| ns > 0.0)), "{times:?}");
        assert_eq!(ns_per_update(&[], &compared), [None, None]);
    }
}
