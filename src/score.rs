//! `plumb score`: what stages make of recordings.

use std::{
    path::{Path, PathBuf},
    process::ExitCode,
};

use ::import::ImportError;
use clap::{Args, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};
use launch::{GyroSamples, Ingest, Launch, LaunchError};
use score::{
    Request,
    plot::{Format, Plots},
    stages::{Choice, Setting},
    trial::{Gnss, Options, RecordedSamples},
    tune::Range,
};

use crate::{
    fail,
    import::{Readable, Reading},
    out::print,
};

/// The command line of `plumb score`.
#[derive(Args)]
#[command(after_help = "\
Errors are those of BROAD: e = q_est q_ref*, total 2 acos |e_w|, heading 2 atan |e_z/e_w|, inclination 2 acos √(e_w² + e_z²); the RMSE \
is over the samples with mov = 1 and a reference, the mean over the trials. No heading offset is taken out.\n\n\
ns/update is the time of the bare estimator: one step each of gyro, accel and fuser, without reading, checking, messages and course. It is the \
CPU time of the thread over the first 30000 checked samples of a trial, in memory, in 7 rounds in which the fusers take turns; the median of the \
rounds' means counts.\n\n\
A recording has the columns t_s,gx,gy,gz,ax,ay,az and, where they are known, mx,my,mz,qw,qx,qy,qz,mov; a file of fixes t_s,ve,vn,vu \
and, where they are known, lat_deg,lon_deg,alt_m.")]
pub(crate) struct Score {
    /// Recordings (CSV, CSV.gz, a ULog of PX4, a log of ArduPilot, MCAP or a ROS 2 bag), or simulations, as `sim:s1` or `sim:cruise?seed=1..200&gnss=gaps`.
    #[arg(required = true, value_name = "FILE")]
    files: Vec<String>,
    /// Stage of the slot `gyro`.
    #[arg(long, value_name = "STAGE")]
    gyro: Option<String>,
    /// Stage of the slot `accel`.
    #[arg(long, value_name = "STAGE")]
    accel: Option<String>,
    /// Stage of the slot `fuser` [default: multiple-model]; again for another one beside it.
    #[arg(long = "fuser", value_name = "STAGE")]
    fusers: Vec<String>,
    /// Stage of the slot `course`.
    #[arg(long, value_name = "STAGE")]
    course: Option<String>,
    /// A launch file: its calibration, mounting and limits are applied, its stages with their settings are the usual ones, and its `[stages.NAME]` can
    /// be chosen, too. Without it, only the `[stages.NAME]` of ./launch.toml can be.
    #[arg(long, value_name = "FILE")]
    launch: Option<PathBuf>,
    /// A parameter of the chosen stages, as `key=value`, `slot.key=value` or `stage.key=value`; as `key=a..b` the errors over that range, at 25 values, by
    /// factors where b is ten times a or more: the best is told, --plot draws them, --json has them, and the scores are with the value before.
    #[arg(long = "set", value_name = "KEY=VALUE|A..B", value_parser = set)]
    settings: Vec<Set>,
    /// Whether the magnetic field is used.
    #[arg(long, value_name = "on|off", default_value = "on")]
    mag: Switch,
    /// Fixes of a satellite receiver; `auto` is `NAME_gnss.csv` beside `NAME_imu.csv.gz`.
    #[arg(long, value_name = "FILE|auto|off", default_value = "auto", value_parser = gnss)]
    gnss: Gnss,
    /// The true attitude of the recording in a file of its own, as `t_s,qw,qx,qy,qz` (body to east-north-up) of a motion capture on the same
    /// clock; the shortest turn is taken between rows that are at most 0.2 s apart.
    #[arg(long, value_name = "FILE")]
    reference: Option<PathBuf>,
    /// What a rate sample is: the mean of its interval, or the value at its end [default: means for recordings; a simulation says it].
    #[arg(long, value_name = "means|instants")]
    gyro_samples: Option<Samples>,
    /// Write `t_s,qw,qx,qy,qz` of each tick to DIR/TRIAL.csv; of several fusers to DIR/FUSER/TRIAL.csv.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Write what was said at each tick, by gyro and accelerometer alone, too, and the truth beside it, to DIR/TRIAL.csv; of several fusers to DIR/FUSER/TRIAL.csv. What is not known is `nan`.
    #[arg(long, value_name = "DIR")]
    csv: Option<PathBuf>,
    /// Write figures to DIR/TRIAL.*.svg; of several fusers those of each to DIR/FUSER/TRIAL.*.svg, and all over one another to DIR/TRIAL.*.svg.
    #[arg(long, value_name = "DIR")]
    plot: Option<PathBuf>,
    /// Begin the figures at this time, seconds from the first sample.
    #[arg(long, value_name = "SECONDS", requires = "plot", default_value_t = 0.0, value_parser = seconds)]
    from: f64,
    /// End the figures at this time.
    #[arg(long, value_name = "SECONDS", requires = "plot", value_parser = seconds)]
    to: Option<f64>,
    /// Width and height of each figure, pixels.
    #[arg(long, value_name = "WIDTHxHEIGHT", requires = "plot", value_parser = size)]
    size: Option<(u32, u32)>,
    /// Whether figures are vectors or pixels; pixels are doubled, and need a typeface of the system.
    #[arg(long, value_name = "svg|png", requires = "plot", default_value = "svg")]
    format: PlotFormat,
    /// Write one page to send: the attitudes of all stages one over the other with the reference, errors, settings, and which to choose; where there is no
    /// reference, how far the stages are apart. It holds all it shows, and asks no other host for anything.
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
    /// Search the value of a parameter of the chosen stages that gives the least error, as `key=a..b`, `slot.key=a..b` or `stage.key=a..b`, and use it: 27
    /// values, by factors where b is ten times a or more. The total error counts, or the inclination where the course is counted from nowhere.
    #[arg(long, value_name = "KEY=A..B")]
    tune: Option<Range>,
    /// Print the errors of roll, pitch, yaw, course and gyro bias, the drift of a heading that is counted from nowhere, and errors over their own standard
    /// deviations, too; --json always has them.
    #[arg(long)]
    all_errors: bool,
    /// Print one JSON object at the end, on the last line of standard output.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    reading: Reading,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Switch {
    On,
    Off,
}

