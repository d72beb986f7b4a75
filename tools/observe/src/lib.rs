//! Seeing a running system: what `plumb top`, `plumb topic` and `plumb doctor` show.
//!
//! Input: messages as bytes with their layout, from wherever they come; what the supervisor says of its services; /proc and /sys.
//! Output: text for people, JSON for scripts. Time: stamps of the messages, and the observer's clock where they have none. Failure:
//! what cannot be known is said to be unknown. Nothing here publishes, creates a topic or makes anybody wait.
//!
//! | module | what it holds |
//! | --- | --- |
//! | [`record`] | a message by its layout: names, units, values |
//! | [`tables`] | messages as tables of numbers |
//! | [`flow`], [`interval`] | rate, intervals, bytes, and what was lost where |
//! | [`readings`] | the sensors' own readings, for a calibration |
//! | [`topics`] | which topics there are, and who is at them |
//! | [`hops`], [`process`], [`top`] | how long each service takes, what it costs, and both with its state |
//! | [`doctor`] | whether the machine and the system are as they should be |
#![forbid(unsafe_code)]

pub mod doctor;
pub mod flow;
pub mod hops;
pub mod interval;
pub mod process;
pub mod readings;
pub mod record;
pub mod tables;
pub mod top;
pub mod topics;
