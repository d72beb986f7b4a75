//! A stage in Rust as a program of its own: answers requests on standard input until there are no more.
//!
//! Input: frames. Output: an answer to each. Time: none of its own. Failure: what cannot be taken over is refused; what is no frame ends the program.

use std::{
    io,
    os::fd::{AsFd, BorrowedFd},
    process::ExitCode,
};

use attitude::{
    Vector3,
    accel::Inclination,
    course::{CourseInput, LastReading, CourseReading},
    fuser::FuserStage,
    gyro::GyroStage,
    scalars::Scalars,
    point::Point,
    stage::{MAX_STATE_VALUES, Snapshot, Stage},
    state::Attitude,
};
use rustix::{
    net::{RecvFlags, SendFlags, recv, send},
    process::{Signal, set_parent_process_death_signal},
};

use crate::{
    description,
    frame::{self, MAX_FRAME_BYTES, FrameError, Head, Kind},
};

/// Runs a gyro stage.
pub fn gyro<S: GyroStage>(stage: S) -> ExitCode {
    run("gyro", stage, |stage, kind, payload| match kind {
        Kind::Align => {
            stage.align(frame::value::<Attitude>(payload)?);
            Ok(())
        }
        _ => Err(ProgramError::NotOfThisSlot(kind)),
    })
}

/// Runs an accelerometer stage.
pub fn accel<S: Stage<Input = Vector3<f64>, Output = Inclination, Common = Point> + Clone>(stage: S) -> ExitCode {
    run("accel", stage, |_, kind, _| Err(ProgramError::NotOfThisSlot(kind)))
}

/// Runs a fuser stage.
pub fn fuser<S: FuserStage>(stage: S) -> ExitCode {
    run("fuser", stage, |stage, kind, _| match kind {
        Kind::Realign => {
            stage.realign();
            Ok(())
        }
        _ => Err(ProgramError::NotOfThisSlot(kind)),
    })
}

/// Runs a course stage.
pub fn course<S: Stage<Input = CourseInput, Output = CourseReading, Common = LastReading> + Clone>(stage: S) -> ExitCode {
    run("course", stage, |_, kind, _| Err(ProgramError::NotOfThisSlot(kind)))
}

/// Why a program ended before it was no longer needed.
#[derive(Debug, thiserror::Error)]
enum ProgramError {
    #[error("{0}; a stage is started by Plumbline, not by hand")]
    Socket(#[from] rustix::io::Errno),
    #[error("reading a request: {0}")]
    Frame(#[from] FrameError),
    #[error("a request of the kind {0:?}, which its slot has not")]
    NotOfThisSlot(Kind),
}

fn run<S>(slot: &str, stage: S, of_slot: impl Fn(&mut S, Kind, &[u8]) -> Result<(), ProgramError>) -> ExitCode
where
    S: Stage<Input: Scalars + Default, Output: Scalars, Common: Scalars + Default> + Clone,
{
    // Where the system has no such thing, the end of the requests ends the program.
    let _ = set_parent_process_death_signal(Some(Signal::KILL));
    match answer(io::stdin().as_fd(), slot, stage, of_slot) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("a stage for the slot {slot}: {error}");
            ExitCode::FAILURE
        }
    }
}

/// Answers until there are no more requests.
fn answer<S>(
    socket: BorrowedFd<'_>,
    slot: &str,
    mut stage: S,
    of_slot: impl Fn(&mut S, Kind, &[u8]) -> Result<(), ProgramError>,
) -> Result<(), ProgramError>
where
    S: Stage<Input: Scalars + Default, Output: Scalars, Common: Scalars + Default> + Clone,
{
    let (mut request, mut answer) = (vec![0; MAX_FRAME_BYTES], Vec::new());
    loop {
        let (len, _) = recv(socket, &mut request[..], RecvFlags::empty())?;
        if len == 0 {
            return Ok(());
        }
        let (head, payload) = Head::of(request.get(..len).unwrap_or_default())?;
        head.begin(&mut answer);
        let mut refused = false;
        match head.kind {
            Kind::Describe => answer.extend(description::text(slot, stage.parameters()).bytes()),
            Kind::Set => refused = !set(&mut stage, payload)?,
            Kind::Step => frame::put(&mut answer, stage.step(&frame::value(payload)?)),
            Kind::Snapshot => {
                let Snapshot { values, len, .. } = stage.snapshot();
                values.iter().take(len).for_each(|number| answer.extend(number.to_le_bytes()));
            }
            Kind::Restore => refused = !restore(&mut stage, payload)?,
            Kind::Common => frame::put(&mut answer, stage.common()),
            Kind::Adopt => refused = stage.adopt(&frame::value(payload)?).is_err(),
            Kind::Align | Kind::Realign => of_slot(&mut stage, head.kind, payload)?,
        }
        if refused {
            Head { refused, ..head }.begin(&mut answer);
        }
        send(socket, &answer, SendFlags::NOSIGNAL)?;
    }
}

/// Sets a parameter by its place.
fn set(stage: &mut impl Stage, payload: &[u8]) -> Result<bool, FrameError> {
    let (place, value): (f64, f64) = {
        let vector = frame::value::<attitude::Complex<f64>>(payload)?;
        (vector.re, vector.im)
    };
    let name = stage.parameters().get(place as usize).map(|parameter| parameter.name);
    Ok(name.is_some_and(|name| stage.set(name, value).is_ok()))
}

fn restore(stage: &mut (impl Stage + Clone), payload: &[u8]) -> Result<bool, FrameError> {
    let mut record = Snapshot { stage: stage.name(), values: [0.0; MAX_STATE_VALUES], len: payload.len() / 8, checksum: 0 };
    let length = FrameError::Length { found: payload.len(), expected: 8 * MAX_STATE_VALUES };
    let (values, numbers) = (record.values.get_mut(..record.len), frame::numbers(payload));
    let (values, numbers) = values.zip(numbers).ok_or(length)?;
    values.iter_mut().zip(numbers).for_each(|(value, number)| *value = number);
    record.checksum = record.compute_checksum();
    Ok(stage.restore(&record).is_ok())
}
