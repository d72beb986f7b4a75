//! `plumb score`: scores stages on recordings and simulations.

use std::path::{Path, PathBuf};

use ::import::{
    ImportError, Table,
    readable::{ReadableFile, ReadableTable},
};
use clap::Args;
use launch::{GyroSamples, Ingest, Launch, LaunchError};
use mapping::names::UnknownName;
use score::{
    Request,
    estimate::Estimate,
    plot::PlotOptions,
    stages::{Setting, StageSelection},
    trial::{Gnss, RecordedGyroSamples, TrialOptions},
    tune::SettingRange,
};

use crate::{
    failure::{Failure, Outcome},
    import::{RateSamples, ReadOptions, SensorNumbers, announce_deferred_warning, announce_references, announcer},
    notice::{notice, progress_bar},
    stdout::print,
    system::LaunchArgs,
};

/// Arguments of `plumb score`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  plumb score flight.ulg --fuser multiple-model --fuser vqf --plot figures
  plumb score sim:s1 --fuser wz-closed --tune fuser.time_constant_s=0.1..10
  plumb score flight.ulg --estimate mine=attitudes.csv --report compared.html

Input: CSV, CSV.gz, PX4 ULog, ArduPilot log, tlog, MCAP, ROS 2 bag, or
sim:SCENARIO. A recording has the columns t_s,gx,gy,gz,ax,ay,az and optional
mx,my,mz,qw,qx,qy,qz,mov; a file of fixes has t_s,ve,vn,vu and optional
lat_deg,lon_deg,alt_m. Files for --estimate and --reference have t_s,qw,qx,qy,qz
on the clock of the recording, body to east-north-up.

KEY is key, slot.key or stage.key. --set KEY=A..B scores 25 values and prints
the best one, but the scores keep the current value. --tune KEY=A..B searches 27
values and uses the best one. Both space the values logarithmically if B is at
least ten times A, and minimise the total error, or the inclination error if the
heading has no reference.

Files of several fusers are written to DIR/FUSER/. Missing values are nan.

Errors are those of BROAD: e = q_est q_ref*, total 2 acos |e_w|, heading 2 atan
|e_z/e_w|, inclination 2 acos sqrt(e_w^2 + e_z^2); RMSE over samples with mov =
1 and a reference, then the mean over trials. No heading offset is removed, but
--set declination_deg=D compares with a reference relative to true north.

