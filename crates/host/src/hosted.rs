//! External stage of a slot.

use std::{
    cell::{OnceCell, RefCell},
    fmt, fs,
    marker::PhantomData,
    time::Duration,
};

use attitude::{
    fuser::{Fuser, FuserStage},
    gyro::{Gyro, GyroStage},
    parameters::{Parameter, ParameterError},
    scalars::Scalars,
    stage::{MAX_STATE_VALUES, RestoreError, Snapshot, Stage, Validate},
    state::Attitude,
};
use launch::ExternalStage;
use sdk::{
    Description,
    frame::{self, FrameError, RequestKind},
};

use crate::{
    child::{Child, HostError},
    finite_input::FiniteInput,
    interned,
};

/// Stage that an external program can replace, because its inputs and outputs are numbers.
pub trait HostableStage:
    Stage<Input: FiniteInput, Output: Scalars + Default + Validate, Common: Scalars + Default>
{
}

impl<S: Stage<Input: FiniteInput, Output: Scalars + Default + Validate, Common: Scalars + Default>> HostableStage
    for S
{
}

/// External program in place of a built-in stage `B`.
///
/// A clone starts another process with the same settings and state.
pub struct HostedStage<B> {
    name: &'static str,
    program: ExternalStage,
    timeout: Duration,
    parameters: &'static [Parameter],
    settings: Vec<(usize, f64)>,
    /// Number of values in the program's state.
    state_len: usize,
    /// Process of the program; `None` if it could not be started or if this is a clone of a failed
    /// stage.
    child: RefCell<Option<Child>>,
    failure: OnceCell<HostError>,
    slot: PhantomData<fn() -> B>,
}

impl<B: HostableStage> HostedStage<B> {
    /// Starts the program as the stage `name`. Each response after the start may take up to
    /// `timeout`.
    ///
    /// # Errors
    ///
    /// Fails if the program cannot be started, describes a stage of another slot or has too many
    /// state values.
    pub fn start(name: &str, program: &ExternalStage, timeout: Duration) -> Result<Self, HostError> {
        let mut child = Child::start(program.command())?;
        let response = child.request(RequestKind::Describe, |_| {})?.map(Description::parse);
        let description = match response {
            Some(Ok(description)) => description,
            Some(Err(error)) => return Err(child.invalid_response(RequestKind::Describe, &error)),
            None => return Err(child.invalid_response(RequestKind::Describe, &"the request was rejected")),
        };
        if description.slot != program.slot.name() {
            let other = format!("it is a stage of the slot {}, not of {}", description.slot, program.slot);
            return Err(child.invalid_response(RequestKind::Describe, &other));
        }
        let interned_texts = interned::text(name).zip(interned::parameters(&description));
        let (name, parameters) = interned_texts
            .ok_or_else(|| child.invalid_response(RequestKind::Describe, &"too many different descriptions"))?;
        let state_len = child.request(RequestKind::Snapshot, |_| {})?.map_or(usize::MAX, <[u8]>::len) / 8;
        if state_len > MAX_STATE_VALUES {
            let cause = format!("the state has more than {MAX_STATE_VALUES} numbers");
            return Err(child.invalid_response(RequestKind::Snapshot, &cause));
        }
        child.set_response_timeout(timeout);
        Ok(Self {
            name,
            program: program.clone(),
            timeout,
            parameters,
            settings: Vec::new(),
            state_len,
            child: RefCell::new(Some(child)),
            failure: OnceCell::new(),
            slot: PhantomData,
        })
    }

    /// Sends a request and parses the response. Returns `None` if the program fails or has failed
    /// before.
    fn request<T>(
        &self,
        kind: RequestKind,
        write: impl FnOnce(&mut Vec<u8>),
        parse: impl FnOnce(&[u8]) -> Result<T, FrameError>,
    ) -> Option<Response<T>> {
        let mut child = self.child.borrow_mut();
        let child = child.as_mut().filter(|_| self.failure.get().is_none())?;
        let parsed = match child.request(kind, write) {
            Ok(None) => return Some(Response::Rejected),
            Ok(Some(payload)) => parse(payload),
            Err(error) => {
                // The failure is still unset here, so `set` cannot fail.
                let _ = self.failure.set(error);
                return None;
            }
        };
        match parsed {
            Ok(value) => Some(Response::Accepted(value)),
            Err(cause) => {
                let _ = self.failure.set(child.invalid_response(kind, &cause));
                None
            }
        }
    }

    /// Sends a request that the program either accepts or rejects.
    fn request_ack(&self, kind: RequestKind, write: impl FnOnce(&mut Vec<u8>)) -> Result<(), RestoreError> {
        match self.request(kind, write, empty_payload) {
            Some(Response::Accepted(())) => Ok(()),
            Some(Response::Rejected) => Err(RestoreError::Invalid { reason: "the program rejects the values" }),
            None => Err(RestoreError::Invalid { reason: "the program has failed" }),
        }
    }
}

impl<B> HostedStage<B> {
    /// Returns the process identifier, or `None` if the process could not be started.
    pub fn pid(&self) -> Option<u32> {
        self.child.borrow().as_ref().map(Child::pid)
    }

