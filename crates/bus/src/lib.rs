//! The on-board bus: typed topics in shared memory and wake-ups for their subscribers.
//!
//! Input: the messages of each publisher.
//!
//! Output: the same messages for every subscriber, without a copy by the kernel.
//!
//! Time: a wait without a message ends after a timeout, or when the supervisor wakes the
//! subscribers of idle topics. Otherwise, a clock is read only to identify a run of the system.
//!
//! Failure: a publisher never blocks on a subscriber. If a subscriber is too slow, its oldest
//! messages are overwritten, which shows as a gap in the ticks.
//!
//! Data is transported by iceoryx2, which no other crate uses directly. An iceoryx2 event costs as
//! much as sending a message and can be lost, so wake-ups use a futex word per topic in shared
//! memory instead.

mod bootstrap;
mod error;
mod feeder;
mod file_monitor;
mod limits;
mod machine_limits;
mod observer;
mod owned_files;
mod port;
mod process_lease;
mod removed_files;
mod session;
mod shared_state;
mod stale_resources;
mod system_name;
mod tap;
mod topic;
mod wake;

pub use error::BusError;
pub use feeder::Feeder;
pub use file_monitor::FileMonitor;
pub use limits::{MAX_OBSERVERS, Mib, OPEN_FILES_REMEDY, REQUIRED_OPEN_FILES, SHARED_MEMORY_REMEDY, SharedMemory};
pub use machine_limits::report_memory_exhaustion;
pub use observer::Observer;
pub use session::Port;
pub use stale_resources::{StaleResources, SystemLiveness};
pub use system_name::{Claim, SystemName};
pub use tap::{Ports, Tap};
pub use topic::{Bus, IdleWaker, Publisher, Subscriber, WakeHandle};
pub use wake::WaitOutcome;
