//! Evaluation of chains over trials.
//!
//! Input: the readings of a trial, and a launch configuration for each chain.
//!
//! Output: the errors of each chain.

use std::{cell::Cell, path::PathBuf};

use attitude::Quaternion;
use launch::{Launch, Source};
use messages::{AttitudeOutput, CourseReference, FusedState, Header, Reference};
use pipeline::{AttitudeFile, Collector, compared_attitude};
use rayon::prelude::*;
use readings::conditioner::Sample;
use runtime::{Pace, ServiceConfig};

use crate::{
    ScoreError,
    csv::TickTable,
    error_stats::{ErrorStats, TickErrors, Truth},
    estimate::{Estimate, EstimateReader},
    plot::PlotRecord,
    table::{Errors, ErrorsDeg, TrialScore},
    trial::Trial,
};

/// Mean errors of a launch configuration over the trials with a reference.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Evaluation {
    pub(crate) mean: Errors,
    /// `true` if the heading is known at the end of every trial.
    pub(crate) heading_is_known: bool,
}

/// Evaluates every launch configuration on all cores.
///
/// The configurations are split into one part per core, and each trial is read once per part.
/// `report_progress` is called with the number of readings processed since its last call.
pub(crate) fn evaluate(
    trials: &[Trial],
    launches: &[Launch],
    report_progress: &(dyn Fn(u64) + Sync),
) -> Result<Vec<Evaluation>, ScoreError> {
    if launches.is_empty() {
        return Ok(Vec::new());
    }
    let cores = rayon::current_num_threads().max(1);
    let shares: Vec<_> = launches.chunks(launches.len().div_ceil(cores)).collect();
    let with_reference = trials.iter().filter(|trial| trial.has_reference);
    let jobs: Vec<_> = with_reference.flat_map(|trial| shares.iter().map(move |share| (trial, *share))).collect();
    let done = jobs.par_iter().map(|(trial, share)| {
        let evaluated = evaluate_trial(trial, share)?;
        report_progress(trial.rows / shares.len() as u64);
        Ok(evaluated)
    });
    let done: Vec<Vec<_>> = done.collect::<Result<_, ScoreError>>()?;
    let errors_by_trial: Vec<Vec<(Errors, bool)>> = done.chunks(shares.len()).map(<[_]>::concat).collect();
    let mean = |at: usize| {
        let errors: Vec<_> = errors_by_trial.iter().map(|trial_errors| trial_errors[at].0).collect();
        let heading_is_known = errors_by_trial.iter().all(|trial_errors| trial_errors[at].1);
        Evaluation { mean: Errors::mean(&errors), heading_is_known }
    };
    Ok((0..launches.len()).map(mean).collect())
}

/// Returns the errors of each launch configuration over a trial, with `true` if the heading is
/// known at the end.
pub(crate) fn evaluate_trial(trial: &Trial, launches: &[Launch]) -> Result<Vec<(Errors, bool)>, ScoreError> {
    let configs: Vec<_> = launches.iter().map(|launch| config(launch, trial)).collect();
    let chain_run = |config: &ServiceConfig| ChainRun::new(config, TrialOutputs::default());
    let mut chain_runs = configs.iter().map(chain_run).collect::<Result<Vec<_>, _>>()?;
    let Some(first) = configs.first() else { return Ok(Vec::new()) };
    let mut conditioner = readings::conditioner(first)?;
    let gyro_bias = gyro_bias(trial, launches);
    for reading in trial.readings()? {
        let reading = reading?;
        let Some(sample) = conditioner.condition(&reading) else { continue };
        let truth = truth(&sample, gyro_bias.as_ref().map(|bias| bias(reading.t_ns)));
        chain_runs.iter_mut().try_for_each(|chain_run| chain_run.process(&sample, truth.as_ref()))?;
    }
    Ok(chain_runs
        .iter()
        .map(|chain_run| (chain_run.errors(), chain_run.stats.heading_is_known() != Some(false)))
        .collect())
}

/// Returns the true state at a tick; `None` without a reference.
pub(crate) fn truth(sample: &Sample, gyro_bias_rad_s: Option<[f64; 3]>) -> Option<Truth> {
    sample.reference.map(|truth| Truth { quaternion: truth.quaternion, scored: truth.scored, gyro_bias_rad_s })
}

/// Returns the function from time in ns to the true gyro bias in rad/s and body axes.
///
/// The result is `None` for a recording, or if calibration or mounting changes the rate of a
/// simulation.
pub(crate) fn gyro_bias(trial: &Trial, launches: &[Launch]) -> Option<impl Fn(i64) -> [f64; 3] + use<>> {
    let default = Launch::default().ingest;
    let is_default = |launch: &Launch| {
        launch.ingest.calibration.gyro == default.calibration.gyro && launch.ingest.mounting == default.mounting
    };
    trial.gyro_bias_rad_s().filter(|_| launches.iter().all(is_default))
}

