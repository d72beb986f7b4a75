//! What a program does as a stage of a running system, judged as Plumbline's own stages are, as far as messages tell it.
//!
//! Input: a launch file with a program for a slot. Output: a [`Report`]. Time: some tens of seconds; the stage is started some fifty
//! times. Failure: a program that ends or says nothing fails the check at hand.
//!
//! Of the kit for stages in this executable these do not apply: a table of parameters is not told to the supervisor, and numbers
//! that ingest and the slots before never let through cannot be given. What is added is what only a process can do wrong: its
//! order, its stamps, whom it obeys, and its end.
//!
//! | module | what it holds |
//! | --- | --- |
//! | `path` | what a slot is given on a script, and Plumbline's own stages on the same |
//! | `bench` | the program as the only stage of a small system |
//! | `verdict` | what is wrong with what came out |

mod bench;
mod path;
mod verdict;

use std::collections::BTreeMap;

use attitude::metrics::AttitudeError;
use bench::Bench;
use conformance::{
    Check, Figure, Report,
    fault::{BEGIN_S, CATALOGUE},
    script::Script,
};
use launch::{Launch, Service, Stage};
use messages::{Checkpoint, Ticked};
use path::{AccelPlace, CoursePlace, FuserPlace, GyroPlace, Place, RATE_HZ, Tick, error, ticks};
use runtime::{
    Role, checkpoint,
    orders::{Record, Resume},
    shadow::Comparable,
};
use scenario::{Errors, Motion};
use verdict::{order, unsound};

/// The life of the program in every trial.
const INCARNATION: u32 = 7;
const OWNER: Role = Role::Owner { from_tick: 0 };
/// Before a fault a stage is given this much, s, and after it that much.
const BEFORE_S: f64 = 2.0;
const AFTER_S: f64 = 2.0;
/// Ticks before a hand-over, and in all, where there is no fault.
const HANDED_OVER: usize = 1500;
const TICKS: usize = 2500;
/// Most that the attitude may differ at the tick after a hand-over, degrees.
const JUMP_DEG: f64 = 0.5;
/// Largest inclination error with exact sensors, degrees.
const ERROR_DEG: f64 = 2.0;

/// Judges the program of that name; `None` where the launch file has none.
pub fn run(launch: &Launch, name: &str) -> Option<Report> {
    let slot = launch.stages.get(name)?.slot;
    let set =
        launch.slot(slot).filter(|chosen| chosen.stage == name).map_or(BTreeMap::new(), |chosen| chosen.set.clone());
    let mut launch = Launch { stages: launch.stages.clone(), ..Launch::default() };
    *launch.slot_mut(slot)? = Stage { stage: name.into(), set };
    let checks = match slot {
        Service::Ingest | Service::Gateway => return None,
        Service::Gyro => Trial::<GyroPlace>::new(launch).checks(),
        Service::Accel => Trial::<AccelPlace>::new(launch).checks(),
        Service::Fuser => Trial::<FuserPlace>::new(launch).checks(),
        Service::Course => Trial::<CoursePlace>::new(launch).checks(),
    };
    Some(Report { slot: slot.name(), stage: name.into(), checks })
}

struct Trial<P> {
    launch: Launch,
    script: Script,
    place: std::marker::PhantomData<P>,
}

/// What came out of one life, and its states.
struct Life<O> {
    outputs: Vec<O>,
    checkpoints: Vec<Checkpoint>,
}

impl<P: Place> Trial<P> {
    fn new(launch: Launch) -> Self {
        let script = Script::new("S1 at 100 Hz", Motion::S1, Errors::S1, RATE_HZ, BEGIN_S + 15.0);
        Self { launch, script, place: std::marker::PhantomData }
    }

    fn checks(&self) -> Vec<Check> {
        let given = match ticks::<P>(&self.script) {
            Ok(given) => given.into_iter().take(TICKS).collect::<Vec<_>>(),
            Err(cause) => return vec![Check::holds("the slots before it run", Some(cause))],
        };
        let whole = match self.life(None, &given) {
            Ok(whole) => whole,
            Err(cause) => return vec![Check::holds("it starts, and gives each tick out", Some(cause))],
        };
        let mut checks = vec![
            Check::holds(
                "it starts, and gives each tick out once, in order, with the stamps it came with",
                order::<P>(&given, &whole.outputs),
            ),
            Check::holds("outputs are finite and rotations without a fault", unsound(&whole.outputs)),
            Check::holds(
                "two runs give the same bits",
                self.failed(|| self.parts(&whole.outputs, self.life(None, &given)?.outputs)),
            ),
            Check::holds("it publishes nothing but what it owns", self.failed(|| self.obeys(&given))),
            Check::holds("what is no parameter is refused", self.takes_anything()),
            Check::holds("it ends when it is asked to", self.failed(|| self.start(OWNER, None)?.end())),
        ];
        checks.extend(self.recovers(&given, &whole));
        checks.extend(P::NAMES.iter().flat_map(|name| self.hand_over(name, &given, &whole)));
        checks.extend(self.tumbling());
        checks.extend(CATALOGUE.iter().map(|fault| {
            let name = format!("outputs are finite and rotations under {}", fault.name);
            let mut script = fault.put_in(&self.script);
            let (begin_s, end_s) = (BEGIN_S - BEFORE_S, BEGIN_S + fault.duration_s + AFTER_S);
            script.ticks.retain(|tick| (begin_s..end_s).contains(&tick.t_s));
            Check::holds(
                name,
                self.failed(|| {
                    let given = ticks::<P>(&script)?;
                    let outputs = self.life(None, &given)?.outputs;
                    order::<P>(&given, &outputs).or_else(|| unsound(&outputs)).map_or(Ok(()), Err)
                }),
            )
        }));
        checks
    }

