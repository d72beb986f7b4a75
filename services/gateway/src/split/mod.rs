//! One system on several hosts: the ticks of some topics go from one gateway to another and are published there as they were here.
//!
//! Input: messages on the bus of the exporting host. Output: the same messages, bit for bit and in the order of ticks, on the bus of the
//! importing host. Time: how often to look and to ask; what is missing is seen by the ticks alone. Failure: a tick that did not arrive is
//! asked for as long as the exporter keeps it; one that it no longer keeps is counted and named.
//!
//! | module | what it holds |
//! | --- | --- |
//! | [`record`] | one tick of the carried topics |
//! | [`merge`] | several topics become one stream of records |
//! | [`cache`] | the records kept for who was cut off |
//! | [`frame`] | records on the wire |
//! | [`arrivals`] | what came, what is missing, what is lost for good |
//! | [`losses`] | what is lost for good, in words |
//! | `export`, `import` | both ends, between bus and network |

pub mod arrivals;
pub mod cache;
pub(crate) mod export;
pub mod frame;
pub(crate) mod import;
pub mod losses;
pub mod merge;
pub mod record;

use std::{fs, sync::Arc, thread::JoinHandle, time::Duration};

use bus::Publisher;
use launch::Service;
use link::{Endpoints, Link, LinkError};
use messages::Checkpoint;
use runtime::{RuntimeError, ServiceContext, service_config::BUFFER_BESIDE};

use crate::{Shared, tap::Taps};
use export::{Export, Kept};
use import::{Import, Intake};

/// The bus's side.
pub(crate) enum Split {
    Not,
    Export(Box<Export>),
    Import(Box<Import>),
}

/// The network's side.
pub(crate) enum End {
    Not,
    Export(Arc<Kept>),
    Import(Arc<Intake>),
}

impl Split {
    pub(crate) fn open(context: &ServiceContext, shared: &Arc<Shared>) -> Result<Self, RuntimeError> {
        let gateway = &context.config.launch.gateway;
        Ok(match &gateway.import {
            Some(import) => Self::Import(Box::new(Import::open(context, shared.clone(), import)?)),
            None if gateway.export.is_empty() => Self::Not,
            None => Self::Export(Box::new(Export::open(context)?)),
        })
    }

    pub(crate) fn end(&self) -> End {
        match self {
            Self::Not => End::Not,
            Self::Export(export) => End::Export(export.kept.clone()),
            Self::Import(import) => End::Import(import.intake.clone()),
        }
    }

    /// Takes what is on the bus, or publishes what has come.
    pub(crate) fn poll(&mut self, context: &ServiceContext) -> Result<(), RuntimeError> {
        match self {
            Self::Not => Ok(()),
            Self::Export(export) => export.poll(context),
            Self::Import(import) => import.poll(context),
        }
    }

    /// Sleeps until ticks have come, no longer than `limit`.
    pub(crate) fn wait(&self, taps: &Taps, limit: Duration) {
        match self {
            Self::Not => taps.wait(limit),
            Self::Export(export) => export.wait(limit),
            Self::Import(import) => import.intake.wait(limit),
        }
    }

    /// Ticks carried so far, and ticks lost for good.
    pub(crate) fn ticks_and_lost(&self) -> Option<(u64, u64)> {
        match self {
            Self::Not => None,
            Self::Export(export) => Some((export.next_tick, 0)),
            Self::Import(import) => Some((import.next_tick, import.lost)),
        }
    }

    /// Nothing more is published.
    pub(crate) fn is_finished(&self) -> bool {
        matches!(self, Self::Import(import) if import.is_finished())
    }
}

impl End {
    /// Carries, in a thread of its own, until the gateway ends.
    pub(crate) fn carry(
        &self,
        link: &Link,
        endpoints: &Endpoints,
        shared: &Arc<Shared>,
    ) -> Result<Option<JoinHandle<()>>, LinkError> {
        match self {
            Self::Not => Ok(None),
            Self::Export(kept) => kept.carry(link, shared.clone()).map(Some),
            // Ticks come from whom this gateway calls and nobody else, so they have a link that nobody can connect to.
            Self::Import(intake) => intake.carry(Link::open(&endpoints.calling())?, shared.clone()).map(Some),
        }
    }
}

/// Says from time to time how far the gateway is, as every slot does: its neighbours and its next incarnation go on from there.
struct Notes {
    checkpoints: Publisher<Checkpoint>,
    due_tick: u64,
}

impl Notes {
    fn open(context: &ServiceContext) -> Result<Self, RuntimeError> {
        Ok(Self { checkpoints: context.bus.publisher(BUFFER_BESIDE)?, due_tick: 1 })
    }

    fn publish(&mut self, context: &ServiceContext, next_tick: u64, run: u64) -> Result<(), RuntimeError> {
        if next_tick < self.due_tick {
            return Ok(());
        }
        self.due_tick = next_tick + context.config.checkpoint_ticks();
        let mut checkpoint = Checkpoint {
            next_tick,
            service: Service::Gateway as u32,
            incarnation: context.config.incarnation,
            slot_words: 1,
            ..bytemuck::Zeroable::zeroed()
        };
        checkpoint.words[0] = run;
        checkpoint.checksum = checkpoint.sum();
        Ok(self.checkpoints.send(&checkpoint)?)
    }
}

/// A number that no other run of a system has: made of the machine's start and the supervisor's.
fn run_of(supervisor_pid: u32) -> u64 {
    let read = |path: &str| fs::read_to_string(path).unwrap_or_default();
    let boot = read("/proc/sys/kernel/random/boot_id");
    let stat = read(&format!("/proc/{supervisor_pid}/stat"));
    // The name may hold anything; the start of the process is the twentieth word after it.
    let start = stat.rsplit_once(')').and_then(|(_, rest)| rest.split_whitespace().nth(19)).unwrap_or_default();
    messages::hash(messages::HASH_START, format!("{boot} {supervisor_pid} {start}").as_bytes())
}
