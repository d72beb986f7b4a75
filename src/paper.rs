//! `plumb paper`: the figures and tables of the papers that the stages come from.

use std::{path::PathBuf, process::ExitCode};

use clap::{Args, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};
use papers::{Paper, picture::Picture};

use crate::{fail, out::print};

/// The command line of `plumb paper`.
#[derive(Args)]
#[command(after_help = "\
Each figure and table becomes DIR/PAPER/NAME.svg and, where the system has a typeface, NAME.png; DIR/index.html shows all papers that were made in \
DIR. The tables are printed, too.")]
pub(crate) struct PaperCommand {
    /// Which paper.
    #[arg(value_name = "PAPER")]
    paper: Which,
    /// The folder that the figures and the page go to.
    #[arg(long, value_name = "DIR", default_value = "papers")]
    out: PathBuf,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Which {
    /// Matveev 2025: the point w and the turn z.
    S1,
    /// Inclinometers by matrix and by quaternion.
    S2,
    /// The improved Madgwick filter.
    S3,
    /// Platform levelling with and without a receiver.
    S4,
    /// All of them.
    All,
}

impl Which {
    fn papers(self) -> Vec<Paper> {
        match self {
            Self::S1 => vec![Paper::S1],
            Self::S2 => vec![Paper::S2],
            Self::S3 => vec![Paper::S3],
            Self::S4 => vec![Paper::S4],
            Self::All => Paper::ALL.into(),
        }
    }
}

pub(crate) fn run(command: &PaperCommand) -> ExitCode {
    let mut text = String::new();
    let mut without_png = None;
    for paper in command.paper.papers() {
        let bar = ProgressBar::new(0).with_style(style()).with_message(paper.name());
        let made = papers::make(paper, &command.out, &mut |done, of| {
            bar.set_length(of);
            bar.set_position(done);
        });
        bar.finish_and_clear();
        match made {
            Ok(made) => {
                for part in &made.parts {
                    if let Picture::Table(table) = &part.picture {
                        text += &format!("{}: {}\n{table}\n\n", paper.name(), part.title);
                    }
                }
                without_png = made.without_png;
            }
            Err(error) => return fail(&error, 1),
        }
    }
    if let Some(missing) = without_png {
        supervisor::announce(missing);
    }
    text += &format!("All figures: {}", command.out.join(papers::page::INDEX).display());
    print(&text)
}

/// Drawn on standard error, and only on a terminal.
fn style() -> ProgressStyle {
    ProgressStyle::with_template("{msg} {bar:40} {pos}/{len}, {eta} left")
        .unwrap_or_else(|_| ProgressStyle::default_bar())
}
