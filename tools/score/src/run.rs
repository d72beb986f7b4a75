//! The stages over the trials, through the slots of the running system.
//!
//! Input: a request. Output: the scores, and the files asked for. Time: the samples' own. Failure: the first of anything ends the
//! run; every trial has been read once before the first is run.

use std::{
    cell::Cell,
    collections::HashSet,
    fs,
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
};

use attitude::metrics::Accuracy;
use ingest::conditioner::Sample;
use judge::{Finding, Judge, Stamps};
use launch::{Launch, Source, counted};
use messages::{AttitudeOutput, CourseReference, FusedState, Reference};
use pipeline::{Collector, OutFile, is_same_file};
use rayon::prelude::*;
use runtime::{Pace, RuntimeError, ServiceConfig};

use crate::{
    ScoreError,
    chain::Stages,
    overlay::{Deviations, Difference, Overlay},
    plot::Figures,
    report::Report,
    seeds::{self, joined},
    stages::{self, Choice},
    table::{ErrorsDeg, Scores, StageScore, TrialScore, Warning},
    tally::{Moment, Tally, Truth},
    timing::{SAMPLES_MAX, Step, ns_per_update},
    trial::{Gnss, Options, Trial},
    tune::{self, Tune},
    verdict::Verdict,
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
    /// The page to be written.
    pub report: Option<PathBuf>,
    /// What was asked, as it was typed, for the page.
    pub command: String,
    /// The setting whose best value is searched and used.
    pub tune: Option<Tune>,
    /// People are to be told every error.
    pub all_errors: bool,
}

/// Runs every stage over every trial, on all cores. `progress` is told the readings done, and of how many.
pub fn run(request: &Request, progress: &mut (dyn FnMut(u64, u64) + Send)) -> Result<Scores, ScoreError> {
    let mut launches = stages::launches(&request.choice)?;
    request.report.as_deref().map_or(Ok(()), has_folder)?;
    let entries = request.files.iter().map(|file| Entry::of(file)).collect::<Result<Vec<_>, _>>()?;
    let trials = trials(request, &entries)?;
    let rows: u64 = trials.iter().map(|trial| trial.rows).sum();
    let of = rows * if request.tune.is_some() { 1 + tune::LOOKS } else { 1 };
    let told = Mutex::new((0, progress));
    let tell = |more: u64| {
        let mut told = told.lock().unwrap_or_else(PoisonError::into_inner);
        told.0 += more;
        let done = told.0.min(of);
        (told.1)(done, of);
    };
    let tuned = match &request.tune {
        Some(tune) => tune::search(tune, &trials, &mut launches, &mut |more| tell(more))?,
        None => Vec::new(),
    };
    let mut scores = Scores {
        stages: launches.iter().map(StageScore::new).collect(),
        tuned,
        all_errors: request.all_errors,
        ..Scores::default()
    };
    let (mut overlays, mut heading_is_known) = (Vec::new(), true);
    let firsts = entries.iter().flat_map(|entry| (0..entry.trials.len()).map(|index| index == 0));
    let runs: Vec<_> = trials.iter().zip(firsts).collect();
    let outcomes = runs.par_iter().map(|(trial, is_first)| one(request, trial, &launches, *is_first, &tell));
    let mut outcomes = trials.iter().zip(outcomes.collect::<Result<Vec<_>, _>>()?);
    for Entry { name, trials } in &entries {
        let mut of_stages = vec![Vec::new(); launches.len()];
        for ((seed, _), (trial, outcome)) in trials.iter().zip(&mut outcomes) {
            let Outcome { all, warnings, overlay, heading } = outcome;
            of_stages.iter_mut().zip(all).for_each(|(of_stage, score)| of_stage.push((*seed, score)));
            scores.warnings.extend(warnings.into_iter().map(|text| Warning { trial: trial.name.clone(), text }));
            if let Some(overlay) = overlay {
                scores.differences.extend(differences(&overlay, &launches));
                overlays.push(overlay);
            }
            heading_is_known &= heading || !trial.has_reference;
        }
        for (stage, mut of_stage) in scores.stages.iter_mut().zip(of_stages) {
            let is_one = of_stage.len() == 1;
            let score = if is_one { of_stage.pop().map(|(_, score)| score) } else { Some(joined(name, &of_stage)) };
            stage.trials.extend(score);
        }
    }
    scores.stages.iter_mut().for_each(StageScore::finish);
    scores.choice = Verdict::of(&scores, heading_is_known);
    if let Some(path) = &request.report {
        let (command, ingest) = (&request.command, &request.choice.launch.ingest);
        Report { scores: &scores, overlays: &overlays, command, ingest, heading_is_known }.write(path)?;
    }
    Ok(scores)
}

/// What was asked for: a trial, or a simulation with many seeds.
struct Entry {
    name: String,
    /// The names of its trials, with the seed where there are many.
    trials: Vec<(u64, String)>,
}

impl Entry {
    fn of(text: &str) -> Result<Self, ScoreError> {
        let trials = seeds::each(text)?.unwrap_or_else(|| vec![(0, text.into())]);
        Ok(Self { name: text.into(), trials })
    }
}

