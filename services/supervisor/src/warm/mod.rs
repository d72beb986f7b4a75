//! Warm start: sensor errors found in one run are kept in a file for the next.
//!
//! - Input: the checkpoints of the slot `fuser`, and the file written by an earlier run.
//! - Output: a [`Prior`] for every fuser of this run, and the file for the next run.
//! - Time: wall-clock time, used only for the age of the file and not visible to the data path.
//! - Failure: a file that cannot be used is reported and ignored. A failed write is reported and
//!   retried.
//!
//! | module | contents |
//! | --- | --- |
//! | `location` | path of the file, and which runs have one |
//! | `record` | content of the file and its validation |
//! | `clock` | age of the file |
//! | `file` | reading an untrusted file, writing atomically |
//! | `writer` | thread that writes the file |

mod clock;
pub(crate) mod file;
mod location;
mod record;
mod writer;

use std::{
    path::Path,
    time::{Duration, Instant},
};

use messages::Checkpoint;
use runtime::Prior;

pub(crate) use location::state_file_path;
use {clock::Timestamp, file::FileError, record::StateError, writer::StateWriter};

use crate::{Plan, error::UpError};

/// Interval between two checks for a new state.
const CHECK_INTERVAL: Duration = Duration::from_millis(500);
/// Minimum interval between two writes: a compromise between the loss of data at a power cut and
/// the wear of a memory card.
///
/// A state is written earlier if its standard deviation has halved.
const WRITE_INTERVAL: Duration = Duration::from_secs(10);

/// Warm-start state of a run.
#[derive(Debug)]
pub(crate) struct WarmStart {
    writer: Option<StateWriter>,
    last_check: Instant,
    last_written: Option<WrittenState>,
    /// Newest known sensor errors and their time. Initially the errors known at the start of the
    /// run.
    latest: Option<(Prior, Instant)>,
    /// Messages to announce.
    messages: Vec<String>,
}

/// State written most recently.
#[derive(Debug, Clone, Copy)]
struct WrittenState {
    written: Instant,
    next_tick: u64,
    prior: Prior,
}

impl WarmStart {
    /// Loads the state of an earlier run and starts the thread that writes the new state.
    ///
    /// # Errors
    ///
    /// Returns an error if the thread cannot be started. An unusable file is only announced.
    pub(crate) fn load(plan: &Plan) -> Result<(Self, Option<Prior>), UpError> {
        let mut warm =
            Self { writer: None, last_check: Instant::now(), last_written: None, latest: None, messages: Vec::new() };
        let Some(path) = &plan.state_file else { return Ok((warm, None)) };
        let sensors = record::sensor_fingerprint(&plan.config.launch.ingest);
        let name = foreign::path(path);
        let prior = match load_prior(path, sensors) {
            Err(error) if error.is_foreign() => {
                warm.messages.push(format!(
                    "state file {name}: {error}; it is left unchanged, and no state is kept for the next start"
                ));
                return Ok((warm, None));
            }
            _ if plan.cold => None,
            Ok(Some((prior, age_s))) => {
                let (age, found) = (record::format_age(age_s), record::describe(&prior));
                warm.messages.push(format!("warm start: {found}, written {age} ago, from {name}"));
                Some(prior)
            }
            Ok(None) => None,
            Err(error) => {
                warm.messages.push(format!("cold start: state file {name} not used: {error}"));
                None
            }
        };
        warm.writer = Some(StateWriter::new(path.clone(), sensors)?);
        warm.latest = prior.map(|prior| (prior, Instant::now()));
        Ok((warm, prior))
    }

    /// Writes the state of the newest checkpoint if due, and returns messages to announce.
    pub(crate) fn update(&mut self, newest: Option<&Checkpoint>) -> Vec<String> {
        if self.last_check.elapsed() >= CHECK_INTERVAL {
            self.last_check = Instant::now();
            self.write_if_due(newest, WRITE_INTERVAL);
        }
        self.messages.extend(self.writer.iter().flat_map(StateWriter::messages));
        std::mem::take(&mut self.messages)
    }

    /// Writes the final state, and returns messages to announce.
    pub(crate) fn finish(&mut self, newest: Option<&Checkpoint>) -> Vec<String> {
        self.write_if_due(newest, Duration::ZERO);
        self.messages.extend(self.writer.take().into_iter().flat_map(StateWriter::finish));
        std::mem::take(&mut self.messages)
    }

    /// Writes a new state if `interval` has passed since the previous write, or if the new state is
    /// much more certain.
    fn write_if_due(&mut self, newest: Option<&Checkpoint>, interval: Duration) {
        let (Some(writer), Some(newest)) = (&self.writer, newest) else { return };
        let next_tick = newest.next_tick;
        let Some(prior) =
            Prior::from_checkpoint(newest).filter(|_| self.last_written.is_none_or(|last| last.next_tick != next_tick))
        else {
            return;
        };
        let prior = with_previous_scale(prior, &mut self.latest);
        let is_worth_writing =
            |last: WrittenState| last.written.elapsed() >= interval || prior.is_much_more_certain_than(&last.prior);
        if self.last_written.is_none_or(is_worth_writing) {
            writer.submit(prior);
            self.last_written = Some(WrittenState { written: Instant::now(), next_tick, prior });
        }
    }
}

/// Adds the previously known gyro scale if the fuser has not estimated one. Stores the result as
/// the newest state.
fn with_previous_scale(found: Prior, latest: &mut Option<(Prior, Instant)>) -> Prior {
    let previous = latest.map(|(prior, found_at)| prior.aged(found_at.elapsed().as_secs_f64(), false));
    let prior = found.or_scale_from(previous);
    *latest = Some((prior, Instant::now()));
    prior
}

/// Returns the prior in the file and its age in seconds, or `None` if the file does not exist.
fn load_prior(path: &Path, sensors: u64) -> Result<Option<(Prior, f64)>, LoadError> {
    let Some(text) = file::read(path)? else { return Ok(None) };
    Ok(Some(record::decode(&text, sensors, &Timestamp::now())?))
}

/// Reason why a state file is not used.
#[derive(Debug, thiserror::Error)]
enum LoadError {
    #[error(transparent)]
    File(#[from] FileError),
    #[error(transparent)]
    Record(#[from] StateError),
}

impl LoadError {
    /// Returns `true` if another program or user wrote the file. Such a file must not be replaced.
    fn is_foreign(&self) -> bool {
        matches!(self, Self::File(_) | Self::Record(StateError::NotStateFile))
    }
}

#[cfg(test)]
mod tests {
    use runtime::PriorEstimate;

    use super::*;

    #[test]
    fn gyro_scale_is_kept_if_next_stage_does_not_estimate_it() {
        let mut before = None;
        let mut with = |found| with_previous_scale(found, &mut before);
        let known = |sd: f64| Some(PriorEstimate { mean: [0.002, -0.001, 0.0], sd });
        let found = |gyro_scale| Prior { bias_rad_s: known(1e-4), hard_iron_ut: None, gyro_scale };
        assert_eq!(with(found(None)).gyro_scale, None);
        assert_eq!(with(found(known(1e-3))).gyro_scale, known(1e-3));
        for _ in 0..2 {
            let kept = with(found(None)).gyro_scale.unwrap();
            assert_eq!(kept.mean, [0.002, -0.001, 0.0]);
            assert!((1e-3..1.001e-3).contains(&kept.sd), "{kept:?}");
        }
        assert_eq!(with(found(known(5e-4))).gyro_scale, known(5e-4));
    }
}
