//! A stage that is a program of its own.

use std::{
    cell::{OnceCell, RefCell},
    fmt,
    marker::PhantomData,
    time::Duration,
};

use attitude::{
    fuser::{Fuser, FuserStage},
    gyro::{Gyro, GyroStage},
    numbers::Numbers,
    parameters::{Parameter, ParameterError},
    stage::{RestoreError, STATE_LIMIT, Snapshot, Sound, Stage},
    state::Attitude,
};
use launch::Program;
use sdk::{
    Description,
    frame::{self, FrameError, Kind},
};

use crate::{
    child::{Child, HostError},
    finite_input::Given,
    interned,
};

/// The stages of a slot, one of which may be a program of its own: its input, output and common state are numbers.
pub trait HostedBy: Stage<Input: Given, Output: Numbers + Default + Sound, Common: Numbers + Default> {}

impl<S: Stage<Input: Given, Output: Numbers + Default + Sound, Common: Numbers + Default>> HostedBy for S {}

/// A program in the place of a stage `B`.
///
/// Its clone is another process, set alike and given the same state.
pub struct Hosted<B> {
    name: &'static str,
    program: Program,
    limit: Duration,
    parameters: &'static [Parameter],
    settings: Vec<(usize, f64)>,
    /// Numbers in its state.
    state_len: usize,
    /// `None` where the stage that it was to be like had failed.
    child: RefCell<Option<Child>>,
    failure: OnceCell<HostError>,
    of: PhantomData<fn() -> B>,
}

impl<B: HostedBy> Hosted<B> {
    /// Starts the program that fills a slot under this name. Each answer may take as long as `limit`.
    pub fn start(name: &str, program: &Program, limit: Duration) -> Result<Self, HostError> {
        let mut child = Child::start(program.command())?;
        let described = child.ask(Kind::Describe, |_| {})?.map(Description::read);
        let description = match described {
            Some(Ok(description)) => description,
            Some(Err(error)) => return Err(child.wrong(Kind::Describe, &error)),
            None => return Err(child.wrong(Kind::Describe, &"a refusal")),
        };
        if description.slot != program.slot.name() {
            let other = format!("`slot {}`, and it is to fill the slot {}", description.slot, program.slot);
            return Err(child.wrong(Kind::Describe, &other));
        }
        let kept = interned::text(name).zip(interned::parameters(&description));
        let (name, parameters) = kept.ok_or_else(|| child.wrong(Kind::Describe, &"ever other descriptions"))?;
        let state_len = child.ask(Kind::Snapshot, |_| {})?.map_or(usize::MAX, <[u8]>::len) / 8;
        if state_len > STATE_LIMIT {
            return Err(child.wrong(Kind::Snapshot, &format_args!("more than {STATE_LIMIT} numbers")));
        }
        child.set_limit(limit)?;
        Ok(Self {
            name,
            program: program.clone(),
            limit,
            parameters,
            settings: Vec::new(),
            state_len,
            child: RefCell::new(Some(child)),
            failure: OnceCell::new(),
            of: PhantomData,
        })
    }

    /// Asks the program, as long as it has not failed, and hands its answer to `take`; `None` where there is no answer.
    fn ask<T>(
        &self,
        kind: Kind,
        put: impl FnOnce(&mut Vec<u8>),
        take: impl FnOnce(&[u8]) -> Result<T, FrameError>,
    ) -> Option<Answer<T>> {
        let mut child = self.child.borrow_mut();
        let child = child.as_mut().filter(|_| self.failure.get().is_none())?;
        let answered = match child.ask(kind, put) {
            Ok(None) => return Some(Answer::Refused),
            Ok(Some(payload)) => take(payload),
            Err(error) => {
                // It fails once, so there is nothing to be replaced.
                let _ = self.failure.set(error);
                return None;
            }
        };
        match answered {
            Ok(value) => Some(Answer::Taken(value)),
            Err(cause) => {
                let _ = self.failure.set(child.wrong(kind, &cause));
                None
            }
        }
    }

    /// Hands something over that the program may refuse.
    fn hand(&self, kind: Kind, put: impl FnOnce(&mut Vec<u8>)) -> Result<(), RestoreError> {
        match self.ask(kind, put, nothing) {
            Some(Answer::Taken(())) => Ok(()),
            Some(Answer::Refused) => Err(RestoreError::Flaw { flaw: "numbers that the program refuses" }),
            None => Err(RestoreError::Flaw { flaw: "and the program has failed" }),
        }
    }
}

impl<B> Hosted<B> {
    /// The process.
    pub fn pid(&self) -> Option<u32> {
        self.child.borrow().as_ref().map(Child::pid)
    }
}

/// What a program answers.
enum Answer<T> {
    Taken(T),
    Refused,
}

impl<T> Answer<T> {
    fn taken(self) -> Option<T> {
        match self {
            Self::Taken(value) => Some(value),
            Self::Refused => None,
        }
    }
}

