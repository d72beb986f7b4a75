//! Queries on the topic table: inputs, outputs and neighbours of a service.

use crate::{Entry, Participant, Presence, Service, Slot, Topic};

/// Topic table.
#[derive(Debug, Clone, Copy)]
pub struct Graph(pub &'static [Entry]);

/// The topic table of the system.
pub const GRAPH: Graph = Graph(Topic::ENTRIES);

impl Graph {
    /// Returns the topics that only `service` publishes.
    ///
    /// Topics that every service publishes, such as `health`, are excluded.
    pub fn outputs(self, service: Service) -> impl Iterator<Item = &'static Entry> {
        self.0.iter().filter(move |topic| topic.publisher == Participant::One(service))
    }

    /// Returns the topic on which `service` publishes a message for every tick, if there is one.
    pub fn output(self, service: Service) -> Option<&'static Entry> {
        self.outputs(service).find(|topic| topic.presence == Presence::EveryTick)
    }

    /// Returns the topics derived from IMU samples to which `service` subscribes.
    pub fn inputs(self, service: Service) -> impl Iterator<Item = &'static Entry> {
        self.0.iter().filter(move |topic| topic.presence.is_ticked() && topic.is_subscribed_by(service))
    }

    /// Returns the services that must deliver an output to `service` for every tick.
    pub fn sources(self, service: Service) -> impl Iterator<Item = Service> {
        let is_waited_for =
            move |source: &Service| self.output(*source).is_some_and(|output| output.is_subscribed_by(service));
        Service::ALL.into_iter().filter(is_waited_for)
    }

    /// Returns the topics that can be carried to another host, in publication order.
    ///
    /// Within one tick, topics with messages for only some ticks come before those with a message
    /// for every tick.
    pub fn carried(self) -> impl Iterator<Item = &'static Entry> {
        let by_density = move |dense: bool| {
            let presence = move |topic: &&Entry| (topic.presence == Presence::EveryTick) == dense;
            self.0.iter().filter(|topic| topic.is_carried()).filter(presence)
        };
        by_density(false).chain(by_density(true))
    }

    /// Returns the checkpointed services that consume messages published by `service`.
    ///
    /// In a split system the gateway subscribes on behalf of remote slots and publishes for them,
    /// so it counts as both a consumer and a publisher of every carried topic.
    pub fn downstream(self, service: Service) -> impl Iterator<Item = Service> {
        let may_publish = move |topic: &Entry| {
            topic.is_carried() && (service.carries_ticks() || topic.publisher == Participant::One(service))
        };
        let may_subscribe = move |consumer: &Service| {
            *consumer != service
                && self
                    .0
                    .iter()
                    .any(|topic| may_publish(topic) && (consumer.carries_ticks() || topic.is_subscribed_by(*consumer)))
        };
        Service::ALL.into_iter().filter(may_subscribe)
    }
}

impl Entry {
    /// Returns `true` if `service` subscribes to the topic for its own computation.
    pub fn is_subscribed_by(&self, service: Service) -> bool {
        self.subscribers.iter().any(|subscriber| subscriber.includes(service))
    }

    /// Returns `true` if the gateway can carry the topic to another host. This requires that a slot
    /// processes the topic's ticks.
    pub fn is_carried(&self) -> bool {
        self.presence.is_ticked() && Slot::ALL.into_iter().any(|slot| self.is_subscribed_by(Service::from(slot)))
    }

    /// Returns the publisher if it is a single service, or `None` otherwise.
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
    /// Calls [`Graph::output`] on the system's topic table.
    pub fn output(self) -> Option<Topic> {
        GRAPH.output(self).and_then(Topic::from_entry)
    }

    /// Calls [`Graph::inputs`] on the system's topic table.
    pub fn inputs(self) -> impl Iterator<Item = Topic> {
        GRAPH.inputs(self).filter_map(Topic::from_entry)
    }

    /// Calls [`Graph::sources`] on the system's topic table.
    pub fn sources(self) -> impl Iterator<Item = Self> {
        GRAPH.sources(self)
    }

    /// Calls [`Graph::downstream`] on the system's topic table.
    pub fn downstream(self) -> impl Iterator<Item = Self> {
        GRAPH.downstream(self)
    }
}

impl Topic {
    /// Calls [`Graph::carried`] on the system's topic table.
    pub fn carried() -> impl Iterator<Item = Self> {
        GRAPH.carried().filter_map(Self::from_entry)
    }
}
