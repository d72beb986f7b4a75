//! The checkpoints that services are started again from.

use std::collections::VecDeque;

use launch::{Launch, Service};
use messages::Checkpoint;

use crate::Resume;

/// Checkpoints kept of each service: as far back as a topic's buffer reaches.
const KEPT: usize = 32;

/// The newest checkpoints of every service, and of who is to take over: an owner goes on from what is its own only. The room for them is
/// taken once: rooms that grew anew at every swap would leave holes between what else is kept.
#[derive(Debug)]
pub(crate) struct CheckpointStore {
    owners: [VecDeque<Checkpoint>; Service::ALL.len()],
    candidates: [VecDeque<Checkpoint>; Service::ALL.len()],
    /// The attitude that is taken next: what its slot is needed for.
    output_tick: Option<u64>,
    /// The first tick whose inputs a living process of each slot may still take: one that was started again, or beside the owner, may
    /// be behind the newest checkpoints.
    positions: [Option<u64>; Service::ALL.len()],
    /// The topics hold every tick from this one on.
    held_from: u64,
    /// The bus holds nothing of what a service has published, and the source makes all of it again: until it has said on this bus where it
    /// is.
    begins_anew: [bool; Service::ALL.len()],
    /// Who reads what each service publishes, of those that every tick passes through.
    readers: [Vec<Service>; Service::ALL.len()],
}

impl CheckpointStore {
    /// An empty one for what runs.
    pub(crate) fn new(launch: &Launch) -> Self {
        let room = |_| VecDeque::with_capacity(KEPT);
        let readers = |service: Service| service.readers().filter(|reader| launch.follows(*reader)).collect();
        Self {
            readers: Service::ALL.map(readers),
            owners: std::array::from_fn(room),
            candidates: std::array::from_fn(room),
            output_tick: None,
            positions: Default::default(),
            held_from: 0,
            begins_anew: [false; Service::ALL.len()],
        }
    }

    /// Takes a checkpoint of the slot's owner; a damaged one is left out.
    pub(crate) fn keep(&mut self, checkpoint: Checkpoint) {
        if keep(&mut self.owners, checkpoint)
            && let Some(begins_anew) = self.begins_anew.get_mut(checkpoint.service as usize)
        {
            *begins_anew = false;
        }
    }

    /// Takes one of a candidate.
    pub(crate) fn keep_candidate(&mut self, checkpoint: Checkpoint) {
        let _ = keep(&mut self.candidates, checkpoint);
    }

    /// Attitudes before this one have been taken.
    pub(crate) fn on_output(&mut self, next_tick: u64) {
        self.output_tick = Some(next_tick);
    }

    /// How far the living processes are, and from which tick on the topics hold every one.
    pub(crate) fn on_positions(&mut self, positions: [Option<u64>; Service::ALL.len()], held_from: u64) {
        (self.positions, self.held_from) = (positions, held_from);
    }

    /// Whether every service starts on a bus that holds nothing, and the source can make all of it again.
    pub(crate) fn set_begins_anew(&mut self, begins_anew: bool) {
        self.begins_anew = [begins_anew; Service::ALL.len()];
    }

    /// There is no candidate, or another one begins.
    pub(crate) fn forget_candidate(&mut self, service: Service) {
        self.candidates[service as usize].clear();
    }

    /// The candidate owns the slot. What the former owner was before stays, should the new one have to make again what that had published.
    pub(crate) fn promote(&mut self, service: Service) {
        let [owner, candidate] = [&mut self.owners, &mut self.candidates].map(|all| &mut all[service as usize]);
        self.begins_anew[service as usize] &= candidate.is_empty();
        candidate.drain(..).for_each(|checkpoint| push(owner, checkpoint));
    }

    /// From where a service goes on when it is started again: the newest state from which it says again all that its readers would need if they
    /// had to go on from their own, as far as it is its to say: before `from_tick` another process publishes.
    pub(crate) fn resume(&self, service: Service, from_tick: u64) -> Resume {
        if service == Service::Ingest {
            let newest = self.of(service).back();
            let [start_ns, offset_ns] = newest.map_or([0, 0], |newest| [newest.words[0], newest.words[1]]);
            let next_tick = self.needed_tick(service);
            return Resume::Source { next_tick, start_ns, offset_ns: offset_ns.cast_signed() };
        }
        match self.early_enough(service, self.needed_tick(service).max(from_tick)) {
            Some(checkpoint) => Resume::Checkpoint(Box::new(*checkpoint)),
            None => Resume::Fresh,
        }
    }