/// There is a folder for the page: better told before the run than after it.
fn has_folder(path: &Path) -> Result<(), ScoreError> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    fs::metadata(folder).map(drop).map_err(|cause| ScoreError::Write { path: path.into(), cause })
}

/// How far the stages are apart where no reference tells which is right.
fn differences(overlay: &Overlay, launches: &[Launch]) -> Vec<Difference> {
    let Some((first, others)) = launches.split_first().filter(|_| !overlay.has_reference()) else { return Vec::new() };
    let apart = |(to, deviations): (&Launch, &Deviations)| Difference {
        trial: overlay.name.clone(),
        from: first.fuser.stage.clone(),
        to: to.fuser.stage.clone(),
        rms: deviations.rms(),
    };
    others.iter().zip(&overlay.differences).map(apart).collect()
}

/// The mean errors of launches over the trials that have a reference.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Errors {
    pub(crate) mean: ErrorsDeg,
    /// The course is counted from north at the end of every trial.
    pub(crate) heading_is_known: bool,
}

/// The errors of every launch, in one reading of each trial. `tell` is told the readings done.
pub(crate) fn errors_of(
    trials: &[Trial],
    launches: &[Launch],
    tell: &mut dyn FnMut(u64),
) -> Result<Vec<Errors>, ScoreError> {
    let mut found = vec![(Vec::new(), true); launches.len()];
    for trial in trials.iter().filter(|trial| trial.has_reference) {
        let all: Vec<_> = launches.iter().map(|launch| config(launch, trial)).collect();
        let lane = |config: &ServiceConfig| Lane::new(config, None, None);
        let mut lanes = all.iter().map(lane).collect::<Result<Vec<_>, _>>()?;
        let Some(first) = all.first() else { continue };
        let mut conditioner = ingest::conditioner(first)?;
        for reading in trial.readings()? {
            let Some(sample) = conditioner.condition(&reading?) else { continue };
            let truth = truth(&sample, None);
            lanes.iter_mut().try_for_each(|lane| lane.offer(&sample, truth))?;
        }
        for (lane, (errors, heading)) in lanes.iter().zip(&mut found) {
            errors.extend(lane.collector.accuracy().rmse());
            *heading &= lane.heading_is_known();
        }
        tell(trial.rows);
    }
    let errors = |(errors, heading_is_known)| Errors { mean: ErrorsDeg::of(Accuracy::mean(errors)), heading_is_known };
    Ok(found.into_iter().map(errors).collect())
}

fn trials(request: &Request, entries: &[Entry]) -> Result<Vec<Trial>, ScoreError> {
    if let (Gnss::File(fixes), trials @ 2..) = (&request.options.gnss, request.files.len()) {
        return Err(ScoreError::FixesOfOne { fixes: fixes.clone(), trials });
    }
    let mut names = HashSet::new();
    let mut trials = Vec::new();
    for (_, name) in entries.iter().flat_map(|entry| &entry.trials) {
        let trial = Trial::open(name, &request.options)?;
        if let Some(path) =
            request.report.as_ref().filter(|path| trial.file().is_some_and(|file| is_same_file(path, file)))
        {
            return Err(ScoreError::ReportIsTrial { path: path.clone() });
        }
        if !names.insert(trial.name.clone()) {
            return Err(ScoreError::NameTwice { name: trial.name });
        }
        trials.push(trial);
    }
    Ok(trials)
}

/// What became of a trial.
struct Outcome {
    all: Vec<TrialScore>,
    warnings: Vec<String>,
    overlay: Option<Overlay>,
    /// The course of every launch was counted from north in the end.
    heading: bool,
}

/// One trial through every launch, and what is to be said of its readings; the first of many seeds alone is timed and drawn. `tell` is told the
/// readings done.
fn one(
    request: &Request,
    trial: &Trial,
    launches: &[Launch],
    is_first: bool,
    tell: &(dyn Fn(u64) + Sync),
) -> Result<Outcome, ScoreError> {
    let all: Vec<_> = launches.iter().map(|launch| config(launch, trial)).collect();
    let mut lanes = all.iter().map(|config| lane(request, trial, config)).collect::<Result<Vec<_>, _>>()?;
    let differ = launches.len() > 1 && !trial.has_reference;
    let mut overlay = (is_first && (request.report.is_some() || differ))
        .then(|| Overlay::new(&trial.name, trial.rows, launches.len()));
    let mut conditioner = ingest::conditioner(all.first().unwrap_or(&config(&Launch::default(), trial)))?;
    let gyro_bias = trial.gyro_bias_rad_s().filter(|_| launches.iter().all(reads_as_it_is));
    let (mut judge, mut stamps, mut findings) = (Judge::default(), Stamps::default(), Vec::new());
    let mut steps = Vec::new();
    let mut told = 0;
    for (count, reading) in (0u64..).zip(trial.readings()?) {
        let reading = reading?;
        if count.is_multiple_of(PROGRESS_ROWS) {
            tell(count - told);
            told = count;
        }
        stamps.take(reading.t_ns);
        let Some(sample) = conditioner.condition(&reading) else { continue };
        findings.extend(judge.take(&sample.imu, sample.mag.as_ref()));
        if is_first && steps.len() < SAMPLES_MAX {
            steps.push(Step::new(&sample));
        }
        let truth = truth(&sample, gyro_bias.as_ref().map(|bias| bias(reading.t_ns)));
        for lane in &mut lanes {
            lane.offer(&sample, truth)?;
        }
        if let Some(overlay) = &mut overlay {
            let tick = sample.imu.header.tick;
            let attitudes: Vec<_> = lanes.iter().map(|lane| lane.attitude_at(tick)).collect();
            overlay.take(sample.imu.header.t_end_ns, sample.reference, &attitudes);
        }
    }
    tell(trial.rows.saturating_sub(told));
    overlay.iter_mut().for_each(Overlay::finish);
    let compared = launches.iter().map(Stages::of).collect::<Result<Vec<_>, _>>()?;
    let times = ns_per_update(&steps, &compared);
    findings.extend(judge.finish());
    let warnings = refusals(conditioner.refused(), &stamps).into_iter().chain(findings.iter().map(Finding::to_string));
    let heading = lanes.iter().all(Lane::heading_is_known);
    let scores = lanes.into_iter().zip(times).map(|(lane, ns)| lane.finish(trial, ns)).collect::<Result<_, _>>()?;
    Ok(Outcome { all: scores, warnings: warnings.collect(), overlay, heading })
}

