//! A run of a system as seen by those who are no part of it.
//!
//! Whoever visits creates no topic and holds no lock for long: killed or stopped, it delays neither the system nor the next one of the name.
//! What it has on the bus carries the names of one run; when another has begun they are the other's, and are left alone.

use std::{cell::RefCell, fs::File, mem, sync::Arc};

use iceoryx2::{
    node::{Node, NodeState, NodeView},
    prelude::{CallbackProgression, Config, ipc},
};

use crate::{BusError, Port, SystemName, page::Page};

/// One run of a system, and how visitors come and go.
#[derive(Debug)]
pub(crate) struct Visit {
    system_name: SystemName,
    config: Config,
    page: Arc<Page>,
    run: u64,
}

impl Visit {
    /// Of the system that runs, and a lock to come in under.
    pub(crate) fn begin(system_name: &SystemName) -> Result<(Self, File), BusError> {
        let inside = system_name.step_in()?;
        if system_name.owner_pid()?.is_none() {
            return Err(system_name.absent());
        }
        let page = system_name.page()?;
        let (config, run) = (system_name.config(), page.run());
        Ok((Self { system_name: system_name.clone(), config, page: Arc::new(page), run }, inside))
    }

    /// The run's page.
    pub(crate) fn page(&self) -> &Arc<Page> {
        &self.page
    }

    /// The name of the system.
    pub(crate) fn system_name(&self) -> &SystemName {
        &self.system_name
    }

    /// The run goes on.
    pub(crate) fn is_running(&self) -> bool {
        self.is_of_this_run() && matches!(self.system_name.owner_pid(), Ok(Some(_)))
    }

    /// While the file is held the run cannot end in another; `None` when it has.
    pub(crate) fn step_in(&self) -> Result<Option<File>, BusError> {
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
