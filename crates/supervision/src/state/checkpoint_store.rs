//! Checkpoints that services are restarted from.

use std::collections::VecDeque;

use launch::{Launch, Service};
use messages::Checkpoint;
use swap::Resume;

/// Maximum number of checkpoints kept per service. They reach as far back as a topic's buffer.
const MAX_CHECKPOINTS: usize = 32;

/// Newest checkpoints of every service and of every candidate.
///
/// An owner resumes only from its own checkpoints. A checkpoint takes 13 kB, of which it uses
/// little. Once a list is full, the oldest checkpoint is overwritten, so that few memory pages are
/// accessed. The lists are allocated once, because reallocating them at every swap would fragment
/// the heap.
#[derive(Debug)]
pub(crate) struct CheckpointStore {
    owners: [VecDeque<Box<Checkpoint>>; Service::ALL.len()],
    candidates: [VecDeque<Box<Checkpoint>>; Service::ALL.len()],
    /// Tick of the next attitude to collect. The output of the last slot on the data path is no
    /// longer needed for earlier ticks.
    output_tick: Option<u64>,
    /// For each service with a slot, the first input tick that a live process of the service may
    /// still need.
    ///
    /// A restarted process or a candidate may be behind the newest checkpoints.
    positions: [Option<u64>; Service::ALL.len()],
    /// Oldest tick that is guaranteed to stay in the topics until it is read.
    held_from: u64,
    /// For each service, `true` if it recomputes its output from the first tick on because the bus
    /// was renewed.
    ///
    /// Set if the new bus is empty and the source is repeatable. Reset by the service's first
    /// checkpoint on the new bus.
    full_replay: [bool; Service::ALL.len()],
    /// For each service, its subscribers among the services that every tick passes through.
    subscribers: [Vec<Service>; Service::ALL.len()],
}

impl CheckpointStore {
    /// Creates an empty store for the services of a launch file.
    pub(crate) fn new(launch: &Launch) -> Self {
        let empty = |_| VecDeque::with_capacity(MAX_CHECKPOINTS);
        let subscribers =
            |service: Service| service.downstream().filter(|subscriber| launch.consumes_ticks(*subscriber)).collect();
        Self {
            subscribers: Service::ALL.map(subscribers),
            owners: std::array::from_fn(empty),
            candidates: std::array::from_fn(empty),
            output_tick: None,
            positions: Default::default(),
            held_from: 0,
            full_replay: [false; Service::ALL.len()],
        }
    }

    /// Records a checkpoint of the owner. A damaged checkpoint is ignored.
    pub(crate) fn record(&mut self, checkpoint: Box<Checkpoint>) {
        let service = checkpoint.service as usize;
        if record(&mut self.owners, checkpoint)
            && let Some(full_replay) = self.full_replay.get_mut(service)
        {
            *full_replay = false;
        }
    }

    /// Records a checkpoint of the candidate. A damaged checkpoint is ignored.
    pub(crate) fn record_candidate(&mut self, checkpoint: Box<Checkpoint>) {
        let _ = record(&mut self.candidates, checkpoint);
    }

    /// Sets the tick before which all attitudes have been collected.
    pub(crate) fn on_output(&mut self, next_tick: u64) {
        self.output_tick = Some(next_tick);
    }

    /// Sets the positions of the live processes. From the tick `held_from` on, every tick is
    /// guaranteed to stay in the topics until it is read.
    pub(crate) fn on_positions(&mut self, positions: [Option<u64>; Service::ALL.len()], held_from: u64) {
        (self.positions, self.held_from) = (positions, held_from);
    }

    /// Sets whether every service recomputes its output from the first tick on. This is necessary
    /// if the bus is empty and the source is repeatable.
    pub(crate) fn set_full_replay(&mut self, full_replay: bool) {
        self.full_replay = [full_replay; Service::ALL.len()];
    }

    /// Removes the checkpoints of the candidate.
    pub(crate) fn clear_candidate(&mut self, service: Service) {
        self.candidates[service as usize].clear();
    }

    /// Makes the candidate the owner.
    ///
    /// The checkpoints of the previous owner are kept in case the new owner has to recompute its
    /// predecessor's output.
    pub(crate) fn promote(&mut self, service: Service) {
        let [owner, candidate] = [&mut self.owners, &mut self.candidates].map(|all| &mut all[service as usize]);
        self.full_replay[service as usize] &= candidate.is_empty();
        candidate.drain(..).for_each(|checkpoint| push(owner, checkpoint));
    }

