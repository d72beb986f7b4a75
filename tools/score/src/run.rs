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

use ingest::conditioner::Sample;
use judge::{Diagnosis, InputCheck, TimestampCheck};
use launch::{Launch, Source, pluralize};
use messages::{AttitudeOutput, CourseReference, FusedState, Reference};
use pipeline::{Collector, OutFile, is_same_file};
use rayon::prelude::*;
use runtime::{Pace, ServiceConfig};

use crate::{
    ScoreError,
    chain::Stages,
    csv::Csv,
    overlay::{Deviations, Difference, Overlay},
    plot::{Pen, Plots, Record},
    report::Report,
    seeds::{self, joined},
    stages::{self, Choice},
    table::{Errors, ErrorsDeg, Scores, StageScore, TrialScore, Warning},
    tally::{Moment, Tally, Truth},
    timing::{MAX_SAMPLES, Step, ns_per_update},
    trial::{Gnss, Options, Trial},
    tune::{self, Range},
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
    /// Folder for what was said at each tick, and the truth beside it.
    pub csv: Option<PathBuf>,
    /// Figures.
    pub plot: Option<Plots>,
    /// The page to be written.
    pub report: Option<PathBuf>,
    /// What was asked, as it was typed, for the page.
    pub command: String,
    /// The settings whose ranges are gone through, each with the others as they are.
    pub sweeps: Vec<Range>,
    /// The setting whose best value is searched and used.
    pub tune: Option<Range>,
    /// People are to be told every error.
    pub all_errors: bool,
}

/// Runs every stage over every trial, on all cores. `progress` is told the readings done, and of how many.
pub fn run(request: &Request, progress: &mut (dyn FnMut(u64, u64) + Send)) -> Result<Scores, ScoreError> {
    let mut launches = stages::launches(&request.choice)?;
    request.report.as_deref().map_or(Ok(()), has_folder)?;
    let entries = request.files.iter().map(|file| Entry::of(file)).collect::<Result<Vec<_>, _>>()?;
    let trials = trials(request, &entries)?;
    let pen = request.plot.as_ref().map(Pen::new).transpose()?;
    let rows: u64 = trials.iter().map(|trial| trial.rows).sum();
    let looks = request.tune.as_ref().map_or(0, |_| tune::LOOKS) + request.sweeps.len() as u64;
    let of = rows * (1 + looks);
    let told = Mutex::new((0, progress));
    let tell = |more: u64| {
        let mut told = told.lock().unwrap_or_else(PoisonError::into_inner);
        told.0 += more;
        let done = told.0.min(of);
        (told.1)(done, of);
    };
    let mut swept = Vec::new();
    for range in &request.sweeps {
        swept.extend(tune::sweep(range, &trials, &launches, &tell)?);
    }
    let tuned = match &request.tune {
        Some(range) => tune::search(range, &trials, &mut launches, &tell)?,
        None => Vec::new(),
    };
    let mut scores = Scores {
        stages: launches.iter().map(StageScore::new).collect(),
        swept,
        tuned,
        all_errors: request.all_errors,
        ..Scores::default()
    };
    let (mut overlays, mut heading_is_known) = (Vec::new(), true);
    let firsts = entries.iter().flat_map(|entry| (0..entry.trials.len()).map(|index| index == 0));
    let runs: Vec<_> = trials.iter().zip(firsts).collect();
    let outcomes =
        runs.par_iter().map(|(trial, is_first)| one(request, pen.as_ref(), trial, &launches, *is_first, &tell));
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
            heading_is_known &= heading;
        }
        for (stage, mut of_stage) in scores.stages.iter_mut().zip(of_stages) {
            let is_one = of_stage.len() == 1;
            let score = if is_one { of_stage.pop().map(|(_, score)| score) } else { Some(joined(name, &of_stage)) };
            stage.trials.extend(score);
        }
    }
    scores.stages.iter_mut().for_each(StageScore::finish);
    if let (Some(pen), Some(plots)) = (&pen, &request.plot) {
        made(&plots.folder)?;
        pen.sweeps(&scores.swept)?;
    }
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

/// The mean errors of a launch over the trials that have a reference.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Found {
    pub(crate) mean: Errors,
    /// The course is counted from north at the end of every trial.
    pub(crate) heading_is_known: bool,
}

