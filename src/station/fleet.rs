//! The vehicles in sight, and whether all that they send arrives.

use std::{
    collections::{BTreeMap, BTreeSet},
    time::Instant,
};

use attitude::frames::Frame;
use graph::Topic;
use link::RemoteMessage;
use messages::{AttitudeOutput, Message};
use observe::{
    hops::Latencies,
    tables::{TableError, Tables},
};
use serde_json::{Value, json};
use wire::{
    Payload, DecodeError, DecodeErrorCounts,
    command::ControlMessage,
    delivery::DeliveryTracker,
    keys,
    v1::{Envelope, GatewayReport},
};

/// Vehicles that are kept in mind.
const MAX_VEHICLES: usize = 256;

/// What is known of a vehicle.
#[derive(Default)]
pub(crate) struct Vehicle {
    pub(crate) services: BTreeSet<String>,
    pub(crate) lives: bool,
    pub(crate) tracks: BTreeMap<String, DeliveryTracker>,
    pub(crate) attitude: Option<AttitudeOutput>,
    /// In which it is.
    pub(crate) frame: Frame,
    /// When the newest attitude came, here.
    pub(crate) attitude_at: Option<Instant>,
    /// From birth to attitude, of the attitudes that came since this was looked at.
    pub(crate) latencies: Latencies,
    refusals: DecodeErrorCounts,
}

/// The vehicles in sight by their names.
pub(crate) type Vehicles = BTreeMap<String, Vehicle>;

/// A vehicle by its name, as long as there are not too many.
fn known<'v>(vehicles: &'v mut Vehicles, name: &str) -> Option<&'v mut Vehicle> {
    let has_room = vehicles.len() < MAX_VEHICLES;
    (has_room || vehicles.contains_key(name)).then(|| vehicles.entry(name.into()).or_default())
}

pub(crate) fn see(vehicles: &mut Vehicles, sign: &RemoteMessage) {
    let Some((name, rest)) = keys::parse(&sign.key) else { return };
    let Some(vehicle) = known(vehicles, name) else { return };
    match rest.strip_prefix(keys::LIVELINESS).map(|service| service.trim_start_matches('/')) {
        Some("") => vehicle.lives = sign.is_present,
        Some(service) if sign.is_present => drop(vehicle.services.insert(service.into())),
        Some(service) => drop(vehicle.services.remove(service)),
        None => {}
    }
}

pub(crate) fn take(vehicles: &mut Vehicles, message: &RemoteMessage, tables: Option<&mut Tables>) -> Result<(), TableError> {
    let Some((name, topic)) = keys::parse(&message.key) else { return Ok(()) };
    let Some(vehicle) = known(vehicles, name) else { return Ok(()) };
    if topic == keys::GATEWAY {
        if let Err(refusal) = vehicle.report(&message.bytes) {
            vehicle.refusals.count(&refusal);
        }
        return Ok(());
    }
    let Some(topic) = Topic::from_name(topic) else { return Ok(()) };
    messages::dispatch!(topic, M => vehicle.take::<M>(name, &message.bytes, tables))
}

impl Vehicle {
    /// Takes messages of a topic to the counts and into a table.
    fn take<M: Payload>(&mut self, name: &str, bytes: &[u8], tables: Option<&mut Tables>) -> Result<(), TableError> {
        let topic = M::TOPIC.name;
        match (self.samples::<M>(topic, bytes), tables) {
            (Ok(samples), Some(tables)) => tables.write(name, topic, &samples),
            (Ok(_), None) => Ok(()),
            (Err(refusal), _) => {
                self.refusals.count(&refusal);
                Ok(())
            }
        }
    }

    fn samples<M: Payload>(&mut self, topic: &str, bytes: &[u8]) -> Result<Vec<M>, DecodeError> {
        let (envelope, samples) = wire::decode_batch::<M>(bytes)?;
        self.track(topic, &envelope, samples.len());
        if topic == AttitudeOutput::TOPIC.name {
            let outputs =
                samples.iter().filter_map(|sample| bytemuck::try_pod_read_unaligned(bytemuck::bytes_of(sample)).ok());
            for output in outputs {
                self.take_attitude(output);
            }
            self.frame = envelope.frame_and_order().map(|(frame, _)| frame).unwrap_or_default();
        }
        Ok(samples)
    }

    fn take_attitude(&mut self, output: AttitudeOutput) {
        self.latencies.add(output.header.t_sent_ns.saturating_sub(output.header.t_born_ns));
        self.attitude_at = Some(Instant::now());
        self.attitude = Some(output);
    }

    fn report(&mut self, bytes: &[u8]) -> Result<(), DecodeError> {
        let report = GatewayReport::from_bytes(bytes)?;
        self.track(keys::GATEWAY, &report.envelope.unwrap_or_default(), 1);
        Ok(())
    }

    fn track(&mut self, topic: &str, envelope: &Envelope, samples: usize) {
        self.tracks.entry(topic.into()).or_default().record(envelope, samples as u64);
    }

    /// Messages that came.
    pub(crate) fn messages(&self) -> u64 {
        self.tracks.values().map(|track| track.messages).sum()
    }

    /// Messages lost on the way.
    pub(crate) fn lost(&self) -> u64 {
        self.tracks.values().map(|track| track.lost_messages).sum()
    }
}

pub(crate) fn report(vehicles: &Vehicles) -> Value {
    let vehicle = |(name, vehicle): (&String, &Vehicle)| {
        let tracks: Vec<_> = vehicle.tracks.iter().map(|(topic, track)| delivered(topic, track)).collect();
        let attitude = vehicle.attitude.map(|output| {
            json!({
                "tick": output.header.tick, "t_s": output.header.t_end_ns as f64 * 1e-9, "quaternion": output.quaternion,
                "frame": vehicle.frame.name(),
                "course_deg": output.course_rad.to_degrees(), "course_reference": output.course_reference.name(),
            })
        });
        json!({
            "vehicle": name, "lives": vehicle.lives, "services": vehicle.services, "attitude": attitude,
            "lost_messages": vehicle.lost(), "refused": vehicle.refusals.total(), "topics": tracks,
        })
    };
    json!({ "vehicles": vehicles.iter().map(vehicle).collect::<Vec<_>>() })
}

fn delivered(topic: &str, track: &DeliveryTracker) -> Value {
    let DeliveryTracker { messages, samples, lost_messages, lost_samples, repeated, .. } = track;
    let DeliveryTracker { restarts, decimated, dropped, .. } = track;
    json!({
        "topic": topic, "messages": messages, "samples": samples, "lost_messages": lost_messages,
        "lost_samples": lost_samples, "repeated": repeated, "restarts": restarts, "decimated": decimated,
        "dropped": dropped,
    })
}