    /// Returns the state that a service restarts from.
    ///
    /// This is the newest state from which the service republishes everything its subscribers would
    /// need if they restarted from their own checkpoints. Ticks before `from_tick` are published by
    /// another process.
    pub(crate) fn resume(&self, service: Service, from_tick: u64) -> Resume {
        if service == Service::Ingest {
            let newest = self.owner_checkpoints(service).back();
            let [start_ns, offset_ns] = newest.map_or([0, 0], |newest| [newest.words[0], newest.words[1]]);
            let next_tick = self.needed_tick(service);
            return Resume::Source { next_tick, start_ns, offset_ns: offset_ns.cast_signed() };
        }
        match self.checkpoint_by(service, self.needed_tick(service).max(from_tick)) {
            Some(checkpoint) => Resume::Checkpoint(Box::new(*checkpoint)),
            None => Resume::Fresh,
        }
    }

    /// Returns the first input tick that a service may need, now or after a restart.
    pub(crate) fn resume_tick(&self, service: Service) -> Option<u64> {
        // A gateway both subscribes and publishes. It resumes from its own newest state.
        let needed_tick = if service.carries_ticks() { u64::MAX } else { self.needed_tick(service) };
        let resume_tick = self.checkpoint_by(service, needed_tick)?.next_tick;
        let promoted = self.resume_tick_if_promoted(service, needed_tick).filter(|tick| *tick >= self.held_from);
        let resumes_at = promoted.map_or(resume_tick, |promoted| promoted.min(resume_tick));
        Some(self.positions[service as usize].map_or(resumes_at, |position| position.min(resumes_at)))
    }

    /// Returns the oldest tick that the downstream services would request if all of them restarted
    /// from their checkpoints.
    fn needed_tick(&self, service: Service) -> u64 {
        if service == Service::Course {
            return self.output_tick.unwrap_or(u64::MAX);
        }
        let subscribers = self.subscribers(service).iter();
        subscribers.map(|subscriber| self.resume_tick(*subscriber).unwrap_or(0)).min().unwrap_or(u64::MAX)
    }

    /// Returns the tick that a service would resume from if its candidate were promoted now.
    ///
    /// Promotion discards the owner's checkpoints that are not older than the candidate's first
    /// one.
    fn resume_tick_if_promoted(&self, service: Service, needed_tick: u64) -> Option<u64> {
        let mut states = self.candidates[service as usize].iter().map(|state| state.next_tick);
        let first = states.clone().next()?;
        let own = self.owner_checkpoints(service).iter().map(|state| state.next_tick).take_while(|tick| *tick < first);
        let is_early_enough = |tick: &u64| *tick <= needed_tick;
        states.rfind(is_early_enough).or_else(|| own.filter(is_early_enough).last()).or(Some(first))
    }

    /// Returns the newest checkpoint at or before `needed_tick`.
    ///
    /// If all checkpoints are later, returns the oldest of them, because the earlier output is on
    /// the bus. There are two exceptions, in which the result is `None`: the output has to be
    /// recomputed after a bus renewal, or the topics still hold every input. In the second case the
    /// publisher of the earlier output may have exited, and a fresh start can recompute that
    /// output.
    fn checkpoint_by(&self, service: Service, needed_tick: u64) -> Option<&Checkpoint> {
        let checkpoints = self.owner_checkpoints(service);
        let full_replay = self.full_replay[service as usize] || self.held_from == 0;
        let oldest = checkpoints.front().filter(|_| !full_replay);
        checkpoints.iter().rev().find(|checkpoint| checkpoint.next_tick <= needed_tick).or(oldest).map(Box::as_ref)
    }

    /// Returns the newest checkpoint of a service.
    pub(crate) fn newest(&self, service: Service) -> Option<&Checkpoint> {
        self.owner_checkpoints(service).back().map(Box::as_ref)
    }

    /// Returns the state that a candidate starts from.
    pub(crate) fn resume_candidate(&self, service: Service) -> Resume {
        let newest = self.newest(service);
        newest.map_or(Resume::Fresh, |checkpoint| Resume::Checkpoint(Box::new(*checkpoint)))
    }

    /// Returns the service's subscribers among the services that every tick passes through.
    pub(crate) fn subscribers(&self, service: Service) -> &[Service] {
        &self.subscribers[service as usize]
    }

    fn owner_checkpoints(&self, service: Service) -> &VecDeque<Box<Checkpoint>> {
        &self.owners[service as usize]
    }
}

/// Records a checkpoint and returns `true` if it was valid.
fn record(stores: &mut [VecDeque<Box<Checkpoint>>], checkpoint: Box<Checkpoint>) -> bool {
    let Some(checkpoints) = stores.get_mut(checkpoint.service as usize) else { return false };
    let is_valid = checkpoint.checksum == checkpoint.compute_checksum();
    if is_valid {
        push(checkpoints, checkpoint);
    }
    is_valid
}