    fn start(&self, role: Role, resume: Option<Resume>) -> Result<Bench<P>, String> {
        Bench::start(&self.launch, role, resume)
    }

    /// Runs the program over these ticks.
    fn life(&self, resume: Option<&Checkpoint>, given: &[Tick]) -> Result<Life<P::Output>, String> {
        let resume = resume.map(|checkpoint| Resume::Checkpoint(Box::new(Record::from(checkpoint))));
        let mut bench = self.start(OWNER, resume)?;
        bench.feed(given)?;
        let (outputs, checkpoints) = (std::mem::take(&mut bench.outputs), std::mem::take(&mut bench.checkpoints));
        bench.end()?;
        Ok(Life { outputs, checkpoints })
    }

    fn failed(&self, check: impl FnOnce() -> Result<(), String>) -> Option<String> {
        check().err()
    }

    /// Where two runs differ in a bit.
    fn parts(&self, one: &[P::Output], other: Vec<P::Output>) -> Result<(), String> {
        let bits = |output: &P::Output| bytemuck::bytes_of(&output.canonical()).to_vec();
        let parting = one.iter().zip(&other).find(|(one, other)| bits(one) != bits(other));
        match parting {
            Some((one, _)) => Err(format!("they part at tick {}", one.header().tick)),
            None if one.len() != other.len() => Err(format!("{} and {} ticks", one.len(), other.len())),
            None => Ok(()),
        }
    }

    /// A candidate is silent until a decision names it; an owner stops where a decision names another.
    fn obeys(&self, given: &[Tick]) -> Result<(), String> {
        let mut bench = self.start(Role::Candidate, Some(Resume::Fresh))?;
        bench.feed_silently(&given[..100])?;
        if let Some(output) = bench.outputs.first() {
            return Err(format!("a candidate publishes tick {}", output.header().tick));
        }
        bench.decide(2, INCARNATION, 90)?;
        bench.feed_silently(&given[100..200])?;
        bench.decide(3, INCARNATION + 1, 250)?;
        bench.feed_silently(&given[200..300])?;
        let published: Vec<_> =
            bench.outputs.iter().map(|output| output.header()).map(|header| (header.tick, header.epoch)).collect();
        let due: Vec<_> = (90..250).map(|tick| (tick, 2)).collect();
        if published != due {
            let (first, last) = (published.first(), published.last());
            return Err(format!(
                "owning ticks 90 to 249 by decision 2 it published {first:?} to {last:?}, {} in all",
                published.len()
            ));
        }
        bench.end()
    }

    fn takes_anything(&self) -> Option<String> {
        let mut launch = self.launch.clone();
        launch.slot_mut(P::SERVICE)?.set.insert("no_such_parameter".into(), 1.0);
        Bench::<P>::start(&launch, OWNER, None).ok().map(|_| "no_such_parameter is taken".into())
    }

    /// A later life goes on from a checkpoint bit for bit, and one that is damaged does no harm.
    fn recovers(&self, given: &[Tick], whole: &Life<P::Output>) -> Vec<Check> {
        let Some(kept) = whole.checkpoints.iter().find(|checkpoint| checkpoint.next_tick > HANDED_OVER as u64) else {
            return vec![Check::holds("it publishes checkpoints", Some("none came".into()))];
        };
        let at = kept.next_tick as usize;
        let goes_on = || self.parts(&whole.outputs[at..], self.life(Some(kept), &given[at..])?.outputs);
        let mut checks = vec![Check::holds("a run goes on from a checkpoint bit for bit", self.failed(goes_on))];
        let own = (kept.slot_words + kept.common_words) as usize;
        let mut flipped = *kept;
        flipped.words[own] ^= 1 << 40;
        let mut not_finite = *kept;
        not_finite.words[own..own + kept.stage_words as usize].fill(f64::NAN.to_bits());
        let mut short = Checkpoint { stage_words: kept.stage_words.saturating_sub(1), ..*kept };
        let mut of_another = Checkpoint { service: (P::SERVICE as u32 + 1) % 5, ..*kept };
        for record in [&mut not_finite, &mut short, &mut of_another] {
            record.checksum = record.sum();
        }
        for (what, record) in [
            ("is damaged", flipped),
            ("is not finite", not_finite),
            ("is too short", short),
            ("is of another slot", of_another),
        ] {
            let harm = || unsound(&self.life(Some(&record), &given[at..at + 500])?.outputs).map_or(Ok(()), Err);
            checks.push(Check::holds(format!("a checkpoint that {what} does no harm"), self.failed(harm)));
        }
        checks
    }