#[derive(Clone, Copy, ValueEnum)]
enum PlotFormat {
    Svg,
    Png,
}

/// A value, or a range of values.
#[derive(Clone)]
enum Set {
    Value(Setting),
    Range(Range),
}

#[derive(Clone, Copy, ValueEnum)]
enum Samples {
    Means,
    Instants,
}

pub(crate) fn run(score: Score) -> ExitCode {
    let Score { files, gyro, accel, fusers, course, launch, settings, mag, gnss, gyro_samples, .. } = score;
    let Score { out, csv, plot, from, to, size, format, report, tune, all_errors, json, reading, reference, .. } =
        score;
    if reference.is_some() && !matches!(&files[..], [file] if !file.starts_with("sim:")) {
        return fail(&"--reference is that of one recording: score the others by themselves", 2);
    }
    if to.is_some_and(|to| to <= from) {
        return fail(&"--to is to be later than --from", 2);
    }
    let format = match format {
        PlotFormat::Svg => Format::Svg,
        PlotFormat::Png => Format::Png,
    };
    let (mut values, mut sweeps) = (Vec::new(), Vec::new());
    for set in settings {
        match set {
            Set::Value(setting) => values.push(setting),
            Set::Range(range) => sweeps.push(range),
        }
    }
    let gyro_samples = gyro_samples.map(|samples| match samples {
        Samples::Means => GyroSamples::Means,
        Samples::Instants => GyroSamples::Instants,
    });
    let base = match base(launch.as_deref(), [&gyro, &accel, &course].into_iter().flatten().chain(&fusers)) {
        Ok(base) => base,
        Err(error) => return fail(&error, 3),
    };
    // What is imported is there until the end.
    let readable = match files.iter().map(|file| readable(file, &reading)).collect::<Result<Vec<_>, _>>() {
        Ok(readable) => readable,
        Err(error) => return fail(&error, error.exit_code()),
    };
    let names = readable.iter().zip(&files).map(|(readable, file)| match readable {
        Some(readable) => readable.path.to_string_lossy().into_owned(),
        None => file.clone(),
    });
    let request = Request {
        files: names.collect(),
        options: Options {
            gnss,
            without_field: mag == Switch::Off,
            reference,
            gyro_samples,
            recorded_samples: RecordedSamples(base.ingest.replay.gyro_samples),
        },
        choice: Choice { gyro, accel, course, fusers, launch: base, settings: values },
        out,
        csv,
        plot: plot.map(|folder| Plots { folder, from_s: from, to_s: to, size, format }),
        report,
        command: command(),
        sweeps,
        tune,
        all_errors,
    };
    let bar = ProgressBar::new(0).with_style(style());
    let scores = score::run(&request, &mut |done, of| {
        bar.set_length(of);
        bar.set_position(done);
    });
    bar.finish_and_clear();
    scores.iter().flat_map(|scores| &scores.warnings).for_each(supervisor::announce);
    match scores {
        Ok(scores) if json => {
            supervisor::announce(&scores);
            print(&scores.json())
        }
        Ok(scores) => print(&scores),
        Err(error) => fail(&error, error.exit_code()),
    }
}