/// What was refused of a trial, where anything was.
fn refusals(refused: u64, stamps: &Stamps) -> Option<String> {
    let Stamps { doubled, disordered, .. } = stamps;
    (refused + doubled + disordered > 0).then(|| {
        let refused = counted(refused, "reading");
        format!("{refused} refused; stamps equal to the one before: {doubled}, earlier: {disordered}")
    })
}

/// The truth at a tick, where there is one.
fn truth(sample: &Sample, gyro_bias_rad_s: Option<[f64; 3]>) -> Option<Truth> {
    sample.reference.map(|truth| Truth { quaternion: truth.quaternion, scored: truth.scored, gyro_bias_rad_s })
}

/// Neither calibration nor mounting is applied: what is wrong with the gyro is wrong with its rate in body axes.
fn reads_as_it_is(launch: &Launch) -> bool {
    let (ours, usual) = (&launch.ingest, Launch::default().ingest);
    ours.calibration.gyro == usual.calibration.gyro && ours.mounting == usual.mounting
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
    tally: Tally,
    figures: Option<Figures>,
    newest: Option<(AttitudeOutput, FusedState)>,
}

/// A lane that writes what the request asks for.
fn lane(request: &Request, trial: &Trial, config: &ServiceConfig) -> Result<Lane, ScoreError> {
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
    Lane::new(config, out, figures)
}

impl Lane {
    fn new(config: &ServiceConfig, out: Option<PathBuf>, figures: Option<Figures>) -> Result<Self, ScoreError> {
        Ok(Self {
            path: pipeline::Path::new(config)?,
            collector: Collector::new(out.map(OutFile::new).as_ref())?,
            tally: Tally::default(),
            figures,
            newest: None,
        })
    }

    fn attitude_at(&self, tick: u64) -> Option<[f64; 4]> {
        self.newest.filter(|(output, _)| output.header.tick == tick).map(|(output, _)| output.quaternion)
    }

    fn heading_is_known(&self) -> bool {
        self.newest.is_some_and(|(_, fused)| fused.course_reference != CourseReference::ARBITRARY)
    }

    fn offer(&mut self, sample: &Sample, truth: Option<Truth>) -> Result<(), RuntimeError> {
        let Self { path, collector, tally, figures, newest } = self;
        let tick = sample.imu.header.tick;
        if let Some(truth) = truth {
            collector.reference(Reference { tick, scored: truth.scored.into(), quaternion: truth.quaternion });
        }
        let state = Cell::new(None);
        path.offer_seen(*sample, &mut |fused| state.set(Some(*fused)), &mut |output| {
            collector.attitude(&output);
            let Some(fused) = state.get() else { return };
            *newest = Some((output, fused));
            if let Some(truth) = truth.filter(|truth| truth.scored) {
                tally.take(&Moment::of(&output, &fused, &truth), &output, &fused);
            }
            if let Some(figures) = figures {
                figures.take(&sample.imu, sample.reference, &output);
            }
        })
    }

    fn finish(mut self, trial: &Trial, ns_per_update: Option<f64>) -> Result<TrialScore, ScoreError> {
        self.collector.finish()?;
        if let Some(figures) = &mut self.figures {
            figures.write()?;
        }
        let accuracy = self.collector.accuracy();
        let heading_is_known = self.heading_is_known();
        let error = self.tally.errors(ErrorsDeg::of(accuracy.rmse()));
        let deviations = self.tally.into_deviations();
        Ok(TrialScore {
            name: trial.name.clone(),
            error,
            heading_is_known,
            normalised: deviations.told(),
            deviations,
            scored: accuracy.count(),
            ticks: self.collector.ticks(),
            ns_per_update,
            spread: None,
        })
    }
}