    /// To one of Plumbline's own stages and from it.
    fn hand_over(&self, name: &str, given: &[Tick], whole: &Life<P::Output>) -> Vec<Check> {
        let check = |what: String, jump: Result<AttitudeError, String>| match jump {
            Ok(jump) => {
                // A stage that knows north where the other did not sets the heading anew.
                let figure = Figure { value: Some(jump.inclination_deg), limit: Some(JUMP_DEG), unit: "°" };
                Check::most(format!("{what}: the level goes on"), figure, || format!("{:.3}° in all", jump.total_deg))
            }
            Err(cause) => Check::holds(what, Some(cause)),
        };
        vec![
            check(format!("hand-over to {name}"), self.hand_over_to(name, given, whole)),
            check(format!("hand-over from {name}"), self.hand_over_from(name, given)),
        ]
    }

    fn hand_over_to(&self, name: &str, given: &[Tick], whole: &Life<P::Output>) -> Result<AttitudeError, String> {
        let kept = whole
            .checkpoints
            .iter()
            .find(|checkpoint| checkpoint.next_tick > HANDED_OVER as u64)
            .ok_or("no checkpoint came")?;
        let mut slot = self.own(name)?;
        checkpoint::resume(&mut slot, P::SERVICE, kept).map_err(|error| error.to_string())?;
        let at = kept.next_tick as usize;
        let taken = offer::<P>(&mut slot, &given[at..=at]);
        let taken = taken.first().ok_or("nothing came out")?;
        error(&whole.outputs[at], taken).ok_or_else(|| "an output without an attitude".into())
    }

    fn hand_over_from(&self, name: &str, given: &[Tick]) -> Result<AttitudeError, String> {
        let mut slot = self.own(name)?;
        offer::<P>(&mut slot, &given[..HANDED_OVER]);
        let record = checkpoint::checkpoint(&mut slot, P::SERVICE, 1);
        let given = &given[HANDED_OVER..HANDED_OVER + 500];
        let (theirs, ours) = (self.life(Some(&record), given)?.outputs, offer::<P>(&mut slot, given));
        if let Some(flaw) = unsound(&theirs) {
            return Err(flaw);
        }
        theirs
            .first()
            .zip(ours.first())
            .and_then(|(one, other)| error(one, other))
            .ok_or_else(|| "nothing came out".into())
    }

    /// One of Plumbline's own stages in the slot.
    fn own(&self, name: &str) -> Result<P::Slot, String> {
        let mut launch = Launch::default();
        if let Some(slot) = launch.slot_mut(P::SERVICE) {
            name.clone_into(&mut slot.stage);
        }
        P::slot(&path::orders(&launch, OWNER, None)).map_err(|error| error.to_string())
    }

    /// Through both charts, with exact sensors.
    fn tumbling(&self) -> Option<Check> {
        let motion = Motion::Tumble([2.4, -1.6, 0.8].into());
        let script = Script::new("tumbling at 100 Hz", motion, Errors::default(), RATE_HZ, 20.0);
        let name = "tumbling: largest inclination error with exact sensors";
        let run = || {
            let given = ticks::<P>(&script)?;
            let outputs = self.life(None, &given)?.outputs;
            unsound(&outputs).map_or(Ok(()), Err)?;
            let of = |(tick, output): (&Tick, &P::Output)| {
                Some(AttitudeError::between(output.attitude()?, tick.truth).inclination_deg)
            };
            Ok(given.iter().zip(&outputs).filter_map(of).fold(0.0, f64::max))
        };
        let limit = Some(ERROR_DEG).filter(|_| P::LEVELS);
        Some(match run() {
            Ok(value) => {
                Check::most(name, Figure { value: Some(value), limit, unit: "°" }, || "it tumbles at 3 rad/s".into())
            }
            Err(cause) => Check::holds(name, Some(cause)),
        })
    }
}

/// What Plumbline's own stage makes of these ticks.
fn offer<P: Place>(slot: &mut P::Slot, given: &[Tick]) -> Vec<P::Output> {
    let mut outputs = Vec::new();
    let feeds = given.iter().flat_map(|tick| &tick.feeds);
    feeds.for_each(|feed| P::offer(slot, feed, &mut |output| outputs.push(output)));
    outputs
}
