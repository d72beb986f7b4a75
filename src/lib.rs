//! `plumb`: one executable with the command line, the supervisor and every service.
#![forbid(unsafe_code)]

mod absent;
mod bench;
mod bridge;
mod calibrate;
mod config;
mod demo;
mod detached;
mod detect;
mod doctor;
mod duration;
mod failure;
mod import;
mod info;
#[cfg(feature = "network")]
mod keys;
mod manual;
mod notice;
mod paper;
mod record;
mod replay;
mod score;
mod service;
mod stage;
#[cfg(all(feature = "network", feature = "tui"))]
mod station;
mod stdout;
mod swap;
mod system;
#[cfg(feature = "tui")]
mod top;
mod topic;
mod topics;
mod up;
#[cfg(feature = "cockpit")]
mod view;

use std::{env, path::PathBuf, process::ExitCode};

#[cfg(not(all(feature = "network", feature = "tui")))]
use absent::station;
#[cfg(not(feature = "tui"))]
use absent::top;
#[cfg(not(feature = "cockpit"))]
use absent::view;
#[cfg(not(feature = "network"))]
use absent::{keys, remote};
use clap::{
    ColorChoice, CommandFactory, Parser, Subcommand,
    error::{ContextKind, ContextValue, ErrorKind},
};
use launch::Service;

#[cfg(feature = "network")]
use ::remote;

use failure::print_error_object;
use stdout::print;

/// Version, commit, build profile and Cargo features of this executable.
const LONG_VERSION: &str = concat!(
    env!("CARGO_PKG_VERSION"),
    "\ncommit: ",
    env!("PLUMB_COMMIT"),
    "\nprofile: ",
    env!("PLUMB_PROFILE"),
    "\nfeatures: ",
    env!("PLUMB_FEATURES"),
);

/// Estimate attitude and course with stages that can be swapped at run time
#[derive(Parser)]
#[command(
    name = "plumb",
    version,
    long_version = LONG_VERSION,
    term_width = 80,
    after_help = "\
Examples:
  plumb demo
  plumb up --source 'sim:s1?seed=2' --for 10s
  plumb top

Exit codes: 0 success, 1 runtime failure or lost ticks, 2 wrong usage,
3 invalid configuration or input file."
)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    /// Colours; auto: on a terminal, unless NO_COLOR is set
    #[arg(long, global = true, value_name = "WHEN", default_value = "auto")]
    color: ColorChoice,
    /// Print no progress and no confirmations
    #[arg(long, short, global = true)]
    quiet: bool,
}

#[derive(Subcommand)]
enum Command {
    /// Run a system until its source ends or Ctrl-C
    Up(up::Up),
    /// Stop a running system
    Down(detached::Down),
    /// Print the messages of a background system
    Logs(detached::Logs),
    /// Run a one-minute demo of a tumble, kills and swaps
    Demo(demo::DemoCommand),
    /// Score stages on recordings: errors and cost per update
    Score(Box<score::Score>),
    /// Reproduce the figures and tables of the source papers
    Paper(paper::PaperCommand),
    /// Convert a log from another system
    Import(import::Import),
    /// Recognise sensors and receivers on serial ports
    Detect(detect::Detect),
    /// Calibrate a sensor unit from its own readings
    Calibrate(Box<calibrate::Calibrate>),
    /// Record a running system to an MCAP file
    Record(record::Record),
    /// Bridge attitude to MAVLink or ROS 2, and readings from ROS 2
    #[command(after_help = "\
Examples:
  plumb bridge mavlink
  plumb bridge ros --rate-hz 50
  plumb bridge ros-sensor --mag imu/mag")]
    Bridge {
        #[command(subcommand)]
        command: bridge::Bridge,
    },
    /// Show the contents of a flight, recording or log
    Info(info::Info),
    /// List, test and create stages
    #[command(after_help = "\
Examples:
  plumb stage list
  plumb stage test vqf
  plumb stage new my-fuser --lang python")]
    Stage {
        #[command(subcommand)]
        command: stage::Stage,
    },
    /// Swap the stage of a slot in a running system without loss
    Swap(swap::Swap),
    /// Run a candidate stage in shadow and print how it differs
    Shadow(swap::Shadow),
    /// List the services of a running system
    #[command(after_help = "\
Examples:
  plumb ps
  plumb ps --json
  plumb ps --remote alpha --connect quic/base:7447 --keys keys/viewer.wall")]
    Ps(system::SystemArgs),
    /// Show live state, rate and latency of each service
    Top(top::TopCommand),
    /// List, inspect and echo topics
    #[command(after_help = "\
Examples:
  plumb topic list
  plumb topic echo attitude --every 100
  plumb topic hz imu --for 10s")]
    Topic {
        #[command(subcommand)]
        command: topic::TopicCommand,
    },
    /// Show a system, remote vehicles or a recorded flight in a browser
    View(view::View),
    /// Diagnose the machine and the system
    Doctor(doctor::DoctorCommand),
    /// Monitor remote vehicles and verify delivery
    Station(station::Station),
    /// Stress-test kills and swaps
    #[command(after_help = "\
Examples:
  plumb bench kills --count 10
  plumb bench swaps --count 10 --same")]
    Bench {
        #[command(subcommand)]
        command: bench::Bench,
    },
    /// Manage certificates of vehicles, operators and viewers
    #[command(after_help = "\
Examples:
  plumb keys init --router 192.168.1.5
  plumb keys vehicle alpha
  plumb keys check")]
    Keys {
        #[command(subcommand)]
        command: keys::Command,
    },
    /// Check and show launch files, and derive systemd settings
    #[command(after_help = "\
Examples:
  plumb config check --launch launch.toml
  plumb config show
  plumb config unit --launch /etc/plumbline/launch.toml")]
    Config {
        #[command(subcommand)]
        command: config::Config,
    },
    /// Print a shell completion script
    #[command(after_help = "\
Examples:
  plumb completions bash
  plumb completions zsh")]
    Completions {
        /// Shell that completes the commands
        shell: clap_complete::Shell,
    },
    /// Write the manual pages of all commands into a folder
    #[command(after_help = "\
Examples:
  plumb man man1
  plumb man /usr/local/share/man/man1")]
    Man {
        /// Folder, created if necessary
        folder: PathBuf,
    },
    /// Run one service of a system; used by the supervisor only
    #[command(hide = true)]
    Service {
        /// Name of the service, such as gyro
        #[arg(value_parser = service::parse)]
        service: Service,
    },
}