/// The errors of every launch, on all cores, each trial read once by each of them. `tell` is told the readings done.
pub(crate) fn errors_of(
    trials: &[Trial],
    launches: &[Launch],
    tell: &(dyn Fn(u64) + Sync),
) -> Result<Vec<Found>, ScoreError> {
    if launches.is_empty() {
        return Ok(Vec::new());
    }
    let cores = rayon::current_num_threads().max(1);
    let shares: Vec<_> = launches.chunks(launches.len().div_ceil(cores)).collect();
    let known = trials.iter().filter(|trial| trial.has_reference);
    let jobs: Vec<_> = known.flat_map(|trial| shares.iter().map(move |share| (trial, *share))).collect();
    let done = jobs.par_iter().map(|(trial, share)| {
        let found = errors_of_trial(trial, share)?;
        tell(trial.rows / shares.len() as u64);
        Ok(found)
    });
    let done: Vec<Vec<_>> = done.collect::<Result<_, ScoreError>>()?;
    let of_trials: Vec<Vec<(Errors, bool)>> = done.chunks(shares.len()).map(<[_]>::concat).collect();
    let mean = |at: usize| {
        let errors: Vec<_> = of_trials.iter().map(|of_trial| of_trial[at].0).collect();
        let heading_is_known = of_trials.iter().all(|of_trial| of_trial[at].1);
        Found { mean: Errors::mean(&errors), heading_is_known }
    };
    Ok((0..launches.len()).map(mean).collect())
}

/// Of each launch its errors over a trial, and whether its heading is known in the end.
fn errors_of_trial(trial: &Trial, launches: &[Launch]) -> Result<Vec<(Errors, bool)>, ScoreError> {
    let all: Vec<_> = launches.iter().map(|launch| config(launch, trial)).collect();
    let lane = |config: &ServiceConfig| Lane::new(config, Files::default());
    let mut lanes = all.iter().map(lane).collect::<Result<Vec<_>, _>>()?;
    let Some(first) = all.first() else { return Ok(Vec::new()) };
    let mut conditioner = ingest::conditioner(first)?;
    let gyro_bias = gyro_bias(trial, launches);
    for reading in trial.readings()? {
        let reading = reading?;
        let Some(sample) = conditioner.condition(&reading) else { continue };
        let truth = truth(&sample, gyro_bias.as_ref().map(|bias| bias(reading.t_ns)));
        lanes.iter_mut().try_for_each(|lane| lane.offer(&sample, truth.as_ref()))?;
    }
    Ok(lanes.iter().map(|lane| (lane.errors(), lane.tally.heading_is_known() != Some(false))).collect())
}

