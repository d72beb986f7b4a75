//! The checkpoints that the services' next lives begin with.

use std::collections::VecDeque;

use launch::{Launch, Service};
use messages::Checkpoint;
use runtime::orders::{Record, Resume};

/// Checkpoints kept of each service: as far back as a topic's buffer reaches.
const KEPT: usize = 32;

/// The newest checkpoints of every service, and of who is to take over: an owner goes on from what is its own only.
#[derive(Debug, Default)]
pub(crate) struct Memory {
    owners: [VecDeque<Checkpoint>; Service::ALL.len()],
    candidates: [VecDeque<Checkpoint>; Service::ALL.len()],
}

impl Memory {
    /// Takes a checkpoint of the slot's owner; a damaged one is left out.
    pub(crate) fn keep(&mut self, checkpoint: Checkpoint) {
        keep(&mut self.owners, checkpoint);
    }

    /// Takes one of a candidate.
    pub(crate) fn keep_candidate(&mut self, checkpoint: Checkpoint) {
        keep(&mut self.candidates, checkpoint);
    }

    /// Another candidate begins.
    pub(crate) fn forget_candidate(&mut self, service: Service) {
        self.candidates[service as usize].clear();
    }

    /// The candidate owns the slot.
    pub(crate) fn promote(&mut self, service: Service) {
        let theirs = std::mem::take(&mut self.candidates[service as usize]);
        if !theirs.is_empty() {
            self.owners[service as usize] = theirs;
        }
    }

    /// From where the next life of a service goes on: the newest state from which it says again all that its readers would need if they
    /// had to go on from their own.
    pub(crate) fn resume(&self, service: Service, launch: &Launch) -> Resume {
        if service == Service::Ingest {
            let newest = self.of(service).back();
            let [start_ns, offset_ns] = newest.map_or([0, 0], |newest| [newest.words[0], newest.words[1]]);
            let next_tick = self.needed_tick(service, launch);
            return Resume::Source { next_tick, start_ns, offset_ns: offset_ns.cast_signed() };
        }
        match self.early_enough(service, self.needed_tick(service, launch)) {
            Some(checkpoint) => Resume::Checkpoint(Box::new(Record::from(checkpoint))),
            None => Resume::Fresh,
        }
    }

    /// The tick that the next life of a service would go on with.
    pub(crate) fn resume_tick(&self, service: Service, launch: &Launch) -> Option<u64> {
        // A gateway both reads and publishes; it goes on from its own newest state.
        let needed_tick = if service == Service::Gateway { u64::MAX } else { self.needed_tick(service, launch) };
        self.early_enough(service, needed_tick).map(|checkpoint| checkpoint.next_tick)
    }

    /// The first tick that a reader of the service would need if it, and whoever reads it in turn, had to go on from their states.
    fn needed_tick(&self, service: Service, launch: &Launch) -> u64 {
        let here = readers(service).iter().filter(|reader| launch.follows(**reader));
        here.map(|reader| self.resume_tick(*reader, launch).unwrap_or(0)).min().unwrap_or(u64::MAX)
    }

    fn early_enough(&self, service: Service, needed_tick: u64) -> Option<&Checkpoint> {
        let kept = self.of(service);
        kept.iter().rev().find(|checkpoint| checkpoint.next_tick <= needed_tick).or(kept.front())
    }

    /// The newest state of a service.
    pub(crate) fn last(&self, service: Service) -> Option<&Checkpoint> {
        self.of(service).back()
    }

    /// The same, for a stage that is to take over.
    pub(crate) fn newest(&self, service: Service) -> Resume {
        let newest = self.last(service);
        newest.map_or(Resume::Fresh, |checkpoint| Resume::Checkpoint(Box::new(Record::from(checkpoint))))
    }

    fn of(&self, service: Service) -> &VecDeque<Checkpoint> {
        &self.owners[service as usize]
    }
}

fn keep(all: &mut [VecDeque<Checkpoint>], checkpoint: Checkpoint) {
    let Some(kept) = all.get_mut(checkpoint.service as usize) else { return };
    if checkpoint.checksum != checkpoint.sum() {
        return;
    }
    // A new life may be behind the one before.
    while kept.back().is_some_and(|newest| newest.next_tick >= checkpoint.next_tick) || kept.len() >= KEPT {
        if kept.len() >= KEPT {
            kept.pop_front()
        } else {
            kept.pop_back()
        };
    }
    kept.push_back(checkpoint);
}

