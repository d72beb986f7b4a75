//! Services, slots and the other publishers and subscribers.

use core::fmt;

/// A service of the system, identified in messages by its index in [`ALL`](Self::ALL).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "lowercase"))]
pub enum Service {
    /// Checks, calibrates and numbers the readings of the source.
    Ingest,
    /// Integrates the angular rate.
    Gyro,
    /// Estimates the vertical from the specific force.
    Accel,
    /// Fuses gyro and accelerometer into an attitude.
    Fuser,
    /// Computes angles and course from the attitude.
    Course,
    /// Exchanges messages with other hosts.
    Gateway,
    /// Reads the devices of a live source.
    Drivers,
    /// Serves the web page.
    Cockpit,
}

impl Service {
    /// Services of the data path, in the order of the data flow.
    pub const PATH: [Self; 5] = [Self::Ingest, Self::Gyro, Self::Accel, Self::Fuser, Self::Course];
    /// Services of the data path that run a stage.
    pub const SLOTS: [Self; 4] = [Self::Gyro, Self::Accel, Self::Fuser, Self::Course];
    /// All services: the data path first, then the auxiliary ones.
    pub const ALL: [Self; 8] =
        [Self::Ingest, Self::Gyro, Self::Accel, Self::Fuser, Self::Course, Self::Gateway, Self::Drivers, Self::Cockpit];
    /// Services that a launch file may list. The drivers are not listed, but started if the source
    /// needs them.
    pub const LISTED: [Self; 7] =
        [Self::Ingest, Self::Gyro, Self::Accel, Self::Fuser, Self::Course, Self::Gateway, Self::Cockpit];

    /// Returns `true` for services outside the data path.
    ///
    /// An auxiliary service publishes no ticks of its own, and its end is not a failure of the
    /// system.
    pub fn is_auxiliary(self) -> bool {
        !Self::PATH.contains(&self)
    }

    /// Returns `true` if the service carries ticks between the hosts of a split system.
    pub const fn carries_ticks(self) -> bool {
        matches!(self, Self::Gateway)
    }

    /// Returns `true` if nothing on board waits for the service, so that it may run at low
    /// priority.
    pub const fn is_low_priority(self) -> bool {
        matches!(self, Self::Gateway | Self::Cockpit)
    }

    /// Returns `true` if the service runs a stage.
    pub fn is_slot(self) -> bool {
        Self::SLOTS.contains(&self)
    }

    /// Returns the name used in launch files and messages.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Ingest => "ingest",
            Self::Gyro => "gyro",
            Self::Accel => "accel",
            Self::Fuser => "fuser",
            Self::Course => "course",
            Self::Gateway => "gateway",
            Self::Drivers => "drivers",
            Self::Cockpit => "cockpit",
        }
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
    /// Returns `true` if `service` is this participant or one of its members.
    pub fn includes(self, service: Service) -> bool {
        match self {
            Self::One(one) => one == service,
            Self::Slots => service.is_slot(),
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

/// Constants for the participants, with the names used in the table.
#[expect(non_upper_case_globals, reason = "the table uses the spelling of launch files")]
pub mod participant {
    use super::{Participant, Service};

    macro_rules! participants {
        ($($name:ident = $participant:expr;)*) => {
            $(#[doc = concat!("`", stringify!($participant), "`.")] pub const $name: Participant = $participant;)*
        };
    }

    participants! {
        feeders = Participant::Feeders;
        ingest = Participant::One(Service::Ingest);
        gyro = Participant::One(Service::Gyro);
        accel = Participant::One(Service::Accel);
        fuser = Participant::One(Service::Fuser);
        course = Participant::One(Service::Course);
        gateway = Participant::One(Service::Gateway);
        slots = Participant::Slots;
        services = Participant::Services;
        candidates = Participant::Candidates;
        supervisor = Participant::Supervisor;
    }
}
