//! Runs the selected stages over all trials, in the slots of the real system.
//!
//! Input: a [`Request`].
//!
//! Output: the scores, and the requested files.
//!
//! Time: sample timestamps.
//!
//! Failure: the first error ends the run. Every recording is validated before any recording is
//! scored.

use std::{
    collections::HashSet,
    fs,
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
};

use judge::{Diagnosis, InputCheck, TimestampCheck};
use launch::{Launch, pluralize};
use messages::Flags;
use pipeline::is_same_file;
use rayon::prelude::*;
use runtime::ServiceConfig;

use crate::{
    ScoreError,
    chain::StageChain,
    csv::TickTable,
    estimate::Estimate,
    evaluation::{ChainRun, TrialOutputs, config, gyro_bias, truth},
    overlay::{ErrorCurves, Overlay},
    plot::{PlotOptions, PlotRecord, Plotter, chain_label},
    report::HtmlReport,
    seeds::{self, merge},
    stages::{self, StageSelection},
    table::{Recommendation, Scores, StageDifference, StageScore, TrialScore, TrialWarning},
    timing::{MAX_SAMPLES, StageInput, ns_per_update},
    trial::{Gnss, Trial, TrialOptions, validate_references},
    tune::{self, SettingRange},
};

/// Number of readings between two progress reports.
const PROGRESS_ROWS: u64 = 1024;

/// Trials, stages and outputs of a scoring run.
#[derive(Debug, Clone, Default)]
pub struct Request {
    /// Names of the trials: files, or simulations such as `sim:s1`.
    pub files: Vec<String>,
    /// Files imported from a format with defined axes, to which `--frame` does not apply.
    pub files_with_axes: Vec<String>,
    /// Options for reading the trials.
    pub options: TrialOptions,
    /// Selected stages and settings.
    pub selection: StageSelection,
    /// Attitudes that other programs have estimated for the only trial, scored in addition to the
    /// stages.
    pub estimates: Vec<Estimate>,
    /// Folder for the attitude of each tick, for stages only.
    pub out: Option<PathBuf>,
    /// Folder for the tables with estimates and reference of each tick.
    pub csv: Option<PathBuf>,
    /// Options for the figures; `None` if no figures are requested.
    pub plot: Option<PlotOptions>,
    /// File for the HTML report.
    pub report: Option<PathBuf>,
    /// Command line, shown in the report.
    pub command: String,
    /// Settings to evaluate over a range, each with the other settings unchanged.
    pub sweeps: Vec<SettingRange>,
    /// Setting to optimise over a range.
    pub tune: Option<SettingRange>,
    /// `true` if the text output also contains the tables of all errors and of normalised errors.
    pub prints_all_errors: bool,
}

