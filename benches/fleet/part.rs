//! The processes of a fleet: the router, some vehicles, the station.

use std::{
    collections::BTreeMap,
    io::{self, Read},
    thread,
    time::{Duration, Instant},
};

use bytemuck::Zeroable as _;
use link::{Endpoints, Link};
use messages::{AttitudeOutput, Header, Message};
use runtime::clock::{monotonic_ns, sleep_until_ns, minimise_timer_slack};
use rustix::process::{Signal, set_parent_process_death_signal};
use serde::{Deserialize, Serialize};
use wire::{batch::batch_name, keys, v1::Envelope};
use zenoh::{Config, Wait};

use crate::{Failure, sample::attitude};

/// What a vehicle sends by default, Hz.
const RATE_HZ: u64 = 50;
/// From the start until all have come together.
const LIMIT: Duration = Duration::from_secs(100);
/// Sessions that are opened one after the other.
const OPENED_BY_ONE: usize = 10;
/// Longest wait for a message.
const WAIT_LIMIT: Duration = Duration::from_millis(50);
/// More than any fleet here: the bound is looked for elsewhere.
const MAX_SESSIONS: &str = "4096";

/// What a process is to be.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) enum Part {
    /// A Zenoh session in the mode of a router.
    Router { at: String },
    /// Vehicles, `count` from the number `first` on.
    Vehicles { at: String, first: usize, count: usize },
    /// Who looks at all of them.
    Station { at: String, vehicles: usize },
}

/// What the station has heard.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Heard {
    /// Messages that arrived and were attitudes.
    pub(crate) arrived: u64,
    /// Messages whose numbers are missing.
    pub(crate) lost: u64,
}

impl Part {
    /// Is it, until the run ends it.
    pub(crate) fn be(&self) -> Result<(), Failure> {
        set_parent_process_death_signal(Some(Signal::KILL))?;
        match self {
            Self::Router { at } => router(at),
            Self::Vehicles { at, first, count } => vehicles(at, *first..first + count),
            Self::Station { at, vehicles } => station(at, *vehicles),
        }
    }
}

fn router(at: &str) -> Result<(), Failure> {
    let mut config = Config::default();
    for (key, value) in [
        ("mode", "\"router\""),
        ("listen/endpoints", &format!("[\"{at}\"]")),
        ("scouting/multicast/enabled", "false"),
        ("scouting/gossip/enabled", "false"),
        ("transport/unicast/max_sessions", MAX_SESSIONS),
    ] {
        config.insert_json5(key, value).map_err(|error| format!("setting {key}: {error}"))?;
    }
    let _session = zenoh::open(config).wait().map_err(|error| format!("opening {at}: {error}"))?;
    println!("ready");
    loop {
        thread::park();
    }
}

fn vehicles(at: &str, numbers: std::ops::Range<usize>) -> Result<(), Failure> {
    minimise_timer_slack();
    let numbers: Vec<_> = numbers.collect();
    // A peer takes half a second to open.
    let links = thread::scope(|scope| {
        let some = numbers.chunks(OPENED_BY_ONE);
        let opening: Vec<_> = some.map(|some| scope.spawn(|| some.iter().map(|_| open(at)).collect())).collect();
        let opened = opening.into_iter().map(|thread| thread.join().unwrap_or_else(|_| Err("a thread failed".into())));
        Ok::<Vec<_>, String>(opened.collect::<Result<Vec<Vec<Link>>, String>>()?.into_iter().flatten().collect())
    })?;
    let outlet = |(link, number): (&Link, &usize)| {
        let key = keys::key(&format!("vehicle-{number}"), AttitudeOutput::TOPIC.name);
        link.publisher(&key, &batch_name::<AttitudeOutput>())
    };
    let outlets = links.iter().zip(&numbers).map(outlet).collect::<Result<Vec<_>, _>>()?;
    if !links.iter().all(|link| link.wait_for_peer(LIMIT)) {
        return Err(format!("vehicles did not reach the router at {at}").into());
    }
    println!("ready");
    io::stdin().read_to_string(&mut String::new())?;
    let start_ns = monotonic_ns();
    for sequence in 0.. {
        for (place, outlet) in outlets.iter().enumerate() {
            // One after the other, evenly over the period.
            let due = sequence * outlets.len() as u64 + place as u64;
            let due_ns = start_ns + due * 1_000_000_000 / (RATE_HZ * outlets.len() as u64);
            while monotonic_ns() < due_ns {
                sleep_until_ns(due_ns, WAIT_LIMIT);
            }
            let t_sent_ns = monotonic_ns();
            let envelope = Envelope { sequence, start_ns, samples_before: sequence, t_sent_ns, ..Envelope::default() };
            outlet.send(&wire::encode_batch(&envelope, &wire::encode_samples([&attitude(header(sequence, t_sent_ns))])))?;
        }
    }
    Ok(())
}

fn open(at: &str) -> Result<Link, String> {
    Link::open(&Endpoints { connect: vec![at.into()], ..Endpoints::default() }).map_err(|error| error.to_string())
}

fn station(at: &str, vehicles: usize) -> Result<(), Failure> {
    let link = Link::open(&Endpoints { connect: vec![at.into()], client: true, ..Endpoints::default() })?;
    let stream = link.subscribe(&keys::key("*", AttitudeOutput::TOPIC.name))?;
    println!("ready");
    let mut last: BTreeMap<String, u64> = BTreeMap::new();
    let mut take = |deadline: Instant, all: usize| -> Result<Heard, Failure> {
        let mut heard = Heard { arrived: 0, lost: 0 };
        while Instant::now() < deadline && last.len() < all {
            let Some(arrival) = stream.next(WAIT_LIMIT) else { continue };
            let (Envelope { sequence, .. }, _) = wire::decode_batch::<AttitudeOutput>(&arrival.bytes)?;
            heard.arrived += 1;
            heard.lost += last.insert(arrival.key, sequence).map_or(0, |before| sequence.saturating_sub(before + 1));
        }
        Ok(heard)
    };
    let (say, told) = std::sync::mpsc::channel();
    thread::spawn(move || {
        let mut text = String::new();
        io::stdin().read_to_string(&mut text).map(|_| say.send(text))
    });
    take(Instant::now() + LIMIT, vehicles)?;
    println!("complete");
    let seconds = loop {
        take(Instant::now() + WAIT_LIMIT, usize::MAX)?;
        if let Ok(text) = told.try_recv() {
            break text.parse()?;
        }
    };
    let heard = take(Instant::now() + Duration::from_secs_f64(seconds), usize::MAX)?;
    println!("{}", serde_json::to_string(&heard)?);
    take(Instant::now() + LIMIT, usize::MAX)?;
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
