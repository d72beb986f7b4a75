//! The stages over the trials, through the slots of the running system.
//!
//! Input: a request. Output: the scores, and the files asked for. Time: the samples' own. Failure: the first of anything ends the
//! run; every trial has been read once before the first is run.

use std::{
    collections::HashSet,
    fs,
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
};

use ingest::conditioner::Sample;
use judge::{Finding, Judge, Stamps};
use launch::{Launch, Source, counted};
use messages::Reference;
use pipeline::{Collector, OutFile, is_same_file};
use rayon::prelude::*;
use runtime::{Pace, RuntimeError, ServiceConfig};

use crate::{
    ScoreError,
    chain::Stages,
    plot::Figures,
    seeds::{self, joined},
    stages::{self, Choice},
    table::{ErrorsDeg, Scores, StageScore, TrialScore, Warning},
    timing::{SAMPLES_MAX, Step, ns_per_update},
    trial::{Gnss, Options, Trial},
};

/// Readings between two signs of progress.
const PROGRESS_ROWS: u64 = 1024;

/// What is to be scored.
#[derive(Debug, Clone, Default)]
pub struct Request {
    /// The trials.
    pub files: Vec<String>,
    /// How they are read.
    pub options: Options,
    /// The stages.
    pub choice: Choice,
    /// Folder for the attitude of each tick.
    pub out: Option<PathBuf>,
    /// Folder for figures.
    pub plot: Option<PathBuf>,
}

/// Runs every stage over every trial, on all cores. `progress` is told the readings done, and of how many.
pub fn run(request: &Request, progress: &mut (dyn FnMut(u64, u64) + Send)) -> Result<Scores, ScoreError> {
    let launches = stages::launches(&request.choice)?;
    let entries = entries(request)?;
    let trials: Vec<(&Trial, bool)> = entries.iter().flat_map(Entry::timed).collect();
    let rows = trials.iter().map(|(trial, _)| trial.rows).sum();
    let told = Mutex::new((0, progress));
    let tell = |more: u64| {
        let mut told = told.lock().unwrap_or_else(PoisonError::into_inner);
        told.0 += more;
        let done = told.0;
        (told.1)(done, rows);
    };
    tell(0);
    let run = trials.par_iter().map(|(trial, is_timed)| one(request, trial, &launches, *is_timed, &tell));
    let mut all = run.collect::<Result<Vec<_>, _>>()?.into_iter();
    let mut scores = Scores { stages: launches.iter().map(StageScore::new).collect(), warnings: Vec::new() };
    for Entry { name, trials } in &entries {
        let mut of_stages = vec![Vec::new(); launches.len()];
        for ((seed, trial), (of_trial, warnings)) in trials.iter().zip(&mut all) {
            scores.warnings.extend(warnings.into_iter().map(|text| Warning { trial: trial.name.clone(), text }));
            of_stages.iter_mut().zip(of_trial).for_each(|(of_stage, score)| of_stage.push((*seed, score)));
        }
        for (stage, mut of_stage) in scores.stages.iter_mut().zip(of_stages) {
            let is_one = of_stage.len() == 1;
            let score = if is_one { of_stage.pop().map(|(_, score)| score) } else { Some(joined(name, &of_stage)) };
            stage.trials.extend(score);
        }
    }
    scores.stages.iter_mut().for_each(StageScore::finish);
    Ok(scores)
}

/// What was asked for: a trial, or a simulation with many seeds.
struct Entry {
    name: String,
    /// With the seed where there are many.
    trials: Vec<(u64, Trial)>,
}

impl Entry {
    fn open(text: &str, options: &Options) -> Result<Self, ScoreError> {
        let seeds = seeds::each(text)?.unwrap_or_else(|| vec![(0, text.into())]);
        let trials = seeds.into_iter().map(|(seed, name)| Ok((seed, Trial::open(&name, options)?)));
        let trials = trials.collect::<Result<Vec<_>, ScoreError>>()?;
        Ok(Self { name: text.into(), trials })
    }

    /// Its trials, of which the first is timed: time does not depend on the seed.
    fn timed(&self) -> impl Iterator<Item = (&Trial, bool)> {
        self.trials.iter().enumerate().map(|(index, (_, trial))| (trial, index == 0))
    }
}

fn entries(request: &Request) -> Result<Vec<Entry>, ScoreError> {
    if let (Gnss::File(fixes), trials @ 2..) = (&request.options.gnss, request.files.len()) {
        return Err(ScoreError::FixesOfOne { fixes: fixes.clone(), trials });
    }
    let entries =
        request.files.iter().map(|file| Entry::open(file, &request.options)).collect::<Result<Vec<_>, _>>()?;
    let mut names = HashSet::new();
    let twice = entries.iter().flat_map(Entry::timed).find(|(trial, _)| !names.insert(trial.name.clone()));
    match twice {
        Some((trial, _)) => Err(ScoreError::NameTwice { name: trial.name.clone() }),
        None => Ok(entries),
    }
}

