//! State of the remote vehicles and delivery statistics of their topics.

use std::{
    collections::{BTreeMap, BTreeSet},
    time::{Duration, Instant},
};

use attitude::frames::Frame;
use foreign::ForeignText;
use graph::Topic;
use link::{Link, MessageStream, RemoteMessage};
use messages::{AttitudeOutput, Message};
use observe::{
    hops::LatencyHistogram,
    tables::{CsvTables, TableError},
};
use serde_json::{Value, json};
use wire::{
    DecodeError, DecodeErrorCounts, Payload,
    command::ControlMessage,
    delivery::DeliveryTracker,
    keys,
    v1::{Envelope, GatewayReport},
};

use crate::error::RemoteError;

/// Maximum number of vehicles that are tracked. Beyond that, a new vehicle replaces one that is not
/// alive.
const MAX_VEHICLES: usize = 256;
/// Maximum number of services that are tracked per vehicle. A system has fewer than 16.
const MAX_SERVICES: usize = 64;
/// Time for the connected vehicles to confirm a new subscription. Messages of a vehicle that does
/// not confirm it in time are counted from their arrival.
const SUBSCRIBE_TIMEOUT: Duration = Duration::from_secs(2);
/// Longest wait for a message.
const RECEIVE_TIMEOUT: Duration = Duration::from_millis(20);
/// Maximum number of messages of a subscription that are received per poll, so that the caller is
/// not starved.
const MAX_MESSAGES: usize = 1000;

/// State of a vehicle.
#[derive(Default)]
pub struct Vehicle {
    /// Names of the running services.
    pub services: BTreeSet<ForeignText>,
    /// `true` while the gateway is reachable.
    pub is_alive: bool,
    /// Delivery statistics of each topic.
    pub trackers: BTreeMap<String, DeliveryTracker>,
    /// Newest attitude.
    pub attitude: Option<AttitudeOutput>,
    /// Frame of the attitude.
    pub frame: Frame,
    /// Arrival time of the newest attitude.
    pub attitude_at: Option<Instant>,
    /// End-to-end latencies of the attitudes since the latencies were last evaluated.
    pub latencies: LatencyHistogram,
    decode_errors: DecodeErrorCounts,
    /// Arrival time of the newest message or token.
    heard_at: Option<Instant>,
}

/// Vehicles by name.
pub type Vehicles = BTreeMap<String, Vehicle>;

/// Subscriptions to all reachable vehicles, and the state of the vehicles.
pub struct FleetMonitor {
    messages: Vec<MessageStream>,
    liveliness: MessageStream,
    tables: Option<CsvTables>,
    /// Known vehicles.
    pub vehicles: Vehicles,
}

impl FleetMonitor {
    /// Subscribes to these topics of all vehicles; `*` stands for every topic. Messages are also
    /// written to `tables` if given.
    ///
    /// Messages are counted once the connected vehicles have confirmed the subscriptions. A vehicle
    /// sends all messages while a peer connects to it, and none from then until it receives the
    /// peer's subscription. The messages in between are not lost.
    ///
    /// # Errors
    ///
    /// Fails if the link is closed.
    pub fn open(link: &Link, topics: &[&str], tables: Option<CsvTables>) -> Result<Self, RemoteError> {
        let messages = topics.iter().map(|topic| link.subscribe(&keys::key("*", topic)));
        let messages = messages.collect::<Result<Vec<_>, _>>()?;
        // A response confirms that the vehicle has processed the subscriptions, which were sent
        // before the query. Its content and errors are ignored.
        let _ = link.query(&keys::key("*", keys::GATEWAY), Vec::new(), SUBSCRIBE_TIMEOUT);
        messages.iter().for_each(MessageStream::discard_received);
        Ok(Self {
            messages,
            liveliness: link.subscribe_liveliness(&keys::key("*", &format!("{}/**", keys::LIVELINESS)))?,
            tables,
            vehicles: Vehicles::new(),
        })
    }