/// Runs every chain over every trial, on all cores.
///
/// `progress` is called with the number of readings processed and their total.
///
/// # Errors
///
/// Returns the first error: an invalid selection or setting, an unreadable trial, or an output that
/// cannot be written.
pub fn run(request: &Request, progress: &mut (dyn FnMut(u64, u64) + Send)) -> Result<Scores, ScoreError> {
    let mut launches = stages::launches(&request.selection)?;
    validate_estimates(request, &launches)?;
    request.report.as_deref().map_or(Ok(()), check_parent_folder)?;
    let groups = request.files.iter().map(|file| TrialGroup::from_argument(file)).collect::<Result<Vec<_>, _>>()?;
    let trials = open_trials(request, &groups)?;
    let plotter = request.plot.as_ref().map(Plotter::new);
    let rows: u64 = trials.iter().map(|trial| trial.rows).sum();
    let passes = request.tune.as_ref().map_or(0, |_| tune::SEARCH_PASSES) + request.sweeps.len() as u64;
    let total = rows * (1 + passes);
    let progress_state = Mutex::new((0, progress));
    let report_progress = |more: u64| {
        let mut state = progress_state.lock().unwrap_or_else(PoisonError::into_inner);
        state.0 += more;
        let done = state.0.min(total);
        (state.1)(done, total);
    };
    let mut swept = Vec::new();
    for range in &request.sweeps {
        swept.extend(tune::sweep(range, &trials, &launches, &report_progress)?);
    }
    let tuned = match &request.tune {
        Some(range) => tune::search(range, &trials, &mut launches, &report_progress)?,
        None => Vec::new(),
    };
    let mut scores = Scores {
        stages: (launches.iter().map(StageScore::new))
            .chain(request.estimates.iter().map(|estimate| StageScore::from_estimate(&estimate.name)))
            .collect(),
        swept,
        tuned,
        prints_all_errors: request.prints_all_errors,
        ..Scores::default()
    };
    let (mut overlays, mut heading_is_known) = (Vec::new(), true);
    let is_first = groups.iter().flat_map(|group| (0..group.trials.len()).map(|index| index == 0));
    let jobs: Vec<_> = trials.iter().zip(is_first).collect();
    let outcomes = jobs
        .par_iter()
        .map(|(trial, is_first)| run_trial(request, plotter.as_ref(), trial, &launches, *is_first, &report_progress));
    let mut outcomes = trials.iter().zip(outcomes.collect::<Result<Vec<_>, _>>()?);
    for TrialGroup { name, trials } in &groups {
        let mut stage_scores = vec![Vec::new(); scores.stages.len()];
        for ((seed, _), (trial, outcome)) in trials.iter().zip(&mut outcomes) {
            let TrialOutcome { scores: chain_scores, warnings, overlay, heading_is_known: trial_heading_is_known } =
                outcome;
            stage_scores
                .iter_mut()
                .zip(chain_scores)
                .for_each(|(scores_by_seed, score)| scores_by_seed.push((*seed, score)));
            scores.warnings.extend(warnings.into_iter().map(|text| TrialWarning { trial: trial.name.clone(), text }));
            if let Some(overlay) = overlay {
                scores.differences.extend(differences(&overlay, &names(request, &launches)));
                overlays.push(overlay);
            }
            heading_is_known &= trial_heading_is_known;
        }
        for (stage, mut scores_by_seed) in scores.stages.iter_mut().zip(stage_scores) {
            let is_single = scores_by_seed.len() == 1;
            let score = if is_single {
                scores_by_seed.pop().map(|(_, score)| score)
            } else {
                Some(merge(name, &scores_by_seed))
            };
            stage.trials.extend(score);
        }
    }
    scores.stages.iter_mut().for_each(StageScore::update_means);
    if let (Some(plotter), Some(plots)) = (&plotter, &request.plot) {
        create_folder(&plots.folder)?;
        plotter.draw_sweeps(&scores.swept)?;
    }
    scores.recommendation = Recommendation::from_scores(&scores, heading_is_known);
    if let Some(path) = &request.report {
        let (command, ingest) = (&request.command, &request.selection.launch.ingest);
        HtmlReport { scores: &scores, overlays: &overlays, command, ingest, heading_is_known }.write(path)?;
    }
    Ok(scores)
}

/// Command-line argument: a single trial, or a simulation with many seeds.
struct TrialGroup {
    name: String,
    /// Seed and name of each trial.
    trials: Vec<(u64, String)>,
}

impl TrialGroup {
    fn from_argument(text: &str) -> Result<Self, ScoreError> {
        let trials = seeds::expand(text)?.unwrap_or_else(|| vec![(0, text.into())]);
        Ok(Self { name: text.into(), trials })
    }
}

/// Returns an error if the parent folder of `path` does not exist.
///
/// This is checked first, so that a long run does not fail at its end.
fn check_parent_folder(path: &Path) -> Result<(), ScoreError> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    fs::metadata(folder).map(drop).map_err(|cause| ScoreError::Write { path: path.into(), cause })
}

/// Returns the names of all chains and estimates. A chain has the name of its fuser.
fn names(request: &Request, launches: &[Launch]) -> Vec<String> {
    let estimates = request.estimates.iter().map(|estimate| estimate.name.clone());
    launches.iter().map(|launch| launch.fuser.stage.clone()).chain(estimates).collect()
}

