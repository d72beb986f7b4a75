//! Services and the other publishers and subscribers.

use core::fmt;

use attitude::slot::Slot;

/// Defines [`Service`] and the services' [`participant`] constants from the service table.
macro_rules! define_services {
    ({}
        source { $($(#[$source_doc:meta])* $source:ident = $source_name:ident: $($source_property:ident)*;)* }
        slots { $($(#[$slot_doc:meta])* $slot:ident = $slot_name:ident: $($slot_property:ident)*;)* }
        auxiliary { $($(#[$other_doc:meta])* $other:ident = $other_name:ident: $($other_property:ident)*;)* }
    ) => {
        /// A service of the system, identified in messages by its index in [`ALL`](Self::ALL).
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "lowercase"))]
        pub enum Service {
            $($(#[$source_doc])* $source,)*
            $($(#[$slot_doc])* $slot,)*
            $($(#[$other_doc])* $other,)*
        }

        /// Name and properties of each service.
        const TABLE: &[(&str, &[Property])] = &[
            $((stringify!($source_name), &[$(Property::$source_property),*]),)*
            $((stringify!($slot_name), &[$(Property::$slot_property),*]),)*
            $((stringify!($other_name), &[$(Property::$other_property),*]),)*
        ];

        impl Service {
            /// All services: the data path first, then the auxiliary ones.
            pub const ALL: [Self; TABLE.len()] = [$(Self::$source,)* $(Self::$slot,)* $(Self::$other,)*];
            /// Services of the data path, in the order of the data flow.
            pub const PATH: [Self; [$(Self::$source,)* $(Self::$slot,)*].len()] =
                [$(Self::$source,)* $(Self::$slot,)*];

            /// Returns the slot of the service, or `None` if the service runs no stage.
            pub const fn slot(self) -> Option<Slot> {
                match self {
                    $(Self::$slot => Some(Slot::$slot),)*
                    $(Self::$source)|* $(| Self::$other)* => None,
                }
            }
        }

        impl From<Slot> for Service {
            fn from(slot: Slot) -> Self {
                match slot {
                    $(Slot::$slot => Self::$slot,)*
                }
            }
        }

        /// Constants for the participants, with the names used in the topic table.
        #[expect(non_upper_case_globals, reason = "the table uses the spelling of launch files")]
        pub mod participant {
            use super::{Participant, Service};

            /// `Participant::Feeders`.
            pub const feeders: Participant = Participant::Feeders;
            /// `Participant::Slots`.
            pub const slots: Participant = Participant::Slots;
            /// `Participant::Services`.
            pub const services: Participant = Participant::Services;
            /// `Participant::Candidates`.
            pub const candidates: Participant = Participant::Candidates;
            /// `Participant::Supervisor`.
            pub const supervisor: Participant = Participant::Supervisor;
            define_services!(participants $($source = $source_name)* $($slot = $slot_name)* $($other = $other_name)*);
        }
    };
    (participants $($service:ident = $name:ident)*) => {
        $(#[doc = concat!("`Participant::One(Service::", stringify!($service), ")`.")]
        pub const $name: Participant = Participant::One(Service::$service);)*
    };
}

crate::services!(define_services {});

/// Property of a service.
#[derive(Clone, Copy)]
enum Property {
    /// A launch file may list the service.
    Listed,
    /// The service carries ticks between the hosts of a split system.
    CarriesTicks,
    /// Nothing on board waits for the service.
    LowPriority,
}

impl Service {
    /// Services that a launch file may list. The drivers cannot be listed. They are started if the
    /// source needs them.
    pub const LISTED: [Self; count_listed()] = listed();

    const fn has(self, property: Property) -> bool {
        let (_, properties) = TABLE[self as usize];
        let mut index = 0;
        while index < properties.len() {
            if properties[index] as usize == property as usize {
                return true;
            }
            index += 1;
        }
        false
    }

    /// Returns `true` for services outside the data path.
    ///
    /// An auxiliary service publishes no ticks of its own, and its exit is not a failure of the
    /// system.
    pub fn is_auxiliary(self) -> bool {
        !Self::PATH.contains(&self)
    }

    /// Returns `true` if the service carries ticks between the hosts of a split system.
    pub const fn carries_ticks(self) -> bool {
        self.has(Property::CarriesTicks)
    }

    /// Returns `true` if nothing on board waits for the service, so that it may run at low
    /// priority.
    pub const fn is_low_priority(self) -> bool {
        self.has(Property::LowPriority)
    }

    /// Returns the name used in launch files and messages.
    pub const fn name(self) -> &'static str {
        TABLE[self as usize].0
    }

    /// Returns the service called `name`.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|service| service.name() == name)
    }

    /// Returns the service with this index in [`ALL`](Self::ALL).
    pub fn from_index(index: u32) -> Option<Self> {
        Self::ALL.get(usize::try_from(index).ok()?).copied()
    }
}

const fn count_listed() -> usize {
    let (mut count, mut index) = (0, 0);
    while index < Service::ALL.len() {
        count += Service::ALL[index].has(Property::Listed) as usize;
        index += 1;
    }
    count
}

const fn listed() -> [Service; count_listed()] {
    let mut listed = [Service::ALL[0]; count_listed()];
    let (mut count, mut index) = (0, 0);
    while index < Service::ALL.len() {
        if Service::ALL[index].has(Property::Listed) {
            listed[count] = Service::ALL[index];
            count += 1;
        }
        index += 1;
    }
    listed
}

impl fmt::Display for Service {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// Publisher or subscriber of a topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Participant {
    /// The source of sensor readings: the `drivers` service or an external program.
    Feeders,
    /// A single service.
    One(Service),
    /// Every slot.
    Slots,
    /// Every service.
    Services,
    /// Every stage that runs as a candidate for a slot.
    Candidates,
    /// The supervisor.
    Supervisor,
}

impl Participant {
    /// Returns `true` if this participant is `service`, or is a group that includes it.
    pub fn includes(self, service: Service) -> bool {
        match self {
            Self::One(one) => one == service,
            Self::Slots => service.slot().is_some(),
            Self::Services => true,
            Self::Feeders => service == Service::Drivers,
            Self::Candidates | Self::Supervisor => false,
        }
    }

    /// Returns `true` if several processes can act as this participant at the same time.
    pub const fn is_many(self) -> bool {
        match self {
            Self::Slots | Self::Services | Self::Candidates => true,
            Self::Feeders | Self::One(_) | Self::Supervisor => false,
        }
    }
}

impl fmt::Display for Participant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Feeders => "drivers or an external program",
            Self::One(service) => service.name(),
            Self::Slots => "every slot",
            Self::Services => "every service",
            Self::Candidates => "every candidate",
            Self::Supervisor => "supervisor",
        })
    }
}
