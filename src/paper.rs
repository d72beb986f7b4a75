//! `plumb paper`: reproduces the figures and tables of the papers behind the stages.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use papers::{Paper, picture::Picture};

use crate::{failure::Outcome, notice::progress_bar, stdout::print};

/// Arguments of `plumb paper`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  plumb paper s1
  plumb paper all --out-dir papers

Writes DIR/PAPER/NAME.svg and DIR/index.html with all papers in DIR. Tables are
also printed.")]
pub(crate) struct PaperCommand {
    /// Paper to reproduce
    #[arg(value_name = "PAPER")]
    paper: PaperArg,
    /// Folder for the figures and the page
    #[arg(long, value_name = "DIR", default_value = "papers")]
    out_dir: PathBuf,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum PaperArg {
    /// Matveev 2025: attitude as point w and angle z
    S1,
    /// Inclinometers by matrix and by quaternion
    S2,
    /// Improved Madgwick filter
    S3,
    /// Platform levelling with and without a GNSS receiver
    S4,
    /// All papers
    All,
}

impl PaperArg {
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

pub(crate) fn run(command: &PaperCommand) -> Outcome {
    let mut text = String::new();
    for paper in command.paper.papers() {
        let bar = progress_bar(0, "{msg} {bar:40} {pos}/{len}, {eta} left").with_message(paper.name());
        let result = papers::reproduce(paper, &command.out_dir, &mut |done, total| {
            bar.set_length(total);
            bar.set_position(done);
        });
        bar.finish_and_clear();
        for part in result? {
            if let Picture::Table(table) = &part.picture {
                text += &format!("{}: {}\n{table}\n\n", paper.name(), part.title);
            }
        }
    }
    text += &format!("All figures: {}", foreign::path(&command.out_dir.join(papers::page::INDEX_FILE)));
    Ok(print(&text))
}
