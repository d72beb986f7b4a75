//! Which system a command is about: one of this machine, or a vehicle elsewhere.

use std::path::Path;

use clap::Args;
use launch::Launch;

use crate::remote::Way;

/// Which system on this machine is asked.
#[derive(Args)]
pub(crate) struct OnBoard {
    /// The system's name [default: that of ./launch.toml, else plumbline].
    #[arg(long = "system", value_name = "NAME")]
    name: Option<String>,
    /// Print JSON.
    #[arg(long)]
    pub(crate) json: bool,
}

/// Which system is asked, on this machine or elsewhere.
#[derive(Args)]
pub(crate) struct System {
    #[command(flatten)]
    on_board: OnBoard,
    /// A vehicle elsewhere in its place, over the network.
    #[arg(long, value_name = "VEHICLE", conflicts_with = "name")]
    remote: Option<String>,
    #[command(flatten)]
    way: Way,
}

impl System {
    pub(crate) fn json(&self) -> bool {
        self.on_board.json
    }

    pub(crate) fn name(&self) -> String {
        self.on_board.name()
    }

    /// The vehicle elsewhere, and the way to it.
    pub(crate) fn remote(&self) -> Option<(&str, &Way)> {
        Some((self.remote.as_deref()?, &self.way))
    }
}

impl OnBoard {
    /// It was named on the command line.
    pub(crate) fn is_named(&self) -> bool {
        self.name.is_some()
    }

    pub(crate) fn name(&self) -> String {
        name(self.name.as_deref())
    }
}

/// The system of that name; where none is named, that of the folder's launch file.
pub(crate) fn name(named: Option<&str>) -> String {
    let of_file = || Some(Launch::read(Path::new("launch.toml")).ok()?.name);
    named.map(str::to_owned).or_else(of_file).unwrap_or_else(|| Launch::default().name)
}