    /// Processes received messages. Waits briefly if no message is available.
    ///
    /// # Errors
    ///
    /// Fails if a table cannot be written.
    pub fn poll(&mut self) -> Result<(), TableError> {
        let Self { messages, liveliness, tables, vehicles } = self;
        for _ in 0..MAX_MESSAGES {
            let Some(token) = liveliness.next(Duration::ZERO) else { break };
            update_liveliness(vehicles, &token);
        }
        for stream in messages {
            let mut wait = RECEIVE_TIMEOUT;
            for _ in 0..MAX_MESSAGES {
                let Some(message) = stream.next(wait) else { break };
                wait = Duration::ZERO;
                record_message(vehicles, &message, tables.as_mut())?;
            }
        }
        Ok(())
    }

    /// Completes the tables and returns the vehicles.
    ///
    /// # Errors
    ///
    /// Fails if a table cannot be written.
    pub fn finish(self) -> Result<Vehicles, TableError> {
        self.tables.map_or(Ok(()), CsvTables::finish)?;
        Ok(self.vehicles)
    }
}

/// Returns the named vehicle, which has sent a message or token. Adds it if it is new.
///
/// If there is no room, the vehicle that has been silent longest is forgotten. Returns `None` if
/// all are alive.
fn entry<'v>(vehicles: &'v mut Vehicles, name: &str) -> Option<&'v mut Vehicle> {
    if vehicles.len() >= MAX_VEHICLES && !vehicles.contains_key(name) {
        let gone = vehicles.iter().filter(|(_, vehicle)| !vehicle.is_alive);
        let (longest_silent, _) = gone.min_by_key(|(_, vehicle)| vehicle.heard_at)?;
        let longest_silent = longest_silent.clone();
        vehicles.remove(&longest_silent);
    }
    let vehicle = vehicles.entry(name.into()).or_default();
    vehicle.heard_at = Some(Instant::now());
    Some(vehicle)
}

fn update_liveliness(vehicles: &mut Vehicles, token: &RemoteMessage) {
    let Some((name, rest)) = keys::parse(&token.key) else { return };
    // The withdrawal of an unknown vehicle's token must not add the vehicle.
    if !token.is_present && !vehicles.contains_key(name) {
        return;
    }
    let Some(vehicle) = entry(vehicles, name) else { return };
    match rest.strip_prefix(keys::LIVELINESS).map(|service| service.trim_start_matches('/')) {
        Some("") => vehicle.is_alive = token.is_present,
        Some(service) if token.is_present => vehicle.add_service(service),
        Some(service) => drop(vehicle.services.remove(service)),
        None => {}
    }
}

fn record_message(
    vehicles: &mut Vehicles,
    message: &RemoteMessage,
    tables: Option<&mut CsvTables>,
) -> Result<(), TableError> {
    let Some((name, topic)) = keys::parse(&message.key) else { return Ok(()) };
    let Some(vehicle) = entry(vehicles, name) else { return Ok(()) };
    if topic == keys::GATEWAY {
        if let Err(error) = vehicle.record_gateway_report(&message.bytes) {
            vehicle.decode_errors.count(&error);
        }
        return Ok(());
    }
    let Some(topic) = Topic::from_name(topic) else { return Ok(()) };
    messages::dispatch!(topic, M => vehicle.record_batch::<M>(name, &message.bytes, tables))
}

impl Vehicle {
    /// Adds a service unless the vehicle already has [`MAX_SERVICES`].
    fn add_service(&mut self, service: &str) {
        if self.services.len() < MAX_SERVICES {
            self.services.insert(service.into());
        }
    }

    /// Counts a batch of messages of a topic and writes it to the topic's table if `tables` is
    /// given.
    fn record_batch<M: Payload>(
        &mut self,
        name: &str,
        bytes: &[u8],
        tables: Option<&mut CsvTables>,
    ) -> Result<(), TableError> {
        let topic = M::TOPIC.name;
        match (self.decode_samples::<M>(topic, bytes), tables) {
            (Ok(samples), Some(tables)) => tables.write(name, topic, &samples),
            (Ok(_), None) => Ok(()),
            (Err(error), _) => {
                self.decode_errors.count(&error);
                Ok(())
            }
        }
    }

