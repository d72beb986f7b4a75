//! The system for Foxglove and Lichtblick: the messages of its topics, and the attitude as viewers know it, over their WebSocket protocol.
//!
//! Input: messages of the topics as they are on the bus. Output: to each client what it subscribes to, on the channels that a flight has, too.
//! Time: each message with its publication on CLOCK_REALTIME. Failure: of a topic that is faster only sixty messages a second are told; a
//! client that is slow misses messages, one that takes nothing is dropped; nobody waits for it.
//!
//! | module | what it holds |
//! | --- | --- |
//! | `feed` | messages on their way to whoever has subscribed |
//! | `pace` | which of them are told |
//! | `protocol` | what is said, and heard |
//! | `client` | a client |

pub(crate) mod client;
pub(crate) mod feed;
mod pace;
pub(crate) mod protocol;
