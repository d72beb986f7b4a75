//! What is done when somebody removes the files of the running system's bus.
//!
//! Who runs goes on, as its memory is still mapped; who starts finds nobody. So once somebody is to start, all start on a new bus, each
//! from its checkpoint. Whoever removes the files again and again ends the system.

use std::{collections::VecDeque, path::PathBuf, time::Duration};

use launch::Service;
use messages::{EventKind, SystemEvent};

use crate::{Action, Failure, ProcessEntry, Supervision};

/// New buses within [`WITHIN`] at most.
const RENEWALS_MAX: usize = 3;
const WITHIN: Duration = Duration::from_secs(60);

/// The new buses of a system.
#[derive(Debug, Default)]
pub(crate) struct Renewals {
    last: VecDeque<Duration>,
    /// People have been told that files are removed.
    told: bool,
    under_way: bool,
    /// A process beside an owner has just ended before it had joined.
    unjoined: bool,
}

impl Renewals {
    pub(crate) fn is_under_way(&self) -> bool {
        self.under_way
    }

    /// Somebody has ended before it had joined, until the next look at the clock.
    pub(crate) fn set_unjoined(&mut self, unjoined: bool) {
        self.unjoined = unjoined;
    }

    /// How many there were of late.
    fn recent(&mut self, now: Duration) -> usize {
        while self.last.pop_front_if(|at| *at + WITHIN < now).is_some() {}
        self.last.len()
    }
}

impl Supervision {
    /// While nobody is to be started or is just starting, only people are told.
    pub(crate) fn on_files_removed(&mut self, path: PathBuf) {
        if self.renewals.under_way {
            return;
        }
        let starts =
            |entry: &ProcessEntry| entry.due.is_some() || entry.is_starting() || entry.has_starting_candidate();
        if !self.renewals.unjoined && !self.table.entries().any(|(_, entry)| starts(entry)) {
            if !std::mem::replace(&mut self.renewals.told, true) {
                self.announce(format!(
                    "somebody removes files of this system while it runs ({}); who runs goes on, and once a service ends or is swapped all start anew. Is it \
                     logind, when its user logs out? RemoveIPC=no in /etc/systemd/logind.conf, or let a system user run it",
                    path.display()
                ));
            }
            return;
        }
        let times = self.renewals.recent(self.now) + 1;
        if times > RENEWALS_MAX {
            return self.finish(Some(Failure::RemovedAgain { path, times, within_s: WITHIN.as_secs() }));
        }
        self.renewals.last.push_back(self.now);
        (self.renewals.under_way, self.renewals.told) = (true, false);
        self.announce(format!(
            "{} was removed while the system ran, so nobody who starts can join it: every service starts anew from its checkpoint",
            path.display()
        ));
        self.abort_requests("the files of the running system were removed, and every service starts anew; ask again");
        self.table.leave_bus();
        self.leave_watches();
        self.flow.start_again();
        self.actions.push(Action::RenewBus);
    }

    /// Every service that has not failed starts from its checkpoint.
    pub(crate) fn on_bus_renewed(&mut self) {
        self.renewals.under_way = false;
        self.tell(SystemEvent::new(EventKind::BUS_RENEWED));
        // The time that it took is nobody's silence.
        self.table.stood_still(self.now);
        let launch = &self.config.launch;
        self.checkpoints
            .set_begins_anew(launch.origin() == Service::Ingest && launch.ingest.source.can_be_read_again());
        for service in launch.services.clone() {
            if !self.table.entry(service).away {
                let resume = self.checkpoints.resume(service, 0);
                self.spawn_owner(service, Some(resume));
            }
        }
        let given_up: Vec<_> = Service::SLOTS.into_iter().filter(|slot| self.swaps.beside(*slot).is_some()).collect();
        self.fill_slots();
        given_up.into_iter().for_each(|slot| self.tell_kept(slot));
        for service in Service::ALL {
            let next_tick = self.published[service as usize];
            self.notify_slot(service, swap::Event::Published { next_tick });
            if self.table.entry(service).away {
                self.notify_slot(service, swap::Event::Vacated);
            }
        }
    }
}
