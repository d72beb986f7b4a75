//! Scores: what stages make of recordings, against their reference attitude, and what a step of them costs.
//!
//! Input: files or simulations, and the stages to run over them side by side. Output: errors per trial and their mean, time per
//! update, attitudes as CSV, figures as SVG or PNG, a page of all of it as HTML, the best value of a setting. Time: the samples' own; the clock only to time the stages. Failure: what was asked
//! for and does not exist, a file that cannot be read or written.
//!
//! | module | what it holds |
//! | --- | --- |
//! | [`stages`] | which stages run, and how they are set |
//! | [`chain`] | the stages of one path |
//! | [`catalogue`] | what there is to choose from |
//! | [`trial`] | a recording or a simulation, moment by moment |
//! | [`seeds`] | a simulation with many seeds, and how its errors spread |
//! | [`mod@run`] | the stages over the trials, through the slots of the running system |
//! | [`timing`] | nanoseconds per update of the bare stages |
//! | [`tally`], [`normalised`] | the errors of a chain of stages over a trial; errors over their own standard deviations |
//! | [`table`], `text` | the scores, for scripts and for people |
//! | [`tune`], [`verdict`] | errors over the range of a setting, the best value; which stage and setting to choose |
//! | [`overlay`], `report` | the attitudes of all stages one over the other; the page |
//! | [`plot`] | figures of a run |
//! | `sensors` | what gyro and accelerometer say on their own |
//! | `csv` | what was said at each tick, and the truth beside it |
#![forbid(unsafe_code)]

pub mod catalogue;
pub mod chain;
mod csv;
mod error;
pub mod normalised;
pub mod overlay;
pub mod plot;
mod report;
pub mod run;
pub mod seeds;
mod sensors;
pub mod stages;
pub mod table;
pub mod tally;
mod text;
pub mod timing;
pub mod trial;
pub mod tune;
pub mod verdict;

pub use error::ScoreError;
pub use run::{Request, run};
