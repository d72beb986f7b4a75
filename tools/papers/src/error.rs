//! Why a paper could not be made.

use std::{error::Error, io, path::PathBuf};

use thiserror::Error;

/// Why a paper could not be made.
#[derive(Debug, Error)]
pub enum PaperError {
    /// A file or folder cannot be written.
    #[error("writing {path}: {cause}; choose another folder with --out", path = path.display())]
    Write {
        /// Which.
        path: PathBuf,
        /// What the system says.
        cause: io::Error,
    },
    /// A file of an earlier paper cannot be read for the page.
    #[error("reading {path} for the page of all: {cause}; make that paper again, or remove the file", path = path.display())]
    Read {
        /// Which.
        path: PathBuf,
        /// What the system says.
        cause: io::Error,
    },
    /// A picture cannot be drawn.
    #[error("drawing {picture}: {cause}")]
    Draw {
        /// Which.
        picture: &'static str,
        /// What the drawing says.
        cause: Box<dyn Error + Send + Sync>,
    },
}
