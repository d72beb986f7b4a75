//! The services and slots, and who else publishes or reads.

use core::fmt;

/// A service of the system. Messages and the wire name it by its place in [`ALL`](Self::ALL).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "lowercase"))]
pub enum Service {
    /// Brings samples in.
    Ingest,
    /// Integrates the rate.
    Gyro,
    /// Finds the vertical in the specific force.
    Accel,
    /// Joins both to the attitude.
    Fuser,
    /// Turns the attitude into angles.
    Course,
    /// Carries messages beyond the board.
    Gateway,
    /// Reads the devices of a live source.
    Drivers,
    /// Shows the system in a browser.
    Cockpit,
}

impl Service {
    /// The services of the data path, in the order data passes through them.
    pub const PATH: [Self; 5] = [Self::Ingest, Self::Gyro, Self::Accel, Self::Fuser, Self::Course];
    /// Those of the path that a stage fills.
    pub const SLOTS: [Self; 4] = [Self::Gyro, Self::Accel, Self::Fuser, Self::Course];
    /// Every service: those of the path, and those beside it.
    pub const ALL: [Self; 8] =
        [Self::Ingest, Self::Gyro, Self::Accel, Self::Fuser, Self::Course, Self::Gateway, Self::Drivers, Self::Cockpit];
    /// Those that a launch file lists. The drivers run where its source needs them.
    pub const LISTED: [Self; 7] =
        [Self::Ingest, Self::Gyro, Self::Accel, Self::Fuser, Self::Course, Self::Gateway, Self::Cockpit];

    /// It is not of the data path: it makes no ticks of its own, and its end is no failure of the system.
    pub fn is_beside(self) -> bool {
        !Self::PATH.contains(&self)
    }

    /// In a split system it brings ticks from one host to another.
    pub const fn carries_ticks(self) -> bool {
        matches!(self, Self::Gateway)
    }

    /// Nothing on board waits for it: on a machine with too much to do it is the one to wait.
    pub const fn can_wait(self) -> bool {
        matches!(self, Self::Gateway | Self::Cockpit)
    }

    /// A stage fills it.
    pub fn is_slot(self) -> bool {
        Self::SLOTS.contains(&self)
    }

    /// The name it has in a launch file.
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

    /// The service of that name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|service| service.name() == name)
    }

    /// The service of that place in [`ALL`](Self::ALL).
    pub fn at(place: u32) -> Option<Self> {
        Self::ALL.get(usize::try_from(place).ok()?).copied()
    }
}

impl fmt::Display for Service {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// Who publishes or reads a topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Participant {
    /// Whoever has the sensors: the service `drivers`, or a program that is no part of the system.
    Feeders,
    /// A service.
    One(Service),
    /// Every slot.
    Slots,
    /// Every service.
    Services,
    /// Every stage that computes beside the owner of its slot.
    Candidates,
    /// The supervisor.
    Supervisor,
}

impl Participant {
    /// The service is the participant, or one of those that it stands for.
    pub fn includes(self, service: Service) -> bool {
        match self {
            Self::One(one) => one == service,
            Self::Slots => service.is_slot(),
            Self::Services => true,
            Self::Feeders => service == Service::Drivers,
            Self::Candidates | Self::Supervisor => false,
        }
    }

    /// As many processes as there are services or slots may be it at once.
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
            Self::Feeders => "drivers, or a program of its own",
            Self::One(service) => service.name(),
            Self::Slots => "every slot",
            Self::Services => "every service",
            Self::Candidates => "every candidate",
            Self::Supervisor => "supervisor",
        })
    }
}

/// The participants under the names that the table has for them.
#[expect(non_upper_case_globals, reason = "the table names them as launch files do")]
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