ns/update is the CPU time of one step each of gyro, accel and fuser, without
reading, checks, messages and course: median over 7 rounds, each over the first
30000 samples of a trial. For a user-defined stage it is the CPU time of its
program and of the communication with it, over the first 1000 samples.")]
#[command(mut_arg("launch", |launch| launch.help("Launch file with calibration, mounting, limits and stages")))]
pub(crate) struct Score {
    /// Recordings, or simulations such as sim:s1 or sim:cruise?seed=1..200
    #[arg(required = true, value_name = "FILE")]
    files: Vec<String>,
    /// Stage of the slot gyro [default: that of --launch, else mobius]
    #[arg(long, value_name = "STAGE")]
    gyro: Option<String>,
    /// Stage of the slot accel [default: that of --launch, else projector]
    #[arg(long, value_name = "STAGE")]
    accel: Option<String>,
    /// Stage of the slot fuser, repeatable [default: multiple-model]
    #[arg(long = "fuser", value_name = "STAGE")]
    fusers: Vec<String>,
    /// Stage of the slot course [default: that of --launch, else angles]
    #[arg(long, value_name = "STAGE")]
    course: Option<String>,
    #[command(flatten)]
    launch: LaunchArgs,
    /// Value or range of a parameter of the selected stages, repeatable
    #[arg(long = "set", value_name = "KEY=VALUE|A..B", value_parser = parse_set)]
    settings: Vec<Set>,
    /// Magnetic field on or off, or index of the magnetometer in a log
    #[arg(long, value_name = "on|off|N", default_value = "on", value_parser = parse_mag)]
    mag: MagChoice,
    /// Fixes: a file, NAME_gnss.csv next to NAME_imu.csv.gz, or receiver N
    #[arg(long, value_name = "FILE|auto|off|N", default_value = "auto", value_parser = parse_gnss)]
    gnss: GnssChoice,
    /// Reference attitude t_s,qw,qx,qy,qz (body to east-north-up)
    #[arg(long, value_name = "FILE")]
    reference: Option<PathBuf>,
    /// Attitudes of another program to score as well; repeatable
    #[arg(long = "estimate", value_name = "NAME=FILE", value_parser = parse_estimate)]
    estimates: Vec<(String, PathBuf)>,
    /// Name of an --estimate with an arbitrary heading, repeatable
    #[arg(long = "arbitrary-heading", value_name = "NAME", requires = "estimates")]
    arbitrary_headings: Vec<String>,
    /// Meaning of a rate sample: mean or end value [default: means]
    #[arg(long, value_name = "means|instants")]
    gyro_samples: Option<RateSamples>,
    /// Folder for attitudes: a TRIAL.csv of t_s,qw,qx,qy,qz per trial
    #[arg(long, value_name = "DIR")]
    out_dir: Option<PathBuf>,
    /// Folder for estimates (fused, gyro-only, accel-only) and reference
    #[arg(long, value_name = "DIR")]
    csv: Option<PathBuf>,
    /// Folder for figures TRIAL.*.svg; several fusers also share one figure
    #[arg(long, value_name = "DIR")]
    plot: Option<PathBuf>,
    /// Start of the figures, s from the first sample
    #[arg(long, value_name = "SECONDS", requires = "plot", default_value_t = 0.0, value_parser = parse_seconds)]
    from: f64,
    /// End of the figures, s from the first sample [default: last sample]
    #[arg(long, value_name = "SECONDS", requires = "plot", value_parser = parse_seconds)]
    to: Option<f64>,
    /// Width and height of each figure, px, 480x320 to 8000x8000
    #[arg(long, value_name = "WIDTHxHEIGHT", requires = "plot", value_parser = parse_size)]
    size: Option<(u32, u32)>,
    /// Self-contained HTML page with attitudes, errors and recommendation
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
    /// Parameter range to search for the smallest error
    #[arg(long, value_name = "KEY=A..B")]
    tune: Option<SettingRange>,
    /// Print errors of angles, course and bias, drift and normalised errors
    #[arg(long)]
    all_errors: bool,
    /// Print one JSON object on the last line of standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    reading: ReadOptions,
}

/// Argument of `--mag`.
#[derive(Clone, Copy, PartialEq)]
enum MagChoice {
    On,
    Off,
    /// Index of the magnetometer to read.
    Number(usize),
}

/// Argument of `--gnss`.
#[derive(Clone)]
enum GnssChoice {
    Fixes(Gnss),
    /// Index of the receiver to read.
    Number(usize),
}

/// Argument of `--set`: a value or a range of values.
#[derive(Clone)]
enum Set {
    Value(Setting),
    Range(SettingRange),
}