/// Returns an error if an estimate is invalid.
///
/// The name of an estimate must be unique and suitable as a file name, the file must be readable,
/// and there must be only one trial.
fn validate_estimates(request: &Request, launches: &[Launch]) -> Result<(), ScoreError> {
    let mut taken: HashSet<&str> = launches.iter().map(|launch| launch.fuser.stage.as_str()).collect();
    for Estimate { name, file, .. } in &request.estimates {
        if name.is_empty()
            || name.starts_with('.')
            || name.contains(|letter: char| letter == '/' || letter.is_control())
        {
            return Err(ScoreError::InvalidEstimateName { name: name.clone() });
        }
        if !taken.insert(name) {
            return Err(ScoreError::DuplicateEstimate { name: name.clone() });
        }
        validate_references(file)?;
    }
    Ok(())
}

/// Returns the differences between the chains on a trial without a reference. `names` contains the
/// names of the chains.
fn differences(overlay: &Overlay, names: &[String]) -> Vec<StageDifference> {
    let Some((first, others)) = names.split_first().filter(|_| !overlay.has_reference()) else { return Vec::new() };
    let difference = |(to, curves): (&String, &ErrorCurves)| StageDifference {
        trial: overlay.name.clone(),
        from: first.clone(),
        to: to.clone(),
        rms: curves.rms(),
    };
    others.iter().zip(&overlay.differences).map(difference).collect()
}

fn open_trials(request: &Request, groups: &[TrialGroup]) -> Result<Vec<Trial>, ScoreError> {
    if let (Gnss::File(fixes), trials @ 2..) = (&request.options.gnss, request.files.len()) {
        return Err(ScoreError::FixesForSeveralTrials { fixes: fixes.clone(), trials });
    }
    let names: Vec<_> = groups.iter().flat_map(|group| &group.trials).map(|(_, name)| name).collect();
    if let ([Estimate { name, .. }, ..], trials @ 2..) = (&request.estimates[..], names.len()) {
        return Err(ScoreError::EstimateForSeveralTrials { name: name.clone(), trials });
    }
    let opened = names.par_iter().map(|name| Trial::open(name, &request.options));
    let trials = opened.collect::<Vec<_>>().into_iter().collect::<Result<Vec<_>, _>>()?;
    let mut names = HashSet::new();
    for trial in &trials {
        let is_trial = |path: &&PathBuf| trial.file().is_some_and(|file| is_same_file(path, file));
        if let Some(path) = request.report.as_ref().filter(is_trial) {
            return Err(ScoreError::ReportIsRecording { path: path.clone() });
        }
        if !names.insert(&trial.name) {
            return Err(ScoreError::DuplicateTrialName { name: trial.name.clone() });
        }
    }
    Ok(trials)
}

/// Result of a trial for all chains.
struct TrialOutcome {
    scores: Vec<TrialScore>,
    warnings: Vec<String>,
    overlay: Option<Overlay>,
    /// `true` if the heading of every chain is known at the end.
    heading_is_known: bool,
}

