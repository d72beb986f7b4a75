//! Formats of files and folders.

use std::fmt;

/// Format of a file or folder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Format {
    /// Plumbline recording, plain or gzip.
    Recording,
    /// Other CSV text, plain or gzip.
    Csv,
    /// PX4 log.
    Ulog,
    /// MCAP file: a recorded Plumbline flight or a ROS 2 log.
    Mcap,
    /// Folder of a ROS 2 bag.
    Bag,
    /// DataFlash log of ArduPilot.
    ArduPilot,
    /// SQLite database, as used by ROS 2 bags.
    Sqlite,
    /// Zip archive.
    Zip,
    /// gzip file that does not contain text.
    Gzip,
}

impl Format {
    /// Returns `true` if the format has topics that can be selected.
    pub fn has_topics(self) -> bool {
        matches!(self, Self::Mcap | Self::Bag | Self::Sqlite)
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Recording => "Plumbline recording",
            Self::Csv => "CSV",
            Self::Ulog => "ULog",
            Self::Mcap => "MCAP",
            Self::ArduPilot => "ArduPilot log (BIN)",
            Self::Bag => "ROS 2 bag",
            Self::Sqlite => "SQLite database (ROS 2 db3)",
            Self::Zip => "zip archive",
            Self::Gzip => "gzip file without text",
        })
    }
}
