//! `plumb`: one executable with every service and the supervisor that runs them.
#![forbid(unsafe_code)]

mod bench;
mod bridge;
mod calibrate;
mod doctor;
mod import;
mod info;
mod keys;
mod out;
mod paper;
mod record;
mod remote;
mod replay;
mod score;
mod seeing;
mod stage;
mod station;
mod swap;
mod system;
mod top;
mod topic;
mod up;
mod view;

use std::{fmt::Display, path::PathBuf, process::ExitCode};

use clap::{Parser, Subcommand};
use launch::{Launch, Service};

/// Attitude and course from separate processes over shared memory.
#[derive(Parser)]
#[command(
    version,
    after_help = "Exit codes: 0 done, 1 failed while running or lost ticks, 2 wrong usage, 3 wrong configuration or input file."
)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Subcommand)]
enum Command {
    /// Run a system until its source ends or Ctrl-C; what `plumb` alone does.
    Up(up::Up),
    /// Run stages over recordings and tell their errors and what an update costs.
    Score(Box<score::Score>),
    /// Make the figures and tables of the papers that the stages come from.
    Paper(paper::PaperCommand),
    /// Make a recording of another system into one of ours.
    Import(import::Import),
    /// Find the errors of a sensor unit from its own readings, and print them as a piece of `launch.toml`.
    Calibrate(Box<calibrate::Calibrate>),
    /// Record a running system to an MCAP file, which viewers open as it is.
    Record(record::Record),
    /// Send the attitude of a running system to the programs of others.
    Bridge {
        #[command(subcommand)]
        command: bridge::Bridge,
    },
    /// Say what a recording holds: a flight (MCAP), a CSV, a log of another system.
    Info(info::Info),
    /// Look at the stages there are, and test them.
    Stage {
        #[command(subcommand)]
        command: stage::Stage,
    },
    /// Swap what fills a slot of a running system, with nothing lost.
    Swap(swap::Swap),
    /// Run a stage beside the one that fills a slot, and tell how far they are apart.
    Shadow(swap::Shadow),
    /// How the services of a running system are.
    Ps(system::System),
    /// How the services of a running system do, from moment to moment.
    Top(top::TopCommand),
    /// Look at what flows through a running system.
    Topic {
        #[command(subcommand)]
        command: topic::TopicCommand,
    },
    /// Show a system, a vehicle elsewhere or a recorded flight as a page in a browser.
    View(view::View),
    /// Say what is wrong with the machine and the system, if anything is, and what to do about it.
    Doctor(doctor::DoctorCommand),
    /// Look at vehicles from elsewhere, and check that all they send arrives.
    Station(station::Station),
    /// Measure what becomes of the output when services are killed or swapped.
    Bench {
        #[command(subcommand)]
        command: bench::Bench,
    },
    /// Make and look at the certificates of vehicles, operators and viewers.
    Keys {
        #[command(subcommand)]
        command: keys::Command,
    },
    /// Look at a launch file.
    Config {
        #[command(subcommand)]
        command: ConfigCommand,
    },
    /// Be one service of a running system; the supervisor starts it so.
    #[command(hide = true)]
    Service {
        /// Which one.
        #[arg(value_parser = service)]
        service: Service,
    },
}

#[derive(Subcommand)]
enum ConfigCommand {
    /// Say what is wrong with a launch file, if anything is.
    Check {
        /// The launch file.
        file: PathBuf,
    },
}

/// Does what the command line says.
pub fn main() -> ExitCode {
    bus::report_memory_exhaustion();
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(said) => return usage(&said),
    };
    match cli.command.unwrap_or(Command::Up(up::Up::default())) {
        Command::Up(up) => up::run(up),
        Command::Score(score) => score::run(*score),
        Command::Paper(command) => paper::run(&command),
        Command::Import(import) => import::run(import),
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
        Command::Config { command: ConfigCommand::Check { file } } => match Launch::read(&file) {
            Ok(_) => {
                supervisor::announce(format_args!("{} is valid", file.display()));
                ExitCode::SUCCESS
            }
            Err(error) => fail(&error, 3),
        },
        Command::Service { service } => {
            let ended: Result<(), Box<dyn Display>> = match service {
                Service::Ingest => ingest::run().map_err(|error| Box::new(error) as _),
                Service::Gyro => gyro::run().map_err(|error| Box::new(error) as _),
                Service::Accel => accel::run().map_err(|error| Box::new(error) as _),
                Service::Fuser => fuser::run().map_err(|error| Box::new(error) as _),
                Service::Course => course::run().map_err(|error| Box::new(error) as _),
                Service::Gateway => gateway::run().map_err(|error| Box::new(error) as _),
                Service::Cockpit => cockpit::run().map_err(|error| Box::new(error) as _),
                Service::Drivers => drivers::run().map_err(|error| Box::new(error) as _),
            };
            ended.map_or_else(|error| fail(&error, 1), |()| ExitCode::SUCCESS)
        }
    }
}

/// Says what ended a command that has printed no result.
fn fail(error: &dyn Display, code: u8) -> ExitCode {
    out::error_object(error);
    fail_after_result(error, code)
}

/// Says what is wrong with a result that has been printed.
fn fail_after_result(error: &dyn Display, code: u8) -> ExitCode {
    supervisor::announce(error);
    ExitCode::from(code)
}

/// Help, the version, or what is wrong with the command line.
fn usage(said: &clap::Error) -> ExitCode {
    if said.use_stderr() {
        out::error_object(&said.render());
    }
    // Nobody reads it: nothing is left to be done.
    let _ = said.print();
    ExitCode::from(said.exit_code() as u8)
}

fn service(name: &str) -> Result<Service, String> {
    Service::from_name(name).ok_or_else(|| "there is no such service".into())
}