    /// The first tick whose inputs a service may need: where it would go on, or where a living process of it is.
    pub(crate) fn resume_tick(&self, service: Service) -> Option<u64> {
        // A gateway both reads and publishes; it goes on from its own newest state.
        let needed_tick = if service == Service::Gateway { u64::MAX } else { self.needed_tick(service) };
        let resumes_at = self.early_enough(service, needed_tick)?.next_tick;
        let promoted = self.promoted(service, needed_tick).filter(|tick| *tick >= self.held_from);
        let resumes_at = promoted.map_or(resumes_at, |promoted| promoted.min(resumes_at));
        Some(self.positions[service as usize].map_or(resumes_at, |position| position.min(resumes_at)))
    }

    /// The first tick that a reader of the service would need if it, and whoever reads it in turn, had to go on from their states.
    fn needed_tick(&self, service: Service) -> u64 {
        if service == Service::Course {
            return self.output_tick.unwrap_or(u64::MAX);
        }
        let readers = self.readers(service).iter();
        readers.map(|reader| self.resume_tick(*reader).unwrap_or(0)).min().unwrap_or(u64::MAX)
    }

    /// From where a service would go on once its candidate owned the slot: what the owner is known to have been beyond the first state of
    /// the candidate is then forgotten.
    fn promoted(&self, service: Service, needed_tick: u64) -> Option<u64> {
        let mut states = self.candidates[service as usize].iter().map(|state| state.next_tick);
        let first = states.clone().next()?;
        let own = self.of(service).iter().map(|state| state.next_tick).take_while(|tick| *tick < first);
        let early = |tick: &u64| *tick <= needed_tick;
        states.rfind(early).or_else(|| own.filter(early).last()).or(Some(first))
    }

    /// Where all are later: the oldest, for what lies before it is on the bus; from the first tick on where that has to be made anew, or
    /// where the topics hold all that it is made of, because who has published it may be gone.
    fn early_enough(&self, service: Service, needed_tick: u64) -> Option<&Checkpoint> {
        let kept = self.of(service);
        let begins_anew = self.begins_anew[service as usize] || self.held_from == 0;
        let oldest = kept.front().filter(|_| !begins_anew);
        kept.iter().rev().find(|checkpoint| checkpoint.next_tick <= needed_tick).or(oldest)
    }

    /// The newest checkpoint of a service.
    pub(crate) fn newest(&self, service: Service) -> Option<&Checkpoint> {
        self.of(service).back()
    }

    /// From where a stage goes on that is to take over.
    pub(crate) fn resume_candidate(&self, service: Service) -> Resume {
        let newest = self.newest(service);
        newest.map_or(Resume::Fresh, |checkpoint| Resume::Checkpoint(Box::new(*checkpoint)))
    }

    /// Who reads what a service publishes, of those that every tick passes through.
    pub(crate) fn readers(&self, service: Service) -> &[Service] {
        &self.readers[service as usize]
    }

    fn of(&self, service: Service) -> &VecDeque<Checkpoint> {
        &self.owners[service as usize]
    }
}

/// Whether it is kept.
fn keep(all: &mut [VecDeque<Checkpoint>], checkpoint: Checkpoint) -> bool {
    let Some(kept) = all.get_mut(checkpoint.service as usize) else { return false };
    let sound = checkpoint.checksum == checkpoint.sum();
    if sound {
        push(kept, checkpoint);
    }
    sound
}

