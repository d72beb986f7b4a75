//! What people ask for, and what goes wrong.

use swap::{Event, Request, State};

use crate::{
    chance::Link,
    world::{READERS, World},
};

/// For how long a request waits for a tick, ms.
pub(crate) const PATIENCE_MS: u64 = 200;
/// As many as a request may have.
pub(crate) const ATTEMPTS_BEFORE_MAX: u32 = 2;
/// Longest time for which the supervisor does nothing, ms.
const STALL_MS: u64 = 30;

impl World {
    /// What people ask for.
    pub(crate) fn ask(&mut self) {
        if self.chance.happens(8) {
            let id = self.asked.len() as u64 + 1;
            let shadow_only = self.chance.happens(200);
            self.asked.insert(id, (self.now_ms, shadow_only));
            let until_ms = if shadow_only { u64::MAX } else { self.now_ms + PATIENCE_MS };
            let attempts_before = self.chance.between(0, ATTEMPTS_BEFORE_MAX.into()) as u32;
            self.apply(Event::Request(Request { id, stage: id.to_string(), shadow_only, until_ms, attempts_before }));
        }
        if self.chance.happens(5) {
            self.apply(Event::Promote { until_ms: self.now_ms + PATIENCE_MS });
        }
        if self.chance.happens(1) {
            self.apply(Event::Cancel);
        }
    }

    /// What goes wrong beside deaths: hangs, a supervisor that is busy, decisions that come again, readers that die.
    pub(crate) fn befall(&mut self) {
        let (chance, now_ms) = (&mut self.chance, self.now_ms);
        for process in &mut self.processes {
            if process.alive && chance.happens(self.nature.hangs_per_mille) {
                let longest_ms = if chance.happens(200) { 600 } else { 150 };
                process.hung_until_ms = now_ms + chance.between(1, longest_ms);
                if self.verbose {
                    println!("{now_ms:5} {} hangs until {}", process.incarnation, process.hung_until_ms);
                }
            }
        }
        if chance.happens(2) {
            self.stalled_until_ms = now_ms + chance.between(1, STALL_MS);
        }
        if chance.happens(10) && !self.controls.is_empty() {
            let again = self.controls[chance.between(0, self.controls.len() as u64 - 1) as usize];
            for process in &mut self.processes {
                process.controls.send(now_ms, chance, again);
            }
        }
        let index = chance.between(0, READERS as u64 - 1) as usize;
        if self.nature.readers_restart && chance.happens(4) && self.can_restart() {
            self.restart_reader(index);
        }
    }

    /// A reader that restarts finds what it lacks only at publishers that live: the deaths of a reader and of the stage that it reads
    /// from, both before hands have changed, are one fault more than the system is made for.
    fn can_restart(&self) -> bool {
        let owner = &self.processes[self.owner as usize - 1];
        !matches!(self.coordinator.state(), State::Armed { .. }) || owner.alive || owner.retired
    }

    fn restart_reader(&mut self, index: usize) {
        self.readers[index].restart(self.nature.lateness_ticks);
        for process in &mut self.processes {
            process.outlets[index] = Link::new(self.nature.outlet_ms, &mut self.chance);
            for packet in process.history.iter().filter(|_| process.alive) {
                process.outlets[index].send(self.now_ms, &mut self.chance, *packet);
            }
        }
        self.narrate(|world| format!("reader {index} restarts at {}", world.readers[index].got.len()));
    }
}