pub(crate) fn run(score: Score) -> Outcome {
    let Score { files, gyro, accel, fusers, course, launch, settings, mag, gnss, gyro_samples, .. } = score;
    let Score { out_dir, csv, plot, from, to, size, report, tune, all_errors, json, reading, reference, .. } = score;
    let Score { estimates, arbitrary_headings, .. } = score;
    if reference.is_some() && !matches!(&files[..], [file] if !file.starts_with("sim:")) {
        return Err(Failure::new("--reference belongs to a single recording; score other files separately", 2));
    }
    if to.is_some_and(|to| to <= from) {
        return Err(Failure::new("--to must be later than --from", 2));
    }
    let estimate_names: Vec<&str> = estimates.iter().map(|(name, _)| name.as_str()).collect();
    if let Some(unknown) = arbitrary_headings.iter().find(|name| !estimate_names.contains(&name.as_str())) {
        let unknown = UnknownName::new("estimate", unknown, estimate_names);
        return Err(Failure::new(format_args!("--arbitrary-heading: {unknown}"), 2));
    }
    let (mut values, mut sweeps) = (Vec::new(), Vec::new());
    for setting in settings {
        match setting {
            Set::Value(setting) => values.push(setting),
            Set::Range(range) => sweeps.push(range),
        }
    }
    let gyro_samples = gyro_samples.map(GyroSamples::from);
    let base = base_launch(&launch, [&gyro, &accel, &course].into_iter().flatten().chain(&fusers))?;
    // An imported recording is a temporary file that is removed on drop, so it is kept until the
    // end of the run.
    let sensors = SensorNumbers {
        mag: match mag {
            MagChoice::Number(number) => Some(number),
            _ => None,
        },
        gnss: match gnss {
            GnssChoice::Number(number) => Some(number),
            GnssChoice::Fixes(_) => None,
        },
    };
    let opened = files.iter().map(|file| readable(file, &reading, sensors)).collect::<Result<Vec<_>, _>>()?;
    let readable: Vec<_> = opened.into_iter().flatten().collect();
    let reference_table = reference.as_ref().map(|path| ReadableTable::open(path, Table::Reference, &mut announcer()));
    let fixes_table = match &gnss {
        GnssChoice::Fixes(Gnss::File(fixes)) => Some(ReadableTable::open(fixes, Table::Fixes, &mut announcer())),
        _ => None,
    };
    let reference = reference_table.as_ref().map(|table| table.path.clone());
    let estimate_tables: Vec<_> =
        estimates.iter().map(|(_, path)| ReadableTable::open(path, Table::Reference, &mut announcer())).collect();
    let names = readable.iter().map(|trial| match trial {
        TrialFile::Recording(readable) => readable.path.to_string_lossy().into_owned(),
        TrialFile::Simulation(name) => name.clone(),
    });
    let with_axes = readable.iter().filter_map(|trial| match trial {
        TrialFile::Recording(readable) => readable.has_own_axes().then(|| readable.path.to_string_lossy().into_owned()),
        TrialFile::Simulation(_) => None,
    });
    let request = Request {
        files: names.collect(),
        files_with_axes: with_axes.collect(),
        options: TrialOptions {
            gnss: match gnss {
                GnssChoice::Fixes(gnss) => fixes_table.as_ref().map_or(gnss, |table| Gnss::File(table.path.clone())),
                GnssChoice::Number(_) => Gnss::Auto,
            },
            without_field: mag == MagChoice::Off,
            reference: reference.clone(),
            gyro_samples,
            recorded_gyro_samples: RecordedGyroSamples(base.ingest.replay.gyro_samples),
        },
        selection: StageSelection { gyro, accel, course, fusers, launch: base, settings: values },
        estimates: (estimates.iter().zip(&estimate_tables))
            .map(|((name, _), table)| Estimate {
                name: name.clone(),
                file: table.path.clone(),
                heading_is_known: !arbitrary_headings.contains(name),
            })
            .collect(),
        out: out_dir,
        csv,
        plot: plot.map(|folder| PlotOptions { folder, from_s: from, to_s: to, size }),
        report,
        command: command_line(),
        sweeps,
        tune,
        prints_all_errors: all_errors,
    };
    let bar = progress_bar(0, "{bar:40} {percent:>3} % of {human_len} samples, {eta} left");
    let scores = score::run(&request, &mut |done, of| {
        bar.set_length(of);
        bar.set_position(done);
    });
    bar.finish_and_clear();
    scores.iter().flat_map(|scores| &scores.warnings).for_each(supervisor::announce);
    for trial in &readable {
        if let TrialFile::Recording(readable) = trial {
            if let (Ok(_), Some(reference)) = (&scores, &reference) {
                announce_references(readable, reference);
            }
            announce_deferred_warning(readable);
        }
    }
    match scores {
        Ok(scores) if json => {
            notice(&scores);
            Ok(print(&scores.json()))
        }
        Ok(scores) => Ok(print(&scores)),
        Err(error) => {
            let text = readable.iter().fold(error.to_string(), |text, trial| match trial {
                TrialFile::Recording(readable) => readable.with_user_path(&text),
                TrialFile::Simulation(_) => text,
            });
            let tables = reference_table.iter().chain(&fixes_table).chain(&estimate_tables);
            let text = tables.fold(text, |text, table| table.with_user_path(&text));
            Err(Failure::new(text, error.exit_code()))
        }
    }
}

