//! Warm start: what is known of the sensors outlives a stop of the whole system, in a file.
//!
//! Input: the checkpoints of the slot `fuser`, and the file that an earlier run has left. Output: a [`Prior`] for every fuser of this
//! run, and the file for the next. Time: the clock on the wall, for the age of the file alone; the path sees none of it. Failure: what
//! cannot be used is named and left out; what cannot be written is said, and tried again.
//!
//! | file | what it does |
//! | --- | --- |
//! | `place` | where the file is, and for which runs there is one |
//! | `record` | what is in it, and whether that is of use now |
//! | `moment` | how old it is |
//! | `file` | reading what may be anybody's, writing what is never half written |
//! | `keeper` | the thread that writes |

mod file;
mod keeper;
mod moment;
mod place;
mod record;

use std::{
    path::Path,
    time::{Duration, Instant},
};

use messages::Checkpoint;
use runtime::Prior;

pub(crate) use place::place;
use {file::FileError, keeper::Keeper, moment::Moment, record::Unusable};

use crate::{Plan, UpError};

/// How often it is looked whether there is something to keep.
const LOOK: Duration = Duration::from_millis(500);
/// From one state that is kept to the next, what a power cut may cost against the life of a memory card; sooner one of half the
/// standard deviation.
const INTERVAL: Duration = Duration::from_secs(10);

/// The state of a run that is kept.
#[derive(Debug)]
pub(crate) struct WarmStart {
    keeper: Option<Keeper>,
    looked: Instant,
    kept: Option<Kept>,
    /// What was known last, and when: at first what the run began with.
    known: Option<(Prior, Instant)>,
    /// For people.
    said: Vec<String>,
}

/// What was kept last.
#[derive(Debug, Clone, Copy)]
struct Kept {
    at: Instant,
    next_tick: u64,
    prior: Prior,
}

impl WarmStart {
    /// What the run begins with, and what keeps what it finds.
    pub(crate) fn begin(plan: &Plan) -> Result<(Self, Option<Prior>), UpError> {
        let mut warm = Self { keeper: None, looked: Instant::now(), kept: None, known: None, said: Vec::new() };
        let Some(path) = &plan.state_file else { return Ok((warm, None)) };
        let sensors = record::sensors(&plan.config.launch.ingest);
        let name = path.display();
        let prior = match look(path, sensors) {
            Err(error) if error.is_foreign() => {
                warm.said.push(format!(
                    "state file {name}: {error}; it stays as it is, and nothing is kept for the next start"
                ));
                return Ok((warm, None));
            }
            _ if plan.cold => None,
            Ok(Some((prior, age_s))) => {
                let (age, found) = (record::age(age_s), record::words(&prior));
                warm.said.push(format!("warm start: {found}, kept {age} ago, from {name}"));
                Some(prior)
            }
            Ok(None) => None,
            Err(error) => {
                warm.said.push(format!("cold start: the state file {name} is not used: {error}"));
                None
            }
        };
        warm.keeper = Some(Keeper::new(path.clone(), sensors)?);
        warm.known = prior.map(|prior| (prior, Instant::now()));
        Ok((warm, prior))
    }

    /// Keeps what the fuser has found, now and then; what is to be said.
    pub(crate) fn keep_newest(&mut self, newest: Option<&Checkpoint>) -> Vec<String> {
        if self.looked.elapsed() >= LOOK {
            self.looked = Instant::now();
            self.keep(newest, INTERVAL);
        }
        self.said.extend(self.keeper.iter().flat_map(Keeper::said));
        std::mem::take(&mut self.said)
    }

    /// Keeps the last of it; what is to be said.
    pub(crate) fn end(&mut self, newest: Option<&Checkpoint>) -> Vec<String> {
        self.keep(newest, Duration::ZERO);
        self.said.extend(self.keeper.take().into_iter().flat_map(Keeper::end));
        std::mem::take(&mut self.said)
    }

    /// Keeps what is new after `interval`. While nothing new comes what is known grows old.
    fn keep(&mut self, newest: Option<&Checkpoint>, interval: Duration) {
        let (Some(keeper), Some(newest)) = (&self.keeper, newest) else { return };
        let next_tick = newest.next_tick;
        let Some(prior) = Prior::of(newest).filter(|_| self.kept.is_none_or(|kept| kept.next_tick != next_tick)) else {
            return;
        };
        let prior = with_scale_of_before(prior, &mut self.known);
        let worth = |kept: Kept| kept.at.elapsed() >= interval || prior.is_much_surer_than(&kept.prior);
        if self.kept.is_none_or(worth) {
            keeper.keep(prior);
            self.kept = Some(Kept { at: Instant::now(), next_tick, prior });
        }
    }
}

/// What a fuser has found, with the scale that was known last where it knows none; that is known from now on.
fn with_scale_of_before(found: Prior, known: &mut Option<(Prior, Instant)>) -> Prior {
    let before = known.map(|(prior, at)| prior.aged(at.elapsed().as_secs_f64(), false));
    let prior = found.or_scale_of(before);
    *known = Some((prior, Instant::now()));
    prior
}

/// What the file tells now, and how old that is, s; nothing where there is no file.
fn look(path: &Path, sensors: u64) -> Result<Option<(Prior, f64)>, LookError> {
    let Some(text) = file::read(path)? else { return Ok(None) };
    Ok(Some(record::prior(&text, sensors, &Moment::now())?))
}

/// Why a state file is not used.
#[derive(Debug, thiserror::Error)]
enum LookError {
    #[error(transparent)]
    File(#[from] FileError),
    #[error(transparent)]
    Record(#[from] Unusable),
}

impl LookError {
    /// Who wrote it was not this program, or not this user: it is not replaced either.
    fn is_foreign(&self) -> bool {
        matches!(self, Self::File(_) | Self::Record(Unusable::NoState))
    }
}

#[cfg(test)]
mod tests {
    use runtime::Known;

    use super::*;

    #[test]
    fn a_scale_stays_known_where_the_next_stage_finds_none() {
        let mut before = None;
        let mut with = |found| with_scale_of_before(found, &mut before);
        let known = |sd: f64| Some(Known { mean: [0.002, -0.001, 0.0], sd });
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
