//! Session of a process that is not part of the system, bound to one run of it.
//!
//! Such a process creates no topic and holds locks only briefly, so that it delays neither the
//! system nor the next run if it is killed or stopped. Each run reuses the same resource names on
//! the bus. Once another run has started, the names belong to that run, so the process leaves the
//! resources alone.

use std::{cell::RefCell, fs::File, mem, sync::Arc};

use iceoryx2::{
    node::{Node, NodeState, NodeView},
    prelude::{CallbackProgression, Config, ipc},
};

use crate::{BusError, SystemName, shared_state::SharedState};

/// Session of an observer or a feeder, bound to one run of a system.
#[derive(Debug)]
pub(crate) struct ObserverSession {
    system_name: SystemName,
    config: Config,
    state: Arc<SharedState>,
    run: u64,
}

impl ObserverSession {
    /// Opens a session with the running system. While the returned file is held, no other run can
    /// start.
    pub(crate) fn open(system_name: &SystemName) -> Result<(Self, File), BusError> {
        let lock = system_name.lock_running()?;
        if system_name.owner_pid()?.is_none() {
            return Err(system_name.absence_error());
        }
        let state = system_name.shared_state()?;
        let (config, run) = (system_name.config(), state.run());
        Ok((Self { system_name: system_name.clone(), config, state: Arc::new(state), run }, lock))
    }

    /// Returns the shared state of the run.
    pub(crate) fn state(&self) -> &Arc<SharedState> {
        &self.state
    }

    pub(crate) fn system_name(&self) -> &SystemName {
        &self.system_name
    }

    /// Returns `true` while the run continues.
    pub(crate) fn is_running(&self) -> bool {
        self.is_current_run() && matches!(self.system_name.owner_pid(), Ok(Some(_)))
    }

    /// Prevents another run from starting while the returned file is held. Returns `None` if
    /// another run has already started.
    pub(crate) fn lock_run(&self) -> Result<Option<File>, BusError> {
        let lock = self.system_name.lock_running()?;
        Ok(Some(lock).filter(|_| self.is_current_run()))
    }

    fn is_current_run(&self) -> bool {
        self.state.run() == self.run && self.system_name.shared_state().is_ok_and(|state| state.run() == self.run)
    }

    /// Releases a port or node. If another run has started, the port or node is leaked instead,
    /// because the files with these names then belong to that run.
    pub(crate) fn release<P>(&self, port: P) {
        match self.lock_run() {
            Ok(Some(_inside)) => drop(port),
            _ => mem::forget(port),
        }
    }

    /// Returns every process on the bus with its node identifier.
    pub(crate) fn processes(&self) -> Result<Vec<(u128, Port)>, BusError> {
        list_processes(&self.system_name, &self.config)
    }
}

pub(crate) fn list_processes(system_name: &SystemName, config: &Config) -> Result<Vec<(u128, Port)>, BusError> {
    let found = RefCell::new(Vec::new());
    let mut record = |node: NodeState<ipc::Service>| {
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
    Node::<ipc::Service>::list(config, &mut record).map_err(|cause| BusError::Node {
        name: system_name.name().into(),
        cause: format!("listing processes: {cause:?}"),
    })?;
    Ok(found.into_inner())
}

/// Process connected to a topic.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Port {
    /// Name under which the process joined the bus.
    pub name: String,
    /// Process identifier; 0 if unknown.
    pub pid: u32,
    /// `false` if the process was killed or is not in the list of processes on the bus.
    pub alive: bool,
}
