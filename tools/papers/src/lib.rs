//! The figures and tables of the four papers that Plumbline's stages come from, made by these stages.
//!
//! Input: which paper, and a folder. Output: each figure and table as SVG and PNG, one HTML page of all that the folder holds, and the
//! tables as text. Time: that of the simulations; no clock. Failure: a file that cannot be written.
//!
//! | module | what it holds |
//! | --- | --- |
//! | [`s1`] | Matveev 2025: the point w and the turn z, noise-free and with errors, the fusion by w |
//! | [`s2`] | pitch and roll by matrix and by quaternion, over the whole sphere |
//! | [`s3`] | Madgwick's filter, original and improved |
//! | [`s4`] | platform levelling with a receiver, without, and both |
//! | [`picture`] | what can be drawn, and the files it becomes |
//! | [`page`] | the HTML page |
#![forbid(unsafe_code)]

mod block_diagram;
mod error;
mod heatmap;
pub mod page;
pub mod picture;
pub mod progress;
pub mod s1;
pub mod s2;
pub mod s3;
pub mod s4;
mod scene;
mod table;

use std::path::Path;

pub use error::PaperError;
use figures::Typeface;
use picture::Part;
pub use progress::Progress;

/// One of the four papers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Paper {
    /// Matveev 2025.
    S1,
    /// Inclinometers by matrix and by quaternion.
    S2,
    /// The improved Madgwick filter.
    S3,
    /// Platform levelling.
    S4,
}

impl Paper {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::S1, Self::S2, Self::S3, Self::S4];

    /// `s1` to `s4`: its name in commands and files.
    pub fn name(self) -> &'static str {
        match self {
            Self::S1 => "s1",
            Self::S2 => "s2",
            Self::S3 => "s3",
            Self::S4 => "s4",
        }
    }

    /// The paper's paper_folder title.
    pub fn title(self) -> &'static str {
        match self {
            Self::S1 => {
                "S1: V. V. Matveev et al., parameters (w, z) in strapdown attitude systems, Devices and Methods of Measurements 16(3), 2025, 202–211"
            }
            Self::S2 => {
                "S2: mathematical modelling of geonavigation measuring systems with three-component accelerometers (matrix and quaternion methods)"
            }
            Self::S3 => {
                "S3: improved orientation of a UAV by a MEMS inertial system on the basis of the Madgwick filter"
            }
            Self::S4 => "S4: orientation algorithm for a low-grade MEMS strapdown system, tried on a Mi-8 helicopter",
        }
    }

    /// Runs of its simulations, which a progress bar counts beside the pictures.
    fn run_count(self) -> u64 {
        match self {
            Self::S1 => s1::RUN_COUNT,
            Self::S2 => s2::RUN_COUNT,
            Self::S3 => s3::RUN_COUNT,
            Self::S4 => s4::RUN_COUNT,
        }
    }

    fn parts(self, progress: &mut Progress<'_>) -> Vec<Part> {
        match self {
            Self::S1 => s1::parts(progress),
            Self::S2 => s2::parts(progress),
            Self::S3 => s3::parts(progress),
            Self::S4 => s4::parts(progress),
        }
    }
}

/// What was made of a paper.
#[derive(Debug)]
pub struct PaperOutput {
    /// Its figures and tables.
    pub parts: Vec<Part>,
    /// Why there is no PNG, where there is none.
    pub png_skipped_reason: Option<String>,
}

/// Makes a paper's figures and tables in `folder/NAME/`, and `folder/index.html` of all papers that are there.
///
/// `on_progress` hears how many of how many run_count and pictures are done.
pub fn reproduce(paper: Paper, folder: &Path, on_progress: &mut dyn FnMut(u64, u64)) -> Result<PaperOutput, PaperError> {
    let mut progress = Progress::new(paper.run_count(), on_progress);
    let parts = paper.parts(&mut progress);
    progress.add_steps(parts.len() as u64);
    let paper_folder = folder.join(paper.name());
    std::fs::create_dir_all(&paper_folder).map_err(|cause| PaperError::Write { path: paper_folder.clone(), cause })?;
    let (typeface, png_skipped_reason) = match Typeface::find() {
        Ok(typeface) => (Some(typeface), None),
        Err(missing) => (None, Some(format!("no PNGs are made, only SVGs: {missing}"))),
    };
    let mut svgs = Vec::new();
    for part in &parts {
        svgs.push(part.write(&paper_folder, typeface.as_ref())?);
        progress.step();
    }
    page::write_section(paper, &paper_folder, &parts, &svgs)?;
    page::write_index(folder)?;
    Ok(PaperOutput { parts, png_skipped_reason })
}
