//! Replaces the bus after its files were removed or damaged while the system was running.
//!
//! Running processes continue, because their memory is still mapped, but a new process cannot join
//! them. As soon as a process has to start, every service is therefore restarted from its
//! checkpoint on a new bus. Repeated faults stop the system.

use std::{path::PathBuf, time::Duration};

use launch::{Service, Slot, TickSource};
use messages::{EventKind, SystemEvent};

use crate::{Action, Failure, FileFault, ProcessEntry, Supervision};

/// Maximum number of renewals within [`RENEWAL_WINDOW`].
const MAX_RENEWALS: usize = 3;
const RENEWAL_WINDOW: Duration = Duration::from_secs(60);

impl Supervision {
    /// Starts a renewal if a process is starting or due to start. Otherwise only announces the
    /// fault.
    pub(crate) fn on_files_unusable(&mut self, path: PathBuf, fault: FileFault) {
        if self.renewals.under_way {
            return;
        }
        let is_starting =
            |entry: &ProcessEntry| entry.restart_at.is_some() || entry.is_starting() || entry.has_starting_candidate();
        if !self.renewals.join_failed && !self.table.entries().any(|(_, entry)| is_starting(entry)) {
            if !std::mem::replace(&mut self.renewals.announced, true) {
                self.announce(format!(
                    "files of the running system were {fault} ({}); running services continue, but all will restart once one of them exits or is swapped. \
                     If systemd-logind removes them at logout, set RemoveIPC=no in /etc/systemd/logind.conf or run the system as a system user",
                    foreign::path(&path)
                ));
            }
            return;
        }
        let count = self.renewals.count_recent(self.now, RENEWAL_WINDOW) + 1;
        if count > MAX_RENEWALS {
            return self.finish(Some(Failure::FilesUnusableRepeatedly {
                path,
                fault,
                count,
                within_s: RENEWAL_WINDOW.as_secs(),
            }));
        }
        self.renewals.renewals.push_back(self.now);
        (self.renewals.under_way, self.renewals.announced) = (true, false);
        self.announce(format!(
            "{} was {fault} while the system ran, so new processes cannot join: restarting every service from its checkpoint",
            foreign::path(&path)
        ));
        self.abort_requests(&format!(
            "files of the running system were {fault} and every service is restarting; retry"
        ));
        self.table.clear_processes();
        self.clear_watches();
        self.flow.restart();
        self.actions.push(Action::RenewBus);
    }

    /// Restarts every service from its checkpoint, except those that were given up.
    pub(crate) fn on_bus_renewed(&mut self) {
        self.renewals.under_way = false;
        self.publish_event(SystemEvent::new(EventKind::BUS_RENEWED));
        // The duration of the renewal does not count as silence.
        self.table.take_stall(self.now);
        let launch = &self.config.launch;
        self.checkpoints
            .set_full_replay(launch.tick_source() == TickSource::Ingest && launch.ingest.source.is_repeatable());
        for service in launch.services.clone() {
            if !self.table.entry(service).given_up {
                let resume = self.checkpoints.resume(service, 0);
                self.spawn_owner(service, Some(resume));
            }
        }
        let interrupted: Vec<_> =
            Slot::ALL.into_iter().filter(|slot| self.swaps.candidate_instance(*slot).is_some()).collect();
        self.init_slots();
        interrupted.into_iter().for_each(|slot| self.publish_owner_unchanged(slot));
        for service in Service::ALL {
            let next_tick = self.published[service as usize];
            self.notify_slot_of(service, swap::Event::Published { next_tick });
            if self.table.entry(service).given_up {
                self.notify_slot_of(service, swap::Event::Vacated);
            }
        }
    }
}
