//! Request loop of an external stage in Rust. It ends when the service closes the socket.
//!
//! Input: request frames on standard input.
//!
//! Output: one response per request.
//!
//! Failure: invalid states and values are rejected. An invalid frame ends the program.

use std::{
    io,
    os::fd::{AsFd, BorrowedFd},
    process::ExitCode,
};

use attitude::{
    Vector3,
    accel::Inclination,
    course::{CourseInput, CourseReading, LastReading},
    fuser::FuserStage,
    gyro::GyroStage,
    point::Point,
    scalars::Scalars,
    stage::{MAX_STATE_VALUES, Snapshot, Stage},
    state::Attitude,
};
use rustix::{
    net::{RecvFlags, SendFlags, recv, send},
    process::{Signal, set_parent_process_death_signal},
};

use crate::{
    description,
    frame::{self, FrameError, FrameHeader, MAX_FRAME_BYTES, RequestKind},
};

/// Runs a gyro stage until the service closes the socket.
pub fn gyro<S: GyroStage>(stage: S) -> ExitCode {
    run("gyro", stage, |stage, kind, payload| match kind {
        RequestKind::Align => {
            stage.align(frame::read_value::<Attitude>(payload)?);
            Ok(())
        }
        _ => Err(ProgramError::UnsupportedRequest(kind)),
    })
}

/// Runs an accelerometer stage until the service closes the socket.
pub fn accel<S: Stage<Input = Vector3<f64>, Output = Inclination, Common = Point> + Clone>(stage: S) -> ExitCode {
    run("accel", stage, |_, kind, _| Err(ProgramError::UnsupportedRequest(kind)))
}

/// Runs a fuser stage until the service closes the socket.
pub fn fuser<S: FuserStage>(stage: S) -> ExitCode {
    run("fuser", stage, |stage, kind, _| match kind {
        RequestKind::Realign => {
            stage.realign();
            Ok(())
        }
        _ => Err(ProgramError::UnsupportedRequest(kind)),
    })
}

/// Runs a course stage until the service closes the socket.
pub fn course<S: Stage<Input = CourseInput, Output = CourseReading, Common = LastReading> + Clone>(
    stage: S,
) -> ExitCode {
    run("course", stage, |_, kind, _| Err(ProgramError::UnsupportedRequest(kind)))
}

/// Error that ends the program.
#[derive(Debug, thiserror::Error)]
enum ProgramError {
    #[error("socket on standard input: {0}; Plumbline starts the stage, try `plumb stage test`")]
    Socket(#[from] rustix::io::Errno),
    #[error("invalid request: {0}")]
    Frame(#[from] FrameError),
    #[error("request {0:?} is not supported by this slot")]
    UnsupportedRequest(RequestKind),
}

fn run<S>(
    slot: &str,
    stage: S,
    handle_slot_request: impl Fn(&mut S, RequestKind, &[u8]) -> Result<(), ProgramError>,
) -> ExitCode
where
    S: Stage<Input: Scalars + Default, Output: Scalars, Common: Scalars + Default> + Clone,
{
    // If this call fails, the program still ends when the socket is closed.
    let _ = set_parent_process_death_signal(Some(Signal::KILL));
    match serve(io::stdin().as_fd(), slot, stage, handle_slot_request) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("stage for slot {slot}: {error}");
            ExitCode::FAILURE
        }
    }
}

/// Responds to requests until the socket is closed.
fn serve<S>(
    socket: BorrowedFd<'_>,
    slot: &str,
    mut stage: S,
    handle_slot_request: impl Fn(&mut S, RequestKind, &[u8]) -> Result<(), ProgramError>,
) -> Result<(), ProgramError>
where
    S: Stage<Input: Scalars + Default, Output: Scalars, Common: Scalars + Default> + Clone,
{
    let (mut request, mut response) = (vec![0; MAX_FRAME_BYTES], Vec::new());
    loop {
        let (len, _) = recv(socket, &mut request[..], RecvFlags::empty())?;
        if len == 0 {
            return Ok(());
        }
        let (header, payload) = FrameHeader::parse(request.get(..len).unwrap_or_default())?;
        header.start_frame(&mut response);
        let mut rejected = false;
        match header.kind {
            RequestKind::Describe => response.extend(description::to_text(slot, stage.parameters()).bytes()),
            RequestKind::Set => rejected = !set(&mut stage, payload)?,
            RequestKind::Step => frame::write_value(&mut response, stage.step(&frame::read_value(payload)?)),
            RequestKind::Snapshot => {
                let Snapshot { values, len, .. } = stage.snapshot();
                values.iter().take(len).for_each(|number| response.extend(number.to_le_bytes()));
            }
            RequestKind::Restore => rejected = !restore(&mut stage, payload)?,
            RequestKind::Common => frame::write_value(&mut response, stage.common()),
            RequestKind::Adopt => rejected = stage.adopt(&frame::read_value(payload)?).is_err(),
            RequestKind::Align | RequestKind::Realign => handle_slot_request(&mut stage, header.kind, payload)?,
        }
        if rejected {
            FrameHeader { rejected, ..header }.start_frame(&mut response);
        }
        send(socket, &response, SendFlags::NOSIGNAL)?;
    }
}

/// Sets the parameter with the given index. Returns `false` if it is rejected.
fn set(stage: &mut impl Stage, payload: &[u8]) -> Result<bool, FrameError> {
    let (index, value): (f64, f64) = {
        let vector = frame::read_value::<attitude::Complex<f64>>(payload)?;
        (vector.re, vector.im)
    };
    let name = stage.parameters().get(index as usize).map(|parameter| parameter.name);
    Ok(name.is_some_and(|name| stage.set(name, value).is_ok()))
}

/// Restores a state. Returns `false` if it is rejected.
fn restore(stage: &mut (impl Stage + Clone), payload: &[u8]) -> Result<bool, FrameError> {
    let mut snapshot =
        Snapshot { stage: stage.name(), values: [0.0; MAX_STATE_VALUES], len: payload.len() / 8, checksum: 0 };
    let length = FrameError::PayloadLength { found: payload.len(), expected: 8 * MAX_STATE_VALUES };
    let (values, numbers) = (snapshot.values.get_mut(..snapshot.len), frame::read_numbers(payload));
    let (values, numbers) = values.zip(numbers).ok_or(length)?;
    values.iter_mut().zip(numbers).for_each(|(value, number)| *value = number);
    snapshot.checksum = snapshot.compute_checksum();
    Ok(stage.restore(&snapshot).is_ok())
}
