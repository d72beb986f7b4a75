//! `plumb station`: every vehicle there is to see, and whether all that it sends arrives.

pub(crate) mod fleet;
mod lines;
mod view;

use std::{
    error::Error,
    ops::ControlFlow,
    path::PathBuf,
    process::ExitCode,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use clap::Args;
use dashboard::Screen;
use link::{Link, MessageStream};
use observe::tables::{TableError, Tables};
use wire::keys;

use crate::{fail, out, remote::Way};
use fleet::Vehicles;

/// Between two tables as lines.
const SHOW_INTERVAL: Duration = Duration::from_secs(1);
/// Longest wait for a message.
const TURN: Duration = Duration::from_millis(20);
/// Messages taken before somebody else has a turn.
const MAX_MESSAGES: usize = 1000;

/// The command line of `plumb station`.
#[derive(Args)]
pub(crate) struct Station {
    #[command(flatten)]
    way: Way,
    /// The vehicle that is shown in detail [default: the first].
    #[arg(long)]
    vehicle: Option<String>,
    /// How long [default: until q or Ctrl-C].
    #[arg(long, value_name = "SECONDS")]
    seconds: Option<f64>,
    /// Write a table DIR/VEHICLE/TOPIC.csv of each topic.
    #[arg(long, value_name = "DIR")]
    csv: Option<PathBuf>,
    /// Print JSON at the end, on the last line of standard output.
    #[arg(long)]
    json: bool,
    /// Print a table each second below the one before, also on a terminal.
    #[arg(long)]
    lines: bool,
}

/// What comes in, and what is known of it.
struct Sight {
    messages: MessageStream,
    signs: MessageStream,
    tables: Option<Tables>,
    vehicles: Vehicles,
    ends: Arc<AtomicBool>,
    since: Instant,
    seconds: Option<f64>,
}

/// Looks at vehicles until it is to end.
pub(crate) fn run(station: &Station) -> ExitCode {
    let ends = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
        if let Err(cause) = signal_hook::flag::register(signal, ends.clone()) {
            return fail(&format_args!("catching signals: {cause}"), 1);
        }
    }
    let link = match station.way.open() {
        Ok(link) => link,
        Err(error) => return fail(&error, error.exit_code()),
    };
    match watch(station, &link, ends) {
        Ok((vehicles, _)) if station.json => out::print(&fleet::report(&vehicles)),
        Ok((_, shown)) => shown.break_value().unwrap_or(ExitCode::SUCCESS),
        Err(error) => fail(&error, 1),
    }
}

fn watch(
    station: &Station,
    link: &Link,
    ends: Arc<AtomicBool>,
) -> Result<(Vehicles, ControlFlow<ExitCode>), Box<dyn Error>> {
    let mut sight = Sight {
        messages: link.subscribe(&keys::key("*", "*"))?,
        signs: link.subscribe_liveliness(&keys::key("*", &format!("{}/**", keys::LIVELINESS)))?,
        tables: station.csv.as_deref().map(Tables::in_folder),
        vehicles: Vehicles::new(),
        ends,
        since: Instant::now(),
        seconds: station.seconds,
    };
    let shown = if !station.json && !station.lines && Screen::is_there() {
        view::show(&mut sight, station.vehicle.as_deref())?;
        ControlFlow::Continue(())
    } else {
        show_lines(&mut sight, station)?
    };
    sight.tables.map_or(Ok(()), Tables::finish)?;
    link.close();
    Ok((sight.vehicles, shown))
}

fn show_lines(sight: &mut Sight, station: &Station) -> Result<ControlFlow<ExitCode>, TableError> {
    let (mut shown, mut shown_at) = (ControlFlow::Continue(()), Instant::now());
    while shown.is_continue() && !sight.is_over() {
        sight.look()?;
        if shown_at.elapsed() > SHOW_INTERVAL && !station.json {
            shown_at = Instant::now();
            shown = out::show_lines(&lines::table(&sight.vehicles, station.vehicle.as_deref()));
        }
    }
    Ok(shown)
}

impl Sight {
    fn is_over(&self) -> bool {
        let over = self.seconds.is_some_and(|limit_s| self.since.elapsed().as_secs_f64() > limit_s);
        over || self.ends.load(Ordering::SeqCst)
    }

    /// Takes what has come, and waits a little where nothing has.
    fn look(&mut self) -> Result<(), TableError> {
        while let Some(sign) = self.signs.next(Duration::ZERO) {
            fleet::see(&mut self.vehicles, &sign);
        }
        let mut wait = TURN;
        for _ in 0..MAX_MESSAGES {
            let Some(message) = self.messages.next(wait) else { break };
            wait = Duration::ZERO;
            fleet::take(&mut self.vehicles, &message, self.tables.as_mut())?;
        }
        Ok(())
    }
}
