//! What follows from the table: who is beside whom.

use crate::{Entry, Participant, Presence, Service, Topic};

/// A table of topics, to be asked.
#[derive(Debug, Clone, Copy)]
pub struct Graph(pub &'static [Entry]);

/// The graph of the system.
pub const GRAPH: Graph = Graph(Topic::ENTRIES);

impl Graph {
    /// What a service publishes that is its own: not what every service does.
    pub fn outputs(self, service: Service) -> impl Iterator<Item = &'static Entry> {
        self.0.iter().filter(move |topic| topic.publisher == Participant::One(service))
    }

    /// The topic on which a service publishes what it makes of each tick.
    pub fn output(self, service: Service) -> Option<&'static Entry> {
        self.outputs(service).find(|topic| topic.presence == Presence::EveryTick)
    }

    /// What a service reads that descends from IMU samples.
    pub fn inputs(self, service: Service) -> impl Iterator<Item = &'static Entry> {
        self.0.iter().filter(move |topic| topic.presence.is_ticked() && topic.is_read_by(service))
    }

    /// The services whose output of a tick another one waits for.
    pub fn sources(self, service: Service) -> impl Iterator<Item = Service> {
        let is_waited_for =
            move |source: &Service| self.output(*source).is_some_and(|output| output.is_read_by(service));
        Service::ALL.into_iter().filter(is_waited_for)
    }

    /// Topics that can be carried to another host, in the order in which those of one tick are published there: what goes with some
    /// ticks before those ticks.
    pub fn carried(self) -> impl Iterator<Item = &'static Entry> {
        let of = move |dense: bool| {
            let presence = move |topic: &&Entry| (topic.presence == Presence::EveryTick) == dense;
            self.0.iter().filter(|topic| topic.is_carried()).filter(presence)
        };
        of(false).chain(of(true))
    }

    /// Who reads what a service publishes and goes on from a checkpoint of its own; in a split system the gateway reads for slots
    /// elsewhere, or publishes for them.
    pub fn readers(self, service: Service) -> impl Iterator<Item = Service> {
        let publishes = move |topic: &Entry| {
            topic.is_carried() && (service.carries_ticks() || topic.publisher == Participant::One(service))
        };
        let reads = move |reader: &Service| {
            *reader != service
                && self.0.iter().any(|topic| publishes(topic) && (reader.carries_ticks() || topic.is_read_by(*reader)))
        };
        Service::ALL.into_iter().filter(reads)
    }
}

impl Entry {
    /// The service reads it in its own work.
    pub fn is_read_by(&self, service: Service) -> bool {
        self.readers.iter().any(|reader| reader.includes(service))
    }

    /// A slot works on its ticks, so the gateway can bring them to one on another host.
    pub fn is_carried(&self) -> bool {
        self.presence.is_ticked() && Service::SLOTS.into_iter().any(|slot| self.is_read_by(slot))
    }

    /// The service that publishes it, if that is one.
    pub fn publishing_service(&self) -> Option<Service> {
        match self.publisher {
            Participant::One(service) => Some(service),
            Participant::Feeders
            | Participant::Slots
            | Participant::Services
            | Participant::Candidates
            | Participant::Supervisor => None,
        }
    }
}

impl Service {
    /// [`Graph::output`] of the system.
    pub fn output(self) -> Option<Topic> {
        GRAPH.output(self).and_then(Topic::of)
    }

    /// [`Graph::inputs`] of the system.
    pub fn inputs(self) -> impl Iterator<Item = Topic> {
        GRAPH.inputs(self).filter_map(Topic::of)
    }

    /// [`Graph::sources`] of the system.
    pub fn sources(self) -> impl Iterator<Item = Self> {
        GRAPH.sources(self)
    }

    /// [`Graph::readers`] of the system.
    pub fn readers(self) -> impl Iterator<Item = Self> {
        GRAPH.readers(self)
    }
}

impl Topic {
    /// [`Graph::carried`] of the system.
    pub fn carried() -> impl Iterator<Item = Self> {
        GRAPH.carried().filter_map(Self::of)
    }
}
