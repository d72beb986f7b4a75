//! The launch file: everything that runs, declared in one place.
//!
//! Input: the text of a `launch.toml`. Output: a [`Launch`] in which every value is present and allowed. Time: none.
//! Failure: every problem of the file at once, each pointing at its line; nothing that is not understood is passed over.
//!
//! | module | what it holds |
//! | --- | --- |
//! | `model` | what a launch file says, and the defaults |
//! | `schema` | which keys there are, and what each may be |
//! | `filling` | what may fill a slot |
//! | `live` | sources that are read while they send |
//! | `format` | how the bytes of a port are to be read |
//! | `source_uri` | a source in one line |
//! | `sensors` | how the sensors are calibrated and mounted |
//! | `north` | from which north a course is counted |
//! | `output` | in which frame the attitude leaves the system |
//! | `gateway` | what goes beyond the board, and to where |
//! | `cockpit` | where the system is shown in a browser |
//! | `endpoint` | how far the gateway's endpoints reach |
//! | `split` | one system on several hosts |
//! | `fault` | what the sensors are made to do wrong |
//! | `program` | stages of the user's own |
//! | `watch` | stages that take over by themselves |
//! | `walk` | reading a table key by key |
//! | `problem` | what is wrong with a file, and how it is shown |
#![forbid(unsafe_code)]

mod cockpit;
mod endpoint;
mod fault;
mod filling;
mod format;
mod gateway;
mod gateway_section;
mod live;
mod model;
mod north;
mod output;
mod problem;
mod program;
mod schema;
mod sensors;
mod source_uri;
mod split;
mod walk;
mod watch;

pub use graph::Service;

pub use cockpit::{Cockpit, CockpitTls};
pub use fault::{DELAY_READINGS_MAX, FAULTS_MAX, Fault, FaultKind, Sensor};
pub use filling::UnknownStage;
pub use format::{Autopilot, Columns, FixMessage, Format, ImuMessage, ReceiverFormat, WitMotion};
pub use gateway::{Gateway, Import, Rate, Tls};
pub use live::{Clock, IioDevice, Live, Port, Ported, ReceiverSource, Stream};
pub use model::{
    BusSource, Calibration, Calibrations, Gnss, GyroSamples, Ingest, Launch, Limits, OnLimit, Replay, Restart, Sim,
    Source, Stage, StateFile, TOPIC_MESSAGES_MAX,
};
pub use north::{Date, MODEL_YEARS, North, Position};
pub use output::Output;
pub use problem::{LaunchError, Problems, counted, nearest};
pub use program::Program;
pub use source_uri::{replayed, with_lines};
pub use split::CACHE_TICKS_MAX;
pub use watch::{Measure, Watch};