/// Returns the definition of the command line.
pub fn command_line() -> clap::Command {
    Cli::command()
}

/// Runs the command line of this process and returns its exit code.
pub fn main() -> ExitCode {
    bus::report_memory_exhaustion();
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => return report_usage_error(with_launch_option(error)),
    };
    notice::configure(cli.color, cli.quiet);
    let Some(command) = cli.command else {
        return print(&command_line().render_help().to_string().trim_end());
    };
    let outcome = match command {
        Command::Up(up) => up::run(up),
        Command::Down(down) => detached::down(down),
        Command::Logs(logs) => detached::logs(logs),
        Command::Demo(demo) => demo::run(&demo),
        Command::Score(score) => score::run(*score),
        Command::Paper(command) => paper::run(&command),
        Command::Import(import) => import::run(import),
        Command::Detect(command) => detect::run(command),
        Command::Calibrate(calibrate) => calibrate::run(*calibrate),
        Command::Record(record) => record::run(&record),
        Command::Bridge { command } => bridge::run(&command),
        Command::Info(info) => info::run(&info),
        Command::Stage { command } => stage::run(command),
        Command::Swap(swap) => swap::swap(swap),
        Command::Shadow(shadow) => swap::shadow(shadow),
        Command::Ps(system) => swap::ps(system),
        Command::Top(command) => top::run(command),
        Command::Topic { command } => topic::run(command),
        Command::View(view) => view::run(&view),
        Command::Doctor(command) => doctor::run(command),
        Command::Station(station) => station::run(&station),
        Command::Bench { command } => bench::run(&command),
        Command::Keys { command } => keys::run(command),
        Command::Config { command } => config::run(&command),
        Command::Completions { shell } => manual::print_completions(command_line(), shell),
        Command::Man { folder } => manual::write_pages(command_line(), &folder),
        Command::Service { service } => service::run(service),
    };
    outcome.unwrap_or_else(|failure| failure.report())
}

/// Prints the help, the version or a usage error.
fn report_usage_error(error: clap::Error) -> ExitCode {
    if error.use_stderr() {
        print_error_object(&error.render());
    }
    // If standard error is closed, the exit code still reports the failure.
    let _ = error.print();
    ExitCode::from(error.exit_code() as u8)
}

/// Suggests `--launch` in the error for an unexpected argument that names a launch file.
fn with_launch_option(mut error: clap::Error) -> clap::Error {
    let command = command_line();
    let command = env::args().skip(1).fold(&command, |command, word| command.find_subcommand(word).unwrap_or(command));
    let accepts_launch = command.get_arguments().any(|argument| argument.get_long() == Some("launch"));
    if let Some(ContextValue::String(argument)) = error.get(ContextKind::InvalidArg)
        && error.kind() == ErrorKind::UnknownArgument
        && argument.ends_with(".toml")
        && accepts_launch
    {
        let tip = format!("to read a launch file, use '--launch {argument}'");
        error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![tip.into()]));
    }
    error
}
