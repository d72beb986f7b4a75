//! Decision logic of the supervisor, as a single value that uses no clock, bus, process or thread.
//!
//! - Input: events, each with the time since the supervisor started.
//! - Output: actions, to be performed in the returned order.
//! - Time: passed with each event. A time before the previous one is ignored.
//! - Failure: a failing service is an ordinary event. A failure that stops the system is reported
//!   in [`Action::Finish`], the last action except for replies.
//!
//! The service `supervisor` translates signals, processes, topics and the control socket into
//! events and performs the actions. The simulator does the same with a simulated bus, simulated
//! processes and a simulated clock.
//!
//! | module | contents |
//! | --- | --- |
//! | `event` | configuration, events and actions |
//! | `supervision` | [`Supervision`]: passes each event to the function that handles it |
//! | `state` | state of a supervision, one file per subject |
//! | `decisions` | decisions on events, one file per subject |
#![forbid(unsafe_code)]

mod decisions;
mod event;
mod state;
mod supervision;

pub use event::{Action, Config, Event, Failure, FileFault, OutputProgress, Reply, Spawn};
pub use state::process::ProcessEntry;
pub use supervision::Supervision;
