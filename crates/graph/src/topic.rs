//! Topics and the entries of the topic table.

use crate::Participant;

/// Entry of the topic table, which describes one topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Entry {
    /// Index in the topic table. The wake word of the topic has the same index.
    pub index: usize,
    /// Name on the bus, on the wire and in output.
    pub name: &'static str,
    /// Type name of the payload.
    pub payload: &'static str,
    /// Ticks for which the topic has a message.
    pub presence: Presence,
    /// Number of messages buffered per subscriber.
    pub buffer: Buffer,
    /// Publishing participant.
    pub publisher: Participant,
    /// Subscribing participants. Observers and the gateway may subscribe in addition.
    pub subscribers: &'static [Participant],
}

/// Ticks for which a topic has a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Presence {
    /// Every tick. A tick without a message counts as lost.
    EveryTick,
    /// Only the ticks that carry the flag of this name.
    Flagged(&'static str),
    /// No ticks, because the messages are not derived from an IMU sample.
    NoTick,
}

/// Number of messages buffered per subscriber before the oldest is overwritten.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Buffer {
    /// The number of messages that the data path produces in `buffer_s`.
    Path,
    /// A small fixed number, for control and status messages.
    Control,
}

impl Presence {
    /// Returns `true` if each message is derived from an IMU sample and carries its tick.
    pub const fn is_ticked(self) -> bool {
        match self {
            Self::EveryTick | Self::Flagged(_) => true,
            Self::NoTick => false,
        }
    }
}

/// Defines `Topic`, with a variant for each line of the table.
#[macro_export]
macro_rules! define_topics {
    ({} $($topic:ident = $name:literal: $payload:ident, $presence:ident $(($flag:ident))?, $buffer:ident,
        $publisher:ident => [$($subscriber:ident),*];)*
    ) => {
        /// A topic of the system: a typed stream of messages.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum Topic {
            $(#[doc = concat!("`", $name, "`: `", stringify!($payload), "`.")] $topic),*
        }

        impl Topic {
            /// All topics, in the order of the table.
            pub const ALL: &'static [Self] = &[$(Self::$topic),*];
            /// All entries of the table.
            pub const ENTRIES: &'static [$crate::Entry] = &[$($crate::Entry {
                index: Self::$topic as usize,
                name: $name,
                payload: stringify!($payload),
                presence: $crate::presence!($presence $(($flag))?),
                buffer: $crate::Buffer::$buffer,
                publisher: $crate::service::participant::$publisher,
                subscribers: &[$($crate::service::participant::$subscriber),*],
            }),*];

            /// Returns the entry of the topic.
            pub const fn entry(self) -> &'static $crate::Entry {
                &Self::ENTRIES[self as usize]
            }

            /// Returns the name on the bus, on the wire and in output.
            pub const fn name(self) -> &'static str {
                self.entry().name
            }

            /// Returns the topic at the index of `entry`.
            pub fn from_entry(entry: &$crate::Entry) -> Option<Self> {
                Self::ALL.get(entry.index).copied()
            }

            /// Returns the topic called `name`.
            pub fn from_name(name: &str) -> Option<Self> {
                Self::ALL.iter().copied().find(|topic| topic.name() == name)
            }
        }
    };
}

/// Translates the presence column of the table into a [`Presence`].
#[doc(hidden)]
#[macro_export]
macro_rules! presence {
    (every_tick) => {
        $crate::Presence::EveryTick
    };
    (flagged($flag:ident)) => {
        $crate::Presence::Flagged(stringify!($flag))
    };
    (no_tick) => {
        $crate::Presence::NoTick
    };
}

crate::topics!(crate::define_topics {});
