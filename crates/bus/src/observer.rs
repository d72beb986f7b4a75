//! Looking at a running system without being part of it.
//!
//! An observer has a seat, one of few, so that the topics always have room for it and for the services. It waits for nobody and wakes nobody.

use std::{fs::File, rc::Rc};

use graph::Topic;
use iceoryx2::{node::Node, prelude::ipc};
use rustix::fs::{FlockOperation, flock};

use crate::{BusError, SystemName, Tap, port::OBSERVERS, topic, visit::Visit};

/// A process that looks at a running system.
#[derive(Debug)]
pub struct Observer {
    visit: Rc<Visit>,
    node: Option<Node<ipc::Service>>,
    _seat: File,
}

impl Observer {
    /// Takes a seat in the system; `who` is the name under which its ports are seen.
    pub fn sit(system_name: &SystemName, who: &str) -> Result<Self, BusError> {
        let (visit, inside) = Visit::begin(system_name)?;
        let seat = seat(system_name)?;
        // Whoever was killed in this seat: its ports are free again. What cannot be removed the supervisor tries again.
        let _ = system_name.clean();
        let node = topic::node(system_name, who)?;
        drop(inside);
        Ok(Self { visit: Rc::new(visit), node: Some(node), _seat: seat })
    }

    /// Reads a topic from its next message on.
    pub fn tap(&self, topic: Topic) -> Result<Tap, BusError> {
        let gone = || self.visit.system_name().absent();
        let node = self.node.as_ref().ok_or_else(gone)?;
        let _inside = self.visit.step_in()?.ok_or_else(gone)?;
        if let Some(path) = self.visit.system_name().half_made() {
            return Err(BusError::HalfMade { name: self.visit.system_name().name().into(), path });
        }
        Tap::open(node, topic, self.visit.clone())
    }

    /// The system that was joined still runs.
    pub fn is_running(&self) -> bool {
        self.visit.is_running()
    }

    /// The supervisor's process.
    pub fn owner_pid(&self) -> u32 {
        self.visit.page().owner_pid()
    }
}

impl Drop for Observer {
    fn drop(&mut self) {
        self.visit.leave(self.node.take());
    }
}

/// A free seat, held for as long as the file is.
fn seat(system_name: &SystemName) -> Result<File, BusError> {
    for number in 0..OBSERVERS {
        let file = system_name.open_seat(number)?;
        if flock(&file, FlockOperation::NonBlockingLockExclusive).is_ok() {
            return Ok(file);
        }
    }
    Err(BusError::Crowded { name: system_name.name().into(), pids: system_name.seated() })
}
