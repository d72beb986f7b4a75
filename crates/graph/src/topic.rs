//! What the table says of a topic.

use crate::Participant;

/// A line of the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Entry {
    /// Its place in the table, which is that of its wake word.
    pub place: usize,
    /// Its name on the bus, on the wire and for people.
    pub name: &'static str,
    /// The name of the payload that it carries.
    pub payload: &'static str,
    /// Which ticks have a message.
    pub presence: Presence,
    /// How many messages it holds for each reader.
    pub buffer: Buffer,
    /// Who publishes it.
    pub publisher: Participant,
    /// Who reads it, beside whoever asks to.
    pub readers: &'static [Participant],
}

/// Which ticks have a message of a topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Presence {
    /// Every one: a tick that is missing is lost.
    EveryTick,
    /// Those with the flag of this name, and no other.
    Flagged(&'static str),
    /// The messages do not descend from an IMU sample.
    NoTick,
}

/// How many messages a topic holds for each reader before the oldest is overwritten.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Buffer {
    /// `buffer_s` of the path.
    Path,
    /// The few of a topic that says how services are and what they are to do.
    Control,
}

impl Presence {
    /// A message of the topic descends from an IMU sample and says from which.
    pub const fn is_ticked(self) -> bool {
        match self {
            Self::EveryTick | Self::Flagged(_) => true,
            Self::NoTick => false,
        }
    }
}

/// Defines `Topic`, one for each line of the table.
#[macro_export]
macro_rules! define_topics {
    ({} $($topic:ident = $name:literal: $payload:ident, $presence:ident $(($flag:ident))?, $buffer:ident,
        $publisher:ident => [$($reader:ident),*];)*
    ) => {
        /// A topic of the system: a typed stream.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum Topic {
            $(#[doc = concat!("`", $name, "`: `", stringify!($payload), "`.")] $topic),*
        }

        impl Topic {
            /// Every topic, in the order of the table.
            pub const ALL: &'static [Self] = &[$(Self::$topic),*];
            /// The lines of the table.
            pub const ENTRIES: &'static [$crate::Entry] = &[$($crate::Entry {
                place: Self::$topic as usize,
                name: $name,
                payload: stringify!($payload),
                presence: $crate::presence!($presence $(($flag))?),
                buffer: $crate::Buffer::$buffer,
                publisher: $crate::service::participant::$publisher,
                readers: &[$($crate::service::participant::$reader),*],
            }),*];

            /// What the table says of it.
            pub const fn entry(self) -> &'static $crate::Entry {
                &Self::ENTRIES[self as usize]
            }

            /// Its name on the bus, on the wire and for people.
            pub const fn name(self) -> &'static str {
                self.entry().name
            }

            /// The topic of a line of this table.
            pub fn of(entry: &$crate::Entry) -> Option<Self> {
                Self::ALL.get(entry.place).copied()
            }

            /// The topic of that name.
            pub fn named(name: &str) -> Option<Self> {
                Self::ALL.iter().copied().find(|topic| topic.name() == name)
            }
        }
    };
}

/// A [`Presence`] as the table writes it.
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