/// Runs one trial through every chain and checks its input.
///
/// If a simulation is repeated with many seeds, only the first one is timed and drawn.
/// `report_progress` is called with the number of readings processed since its last call.
fn run_trial(
    request: &Request,
    plotter: Option<&Plotter<'_>>,
    trial: &Trial,
    launches: &[Launch],
    is_first: bool,
    report_progress: &(dyn Fn(u64) + Sync),
) -> Result<TrialOutcome, ScoreError> {
    let configs: Vec<_> = launches.iter().map(|launch| config(launch, trial)).collect();
    let default_config = config(&Launch::default(), trial);
    let first_config = configs.first().unwrap_or(&default_config);
    let chain_run = |config: &ServiceConfig| {
        let name = &config.launch.fuser.stage;
        ChainRun::new(config, create_outputs(request, trial, config, name, request.out.as_deref(), is_first)?)
    };
    let estimate_run = |estimate: &Estimate| {
        let outputs = create_outputs(request, trial, first_config, &estimate.name, None, is_first)?;
        ChainRun::from_estimate(estimate, outputs)
    };
    let mut chain_runs = (configs.iter().map(chain_run))
        .chain(request.estimates.iter().map(estimate_run))
        .collect::<Result<Vec<_>, _>>()?;
    let compares_stages = chain_runs.len() > 1 && !trial.has_reference;
    let mut overlay = (is_first && (request.report.is_some() || compares_stages))
        .then(|| Overlay::new(&trial.name, trial.rows, chain_runs.len()));
    let mut conditioner = readings::conditioner(first_config)?;
    let gyro_bias = gyro_bias(trial, launches);
    let (mut input_check, mut timestamp_check, mut findings) =
        (InputCheck::default(), TimestampCheck::default(), Vec::new());
    let mut steps = Vec::new();
    let (mut reported, mut ticks, mut scored_ticks, mut ticks_without_rate) = (0, 0, 0, 0);
    for (count, reading) in (0u64..).zip(trial.readings()?) {
        let reading = reading?;
        if count.is_multiple_of(PROGRESS_ROWS) {
            report_progress(count - reported);
            reported = count;
        }
        timestamp_check.push(reading.t_ns);
        let Some(sample) = conditioner.condition(&reading) else { continue };
        findings.extend(input_check.update(&sample.imu, sample.mag.as_ref()));
        if is_first && steps.len() < MAX_SAMPLES {
            steps.push(StageInput::new(&sample));
        }
        ticks += 1;
        ticks_without_rate += u64::from(sample.imu.header.flags.any(Flags::RATE_INVALID));
        scored_ticks += u64::from(sample.reference.is_some_and(|truth| truth.scored));
        let truth = truth(&sample, gyro_bias.as_ref().map(|bias| bias(reading.t_ns)));
        for chain_run in &mut chain_runs {
            chain_run.process(&sample, truth.as_ref())?;
        }
        if let Some(overlay) = &mut overlay {
            let tick = sample.imu.header.tick;
            let attitudes: Vec<_> = chain_runs.iter().map(|chain_run| chain_run.attitude_at(tick)).collect();
            overlay.push(sample.imu.header.t_end_ns, sample.reference, &attitudes);
        }
    }
    report_progress(trial.rows.saturating_sub(reported));
    overlay.iter_mut().for_each(Overlay::finish);
    let compared = launches.iter().map(StageChain::from_launch).collect::<Result<Vec<_>, _>>()?;
    let times = ns_per_update(&steps, &compared);
    findings.extend(input_check.finish());
    let nothing_scored =
        trial.has_reference && chain_runs.iter().all(|chain_run| chain_run.collector.accuracy().count() == 0);
    let warnings = rejection_warning(conditioner.rejected(), &timestamp_check)
        .into_iter()
        .chain(missing_rate_warning(ticks_without_rate, ticks))
        .chain(findings.iter().map(Diagnosis::to_string));
    let no_score_reason = if trial.name.raw().starts_with("sim:") { SIMULATION_TOO_SHORT } else { NO_SCORED_REFERENCE };
    let warnings = warnings.chain((nothing_scored && is_first).then(|| no_score_reason.into()));
    // The remedies apply to stages only, not to estimates from files.
    let mut stage_runs = chain_runs.iter().take(launches.len());
    let heading_offset = stage_runs.find_map(|chain_run| chain_run.stats.constant_heading_error_deg());
    // A wrong unit or axis also causes a heading offset, and its warning has a separate remedy.
    let heading_offset = heading_offset.filter(|_| findings.is_empty());
    let has_axes = |path: &Path| request.files_with_axes.iter().any(|file| Path::new(file) == path);
    let has_axes = trial.file().is_none_or(has_axes);
    let warnings = warnings.chain(heading_offset.map(|offset_deg| heading_offset_warning(offset_deg, has_axes)));
    let estimate_runs = chain_runs.iter().skip(launches.len()).zip(&request.estimates);
    let warnings = warnings.chain(estimate_runs.filter_map(|(run, Estimate { name, .. })| {
        let (found, of, what) = match scored_ticks {
            0 => (run.collector.ticks(), ticks, "samples"),
            _ => (run.collector.accuracy().count(), scored_ticks, "scored samples"),
        };
        coverage_warning(name, found, of, what)
    }));
    let warnings: Vec<_> = warnings.collect();
    let heading_is_known = chain_runs.iter().all(|chain_run| chain_run.stats.heading_is_known() != Some(false));
    if let Some(plotter) = plotter.filter(|_| is_first) {
        draw(request, plotter, trial, &configs, &mut chain_runs)?;
    }
    let scores = chain_runs
        .into_iter()
        .zip(times.into_iter().chain(std::iter::repeat(None)))
        .map(|(chain_run, ns)| chain_run.finish(trial, ns))
        .collect::<Result<_, _>>()?;
    Ok(TrialOutcome { scores, warnings, overlay, heading_is_known })
}

