//! Launch file: the declaration of everything that runs in a system.
//!
//! Input: the text of a `launch.toml`.
//!
//! Output: a [`Launch`] in which every value is present and valid.
//!
//! Failure: all problems of the file are reported together, each with its line. Unknown keys are
//! rejected.
//!
//! | module | contents |
//! | --- | --- |
//! | `keys` | declaration of a section: one row per key |
//! | `kind` | kinds of values |
//! | `model` | top level, `[restart]`, and the stages of the slots |
//! | `ingest` | source of the samples, and their limits |
//! | `slot_stage` | stages allowed in a slot |
//! | `live_sources` | sources that send in real time |
//! | `serial_line` | baud rate of a serial line |
//! | `format` | byte formats of ports |
//! | `source_uri` | a source in one line |
//! | `sensors` | kind of rate sample, calibration and mounting of the sensors |
//! | `north` | north reference of the course |
//! | `output` | reference frame of published attitudes |
//! | `gateway` | connections to other hosts, and the topics sent |
//! | `cockpit` | web page of the system |
//! | `endpoint` | security of the gateway's endpoints |
//! | `split` | one system on several hosts |
//! | `fault` | injection of sensor faults |
//! | `external_stage` | user-defined stages |
//! | `promotion_rule` | automatic promotion of a stage |
//! | `schema` | reading a launch file, and checks that concern several sections |
//! | `toml_reader` | reading and describing a TOML table key by key |
//! | `description` | description of all keys, for documentation |
//! | `edit` | replacing sections of a file |
//! | `effective` | the file with all defaults |
//! | `service_unit` | drop-in for the systemd unit |
//! | `problem` | problems of a file, and their display |
#![forbid(unsafe_code)]

mod cockpit;
mod description;
mod edit;
mod effective;
mod endpoint;
mod external_stage;
mod fault;
mod format;
mod gateway;
mod ingest;
mod keys;
mod kind;
mod live_sources;
mod model;
mod north;
mod output;
mod problem;
mod promotion_rule;
mod schema;
mod sensors;
mod serial_line;
mod service_unit;
mod slot_stage;
mod source_uri;
mod split;
mod toml_reader;

pub use graph::{Service, Slot, StageConfig};

pub use cockpit::{Cockpit, CockpitTls};
pub use description::{KeyDescription, SectionDescription};
pub use edit::{EditError, write_sections};
pub use effective::effective_text;
pub use external_stage::ExternalStage;
pub use fault::{Fault, FaultKind, MAX_DELAYED_READINGS, MAX_FAULTS, Sensor};
pub use format::{Autopilot, Columns, FixMessage, Format, ImuMessage, ReceiverFormat, WitMotion, Xsens};
pub use gateway::{Gateway, Import, Tls, TopicRate};
pub use ingest::{BusSource, Gnss, Ingest, Replay, Sim, Source};
pub use live_sources::{
    Clock, DEFAULT_IIO_RATE_HZ, DEFAULT_RATE_HZ, IioDevice, LiveSources, MavlinkSource, Port, ReceiverSource,
    SerialSource, StdinSource, Stream, TcpSource, UdpSource,
};
pub use model::{Launch, OnLimit, Restart, StateFile};
pub use north::{Date, MODEL_YEARS, NorthReference, Position};
pub use output::Output;
pub use problem::{LaunchError, Problems, pluralize};
pub use promotion_rule::{Measure, PromotionRule};
pub use schema::{MAX_TOPIC_MESSAGES, MIN_TOPIC_MESSAGES, describe, max_buffer_s};
pub use sensors::{Calibration, Calibrations, GyroSamples};
pub use serial_line::SerialLine;
pub use service_unit::UnsupportedDevicePath;
pub use slot_stage::UnknownStage;
pub use source_uri::{replay_path, with_overrides};
pub use split::{MAX_CACHE_TICKS, TickSource};
