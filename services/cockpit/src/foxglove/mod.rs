//! Server of the Foxglove WebSocket protocol, for Foxglove and Lichtblick.
//!
//! Input: messages of the topics, in their bus layout.
//! Output: the subscribed channels, which are the same as in a recorded flight.
//! Time: each message is stamped with its publication time on CLOCK_REALTIME.
//! Failure: fast topics are limited to 60 messages per second, slow clients miss messages, and a
//! client that accepts no data is disconnected.
//!
//! | module | contents |
//! | --- | --- |
//! | `feed` | encoding and distribution of the messages |
//! | `rate_limit` | maximum message rate per topic |
//! | `protocol` | messages of the protocol |
//! | `client` | connection of a client |

pub(crate) mod client;
pub(crate) mod feed;
pub(crate) mod protocol;
mod rate_limit;