    fn decode_samples<M: Payload>(&mut self, topic: &str, bytes: &[u8]) -> Result<Vec<M>, DecodeError> {
        let (envelope, samples) = wire::decode_batch::<M>(bytes)?;
        self.count_delivery(topic, &envelope, samples.len());
        if topic == AttitudeOutput::TOPIC.name {
            let outputs =
                samples.iter().filter_map(|sample| bytemuck::try_pod_read_unaligned(bytemuck::bytes_of(sample)).ok());
            for output in outputs {
                self.record_attitude(output);
            }
            self.frame = envelope.frame_and_order().map(|(frame, _)| frame).unwrap_or_default();
        }
        Ok(samples)
    }

    fn record_attitude(&mut self, output: AttitudeOutput) {
        self.latencies.record_ns(output.header.t_sent_ns.saturating_sub(output.header.t_born_ns));
        self.attitude_at = Some(Instant::now());
        self.attitude = Some(output);
    }

    fn record_gateway_report(&mut self, bytes: &[u8]) -> Result<(), DecodeError> {
        let report = GatewayReport::from_bytes(bytes)?;
        self.count_delivery(keys::GATEWAY, &report.envelope.unwrap_or_default(), 1);
        Ok(())
    }

    fn count_delivery(&mut self, topic: &str, envelope: &Envelope, samples: usize) {
        self.trackers.entry(topic.into()).or_default().record(envelope, samples as u64);
    }

    /// Returns the number of messages received.
    pub fn messages(&self) -> u64 {
        self.trackers.values().map(|tracker| tracker.messages).sum()
    }

    /// Returns the number of messages lost in transit.
    pub fn lost(&self) -> u64 {
        self.trackers.values().map(|tracker| tracker.lost_messages).sum()
    }
}

/// Returns the state of the vehicles as a JSON object.
pub fn to_json(vehicles: &Vehicles) -> Value {
    let vehicle = |(name, vehicle): (&String, &Vehicle)| {
        let trackers: Vec<_> = vehicle.trackers.iter().map(|(topic, tracker)| topic_json(topic, tracker)).collect();
        let attitude = vehicle.attitude.map(|output| {
            json!({
                "tick": output.header.tick, "t_s": output.header.t_end_ns as f64 * 1e-9, "quaternion": output.quaternion,
                "frame": vehicle.frame.name(),
                "course_deg": output.course_rad.to_degrees(), "course_reference": output.course_reference.name(),
            })
        });
        json!({
            "vehicle": name, "alive": vehicle.is_alive, "services": vehicle.services, "attitude": attitude,
            "lost_messages": vehicle.lost(), "rejected": vehicle.decode_errors.total(), "topics": trackers,
        })
    };
    json!({ "vehicles": vehicles.iter().map(vehicle).collect::<Vec<_>>() })
}

fn topic_json(topic: &str, tracker: &DeliveryTracker) -> Value {
    let DeliveryTracker { messages, samples, lost_messages, lost_samples, repeated, .. } = tracker;
    let DeliveryTracker { restarts, decimated, dropped, .. } = tracker;
    json!({
        "topic": topic, "messages": messages, "samples": samples, "lost_messages": lost_messages,
        "lost_samples": lost_samples, "repeated": repeated, "restarts": restarts, "decimated": decimated,
        "dropped": dropped,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn number_of_services_of_a_vehicle_is_limited() {
        let mut vehicles = Vehicles::new();
        for number in 0..1000 {
            let key = keys::service_liveliness("boat", &number.to_string());
            update_liveliness(&mut vehicles, &RemoteMessage { key, bytes: Vec::new(), is_present: true });
        }
        assert_eq!(vehicles["boat"].services.len(), MAX_SERVICES);
    }

    #[test]
    fn hostile_service_name_is_escaped_except_in_json() {
        let mut vehicles = Vehicles::new();
        let hostile = "e\x1b[2J\nforged";
        let mut token =
            RemoteMessage { key: keys::service_liveliness("boat", hostile), bytes: Vec::new(), is_present: true };
        update_liveliness(&mut vehicles, &token);
        let names: Vec<_> = vehicles["boat"].services.iter().map(ToString::to_string).collect();
        assert_eq!(names, [r"e\u{1b}[2J\nforged"]);
        assert_eq!(to_json(&vehicles)["vehicles"][0]["services"][0], hostile);
        token.is_present = false;
        update_liveliness(&mut vehicles, &token);
        assert!(vehicles["boat"].services.is_empty());
    }
}
