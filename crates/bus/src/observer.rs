//! Looking at a running system without being part of it.
//!
//! An observer has a seat, one of few, so that the topics always have room for it and for the services. It creates no topic, waits
//! for nobody, wakes nobody, and holds no lock for long: killed or stopped, it delays neither the system nor the next one of the
//! name. What it has on the bus carries the names of one run; when another has begun they are the other's, and are left alone.

use std::{cell::RefCell, fs::File, mem, rc::Rc};

use graph::Topic;
use iceoryx2::{
    node::{Node, NodeState, NodeView},
    prelude::{CallbackProgression, Config, ipc},
};
use rustix::fs::{FlockOperation, flock};

use crate::{BusError, Port, SystemName, Tap, page::Page, port::OBSERVERS, topic};

/// A process that looks at a running system.
#[derive(Debug)]
pub struct Observer {
    observed: Rc<ObservedRun>,
    node: Option<Node<ipc::Service>>,
    _seat: File,
}

impl Observer {
    /// Takes a seat in the system; `who` is the name under which its ports are seen.
    pub fn sit(system_name: &SystemName, who: &str) -> Result<Self, BusError> {
        let inside = system_name.step_in()?;
        if system_name.owner_pid()?.is_none() {
            return Err(system_name.absent());
        }
        let seat = seat(system_name)?;
        let page = system_name.page()?;
        // Whoever was killed in this seat: its ports are free again. What cannot be removed the supervisor tries again.
        let _ = system_name.clean();
        let node = topic::node(system_name, who)?;
        let observed = Rc::new(ObservedRun {
            run: page.run(),
            page,
            config: system_name.config(),
            system_name: system_name.clone(),
        });
        drop(inside);
        Ok(Self { observed, node: Some(node), _seat: seat })
    }

    /// Reads a topic from its next message on.
    pub fn tap(&self, topic: Topic) -> Result<Tap, BusError> {
        let gone = || self.observed.system_name.absent();
        let node = self.node.as_ref().ok_or_else(gone)?;
        let _inside = self.observed.step_in()?.ok_or_else(gone)?;
        if let Some(path) = self.observed.system_name.half_made() {
            return Err(BusError::HalfMade { name: self.observed.system_name.name().into(), path });
        }
        Tap::open(node, topic, self.observed.clone())
    }

    /// The system that was joined still runs.
    pub fn is_running(&self) -> bool {
        self.observed.is_of_this_run() && matches!(self.observed.system_name.owner_pid(), Ok(Some(_)))
    }

    /// The supervisor's process.
    pub fn owner_pid(&self) -> u32 {
        self.observed.page.owner_pid()
    }
}

impl Drop for Observer {
    fn drop(&mut self) {
        self.observed.leave(self.node.take());
    }
}

/// One run of a system, and how its observers come and go.
#[derive(Debug)]
pub(crate) struct ObservedRun {
    system_name: SystemName,
    config: Config,
    page: Page,
    run: u64,
}

impl ObservedRun {
    /// While the file is held the run cannot end in another; `None` when it has.
    fn step_in(&self) -> Result<Option<File>, BusError> {
        let inside = self.system_name.step_in()?;
        Ok(Some(inside).filter(|_| self.is_of_this_run()))
    }

    fn is_of_this_run(&self) -> bool {
        self.page.run() == self.run && self.system_name.page().is_ok_and(|page| page.run() == self.run)
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
        members(&self.system_name, &self.config)
    }
}

pub(crate) fn members(system_name: &SystemName, config: &Config) -> Result<Vec<(u128, Port)>, BusError> {
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
        name: system_name.name().into(),
        cause: format!("listing who is there: {cause:?}"),
    })?;
    Ok(found.into_inner())
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