/// Returns the configuration that the slots have in a system that replays a recording at maximum
/// speed.
pub(crate) fn config(launch: &Launch, trial: &Trial) -> ServiceConfig {
    let mut launch = launch.clone();
    launch.ingest.source = Source::Replay;
    launch.ingest.replay.gyro_samples = trial.gyro_samples;
    ServiceConfig::standalone(launch, trial.rate_hz, Pace::Max)
}

/// Source of the attitudes of a run.
enum AttitudeSource {
    Stages(Box<pipeline::Path>),
    File(Box<EstimateReader>),
}

/// Run over one trial, with its statistics and outputs. The attitudes are computed by a chain or
/// read from an estimate.
pub(crate) struct ChainRun {
    source: AttitudeSource,
    pub(crate) collector: Collector,
    pub(crate) stats: ErrorStats,
    pub(crate) files: TrialOutputs,
    /// Outputs of the current tick.
    pub(crate) outputs: Vec<(AttitudeOutput, FusedState)>,
    pub(crate) newest: Option<(AttitudeOutput, FusedState)>,
}

/// Optional outputs of a chain in addition to its score.
#[derive(Default)]
pub(crate) struct TrialOutputs {
    pub(crate) out: Option<PathBuf>,
    pub(crate) csv: Option<TickTable>,
    pub(crate) record: Option<Box<PlotRecord>>,
}

impl ChainRun {
    pub(crate) fn new(config: &ServiceConfig, files: TrialOutputs) -> Result<Self, ScoreError> {
        Self::with_source(AttitudeSource::Stages(Box::new(pipeline::Path::new(config)?)), files)
    }

    /// Creates the run of an estimate from a file.
    pub(crate) fn from_estimate(estimate: &Estimate, files: TrialOutputs) -> Result<Self, ScoreError> {
        Self::with_source(AttitudeSource::File(Box::new(EstimateReader::open(estimate)?)), files)
    }

    fn with_source(source: AttitudeSource, files: TrialOutputs) -> Result<Self, ScoreError> {
        Ok(Self {
            source,
            collector: Collector::new(files.out.as_ref().map(AttitudeFile::new).as_ref())?,
            stats: ErrorStats::default(),
            files,
            outputs: Vec::new(),
            newest: None,
        })
    }

    pub(crate) fn attitude_at(&self, tick: u64) -> Option<Quaternion<f64>> {
        self.newest.filter(|(output, _)| output.header.tick == tick).map(|(output, _)| compared_attitude(&output))
    }

    /// Returns `true` if the heading is known at the last scored tick, or at the last tick if none
    /// is scored.
    pub(crate) fn heading_is_known(&self) -> bool {
        let known_at_end =
            || self.newest.is_some_and(|(_, fused)| fused.course_reference != CourseReference::ARBITRARY);
        self.stats.heading_is_known().unwrap_or_else(known_at_end)
    }

    pub(crate) fn errors(&self) -> Errors {
        self.stats.errors(ErrorsDeg::from_error(self.collector.accuracy().rmse()))
    }

    pub(crate) fn process(&mut self, sample: &Sample, truth: Option<&Truth>) -> Result<(), ScoreError> {
        let Self { source, collector, stats, files, outputs, newest } = self;
        let Header { tick, t_end_ns, .. } = sample.imu.header;
        if let Some(&Truth { quaternion, scored, .. }) = truth {
            collector.record_reference(Reference { tick, t_end_ns, scored: scored.into(), quaternion });
        }
        outputs.clear();
        match source {
            AttitudeSource::Stages(path) => {
                let state = Cell::new(None);
                path.offer_observed(*sample, &mut |fused| state.set(Some(*fused)), &mut |output| {
                    outputs.extend(state.get().map(|fused| (output, fused)));
                })?;
            }
            AttitudeSource::File(estimate) => outputs.extend(estimate.at(&sample.imu)?),
        }
        for (output, fused) in outputs.iter() {
            collector.record_attitude(output);
            *newest = Some((*output, *fused));
            let errors = truth.map(|truth| (truth, TickErrors::new(output, fused, truth)));
            if let Some((_, errors)) = errors.as_ref().filter(|(truth, _)| truth.scored) {
                stats.update(errors, output, fused);
            }
            if let Some(record) = &mut files.record {
                record.update(&sample.imu, errors.as_ref().map(|(truth, errors)| (*truth, errors)), output, fused);
            }
            if let Some(csv) = &mut files.csv {
                csv.write(&sample.imu, output, fused, truth)?;
            }
        }
        Ok(())
    }

    pub(crate) fn finish(mut self, trial: &Trial, ns_per_update: Option<f64>) -> Result<TrialScore, ScoreError> {
        self.collector.finish()?;
        self.files.csv.take().map_or(Ok(()), TickTable::finish)?;
        let (error, heading_is_known) = (self.errors(), self.heading_is_known());
        let ratios = self.stats.into_ratios();
        Ok(TrialScore {
            name: trial.name.clone(),
            error,
            heading_is_known,
            normalised: ratios.quantiles(),
            ratios,
            scored: self.collector.accuracy().count(),
            ticks: self.collector.ticks(),
            ns_per_update,
            spread: None,
        })
    }
}