/// The recording to read for a name; none for a simulation's.
fn readable(file: &str, reading: &Reading) -> Result<Option<Readable>, ImportError> {
    if file.starts_with("sim:") { Ok(None) } else { Readable::of(Path::new(file), reading).map(Some) }
}

/// What the launch file says of readings and stages; who names none and asks only for what this executable has needs none.
fn base<'a>(launch: Option<&Path>, mut asked: impl Iterator<Item = &'a String>) -> Result<Launch, LaunchError> {
    let ours = |asked: &String| conformance::stages().any(|(_, name)| name == asked);
    if launch.is_none() && asked.all(ours) {
        return Ok(Launch::default());
    }
    let read = crate::stage::programs(launch)?;
    if launch.is_none() {
        return Ok(Launch { stages: read.stages, ..Launch::default() });
    }
    let Launch { ingest, stages, gyro, accel, fuser, course, north, .. } = read;
    // What the sensors are made to do wrong is for a system that runs.
    let ingest = Ingest { faults: Vec::new(), ..ingest };
    Ok(Launch { ingest, stages, gyro, accel, fuser, course, north, ..Launch::default() })
}

/// What was typed.
fn command() -> String {
    let words = std::env::args_os().skip(1).map(|word| word.to_string_lossy().into_owned());
    let quoted = |word: String| if word.contains([' ', '&', '?', '*']) { format!("\"{word}\"") } else { word };
    ["plumb".to_owned()].into_iter().chain(words.map(quoted)).collect::<Vec<_>>().join(" ")
}

/// Drawn on standard error, and only on a terminal.
fn style() -> ProgressStyle {
    ProgressStyle::with_template("{bar:40} {percent:>3} % of {human_len} samples, {eta} left")
        .unwrap_or_else(|_| ProgressStyle::default_bar())
}

fn set(text: &str) -> Result<Set, String> {
    let is_range = text.split_once('=').is_some_and(|(_, value)| value.contains(".."));
    if is_range { text.parse().map(Set::Range) } else { text.parse().map(Set::Value) }
}

fn seconds(text: &str) -> Result<f64, String> {
    let found = text.parse().ok().filter(|seconds: &f64| (0.0..1e9).contains(seconds));
    found.ok_or_else(|| "expected seconds from the first sample, as in 12.5".into())
}

fn size(text: &str) -> Result<(u32, u32), String> {
    let pair = text.split_once('x').and_then(|(width, height)| Some((width.parse().ok()?, height.parse().ok()?)));
    let found = pair.filter(|(width, height)| (480..=8000).contains(width) && (320..=8000).contains(height));
    found.ok_or_else(|| "expected WIDTHxHEIGHT, from 480x320 to 8000x8000 pixels, as in 1200x900".into())
}

fn gnss(text: &str) -> Result<Gnss, String> {
    Ok(match text {
        "auto" => Gnss::Auto,
        "off" => Gnss::Off,
        file => Gnss::File(file.into()),
    })
}