/// Returns a warning about a constant heading error of `offset_deg` degrees, positive
/// counter-clockwise.
///
/// `has_axes` is `true` if the format of the trial defines its axes.
fn heading_offset_warning(offset_deg: f64, has_axes: bool) -> String {
    /// Largest magnetic declination away from the poles, degrees.
    const MAX_DECLINATION_DEG: f64 = 40.0;
    /// Maximum deviation in degrees from a multiple of 90° at which a heading offset is attributed
    /// to exchanged axes.
    const MAX_AXES_ERROR_DEG: f64 = 15.0;
    let from_axes_deg = offset_deg - (offset_deg / 90.0).round() * 90.0;
    let cause = if offset_deg.abs() < MAX_DECLINATION_DEG {
        format!(
            "\n    a reference relative to true north, whose declination is missing: `--set declination_deg={offset_deg:.1}`\n    a reference with its own zero of yaw: align it with north"
        )
    } else if from_axes_deg.abs() < MAX_AXES_ERROR_DEG {
        let axes = "\n    axes that are exchanged (forward and right, or north and east): ";
        let remedy = if has_axes {
            "the format of the trial defines its axes, so align the reference"
        } else {
            "`--frame enu-flu` or `--frame ned-frd`"
        };
        format!("{axes}{remedy}")
    } else {
        "\n    a reference with its own zero of yaw: align it with north".to_owned()
    };
    format!(
        "heading-offset: the heading differs from the reference by a constant {offset_deg:+.1}° (counter-clockwise){cause}"
    )
}

/// Returns a warning if an estimate covers only some of the samples.
fn coverage_warning(name: &str, found: u64, of: u64, what: &str) -> Option<String> {
    /// Share of the samples that an estimate must cover to avoid a warning. The share is below 1,
    /// because no attitude can be interpolated before the first and after the last row of the
    /// estimate.
    const MIN_SHARE: f64 = 0.99;
    if found == 0 && of > 0 {
        return Some(format!(
            "estimate `{name}` has no attitude at any of the {what}; check that its t_s is the clock of the recording"
        ));
    }
    ((found as f64) < MIN_SHARE * of as f64).then(|| {
        format!("estimate `{name}` has an attitude at {found} of {of} {what}; its errors are those of these samples")
    })
}

/// Draws the figures of each chain. If there are several chains, also draws figures that compare
/// them.
fn draw(
    request: &Request,
    plotter: &Plotter<'_>,
    trial: &Trial,
    configs: &[ServiceConfig],
    chain_runs: &mut [ChainRun],
) -> Result<(), ScoreError> {
    let Some(plots) = &request.plot else { return Ok(()) };
    let empty_record_end_s =
        chain_runs.iter().find_map(|chain_run| chain_run.files.record.as_deref()?.end_s_if_empty());
    if let Some(end_s) = empty_record_end_s {
        let PlotOptions { from_s, to_s, .. } = *plots;
        return Err(ScoreError::EmptyPlotWindow { trial: trial.name.clone(), from_s, to_s, end_s });
    }
    chain_runs.iter_mut().filter_map(|chain_run| chain_run.files.record.as_deref_mut()).for_each(PlotRecord::finish);
    let records: Vec<_> = chain_runs.iter().filter_map(|chain_run| chain_run.files.record.as_deref()).collect();
    let launches: Vec<_> = configs.iter().map(|config| config.launch.clone()).collect();
    let names = names(request, &launches);
    let estimates = request.estimates.iter().map(|estimate| estimate.name.clone());
    let labels = launches.iter().map(chain_label).chain(estimates);
    for ((name, label), record) in names.iter().zip(labels).zip(&records) {
        let base_path = output_path(request, trial, name, &plots.folder, "")?;
        plotter.draw_chain(&base_path, &trial.name.to_string(), &label, record)?;
    }
    let comparison_path = plots.folder.join(trial.file_stem());
    if records.len() > 1 {
        plotter.draw_comparison(&comparison_path, &trial.name.to_string(), &names, &records)
    } else {
        Ok(())
    }
}

