//! Looking at a running system without being part of it.
//!
//! An observer has a seat, one of few, so that the topics always have room for it and for the services. It creates no topic, waits
//! for nobody, wakes nobody, and holds no lock for long: killed or stopped, it delays neither the system nor the next one of the
//! name. What it has on the bus carries the names of one run; when another has begun they are the other's, and are left alone.

use std::{cell::RefCell, fs::File, mem, rc::Rc};

use iceoryx2::{
    node::{Node, NodeState, NodeView},
    prelude::{CallbackProgression, Config, ipc},
};
use rustix::fs::{FlockOperation, flock};

use crate::{BusError, Domain, Port, Tap, topic, wake::Page};

/// Observers of a system at once.
pub const OBSERVERS: usize = 4;

/// A process that looks at a running system.
#[derive(Debug)]
pub struct Observer {
    room: Rc<Room>,
    node: Option<Node<ipc::Service>>,
    _seat: File,
}

impl Observer {
    /// Takes a seat in the system; `who` is the name under which its ports are seen.
    pub fn sit(domain: &Domain, who: &str) -> Result<Self, BusError> {
        let inside = domain.step_in()?;
        if domain.owner_pid()?.is_none() {
            return Err(BusError::NotRunning { name: domain.name().into() });
        }
        let seat = seat(domain)?;
        let page = domain.page()?;
        // Whoever was killed in this seat: its ports are free again. What cannot be removed the supervisor tries again.
        let _ = domain.clean();
        let node = topic::node(domain, who)?;
        let room = Rc::new(Room { run: page.run(), page, config: domain.config(), domain: domain.clone() });
        drop(inside);
        Ok(Self { room, node: Some(node), _seat: seat })
    }

    /// Reads a topic from its next message on.
    pub fn tap(&self, topic: &str) -> Result<Tap, BusError> {
        let gone = || BusError::NotRunning { name: self.room.domain.name().into() };
        let node = self.node.as_ref().ok_or_else(gone)?;
        let _inside = self.room.step_in()?.ok_or_else(gone)?;
        if let Some(path) = self.room.domain.half_made() {
            return Err(BusError::HalfMade { name: self.room.domain.name().into(), path });
        }
        Tap::open(node, topic, self.room.clone())
    }

    /// The system that was joined still runs.
    pub fn is_running(&self) -> bool {
        self.room.is_of_this_run() && matches!(self.room.domain.owner_pid(), Ok(Some(_)))
    }

    /// The supervisor's process.
    pub fn owner_pid(&self) -> u32 {
        self.room.page.owner_pid()
    }
}

impl Drop for Observer {
    fn drop(&mut self) {
        self.room.leave(self.node.take());
    }
}

/// One run of a system, and how its observers come and go.
#[derive(Debug)]
pub(crate) struct Room {
    domain: Domain,
    config: Config,
    page: Page,
    run: u64,
}

impl Room {
    /// While the file is held the run cannot end in another; `None` when it has.
    fn step_in(&self) -> Result<Option<File>, BusError> {
        let inside = self.domain.step_in()?;
        Ok(Some(inside).filter(|_| self.is_of_this_run()))
    }

    fn is_of_this_run(&self) -> bool {
        self.page.run() == self.run && self.domain.page().is_ok_and(|page| page.run() == self.run)
    }

    /// Gives back what is on the bus. What another run has taken the names of is not touched.
    pub(crate) fn leave<P>(&self, port: P) {
        match self.step_in() {
            Ok(Some(_inside)) => drop(port),
            _ => mem::forget(port),
        }
    }

    /// Every process on the bus, by its node.
    pub(crate) fn members(&self) -> Result<Vec<(u128, Port)>, BusError> {
        members(&self.domain, &self.config)
    }
}

pub(crate) fn members(domain: &Domain, config: &Config) -> Result<Vec<(u128, Port)>, BusError> {
    let found = RefCell::new(Vec::new());
    let mut take = |node: NodeState<ipc::Service>| {
        let (details, alive) = match &node {
            NodeState::Alive(view) => (view.details(), true),
            NodeState::Dead(view) => (view.details(), false),
            NodeState::Inaccessible(_) | NodeState::Undefined(_) => (&None, true),
        };
        let name = details.as_ref().map_or_else(|| "unknown".into(), |details| details.name().to_string());
        let pid = details.as_ref().map_or(0, |details| details.process_id().value().cast_unsigned());
        found.borrow_mut().push((node.node_id().value(), Port { name, pid, alive }));
        CallbackProgression::Continue
    };
    Node::<ipc::Service>::list(config, &mut take).map_err(|cause| BusError::Node {
        name: domain.name().into(),
        cause: format!("listing who is there: {cause:?}"),
    })?;
    Ok(found.into_inner())
}

/// A free seat, held for as long as the file is.
fn seat(domain: &Domain) -> Result<File, BusError> {
    for number in 0..OBSERVERS {
        let file = domain.open_seat(number)?;
        if flock(&file, FlockOperation::NonBlockingLockExclusive).is_ok() {
            return Ok(file);
        }
    }
    Err(BusError::Crowded { name: domain.name().into(), observers: OBSERVERS })
}
