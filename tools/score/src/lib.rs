//! Scoring of stages: errors against the reference attitude of recordings, and cost of an update.
//!
//! Input: recordings or simulations, and the stages to compare on them.
//!
//! Output: errors per trial and their mean, time per update, attitudes as CSV, figures as SVG, an
//! HTML report, and the best value of a setting.
//!
//! Time: sample timestamps. Only the timing of the stages reads a clock.
//!
//! Failure: unknown names, invalid settings, and files that cannot be read or written, are errors.
//!
//! | module | contents |
//! | --- | --- |
//! | [`stages`] | selection of stages and their settings |
//! | [`chain`] | the stages of the four slots |
//! | [`catalogue`] | list of all stages and parameters |
//! | [`trial`] | a recording or a simulation as a sequence of readings |
//! | [`estimate`] | attitudes that another program has estimated |
//! | [`seeds`] | a simulation repeated with many seeds, and the spread of its errors |
//! | [`mod@run`] | run of all stages over all trials, in the slots of the real system |
//! | [`timing`] | CPU time per update of the bare stages |
//! | `evaluation` | run of chains over trials |
//! | [`error_stats`] | error statistics of a chain over a trial |
//! | [`normalised`] | errors divided by their reported standard deviations |
//! | [`table`], `text` | the scores as JSON and as text tables |
//! | [`tune`] | errors over the range of a setting, and its best value |
//! | [`recommendation`] | recommended stage and setting |
//! | [`overlay`], `report` | attitudes of all stages in common charts; the HTML report |
//! | [`plot`] | figures of a run |
//! | `sensors` | attitude estimates from the gyro alone and the accelerometer alone |
//! | `csv` | table of estimates and reference for each tick |
#![forbid(unsafe_code)]

pub mod catalogue;
pub mod chain;
mod csv;
mod error;
pub mod error_stats;
pub mod estimate;
mod evaluation;
pub mod normalised;
pub mod overlay;
pub mod plot;
pub mod recommendation;
mod report;
pub mod run;
pub mod seeds;
mod sensors;
pub mod stages;
pub mod table;
mod text;
pub mod timing;
pub mod trial;
pub mod tune;

pub use error::ScoreError;
pub use run::{Request, run};
