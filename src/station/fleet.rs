//! State of the remote vehicles and delivery statistics of their topics.

use std::{
    collections::{BTreeMap, BTreeSet},
    time::Instant,
};

use attitude::frames::Frame;
use graph::Topic;
use link::RemoteMessage;
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

/// Maximum number of vehicles that are tracked.
const MAX_VEHICLES: usize = 256;

/// State of a vehicle.
#[derive(Default)]
pub(crate) struct Vehicle {
    pub(crate) services: BTreeSet<String>,
    pub(crate) is_alive: bool,
    pub(crate) trackers: BTreeMap<String, DeliveryTracker>,
    pub(crate) attitude: Option<AttitudeOutput>,
    /// Frame of the attitude.
    pub(crate) frame: Frame,
    /// Arrival time of the newest attitude.
    pub(crate) attitude_at: Option<Instant>,
    /// End-to-end latencies of the attitudes since the latencies were last evaluated.
    pub(crate) latencies: LatencyHistogram,
    decode_errors: DecodeErrorCounts,
}

/// Vehicles by name.
pub(crate) type Vehicles = BTreeMap<String, Vehicle>;

/// Returns the named vehicle. Adds it if there is room, otherwise returns `None`.
fn entry<'v>(vehicles: &'v mut Vehicles, name: &str) -> Option<&'v mut Vehicle> {
    let has_room = vehicles.len() < MAX_VEHICLES;
    (has_room || vehicles.contains_key(name)).then(|| vehicles.entry(name.into()).or_default())
}

pub(crate) fn update_liveliness(vehicles: &mut Vehicles, token: &RemoteMessage) {
    let Some((name, rest)) = keys::parse(&token.key) else { return };
    let Some(vehicle) = entry(vehicles, name) else { return };
    match rest.strip_prefix(keys::LIVELINESS).map(|service| service.trim_start_matches('/')) {
        Some("") => vehicle.is_alive = token.is_present,
        Some(service) if token.is_present => drop(vehicle.services.insert(service.into())),
        Some(service) => drop(vehicle.services.remove(service)),
        None => {}
    }
}

pub(crate) fn record_message(
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
    pub(crate) fn messages(&self) -> u64 {
        self.trackers.values().map(|tracker| tracker.messages).sum()
    }

    /// Returns the number of messages lost in transit.
    pub(crate) fn lost(&self) -> u64 {
        self.trackers.values().map(|tracker| tracker.lost_messages).sum()
    }
}

pub(crate) fn to_json(vehicles: &Vehicles) -> Value {
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
