//! The loop that runs a slot: joins its inputs, steps its stage and publishes one output per tick.
//!
//! - Input: messages of the topics that a slot subscribes to.
//! - Output: one message per tick, in order.
//! - Time: clocks are used only for timestamps and waits. Outputs never depend on a clock.
//! - Failure: a missing tick is counted and reported. A silent input is given up once another input
//!   is far enough ahead.
//!
//! | module | contents |
//! | --- | --- |
//! | [`slot`] | processing in a slot, independent of clock and bus |
//! | [`checkpoint`] | state of a slot, and resuming from it in another process |
//! | [`join`] | join of several inputs by tick |
//! | [`prior`] | estimates of sensor errors from an earlier run |
//! | [`convert`] | conversion between payloads and mathematical types |
//! | [`decimator`] | selection of samples to meet a rate |
//! | [`frames`] | conversion of messages to other axis conventions |
//! | [`service_config`] | start-up configuration of a service, and values derived from it |
//! | [`stderr_tail`] | last standard-error output of a child process |
//! | [`service_context`] | connection of a service to a running system |
//! | [`ordered_subscriber`] | subscriber that delivers each tick once and in order |
//! | [`slot_service`] | service of a slot, independent of bus and clock |
//! | [`input_scheduling`] | choice of the input that is polled next |
//! | `brief_wait` | limited yields of the processor to other services |
//! | [`service`] | main loop of a service on the bus |
//! | [`comparable`] | attitude of an output, for comparison |
//! | [`shadow`] | comparison of a candidate with the owner of its slot |
//! | [`stage`] | creation and supervision of the stage named in a launch file |
//! | [`machine`] | state folder and boot ID |
//! | [`clock`] | monotonic clock and processor time |
//! | [`pacing_timer`] | timer for waits at regular intervals |
#![forbid(unsafe_code)]

mod brief_wait;
pub mod checkpoint;
pub mod clock;
pub mod comparable;
pub mod convert;
pub mod decimator;
mod error;
pub mod frames;
pub mod input_scheduling;
pub mod join;
pub mod machine;
pub mod ordered_subscriber;
pub mod pacing_timer;
pub mod prior;
pub mod service;
pub mod service_config;
pub mod service_context;
pub mod shadow;
pub mod slot;
pub mod slot_service;
pub mod stage;
pub mod stderr_tail;

pub use brief_wait::BriefWait;
pub use error::RuntimeError;
pub use join::{Join, JoinInput, JoinInputs, Joined};
pub use ordered_subscriber::{OrderedSubscriber, SlotInput, SlotInputs};
pub use pacing_timer::PacingTimer;
pub use prior::{ImplausibleValue, Prior, PriorEstimate};
pub use service::{ServiceLoop, SlotLoop, serve};
pub use service_config::{Pace, Role, ServiceConfig};
pub use service_context::ServiceContext;
pub use slot::{SingleInputSlot, SlotProcessor, TickProcessor};
pub use swap::Sequence;