/// A new process may be behind the one before.
fn push(kept: &mut VecDeque<Checkpoint>, checkpoint: Checkpoint) {
    while kept.back().is_some_and(|newest| newest.next_tick >= checkpoint.next_tick) || kept.len() >= KEPT {
        if kept.len() >= KEPT {
            kept.pop_front()
        } else {
            kept.pop_back()
        };
    }
    kept.push_back(checkpoint);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checkpoint(service: Service, next_tick: u64) -> Checkpoint {
        let mut checkpoint = Checkpoint { next_tick, service: service as u32, ..bytemuck::Zeroable::zeroed() };
        checkpoint.checksum = checkpoint.sum();
        checkpoint
    }

    /// One whose topics do not hold the first ticks any more.
    fn store() -> CheckpointStore {
        let mut store = CheckpointStore::new(&Launch::default());
        store.on_positions(Default::default(), 1);
        store
    }

    fn next_tick(resume: &Resume) -> Option<u64> {
        match resume {
            Resume::Checkpoint(checkpoint) => Some(checkpoint.next_tick),
            Resume::Source { next_tick, .. } => Some(*next_tick),
            Resume::Fresh => None,
        }
    }

    #[test]
    fn where_the_topics_hold_all_a_service_without_an_early_state_begins_with_the_first_tick() {
        let mut store = store();
        store.keep(checkpoint(Service::Course, 0));
        store.keep(checkpoint(Service::Fuser, 85));
        store.on_output(19);
        assert_eq!(
            next_tick(&store.resume(Service::Fuser, 0)),
            Some(85),
            "what comes before is on the bus, or nowhere"
        );
        store.on_positions(Default::default(), 0);
        assert!(matches!(store.resume(Service::Fuser, 0), Resume::Fresh), "who has published it may be gone");
        assert_eq!(next_tick(&store.resume(Service::Ingest, 0)), Some(0));
        store.keep(checkpoint(Service::Course, 90));
        store.on_output(90);
        assert_eq!(next_tick(&store.resume(Service::Fuser, 0)), Some(85));
    }

    #[test]
    fn what_inputs_are_kept_for_does_not_go_back_when_a_candidate_takes_over() {
        for ticks in [vec![45, 55], vec![55], vec![85], vec![]] {
            let mut store = store();
            (1..=8).for_each(|i| store.keep(checkpoint(Service::Course, 10 * i)));
            store.on_output(78);
            assert_eq!(store.resume_tick(Service::Course), Some(70));
            ticks.iter().for_each(|tick| store.keep_candidate(checkpoint(Service::Course, *tick)));
            let before = store.resume_tick(Service::Course);
            store.promote(Service::Course);
            assert_eq!(
                (store.resume_tick(Service::Course), before),
                (before, Some(ticks.last().map_or(70, |tick| *tick.min(&70))))
            );
        }
    }

    #[test]
    fn nobody_goes_back_for_a_candidate_whose_inputs_the_topics_do_not_hold() {
        let mut store = store();
        (1..=8).for_each(|i| store.keep(checkpoint(Service::Course, 10 * i)));
        store.keep_candidate(checkpoint(Service::Course, 25));
        assert_eq!(store.resume_tick(Service::Course), Some(25));
        store.on_positions(Default::default(), 30);
        assert_eq!(store.resume_tick(Service::Course), Some(80));
    }

    #[test]
    fn a_service_goes_on_from_where_its_readers_could_have_to() {
        let mut store = store();
        assert_eq!(next_tick(&store.resume(Service::Gyro, 0)), None);
        (1..=10).for_each(|i| store.keep(checkpoint(Service::Gyro, 10 * i)));
        store.keep(checkpoint(Service::Fuser, 75));
        store.keep(checkpoint(Service::Course, 31));
        assert_eq!(next_tick(&store.resume(Service::Gyro, 0)), Some(70));
        assert_eq!(next_tick(&store.resume(Service::Course, 0)), Some(31), "nobody goes on from what it says");
        assert_eq!(next_tick(&store.resume(Service::Ingest, 0)), Some(0), "accel has not said where it is");
    }

    #[test]
    fn on_a_bus_that_holds_nothing_what_lies_before_the_oldest_state_is_made_anew() {
        let mut store = store();
        for (service, next_tick) in
            [(Service::Gyro, 50), (Service::Accel, 20), (Service::Fuser, 30), (Service::Course, 30)]
        {
            store.keep(checkpoint(service, next_tick));
        }
        assert_eq!(next_tick(&store.resume(Service::Gyro, 0)), Some(50), "the bus holds what comes before");
        store.set_begins_anew(true);
        assert!(matches!(store.resume(Service::Gyro, 0), Resume::Fresh));
        assert_eq!(next_tick(&store.resume(Service::Accel, 0)), Some(20));
        assert_eq!(next_tick(&store.resume(Service::Ingest, 0)), Some(0));
        store.keep(checkpoint(Service::Gyro, 70));
        assert_eq!(next_tick(&store.resume(Service::Gyro, 0)), Some(50), "it has been there");
    }

    #[test]
    fn a_reader_goes_on_from_where_its_own_readers_could_have_to() {
        let mut store = store();
        for service in [Service::Gyro, Service::Accel, Service::Fuser] {
            (1..=10).for_each(|i| store.keep(checkpoint(service, 10 * i)));
        }
        store.keep(checkpoint(Service::Course, 35));
        let resumes = |service| next_tick(&store.resume(service, 0));
        assert_eq!(resumes(Service::Fuser), Some(30));
        assert_eq!(resumes(Service::Gyro), Some(30), "the fuser would go back to 30, because of the course");
        assert_eq!(resumes(Service::Ingest), Some(30));
        assert_eq!(store.resume_tick(Service::Accel), Some(30));
    }

    #[test]
    fn the_last_slot_goes_on_from_the_attitude_that_is_taken_next() {
        let mut store = store();
        (1..=10).for_each(|i| store.keep(checkpoint(Service::Course, 10 * i)));
        (1..=10).for_each(|i| store.keep(checkpoint(Service::Fuser, 10 * i)));
        store.on_output(75);
        assert_eq!(next_tick(&store.resume(Service::Course, 0)), Some(70));
        assert_eq!(next_tick(&store.resume(Service::Fuser, 0)), Some(70));
    }

    #[test]
    fn a_damaged_checkpoint_is_left_out_and_what_lies_behind_it_is_forgotten() {
        let mut store = store();
        store.keep(checkpoint(Service::Course, 10));
        store.keep(checkpoint(Service::Course, 20));
        store.keep(Checkpoint { next_tick: 30, ..checkpoint(Service::Course, 10) });
        assert_eq!(next_tick(&store.resume(Service::Course, 0)), Some(20));
        store.keep(checkpoint(Service::Course, 15));
        assert_eq!(next_tick(&store.resume(Service::Course, 0)), Some(15));
    }

    #[test]
    fn an_owner_does_not_go_on_from_what_a_candidate_of_another_kind_was() {
        let mut store = store();
        store.keep(checkpoint(Service::Course, 10));
        store.keep_candidate(checkpoint(Service::Course, 20));
        assert_eq!(next_tick(&store.resume(Service::Course, 0)), Some(10));
        store.promote(Service::Course);
        assert_eq!(next_tick(&store.resume(Service::Course, 0)), Some(20));
        store.keep_candidate(checkpoint(Service::Course, 30));
        store.forget_candidate(Service::Course);
        store.promote(Service::Course);
        assert_eq!(next_tick(&store.resume(Service::Course, 0)), Some(20));
    }

    #[test]
    fn a_new_owner_can_go_on_from_before_its_first_state_where_it_has_to_publish_that() {
        let mut store = store();
        (1..=5).for_each(|i| store.keep(checkpoint(Service::Fuser, 10 * i)));
        [45, 55, 65].into_iter().for_each(|tick| store.keep_candidate(checkpoint(Service::Fuser, tick)));
        store.promote(Service::Fuser);
        store.keep(checkpoint(Service::Course, 33));
        let resumes = |from_tick| next_tick(&store.resume(Service::Fuser, from_tick));
        assert_eq!(resumes(60), Some(55), "before 60 the former stage publishes");
        assert_eq!(resumes(0), Some(30));
    }

    #[test]
    fn no_swap_takes_or_gives_back_room() {
        let mut store = store();
        let rooms = |store: &CheckpointStore| {
            store.owners.iter().chain(&store.candidates).map(VecDeque::capacity).collect::<Vec<_>>()
        };
        let before = rooms(&store);
        for tick in 0..1000 {
            store.keep(checkpoint(Service::Gyro, tick));
            store.keep_candidate(checkpoint(Service::Gyro, tick));
            match tick % 100 {
                50 => store.forget_candidate(Service::Gyro),
                99 => store.promote(Service::Gyro),
                _ => {}
            }
        }
        store.promote(Service::Course);
        Service::ALL.into_iter().for_each(|service| store.forget_candidate(service));
        assert_eq!(rooms(&store), before);
    }

    #[test]
    fn the_number_kept_has_a_limit() {
        let mut store = store();
        (0..1000).for_each(|tick| store.keep(checkpoint(Service::Gyro, tick)));
        assert_eq!(store.of(Service::Gyro).len(), KEPT);
    }
}