/// One trial through every launch, and what is to be said of its readings.
fn one(
    request: &Request,
    trial: &Trial,
    launches: &[Launch],
    is_timed: bool,
    progress: &(dyn Fn(u64) + Sync),
) -> Result<(Vec<TrialScore>, Vec<String>), ScoreError> {
    let all: Vec<_> = launches.iter().map(|launch| config(launch, trial)).collect();
    let mut lanes = all.iter().map(|config| Lane::new(request, trial, config)).collect::<Result<Vec<_>, _>>()?;
    let Some(first) = all.first() else { return Ok((Vec::new(), Vec::new())) };
    let mut conditioner = ingest::conditioner(first)?;
    let (mut judge, mut stamps, mut findings) = (Judge::default(), Stamps::default(), Vec::new());
    let (mut steps, mut last) = (Vec::new(), 0);
    for (count, reading) in (0u64..).zip(trial.readings()?) {
        let reading = reading?;
        if count > 0 && count.is_multiple_of(PROGRESS_ROWS) {
            progress(PROGRESS_ROWS);
        }
        last = count;
        stamps.take(reading.t_ns);
        let Some(sample) = conditioner.condition(&reading) else { continue };
        findings.extend(judge.take(&sample.imu, sample.mag.as_ref()));
        if is_timed && steps.len() < SAMPLES_MAX {
            steps.push(Step::new(&sample));
        }
        for lane in &mut lanes {
            lane.offer(&sample)?;
        }
    }
    progress((last + 1) % PROGRESS_ROWS);
    let compared = launches.iter().map(Stages::of).collect::<Result<Vec<_>, _>>()?;
    let times = ns_per_update(&steps, &compared);
    findings.extend(judge.finish());
    let warnings = refusals(conditioner.refused(), &stamps).into_iter().chain(findings.iter().map(Finding::to_string));
    let scores = lanes.into_iter().zip(times).map(|(lane, ns)| lane.finish(trial, ns)).collect::<Result<_, _>>()?;
    Ok((scores, warnings.collect()))
}

/// What was refused of a trial, where anything was.
fn refusals(refused: u64, stamps: &Stamps) -> Option<String> {
    let Stamps { doubled, disordered, .. } = stamps;
    (refused + doubled + disordered > 0).then(|| {
        let refused = counted(refused, "reading");
        format!("{refused} refused; stamps equal to the one before: {doubled}, earlier: {disordered}")
    })
}

/// What the slots are told. The limits are those of a system that replays the recording.
fn config(launch: &Launch, trial: &Trial) -> ServiceConfig {
    let mut launch = launch.clone();
    launch.ingest.source = Source::Replay;
    launch.ingest.replay.gyro_samples = trial.gyro_samples;
    ServiceConfig {
        launch,
        rate_hz: trial.rate_hz,
        pace: Pace::Max,
        ticks_max: None,
        incarnation: 0,
        epoch: runtime::service_config::FIRST_EPOCH,
        role: runtime::Role::Owner { from_tick: 0 },
        prior: None,
        resume: None,
        readings: false,
        supervisor_pid: std::process::id(),
    }
}

/// One path through the slots, and what becomes of its attitudes.
struct Lane {
    path: pipeline::Path,
    collector: Collector,
    figures: Option<Figures>,
}

impl Lane {
    fn new(request: &Request, trial: &Trial, config: &ServiceConfig) -> Result<Self, ScoreError> {
        let place = |folder: &Path, ending: &str| {
            let several = request.choice.fusers.len() > 1;
            let folder = if several { folder.join(&config.launch.fuser.stage) } else { folder.to_path_buf() };
            let made = fs::create_dir_all(&folder);
            made.map_err(|cause| ScoreError::Write { path: folder.clone(), cause })?;
            Ok::<_, ScoreError>(folder.join(format!("{}{ending}", trial.file_stem())))
        };
        let out = request.out.as_deref().map(|folder| place(folder, ".csv")).transpose()?;
        if let Some(path) = out.as_ref().filter(|out| trial.file().is_some_and(|file| is_same_file(out, file))) {
            return Err(ScoreError::OutIsTrial { path: path.clone() });
        }
        let figures = match &request.plot {
            Some(folder) => Some(Figures::new(place(folder, "")?, trial, config)?),
            None => None,
        };
        Ok(Self {
            path: pipeline::Path::new(config)?,
            collector: Collector::new(out.map(OutFile::new).as_ref())?,
            figures,
        })
    }

    fn offer(&mut self, sample: &Sample) -> Result<(), RuntimeError> {
        let Self { path, collector, figures } = self;
        let truth = sample.reference;
        if let Some(truth) = truth {
            let (tick, scored) = (sample.imu.header.tick, truth.scored.into());
            collector.reference(Reference { tick, scored, quaternion: truth.quaternion });
        }
        path.offer(*sample, &mut |output| {
            collector.attitude(&output);
            if let Some(figures) = figures {
                figures.take(&sample.imu, truth, &output);
            }
        })
    }

    fn finish(mut self, trial: &Trial, ns_per_update: Option<f64>) -> Result<TrialScore, ScoreError> {
        self.collector.finish()?;
        if let Some(figures) = &mut self.figures {
            figures.write()?;
        }
        let accuracy = self.collector.accuracy();
        Ok(TrialScore {
            name: trial.name.clone(),
            error: ErrorsDeg::of(accuracy.rmse()),
            scored: accuracy.count(),
            ticks: self.collector.ticks(),
            ns_per_update,
            spread: None,
        })
    }
}