/// Appends a checkpoint and removes all checkpoints that are not older than the new one. The
/// checkpoints of a new process that is behind its predecessor thereby replace those of the
/// predecessor.
fn push(checkpoints: &mut VecDeque<Box<Checkpoint>>, checkpoint: Box<Checkpoint>) {
    while checkpoints.back().is_some_and(|newest| newest.next_tick >= checkpoint.next_tick) {
        checkpoints.pop_back();
    }
    let oldest = if checkpoints.len() < MAX_CHECKPOINTS { None } else { checkpoints.pop_front() };
    checkpoints.push_back(match oldest {
        Some(mut oldest) => {
            oldest.replace_with(&checkpoint);
            oldest
        }
        None => checkpoint,
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checkpoint(service: Service, next_tick: u64) -> Box<Checkpoint> {
        let mut checkpoint = Checkpoint { next_tick, service: service as u32, ..bytemuck::Zeroable::zeroed() };
        checkpoint.checksum = checkpoint.compute_checksum();
        Box::new(checkpoint)
    }

    /// Creates a store for topics that no longer hold the first ticks.
    fn store() -> CheckpointStore {
        let mut store = CheckpointStore::new(&Launch::default());
        store.on_positions(Default::default(), 1);
        store
    }

    #[test]
    fn service_without_early_state_starts_fresh_if_topics_hold_all() {
        let mut store = store();
        store.record(checkpoint(Service::Course, 0));
        store.record(checkpoint(Service::Fuser, 85));
        store.on_output(19);
        assert_eq!(store.resume(Service::Fuser, 0).next_tick(), Some(85), "earlier output is on the bus or lost");
        store.on_positions(Default::default(), 0);
        assert!(
            matches!(store.resume(Service::Fuser, 0), Resume::Fresh),
            "the publisher of the earlier output may be gone"
        );
        assert_eq!(store.resume(Service::Ingest, 0).next_tick(), Some(0));
        store.record(checkpoint(Service::Course, 90));
        store.on_output(90);
        assert_eq!(store.resume(Service::Fuser, 0).next_tick(), Some(85));
    }

    #[test]
    fn promotion_does_not_move_resume_tick_back() {
        for ticks in [vec![45, 55], vec![55], vec![85], vec![]] {
            let mut store = store();
            (1..=8).for_each(|i| store.record(checkpoint(Service::Course, 10 * i)));
            store.on_output(78);
            assert_eq!(store.resume_tick(Service::Course), Some(70));
            ticks.iter().for_each(|tick| store.record_candidate(checkpoint(Service::Course, *tick)));
            let before = store.resume_tick(Service::Course);
            store.promote(Service::Course);
            assert_eq!(
                (store.resume_tick(Service::Course), before),
                (before, Some(ticks.last().map_or(70, |tick| *tick.min(&70))))
            );
        }
    }

    #[test]
    fn candidate_before_held_ticks_does_not_lower_resume_tick() {
        let mut store = store();
        (1..=8).for_each(|i| store.record(checkpoint(Service::Course, 10 * i)));
        store.record_candidate(checkpoint(Service::Course, 25));
        assert_eq!(store.resume_tick(Service::Course), Some(25));
        store.on_positions(Default::default(), 30);
        assert_eq!(store.resume_tick(Service::Course), Some(80));
    }

    #[test]
    fn service_resumes_where_its_subscribers_may_resume() {
        let mut store = store();
        assert_eq!(store.resume(Service::Gyro, 0).next_tick(), None);
        (1..=10).for_each(|i| store.record(checkpoint(Service::Gyro, 10 * i)));
        store.record(checkpoint(Service::Fuser, 75));
        store.record(checkpoint(Service::Course, 31));
        assert_eq!(store.resume(Service::Gyro, 0).next_tick(), Some(70));
        assert_eq!(store.resume(Service::Course, 0).next_tick(), Some(31), "course has no subscribers");
        assert_eq!(store.resume(Service::Ingest, 0).next_tick(), Some(0), "accel has no checkpoint");
    }

    #[test]
    fn empty_bus_replays_ticks_before_oldest_checkpoint() {
        let mut store = store();
        for (service, next_tick) in
            [(Service::Gyro, 50), (Service::Accel, 20), (Service::Fuser, 30), (Service::Course, 30)]
        {
            store.record(checkpoint(service, next_tick));
        }
        assert_eq!(store.resume(Service::Gyro, 0).next_tick(), Some(50), "the bus holds the earlier output");
        store.set_full_replay(true);
        assert!(matches!(store.resume(Service::Gyro, 0), Resume::Fresh));
        assert_eq!(store.resume(Service::Accel, 0).next_tick(), Some(20));
        assert_eq!(store.resume(Service::Ingest, 0).next_tick(), Some(0));
        store.record(checkpoint(Service::Gyro, 70));
        assert_eq!(store.resume(Service::Gyro, 0).next_tick(), Some(50), "a checkpoint on the new bus exists");
    }

    #[test]
    fn resume_tick_accounts_for_indirect_subscribers() {
        let mut store = store();
        for service in [Service::Gyro, Service::Accel, Service::Fuser] {
            (1..=10).for_each(|i| store.record(checkpoint(service, 10 * i)));
        }
        store.record(checkpoint(Service::Course, 35));
        let resumes = |service| store.resume(service, 0).next_tick();
        assert_eq!(resumes(Service::Fuser), Some(30));
        assert_eq!(resumes(Service::Gyro), Some(30), "the fuser would resume at 30 because of the course");
        assert_eq!(resumes(Service::Ingest), Some(30));
        assert_eq!(store.resume_tick(Service::Accel), Some(30));
    }

    #[test]
    fn last_slot_resumes_at_next_output_tick() {
        let mut store = store();
        (1..=10).for_each(|i| store.record(checkpoint(Service::Course, 10 * i)));
        (1..=10).for_each(|i| store.record(checkpoint(Service::Fuser, 10 * i)));
        store.on_output(75);
        assert_eq!(store.resume(Service::Course, 0).next_tick(), Some(70));
        assert_eq!(store.resume(Service::Fuser, 0).next_tick(), Some(70));
    }

    #[test]
    fn damaged_checkpoint_is_ignored_and_later_ones_are_dropped() {
        let mut store = store();
        store.record(checkpoint(Service::Course, 10));
        store.record(checkpoint(Service::Course, 20));
        store.record(Box::new(Checkpoint { next_tick: 30, ..*checkpoint(Service::Course, 10) }));
        assert_eq!(store.resume(Service::Course, 0).next_tick(), Some(20));
        store.record(checkpoint(Service::Course, 15));
        assert_eq!(store.resume(Service::Course, 0).next_tick(), Some(15));
    }

    #[test]
    fn owner_does_not_resume_from_candidate_checkpoint() {
        let mut store = store();
        store.record(checkpoint(Service::Course, 10));
        store.record_candidate(checkpoint(Service::Course, 20));
        assert_eq!(store.resume(Service::Course, 0).next_tick(), Some(10));
        store.promote(Service::Course);
        assert_eq!(store.resume(Service::Course, 0).next_tick(), Some(20));
        store.record_candidate(checkpoint(Service::Course, 30));
        store.clear_candidate(Service::Course);
        store.promote(Service::Course);
        assert_eq!(store.resume(Service::Course, 0).next_tick(), Some(20));
    }

    #[test]
    fn new_owner_may_resume_from_predecessor_checkpoint() {
        let mut store = store();
        (1..=5).for_each(|i| store.record(checkpoint(Service::Fuser, 10 * i)));
        [45, 55, 65].into_iter().for_each(|tick| store.record_candidate(checkpoint(Service::Fuser, tick)));
        store.promote(Service::Fuser);
        store.record(checkpoint(Service::Course, 33));
        let resumes = |from_tick| store.resume(Service::Fuser, from_tick).next_tick();
        assert_eq!(resumes(60), Some(55), "the previous stage publishes the ticks before 60");
        assert_eq!(resumes(0), Some(30));
    }

    #[test]
    fn swaps_do_not_reallocate() {
        let mut store = store();
        let capacities = |store: &CheckpointStore| {
            store.owners.iter().chain(&store.candidates).map(VecDeque::capacity).collect::<Vec<_>>()
        };
        let before = capacities(&store);
        for tick in 0..1000 {
            store.record(checkpoint(Service::Gyro, tick));
            store.record_candidate(checkpoint(Service::Gyro, tick));
            match tick % 100 {
                50 => store.clear_candidate(Service::Gyro),
                99 => store.promote(Service::Gyro),
                _ => {}
            }
        }
        store.promote(Service::Course);
        Service::ALL.into_iter().for_each(|service| store.clear_candidate(service));
        assert_eq!(capacities(&store), before);
    }

    #[test]
    fn number_of_checkpoints_is_bounded() {
        let mut store = store();
        (0..1000).for_each(|tick| store.record(checkpoint(Service::Gyro, tick)));
        let ticks = |store: &CheckpointStore| {
            let checkpoints = store.owner_checkpoints(Service::Gyro);
            checkpoints.iter().map(|checkpoint| checkpoint.next_tick).collect::<Vec<_>>()
        };
        let newest = 1000 - MAX_CHECKPOINTS as u64..1000;
        assert_eq!(ticks(&store), newest.clone().collect::<Vec<_>>());
        store.record(checkpoint(Service::Gyro, 998));
        assert_eq!(ticks(&store), (newest.start..999).collect::<Vec<_>>());
    }
}