/// Recording or simulation to score.
enum TrialFile {
    Recording(ReadableFile),
    Simulation(String),
}

/// Opens the segments of a recording, or a simulation.
fn readable(file: &str, reading: &ReadOptions, sensors: SensorNumbers) -> Result<Vec<TrialFile>, ImportError> {
    if file.starts_with("sim:") {
        return Ok(vec![TrialFile::Simulation(file.to_owned())]);
    }
    let segments = ReadableFile::open_segments(Path::new(file), &reading.options(sensors)?, &mut announcer())?;
    Ok(segments.into_iter().map(TrialFile::Recording).collect())
}

/// Returns the base configuration. No launch file is read if only built-in stages are named.
fn base_launch<'a>(launch: &LaunchArgs, mut wanted: impl Iterator<Item = &'a String>) -> Result<Launch, LaunchError> {
    let is_built_in = |wanted: &String| conformance::stages().any(|(_, name)| name == wanted);
    if launch.launch.is_none() && wanted.all(is_built_in) {
        return Ok(Launch::default());
    }
    let read = launch.read()?;
    if launch.launch.is_none() {
        return Ok(Launch { stages: read.stages, ..Launch::default() });
    }
    let Launch { ingest, stages, gyro, accel, fuser, course, north, .. } = read;
    // Injected sensor faults are for running systems only.
    let ingest = Ingest { faults: Vec::new(), ..ingest };
    Ok(Launch { ingest, stages, gyro, accel, fuser, course, north, ..Launch::default() })
}

/// Returns the command line of this process, quoted for a shell.
fn command_line() -> String {
    let words = std::env::args_os().skip(1).map(|word| word.to_string_lossy().into_owned());
    let quoted = |word: String| if word.contains([' ', '&', '?', '*']) { format!("\"{word}\"") } else { word };
    ["plumb".to_owned()].into_iter().chain(words.map(quoted)).collect::<Vec<_>>().join(" ")
}

fn parse_set(text: &str) -> Result<Set, String> {
    let is_range = text.split_once('=').is_some_and(|(_, value)| value.contains(".."));
    if is_range { text.parse().map(Set::Range) } else { text.parse().map(Set::Value) }
}

fn parse_estimate(text: &str) -> Result<(String, PathBuf), String> {
    let pair = text.split_once('=').filter(|(_, file)| !file.is_empty());
    let (name, file) = pair.ok_or("expected NAME=FILE, as in mine=attitudes.csv")?;
    Ok((name.into(), file.into()))
}

fn parse_seconds(text: &str) -> Result<f64, String> {
    let found = text.parse().ok().filter(|seconds: &f64| (0.0..1e9).contains(seconds));
    found.ok_or_else(|| "expected seconds from the first sample, as in 12.5".into())
}

fn parse_size(text: &str) -> Result<(u32, u32), String> {
    let pair = text.split_once('x').and_then(|(width, height)| Some((width.parse().ok()?, height.parse().ok()?)));
    let found = pair.filter(|(width, height)| (480..=8000).contains(width) && (320..=8000).contains(height));
    found.ok_or_else(|| "expected WIDTHxHEIGHT, from 480x320 to 8000x8000 pixels, as in 1200x900".into())
}

fn parse_gnss(text: &str) -> Result<GnssChoice, String> {
    Ok(match (text, text.parse()) {
        ("auto", _) => GnssChoice::Fixes(Gnss::Auto),
        ("off", _) => GnssChoice::Fixes(Gnss::Off),
        (_, Ok(number)) => GnssChoice::Number(number),
        (file, _) => GnssChoice::Fixes(Gnss::File(file.into())),
    })
}

fn parse_mag(text: &str) -> Result<MagChoice, String> {
    match (text, text.parse()) {
        ("on", _) => Ok(MagChoice::On),
        ("off", _) => Ok(MagChoice::Off),
        (_, Ok(number)) => Ok(MagChoice::Number(number)),
        _ => Err("expected on, off or the number of a magnetometer".into()),
    }
}