/// Warning about a simulation that ends before the first scored sample.
const SIMULATION_TOO_SHORT: &str =
    "no sample is scored: the simulation ends before scoring starts; set a longer duration_s";
/// Warning about a recording in which no scored sample has a reference.
const NO_SCORED_REFERENCE: &str = "no sample is scored: no sample with mov = 1 has a reference; check that --reference uses the clock of the recording";

/// Returns a warning if most samples lack a valid rate.
fn missing_rate_warning(without_rate: u64, ticks: u64) -> Option<String> {
    (without_rate > ticks / 2).then(|| {
        format!(
            "{without_rate} of {} have no valid angular rate, so the errors do not describe the stages; check the columns gx,gy,gz",
            pluralize(ticks, "sample")
        )
    })
}

/// Returns a warning if readings were rejected or timestamps do not increase.
fn rejection_warning(rejected: u64, check: &TimestampCheck) -> Option<String> {
    let TimestampCheck { repeated, out_of_order, .. } = check;
    (rejected + repeated + out_of_order > 0).then(|| {
        let readings = pluralize(rejected, "reading");
        format!("{readings} rejected; timestamps equal to the previous one: {repeated}, earlier: {out_of_order}")
    })
}

/// Opens the requested outputs of the chain or estimate called `name`. `out` is the folder for its
/// attitudes. If a simulation is repeated with many seeds, only the first one is drawn.
fn create_outputs(
    request: &Request,
    trial: &Trial,
    config: &ServiceConfig,
    name: &str,
    out: Option<&Path>,
    is_first: bool,
) -> Result<TrialOutputs, ScoreError> {
    let inputs = || trial.file().into_iter().chain(request.estimates.iter().map(|estimate| estimate.file.as_path()));
    let table = |folder: Option<&Path>| {
        let Some(folder) = folder else { return Ok(None) };
        let path = output_path(request, trial, name, folder, ".csv")?;
        let is_input = inputs().any(|file| is_same_file(&path, file));
        if is_input { Err(ScoreError::OutputIsRecording { path }) } else { Ok(Some(path)) }
    };
    let record = |plots: &PlotOptions| PlotRecord::new(plots, config, trial.rows).map(Box::new);
    Ok(TrialOutputs {
        out: table(out)?,
        csv: table(request.csv.as_deref())?.map(|path| TickTable::create(path, config)).transpose()?,
        record: request.plot.as_ref().filter(|_| is_first).map(record).transpose()?,
    })
}

/// Returns the path of an output file of the chain or estimate called `name`. If there are several
/// chains and estimates, each has a separate folder.
fn output_path(
    request: &Request,
    trial: &Trial,
    name: &str,
    folder: &Path,
    extension: &str,
) -> Result<PathBuf, ScoreError> {
    let has_several = request.selection.fusers.len().max(1) + request.estimates.len() > 1;
    let folder = if has_several { folder.join(name) } else { folder.to_path_buf() };
    create_folder(&folder)?;
    Ok(folder.join(format!("{}{extension}", trial.file_stem())))
}

fn create_folder(folder: &Path) -> Result<(), ScoreError> {
    fs::create_dir_all(folder).map_err(|cause| ScoreError::Write { path: folder.into(), cause })
}