fn trials(request: &Request, entries: &[Entry]) -> Result<Vec<Trial>, ScoreError> {
    if let (Gnss::File(fixes), trials @ 2..) = (&request.options.gnss, request.files.len()) {
        return Err(ScoreError::FixesOfOne { fixes: fixes.clone(), trials });
    }
    let names: Vec<_> = entries.iter().flat_map(|entry| &entry.trials).map(|(_, name)| name).collect();
    let opened = names.par_iter().map(|name| Trial::open(name, &request.options));
    let trials = opened.collect::<Vec<_>>().into_iter().collect::<Result<Vec<_>, _>>()?;
    let mut names = HashSet::new();
    for trial in &trials {
        let is_trial = |path: &&PathBuf| trial.file().is_some_and(|file| is_same_file(path, file));
        if let Some(path) = request.report.as_ref().filter(is_trial) {
            return Err(ScoreError::ReportIsTrial { path: path.clone() });
        }
        if !names.insert(&trial.name) {
            return Err(ScoreError::NameTwice { name: trial.name.clone() });
        }
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
    pen: Option<&Pen<'_>>,
    trial: &Trial,
    launches: &[Launch],
    is_first: bool,
    tell: &(dyn Fn(u64) + Sync),
) -> Result<Outcome, ScoreError> {
    let all: Vec<_> = launches.iter().map(|launch| config(launch, trial)).collect();
    let lane = |config| Lane::new(config, files(request, trial, config, is_first)?);
    let mut lanes = all.iter().map(lane).collect::<Result<Vec<_>, _>>()?;
    let differ = launches.len() > 1 && !trial.has_reference;
    let mut overlay = (is_first && (request.report.is_some() || differ))
        .then(|| Overlay::new(&trial.name, trial.rows, launches.len()));
    let mut conditioner = ingest::conditioner(all.first().unwrap_or(&config(&Launch::default(), trial)))?;
    let gyro_bias = gyro_bias(trial, launches);
    let (mut judge, mut stamps, mut findings) = (InputCheck::default(), TimestampCheck::default(), Vec::new());
    let mut steps = Vec::new();
    let mut told = 0;
    for (count, reading) in (0u64..).zip(trial.readings()?) {
        let reading = reading?;
        if count.is_multiple_of(PROGRESS_ROWS) {
            tell(count - told);
            told = count;
        }
        stamps.push(reading.t_ns);
        let Some(sample) = conditioner.condition(&reading) else { continue };
        findings.extend(judge.update(&sample.imu, sample.mag.as_ref()));
        if is_first && steps.len() < MAX_SAMPLES {
            steps.push(Step::new(&sample));
        }
        let truth = truth(&sample, gyro_bias.as_ref().map(|bias| bias(reading.t_ns)));
        for lane in &mut lanes {
            lane.offer(&sample, truth.as_ref())?;
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
    let nothing_counts = trial.has_reference && lanes.iter().all(|lane| lane.collector.accuracy().count() == 0);
    let warnings = refusals(conditioner.refused(), &stamps).into_iter().chain(findings.iter().map(Diagnosis::to_string));
    let why = if trial.name.starts_with("sim:") { SIMULATION_ENDS } else { NOTHING_COUNTS };
    let warnings = warnings.chain((nothing_counts && is_first).then(|| why.into()));
    let heading = lanes.iter().all(|lane| lane.tally.heading_is_known() != Some(false));
    if let Some(pen) = pen.filter(|_| is_first) {
        draw(request, pen, trial, &all, &mut lanes)?;
    }
    let scores = lanes.into_iter().zip(times).map(|(lane, ns)| lane.finish(trial, ns)).collect::<Result<_, _>>()?;
    Ok(Outcome { all: scores, warnings: warnings.collect(), overlay, heading })
}

/// Each lane's figures, and those of all lanes together where there are several.
fn draw(
    request: &Request,
    pen: &Pen<'_>,
    trial: &Trial,
    all: &[ServiceConfig],
    lanes: &mut [Lane],
) -> Result<(), ScoreError> {
    let Some(plots) = &request.plot else { return Ok(()) };
    let nothing = lanes.iter().find_map(|lane| lane.files.record.as_deref()?.shows_nothing_until_s());
    if let Some(end_s) = nothing {
        let Plots { from_s, to_s, .. } = *plots;
        return Err(ScoreError::NothingToDraw { trial: trial.name.clone(), from_s, to_s, end_s });
    }
    lanes.iter_mut().filter_map(|lane| lane.files.record.as_deref_mut()).for_each(Record::finish);
    let records: Vec<_> = lanes.iter().filter_map(|lane| lane.files.record.as_deref()).collect();
    for (config, record) in all.iter().zip(&records) {
        pen.one(&place(request, trial, config, &plots.folder, "")?, &trial.name, &config.launch, record)?;
    }
    let launches: Vec<_> = all.iter().map(|config| config.launch.clone()).collect();
    let together = plots.folder.join(trial.file_stem());
    if records.len() > 1 { pen.all(&together, &trial.name, &launches, &records) } else { Ok(()) }
}

/// Why a trial with a truth has no score.
const SIMULATION_ENDS: &str = "nothing is scored: it ends before it counts; give it a longer duration_s";
const NOTHING_COUNTS: &str = "nothing is scored: no sample that counts (column `mov`) has a truth; see that --reference is on the clock of the recording";

/// What was refused of a trial, where anything was.
fn refusals(refused: u64, stamps: &TimestampCheck) -> Option<String> {
    let TimestampCheck { repeated: doubled, out_of_order: disordered, .. } = stamps;
    (refused + doubled + disordered > 0).then(|| {
        let refused = pluralize(refused, "reading");
        format!("{refused} refused; stamps equal to the one before: {doubled}, earlier: {disordered}")
    })
}

/// The truth at a tick, where there is one.
fn truth(sample: &Sample, gyro_bias_rad_s: Option<[f64; 3]>) -> Option<Truth> {
    sample.reference.map(|truth| Truth { quaternion: truth.quaternion, scored: truth.scored, gyro_bias_rad_s })
}

/// What the gyro reads too much in body axes at a time, ns: known of a simulation to whose rate neither calibration nor mounting is applied.
fn gyro_bias(trial: &Trial, launches: &[Launch]) -> Option<impl Fn(i64) -> [f64; 3] + use<>> {
    let usual = Launch::default().ingest;
    let as_it_is = |launch: &Launch| {
        launch.ingest.calibration.gyro == usual.calibration.gyro && launch.ingest.mounting == usual.mounting
    };
    trial.gyro_bias_rad_s().filter(|_| launches.iter().all(as_it_is))
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
        max_ticks: None,
        incarnation: 0,
        epoch: runtime::service_config::FIRST_EPOCH,
        role: runtime::Role::Owner { from_tick: 0 },
        prior: None,
        resume: None,
        publishes_readings: false,
        supervisor_pid: std::process::id(),
    }
}

/// One path through the slots, and what becomes of its attitudes.
struct Lane {
    path: pipeline::Path,
    collector: Collector,
    tally: Tally,
    files: Files,
    /// What was said at the tick.
    said: Vec<(AttitudeOutput, FusedState)>,
    newest: Option<(AttitudeOutput, FusedState)>,
}

/// What is made of a lane beside its score.
#[derive(Default)]
struct Files {
    out: Option<PathBuf>,
    csv: Option<Csv>,
    record: Option<Box<Record>>,
}

/// The files that the request asks for; only the first of many seeds is drawn.
fn files(request: &Request, trial: &Trial, config: &ServiceConfig, is_first: bool) -> Result<Files, ScoreError> {
    let table = |folder: &Option<PathBuf>| {
        let Some(folder) = folder else { return Ok(None) };
        let path = place(request, trial, config, folder, ".csv")?;
        let is_trial = trial.file().is_some_and(|file| is_same_file(&path, file));
        if is_trial { Err(ScoreError::OutIsTrial { path }) } else { Ok(Some(path)) }
    };
    let record = |plots: &Plots| Record::new(plots, config, trial.rows).map(Box::new);
    Ok(Files {
        out: table(&request.out)?,
        csv: table(&request.csv)?.map(|path| Csv::create(path, config)).transpose()?,
        record: request.plot.as_ref().filter(|_| is_first).map(record).transpose()?,
    })
}

/// Where a file of a lane is: with several fusers in a folder for each.
fn place(
    request: &Request,
    trial: &Trial,
    config: &ServiceConfig,
    folder: &Path,
    ending: &str,
) -> Result<PathBuf, ScoreError> {
    let several = request.choice.fusers.len() > 1;
    let folder = if several { folder.join(&config.launch.fuser.stage) } else { folder.to_path_buf() };
    made(&folder)?;
    Ok(folder.join(format!("{}{ending}", trial.file_stem())))
}

fn made(folder: &Path) -> Result<(), ScoreError> {
    fs::create_dir_all(folder).map_err(|cause| ScoreError::Write { path: folder.into(), cause })
}

impl Lane {
    fn new(config: &ServiceConfig, files: Files) -> Result<Self, ScoreError> {
        Ok(Self {
            path: pipeline::Path::new(config)?,
            collector: Collector::new(files.out.as_ref().map(OutFile::new).as_ref())?,
            tally: Tally::default(),
            files,
            said: Vec::new(),
            newest: None,
        })
    }

    fn attitude_at(&self, tick: u64) -> Option<[f64; 4]> {
        self.newest.filter(|(output, _)| output.header.tick == tick).map(|(output, _)| output.quaternion)
    }

    /// Where something is scored, at the last tick that is; else at the last.
    fn heading_is_known(&self) -> bool {
        let in_the_end = || self.newest.is_some_and(|(_, fused)| fused.course_reference != CourseReference::ARBITRARY);
        self.tally.heading_is_known().unwrap_or_else(in_the_end)
    }

    fn errors(&self) -> Errors {
        self.tally.errors(ErrorsDeg::of(self.collector.accuracy().rmse()))
    }

    fn offer(&mut self, sample: &Sample, truth: Option<&Truth>) -> Result<(), ScoreError> {
        let Self { path, collector, tally, files, said, newest } = self;
        let tick = sample.imu.header.tick;
        if let Some(truth) = truth {
            collector.reference(Reference { tick, scored: truth.scored.into(), quaternion: truth.quaternion });
        }
        let state = Cell::new(None);
        said.clear();
        path.offer_seen(*sample, &mut |fused| state.set(Some(*fused)), &mut |output| {
            said.extend(state.get().map(|fused| (output, fused)));
        })?;
        for (output, fused) in said.iter() {
            collector.attitude(output);
            *newest = Some((*output, *fused));
            let moment = truth.map(|truth| (truth, Moment::of(output, fused, truth)));
            if let Some((_, moment)) = moment.as_ref().filter(|(truth, _)| truth.scored) {
                tally.take(moment, output, fused);
            }
            if let Some(record) = &mut files.record {
                record.take(&sample.imu, moment.as_ref().map(|(truth, moment)| (*truth, moment)), output, fused);
            }
            if let Some(csv) = &mut files.csv {
                csv.take(&sample.imu, output, fused, truth)?;
            }
        }
        Ok(())
    }

    fn finish(mut self, trial: &Trial, ns_per_update: Option<f64>) -> Result<TrialScore, ScoreError> {
        self.collector.finish()?;
        self.files.csv.take().map_or(Ok(()), Csv::finish)?;
        let (error, heading_is_known) = (self.errors(), self.heading_is_known());
        let deviations = self.tally.into_deviations();
        Ok(TrialScore {
            name: trial.name.clone(),
            error,
            heading_is_known,
            normalised: deviations.told(),
            deviations,
            scored: self.collector.accuracy().count(),
            ticks: self.collector.ticks(),
            ns_per_update,
            spread: None,
        })
    }
}