/// Who reads what a service publishes; in a split system the gateway reads for slots elsewhere, or publishes for them.
pub(crate) fn readers(service: Service) -> &'static [Service] {
    match service {
        Service::Ingest => &[Service::Gyro, Service::Accel, Service::Fuser, Service::Course, Service::Gateway],
        Service::Gyro | Service::Accel => &[Service::Fuser, Service::Gateway],
        Service::Fuser => &[Service::Course, Service::Gateway],
        Service::Gateway => &[Service::Gyro, Service::Accel, Service::Fuser, Service::Course],
        Service::Course => &[],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checkpoint(service: Service, next_tick: u64) -> Checkpoint {
        let mut checkpoint = Checkpoint { next_tick, service: service as u32, ..bytemuck::Zeroable::zeroed() };
        checkpoint.checksum = checkpoint.sum();
        checkpoint
    }

    fn next_tick(resume: &Resume) -> Option<u64> {
        match resume {
            Resume::Checkpoint(record) => record.checkpoint().map(|checkpoint| checkpoint.next_tick),
            Resume::Source { next_tick, .. } => Some(*next_tick),
            Resume::Fresh => None,
        }
    }

    #[test]
    fn a_service_goes_on_from_where_its_readers_could_have_to() {
        let mut memory = Memory::default();
        assert_eq!(next_tick(&memory.resume(Service::Gyro, &Launch::default())), None);
        (1..=10).for_each(|i| memory.keep(checkpoint(Service::Gyro, 10 * i)));
        memory.keep(checkpoint(Service::Fuser, 75));
        memory.keep(checkpoint(Service::Course, 31));
        assert_eq!(next_tick(&memory.resume(Service::Gyro, &Launch::default())), Some(70));
        assert_eq!(
            next_tick(&memory.resume(Service::Course, &Launch::default())),
            Some(31),
            "nobody goes on from what it says"
        );
        assert_eq!(
            next_tick(&memory.resume(Service::Ingest, &Launch::default())),
            Some(0),
            "accel has not said where it is"
        );
    }

    #[test]
    fn a_reader_goes_on_from_where_its_own_readers_could_have_to() {
        let mut memory = Memory::default();
        for service in [Service::Gyro, Service::Accel, Service::Fuser] {
            (1..=10).for_each(|i| memory.keep(checkpoint(service, 10 * i)));
        }
        memory.keep(checkpoint(Service::Course, 35));
        let launch = Launch::default();
        let resumes = |service| next_tick(&memory.resume(service, &launch));
        assert_eq!(resumes(Service::Fuser), Some(30));
        assert_eq!(resumes(Service::Gyro), Some(30), "the fuser would go back to 30, because of the course");
        assert_eq!(resumes(Service::Ingest), Some(30));
        assert_eq!(memory.resume_tick(Service::Accel, &launch), Some(30));
    }

    #[test]
    fn a_damaged_checkpoint_is_left_out_and_an_older_life_is_forgotten() {
        let mut memory = Memory::default();
        memory.keep(checkpoint(Service::Course, 10));
        memory.keep(checkpoint(Service::Course, 20));
        memory.keep(Checkpoint { next_tick: 30, ..checkpoint(Service::Course, 10) });
        assert_eq!(next_tick(&memory.resume(Service::Course, &Launch::default())), Some(20));
        memory.keep(checkpoint(Service::Course, 15));
        assert_eq!(next_tick(&memory.resume(Service::Course, &Launch::default())), Some(15));
    }

    #[test]
    fn an_owner_does_not_go_on_from_what_a_candidate_of_another_kind_was() {
        let mut memory = Memory::default();
        memory.keep(checkpoint(Service::Course, 10));
        memory.keep_candidate(checkpoint(Service::Course, 20));
        assert_eq!(next_tick(&memory.resume(Service::Course, &Launch::default())), Some(10));
        memory.promote(Service::Course);
        assert_eq!(next_tick(&memory.resume(Service::Course, &Launch::default())), Some(20));
        memory.keep_candidate(checkpoint(Service::Course, 30));
        memory.forget_candidate(Service::Course);
        memory.promote(Service::Course);
        assert_eq!(next_tick(&memory.resume(Service::Course, &Launch::default())), Some(20));
    }

    #[test]
    fn the_number_kept_has_a_limit() {
        let mut memory = Memory::default();
        (0..1000).for_each(|tick| memory.keep(checkpoint(Service::Gyro, tick)));
        assert_eq!(memory.of(Service::Gyro).len(), KEPT);
    }
}
