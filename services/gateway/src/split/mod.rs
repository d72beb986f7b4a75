//! Split systems: the ticks of some topics are carried from one host's bus to another's.
//!
//! Input: messages on the bus of the exporting host.
//!
//! Output: the same messages, bit for bit and in tick order, on the bus of the importing host.
//!
//! Time: used only for polling and request intervals. Missing data are detected by tick numbers.
//!
//! Failure: a missing tick is requested for as long as the exporter caches it. A tick that is no
//! longer cached is counted and reported as lost.
//!
//! | module | contents |
//! | --- | --- |
//! | [`record`] | messages of one tick |
//! | [`merge`] | join of several topics into a stream of records |
//! | [`cache`] | newest records, for importers that were disconnected |
//! | [`frame`] | records in network format |
//! | [`reassembly`] | received, missing and lost ticks |
//! | [`losses`] | summaries of lost ticks |
//! | `progress` | progress as checkpoints |
//! | `export`, `import` | exporting and importing side, each between bus and network |

pub mod cache;
pub(crate) mod export;
pub mod frame;
pub(crate) mod import;
pub mod losses;
pub mod merge;
mod progress;
pub mod reassembly;
pub mod record;

use std::{sync::Arc, thread::JoinHandle, time::Duration};

use link::{Endpoints, Link, LinkError};
use runtime::{RuntimeError, ServiceContext};

use crate::{shared::Shared, tap::Taps};
use export::{Export, ExportState};
use import::{Import, ImportState};

/// Bus side of a split system, driven by the main thread.
pub(crate) enum BusSide {
    Disabled,
    Export(Box<Export>),
    Import(Box<Import>),
}

/// Network side of a split system, which runs in its own thread.
pub(crate) enum NetworkSide {
    Disabled,
    Export(Arc<ExportState>),
    Import(Arc<ImportState>),
}

impl BusSide {
    pub(crate) fn open(context: &ServiceContext, shared: &Arc<Shared>) -> Result<Self, RuntimeError> {
        let gateway = &context.config.launch.gateway;
        Ok(match &gateway.import {
            Some(import) => Self::Import(Box::new(Import::open(context, shared.clone(), import)?)),
            None if gateway.export.is_empty() => Self::Disabled,
            None => Self::Export(Box::new(Export::open(context)?)),
        })
    }

    pub(crate) fn network_side(&self) -> NetworkSide {
        match self {
            Self::Disabled => NetworkSide::Disabled,
            Self::Export(export) => NetworkSide::Export(export.state.clone()),
            Self::Import(import) => NetworkSide::Import(import.state.clone()),
        }
    }

    /// Reads the messages to be exported from the bus, or publishes the imported messages.
    pub(crate) fn poll(&mut self, context: &ServiceContext) -> Result<(), RuntimeError> {
        match self {
            Self::Disabled => Ok(()),
            Self::Export(export) => export.poll(context),
            Self::Import(import) => import.poll(context),
        }
    }

    /// Waits up to `limit` for ticks.
    pub(crate) fn wait(&self, taps: &Taps, limit: Duration) {
        match self {
            Self::Disabled => taps.wait(limit),
            Self::Export(export) => export.wait(limit),
            Self::Import(import) => import.state.wait(limit),
        }
    }

    /// Returns the numbers of carried and lost ticks, or `None` if the system is not split.
    pub(crate) fn ticks_and_lost(&self) -> Option<(u64, u64)> {
        match self {
            Self::Disabled => None,
            Self::Export(export) => Some((export.next_tick, 0)),
            Self::Import(import) => Some((import.next_tick, import.lost)),
        }
    }

    /// Returns `true` if nothing more will be published.
    pub(crate) fn is_finished(&self) -> bool {
        matches!(self, Self::Import(import) if import.is_finished())
    }
}

impl NetworkSide {
    /// Starts the thread that carries ticks until the gateway stops.
    pub(crate) fn spawn(
        &self,
        link: &Link,
        endpoints: &Endpoints,
        shared: &Arc<Shared>,
    ) -> Result<Option<JoinHandle<()>>, LinkError> {
        match self {
            Self::Disabled => Ok(None),
            Self::Export(state) => state.spawn(link, shared.clone()).map(Some),
            // Ticks are accepted only from peers that this gateway connects to. A separate link is
            // used, which accepts no incoming connections.
            Self::Import(state) => state.spawn(Link::open(&endpoints.connect_only())?, shared.clone()).map(Some),
        }
    }
}
