//! Processes of a fleet: the router, groups of vehicles and the station.

use std::{
    collections::BTreeMap,
    io::{self, Read},
    thread,
    time::{Duration, Instant},
};

use bytemuck::Zeroable as _;
use link::{Endpoints, Link};
use messages::{AttitudeOutput, Header, Message};
use runtime::{PacingTimer, clock::monotonic_ns};
use rustix::process::{Signal, set_parent_process_death_signal};
use serde::{Deserialize, Serialize};
use wire::{batch::batch_name, keys, v1::Envelope};
use zenoh::{Config, Wait};

use crate::{Failure, sample::attitude};

/// Rate at which each vehicle publishes its attitude, Hz. It is the default rate of the gateway.
const RATE_HZ: u64 = 50;
/// Time allowed for all sessions to connect.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(100);
/// Number of sessions that one thread opens in sequence.
const LINKS_PER_THREAD: usize = 10;
/// Longest wait for a message.
const MAX_WAIT: Duration = Duration::from_millis(50);
/// Maximum number of sessions of the router. It is above the size of any fleet measured here.
const MAX_SESSIONS: &str = "4096";

/// Settings for one process of the fleet.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) enum ProcessSettings {
    /// Zenoh session in router mode.
    Router { endpoint: String },
    /// `count` vehicles, numbered from `first`.
    Vehicles { endpoint: String, first: usize, count: usize },
    /// Subscriber to all vehicles.
    Station { endpoint: String, vehicles: usize },
}

/// Message counts of the station.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct StationReport {
    /// Number of attitude messages received.
    pub(crate) arrived: u64,
    /// Number of messages missing according to the sequence numbers.
    pub(crate) lost: u64,
}

impl ProcessSettings {
    /// Runs the process until it is killed.
    pub(crate) fn run(&self) -> Result<(), Failure> {
        set_parent_process_death_signal(Some(Signal::KILL))?;
        match self {
            Self::Router { endpoint } => router(endpoint),
            Self::Vehicles { endpoint, first, count } => vehicles(endpoint, *first..first + count),
            Self::Station { endpoint, vehicles } => station(endpoint, *vehicles),
        }
    }
}

fn router(endpoint: &str) -> Result<(), Failure> {
    let mut config = Config::default();
    for (key, value) in [
        ("mode", "\"router\""),
        ("listen/endpoints", &format!("[\"{endpoint}\"]")),
        ("scouting/multicast/enabled", "false"),
        ("scouting/gossip/enabled", "false"),
        ("transport/unicast/max_sessions", MAX_SESSIONS),
    ] {
        config.insert_json5(key, value).map_err(|error| format!("setting {key}: {error}"))?;
    }
    let _session = zenoh::open(config).wait().map_err(|error| format!("opening {endpoint}: {error}"))?;
    println!("ready");
    loop {
        thread::park();
    }
}

fn vehicles(endpoint: &str, numbers: std::ops::Range<usize>) -> Result<(), Failure> {
    let mut timer = PacingTimer::for_current_thread();
    let numbers: Vec<_> = numbers.collect();
    // Sessions are opened in parallel, because opening one takes half a second.
    let links = thread::scope(|scope| {
        let chunks = numbers.chunks(LINKS_PER_THREAD);
        let opening: Vec<_> =
            chunks.map(|chunk| scope.spawn(|| chunk.iter().map(|_| open(endpoint)).collect())).collect();
        let opened = opening
            .into_iter()
            .map(|thread| thread.join().unwrap_or_else(|_| Err("a connecting thread panicked".into())));
        Ok::<Vec<_>, String>(opened.collect::<Result<Vec<Vec<Link>>, String>>()?.into_iter().flatten().collect())
    })?;
    let publisher = |(link, number): (&Link, &usize)| {
        let key = keys::key(&format!("vehicle-{number}"), AttitudeOutput::TOPIC.name);
        link.publisher(&key, &batch_name::<AttitudeOutput>())
    };
    let publishers = links.iter().zip(&numbers).map(publisher).collect::<Result<Vec<_>, _>>()?;
    if !links.iter().all(|link| link.wait_for_peer(CONNECT_TIMEOUT)) {
        return Err(format!("vehicles did not reach the router at {endpoint}").into());
    }
    println!("ready");
    io::stdin().read_to_string(&mut String::new())?;
    let start_ns = monotonic_ns();
    for sequence in 0.. {
        for (index, publisher) in publishers.iter().enumerate() {
            // The vehicles publish one after another, evenly spread over the period.
            let due = sequence * publishers.len() as u64 + index as u64;
            let due_ns = start_ns + due * 1_000_000_000 / (RATE_HZ * publishers.len() as u64);
            while monotonic_ns() < due_ns {
                timer.sleep_until_ns(due_ns, MAX_WAIT);
            }
            let t_sent_ns = monotonic_ns();
            let envelope = Envelope { sequence, start_ns, samples_before: sequence, t_sent_ns, ..Envelope::default() };
            publisher.send(&wire::encode_batch(
                &envelope,
                &wire::encode_samples([&attitude(header(sequence, t_sent_ns))]),
            ))?;
        }
    }
    Ok(())
}

fn open(endpoint: &str) -> Result<Link, String> {
    Link::open(&Endpoints { connect: vec![endpoint.into()], ..Endpoints::default() }).map_err(|error| error.to_string())
}

fn station(endpoint: &str, vehicles: usize) -> Result<(), Failure> {
    let link = Link::open(&Endpoints { connect: vec![endpoint.into()], client: true, ..Endpoints::default() })?;
    let stream = link.subscribe(&keys::key("*", AttitudeOutput::TOPIC.name))?;
    println!("ready");
    let mut last: BTreeMap<String, u64> = BTreeMap::new();
    let mut receive_until = |deadline: Instant, all: usize| -> Result<StationReport, Failure> {
        let mut report = StationReport { arrived: 0, lost: 0 };
        while Instant::now() < deadline && last.len() < all {
            let Some(arrival) = stream.next(MAX_WAIT) else { continue };
            let (Envelope { sequence, .. }, _) = wire::decode_batch::<AttitudeOutput>(&arrival.bytes)?;
            report.arrived += 1;
            report.lost += last.insert(arrival.key, sequence).map_or(0, |before| sequence.saturating_sub(before + 1));
        }
        Ok(report)
    };
    let (sender, duration) = std::sync::mpsc::channel();
    thread::spawn(move || {
        let mut text = String::new();
        io::stdin().read_to_string(&mut text).map(|_| sender.send(text))
    });
    receive_until(Instant::now() + CONNECT_TIMEOUT, vehicles)?;
    println!("complete");
    let seconds = loop {
        receive_until(Instant::now() + MAX_WAIT, usize::MAX)?;
        if let Ok(text) = duration.try_recv() {
            break text.parse()?;
        }
    };
    let report = receive_until(Instant::now() + Duration::from_secs_f64(seconds), usize::MAX)?;
    println!("{}", serde_json::to_string(&report)?);
    receive_until(Instant::now() + CONNECT_TIMEOUT, usize::MAX)?;
    Ok(())
}

fn header(tick: u64, now_ns: u64) -> Header {
    let t_end_ns = now_ns.cast_signed();
    Header {
        tick,
        t_start_ns: t_end_ns - 1_000_000,
        t_end_ns,
        t_born_ns: now_ns,
        t_sent_ns: now_ns,
        ..Header::zeroed()
    }
}
