//! Observers: processes that read from a running system without being part of it.
//!
//! Lock files limit the number of observers, so that topics always have enough ports for services.
//! An observer neither waits for nor wakes any other process.

use std::{fs::File, rc::Rc};

use graph::Topic;
use iceoryx2::{node::Node, prelude::ipc};
use rustix::fs::{FlockOperation, flock};

use crate::{BusError, SystemName, Tap, limits::MAX_OBSERVERS, session::ObserverSession, topic};

/// Observing process of a running system.
#[derive(Debug)]
pub struct Observer {
    session: Rc<ObserverSession>,
    node: Option<Node<ipc::Service>>,
    _place: Place,
}

impl Observer {
    /// Attaches to the running system. `process_name` is the name under which its ports are listed.
    ///
    /// # Errors
    ///
    /// Fails if the system is not running or has [`MAX_OBSERVERS`] observers.
    pub fn attach(system_name: &SystemName, process_name: &str) -> Result<Self, BusError> {
        let (session, run_lock) = ObserverSession::open(system_name)?;
        let place = lock_free_place(system_name)?;
        // Frees the ports of killed observers. An error is ignored, because the supervisor also
        // frees these ports and retries.
        let _ = system_name.remove_dead_nodes();
        system_name.remove_incomplete_connections();
        let node = topic::create_node(system_name, process_name)?;
        drop(run_lock);
        Ok(Self { session: Rc::new(session), node: Some(node), _place: place })
    }

    /// Subscribes to a topic, starting with its next message.
    pub fn tap(&self, topic: Topic) -> Result<Tap, BusError> {
        let gone = || self.session.system_name().absence_error();
        let node = self.node.as_ref().ok_or_else(gone)?;
        let _lock = self.session.lock_run()?.ok_or_else(gone)?;
        if let Some(path) = self.session.system_name().incomplete_segment() {
            return Err(BusError::IncompleteSegment { name: self.session.system_name().name().into(), path });
        }
        Tap::open(node, topic, self.session.clone())
    }

    /// Returns `true` while the observed run of the system continues.
    pub fn is_running(&self) -> bool {
        self.session.is_running()
    }

    /// Returns the process identifier of the supervisor.
    pub fn owner_pid(&self) -> u32 {
        self.session.state().owner_pid()
    }
}

impl Drop for Observer {
    fn drop(&mut self) {
        self.session.release(self.node.take());
    }
}

/// Locked lock file of an observer, one of [`MAX_OBSERVERS`].
#[derive(Debug)]
struct Place(File);

impl Drop for Place {
    fn drop(&mut self) {
        // Closing the file is not sufficient: a child process that another thread has just forked
        // keeps the lock until it executes its program. An error is ignored, because the lock ends
        // when the last copy of the file is closed.
        let _ = flock(&self.0, FlockOperation::Unlock);
    }
}

/// Locks a free lock file for an observer.
fn lock_free_place(system_name: &SystemName) -> Result<Place, BusError> {
    for number in 0..MAX_OBSERVERS {
        let file = system_name.open_observer_lock(number)?;
        if flock(&file, FlockOperation::NonBlockingLockExclusive).is_ok() {
            return Ok(Place(file));
        }
    }
    Err(BusError::TooManyObservers { name: system_name.name().into(), pids: system_name.observer_pids() })
}