/// An answer without a payload.
fn nothing(payload: &[u8]) -> Result<(), FrameError> {
    if payload.is_empty() { Ok(()) } else { Err(FrameError::Length { found: payload.len(), expected: 0 }) }
}

/// A value without a number in it: what a stage gives that has failed.
fn no_numbers<T: Numbers + Default>() -> T {
    let mut value = T::default();
    value.visit(&mut |number| *number = f64::NAN);
    value
}

impl<B: HostedBy> Stage for Hosted<B> {
    type Input = B::Input;
    type Output = B::Output;
    type Common = B::Common;

    fn name(&self) -> &'static str {
        self.name
    }

    fn parameters(&self) -> &'static [Parameter] {
        self.parameters
    }

    fn set(&mut self, name: &str, value: f64) -> Result<(), ParameterError> {
        let unknown = ParameterError::Unknown { known: self.parameters };
        let place = self.parameters.iter().position(|parameter| parameter.name == name).ok_or(unknown)?;
        let parameter = self.parameters.get(place).ok_or(unknown)?;
        let in_range = (parameter.least..=parameter.most).contains(&value);
        // What it refuses in its own range it does not take either.
        let put = |frame: &mut Vec<u8>| [place as f64, value].into_iter().for_each(|number| frame::put(frame, number));
        if !in_range || self.hand(Kind::Set, put).is_err() {
            return Err(ParameterError::OutOfRange { parameter, value });
        }
        self.settings.push((place, value));
        Ok(())
    }

    fn step(&mut self, input: &B::Input) -> B::Output {
        let given = input.finite();
        let output = self.ask(Kind::Step, |frame| frame::put(frame, given), frame::value).and_then(Answer::taken);
        output.unwrap_or_else(no_numbers)
    }

    /// Nothing: the state is in the other process, and [`Stage::snapshot`] and [`Stage::restore`] fetch and bring it.
    fn visit_state(&mut self, _visit: &mut dyn FnMut(&mut f64)) {}

    fn common(&self) -> B::Common {
        let common = self.ask(Kind::Common, |_| {}, frame::value).and_then(Answer::taken);
        common.unwrap_or_else(no_numbers)
    }

    fn adopt(&mut self, common: &B::Common) -> Result<(), RestoreError> {
        self.hand(Kind::Adopt, |frame| frame::put(frame, *common))
    }

    fn failure(&self) -> Option<&dyn std::error::Error> {
        self.failure.get().map(|error| error as &dyn std::error::Error)
    }

    fn snapshot(&self) -> Snapshot {
        let mut record = Snapshot { stage: self.name, values: [0.0; STATE_LIMIT], len: self.state_len, checksum: 0 };
        let values = &mut record.values[..self.state_len];
        self.ask(
            Kind::Snapshot,
            |_| {},
            |payload| {
                let numbers = frame::numbers(payload).filter(|_| payload.len() == 8 * values.len());
                let length = FrameError::Length { found: payload.len(), expected: 8 * values.len() };
                values.iter_mut().zip(numbers.ok_or(length)?).for_each(|(value, number)| *value = number);
                Ok(())
            },
        );
        record.checksum = record.sum();
        record
    }

    fn restore(&mut self, record: &Snapshot) -> Result<(), RestoreError> {
        record.check(self.name, self.state_len)?;
        self.hand(Kind::Restore, |frame| {
            record.values[..record.len].iter().for_each(|number| frame::put(frame, *number))
        })
    }
}

impl GyroStage for Hosted<Gyro> {
    fn align(&mut self, attitude: Attitude) {
        self.ask(Kind::Align, |frame| frame::put(frame, attitude), nothing);
    }
}

impl FuserStage for Hosted<Fuser> {
    fn realign(&mut self) {
        self.ask(Kind::Realign, |_| {}, nothing);
    }
}

impl<B: HostedBy> Clone for Hosted<B> {
    fn clone(&self) -> Self {
        let record = self.snapshot();
        let like = match &self.failure.get() {
            Some(error) => Err(HostError::Like(error.to_string())),
            None => Self::start(self.name, &self.program, self.limit),
        };
        let mut like = match like {
            Ok(like) => like,
            Err(error) => {
                let failure = OnceCell::from(error);
                let (program, settings) = (self.program.clone(), self.settings.clone());
                return Self { program, settings, failure, child: RefCell::new(None), ..*self };
            }
        };
        for (place, value) in &self.settings {
            if let Some(parameter) = self.parameters.get(*place) {
                // What was taken once is taken again.
                let _ = like.set(parameter.name, *value);
            }
        }
        if let Err(error) = like.restore(&record) {
            let _ = like.failure.set(HostError::Like(format!("another process of {}: {error}", self.name)));
        }
        like
    }
}

impl<B> fmt::Debug for Hosted<B> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Hosted").field("name", &self.name).field("program", &self.program).finish_non_exhaustive()
    }
}
