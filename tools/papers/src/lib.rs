//! Reproduces the figures and tables of four papers with the stages that are based on them.
//!
//! Input: a paper and a folder.
//!
//! Output: each figure and table as SVG, and one HTML page with all papers reproduced in the
//! folder. Tables are also available as text.
//!
//! Failure: an error if a file cannot be written, or if the section of a previously reproduced
//! paper cannot be read.
//!
//! | module | content |
//! | --- | --- |
//! | [`s1`] | Matveev 2025: the point w and the angle z, noise-free and with errors, fusion by w |
//! | [`s2`] | pitch and roll by matrix and by quaternion, over the whole sphere |
//! | [`s3`] | Madgwick filter, original and improved |
//! | [`s4`] | platform levelling with GNSS, without GNSS, and unified |
//! | [`picture`] | figures and tables, and the files they are written to |
//! | [`page`] | HTML page |
#![forbid(unsafe_code)]

mod error;
mod heatmap;
pub mod page;
mod paper;
pub mod picture;
pub mod progress;
pub mod s1;
pub mod s2;
pub mod s3;
pub mod s4;
mod sphere;
mod table;

use std::path::Path;

pub use error::PaperError;
pub use paper::Paper;
use picture::Part;
pub use progress::Progress;

/// Reproduces a paper: writes its figures and tables to `folder/NAME/`, and updates
/// `folder/index.html`.
///
/// The index page contains every paper that the folder holds. `on_progress` receives the number of
/// finished steps and the total number of steps. A step is a simulation run or a picture. Returns
/// the figures and tables in the order of the page.
///
/// # Errors
///
/// Returns an error if a file or folder cannot be written, a picture cannot be drawn, or the
/// section of another paper in the folder cannot be read.
pub fn reproduce(paper: Paper, folder: &Path, on_progress: &mut dyn FnMut(u64, u64)) -> Result<Vec<Part>, PaperError> {
    let mut progress = Progress::new(paper.run_count(), on_progress);
    let parts = paper.parts(&mut progress);
    progress.add_steps(parts.len() as u64);
    let paper_folder = folder.join(paper.name());
    std::fs::create_dir_all(&paper_folder).map_err(|cause| PaperError::Write { path: paper_folder.clone(), cause })?;
    let mut svgs = Vec::new();
    for part in &parts {
        svgs.push(part.write(&paper_folder)?);
        progress.step();
    }
    page::write_section(paper, &paper_folder, &parts, &svgs)?;
    page::write_index(folder)?;
    Ok(parts)
}
