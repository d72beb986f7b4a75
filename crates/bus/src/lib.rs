//! The bus on board: typed topics in shared memory and the wake-up of whoever waits for them.
//!
//! Input: messages of a topic. Output: the same messages in every subscriber, without a copy by the kernel. Time: waits have a
//! limit; nothing else looks at a clock. Failure: a publisher never blocks on a reader; what a reader is too slow for is overwritten,
//! oldest first, and shows as a gap in the ticks.
//!
//! Data goes through iceoryx2, which no other crate names. Its events cost as much as a hop and can lose a wake-up, so each topic
//! has one futex word in a page of our own instead.

mod bootstrap;
mod damage;
mod error;
mod feeder;
mod machine_limits;
mod membership;
mod observer;
mod owned_files;
mod page;
mod port;
mod stale_resources;
mod system_name;
mod tap;
mod topic;
mod visit;
mod wake;

pub use error::BusError;
pub use feeder::Feeder;
pub use machine_limits::{FILES, MORE_FILES, MORE_MEMORY, Mib, SharedMemory, say_when_memory_runs_out};
pub use observer::Observer;
pub use port::OBSERVERS;
pub use stale_resources::{StaleResources, SystemLiveness};
pub use system_name::{Claim, SystemName};
pub use tap::{Port, Ports, Tap};
pub use topic::{Bus, Publisher, Subscriber};
pub use wake::Woken;