    /// Returns the CPU time in ns that all threads of the program have used so far. Returns `None`
    /// if the process could not be started or the kernel does not report the time.
    pub fn cpu_ns(&self) -> Option<f64> {
        let threads = fs::read_dir(format!("/proc/{}/task", self.pid()?)).ok()?;
        let cpu_ns = |thread: fs::DirEntry| -> Option<f64> {
            let text = fs::read_to_string(thread.path().join("schedstat")).ok()?;
            text.split_whitespace().next()?.parse().ok()
        };
        threads.flatten().map(cpu_ns).sum()
    }
}

/// Response of the program to a request.
enum Response<T> {
    Accepted(T),
    Rejected,
}

impl<T> Response<T> {
    fn accepted(self) -> Option<T> {
        match self {
            Self::Accepted(value) => Some(value),
            Self::Rejected => None,
        }
    }
}

/// Parses a response without a payload.
fn empty_payload(payload: &[u8]) -> Result<(), FrameError> {
    if payload.is_empty() { Ok(()) } else { Err(FrameError::PayloadLength { found: payload.len(), expected: 0 }) }
}

/// Returns a value that consists of NaNs, which is the output of a failed stage.
fn nan_value<T: Scalars + Default>() -> T {
    let mut value = T::default();
    value.visit(&mut |number| *number = f64::NAN);
    value
}

impl<B: HostableStage> Stage for HostedStage<B> {
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
        let index = self.parameters.iter().position(|parameter| parameter.name == name).ok_or(unknown)?;
        let parameter = self.parameters.get(index).ok_or(unknown)?;
        let in_range = (parameter.min..=parameter.max).contains(&value);
        // A value that the program rejects is reported as out of range, too.
        let write = |frame: &mut Vec<u8>| {
            [index as f64, value].into_iter().for_each(|number| frame::write_value(frame, number))
        };
        if !in_range || self.request_ack(RequestKind::Set, write).is_err() {
            return Err(ParameterError::OutOfRange { parameter, value });
        }
        self.settings.push((index, value));
        Ok(())
    }

    fn step(&mut self, input: &B::Input) -> B::Output {
        let input = input.finite();
        let output = self
            .request(RequestKind::Step, |frame| frame::write_value(frame, input), frame::read_value)
            .and_then(Response::accepted);
        output.unwrap_or_else(nan_value)
    }

    /// Visits no values, because the state is in the other process. Use [`Stage::snapshot`] and
    /// [`Stage::restore`] to transfer it.
    fn visit_state(&mut self, _visit: &mut dyn FnMut(&mut f64)) {}

    fn common(&self) -> B::Common {
        let common = self.request(RequestKind::Common, |_| {}, frame::read_value).and_then(Response::accepted);
        common.unwrap_or_else(nan_value)
    }

    fn adopt(&mut self, common: &B::Common) -> Result<(), RestoreError> {
        self.request_ack(RequestKind::Adopt, |frame| frame::write_value(frame, *common))
    }

    fn failure(&self) -> Option<&dyn std::error::Error> {
        self.failure.get().map(|error| error as &dyn std::error::Error)
    }

    fn visit_values(&self, visit: &mut dyn FnMut(f64)) {
        let mut values = [0.0; MAX_STATE_VALUES];
        let values = &mut values[..self.state_len];
        self.request(
            RequestKind::Snapshot,
            |_| {},
            |payload| {
                let numbers = frame::read_numbers(payload).filter(|_| payload.len() == 8 * values.len());
                let length = FrameError::PayloadLength { found: payload.len(), expected: 8 * values.len() };
                values.iter_mut().zip(numbers.ok_or(length)?).for_each(|(value, number)| *value = number);
                Ok(())
            },
        );
        values.iter().for_each(|value| visit(*value));
    }

    fn restore(&mut self, record: &Snapshot) -> Result<(), RestoreError> {
        record.validate(self.name, self.state_len)?;
        self.request_ack(RequestKind::Restore, |frame| {
            record.values[..record.len].iter().for_each(|number| frame::write_value(frame, *number))
        })
    }
}

impl GyroStage for HostedStage<Gyro> {
    fn align(&mut self, attitude: Attitude) {
        self.request(RequestKind::Align, |frame| frame::write_value(frame, attitude), empty_payload);
    }
}

impl FuserStage for HostedStage<Fuser> {
    fn realign(&mut self) {
        self.request(RequestKind::Realign, |_| {}, empty_payload);
    }
}

impl<B: HostableStage> Clone for HostedStage<B> {
    fn clone(&self) -> Self {
        let record = self.snapshot();
        let copy = match &self.failure.get() {
            Some(error) => Err(HostError::CloneFailed(error.to_string())),
            None => Self::start(self.name, &self.program, self.timeout),
        };
        let mut copy = match copy {
            Ok(copy) => copy,
            Err(error) => {
                let failure = OnceCell::from(error);
                let (program, settings) = (self.program.clone(), self.settings.clone());
                return Self { program, settings, failure, child: RefCell::new(None), ..*self };
            }
        };
        for (index, value) in &self.settings {
            if let Some(parameter) = self.parameters.get(*index) {
                // The original accepted this value, so the copy does, too.
                let _ = copy.set(parameter.name, *value);
            }
        }
        if let Err(error) = copy.restore(&record) {
            let _ = copy.failure.set(HostError::CloneFailed(format!("another process of {}: {error}", self.name)));
        }
        copy
    }
}

impl<B> fmt::Debug for HostedStage<B> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Hosted").field("name", &self.name).field("program", &self.program).finish_non_exhaustive()
    }
}
