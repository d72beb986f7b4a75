//! Reference runs: outputs of the slots in a run without faults, with the committed swaps applied.

use std::{collections::BTreeMap, sync::OnceLock};

use bytemuck::Zeroable as _;
use launch::{Launch, Slot};
use messages::{AttitudeOutput, Checkpoint, Flags, Ticked};
use runtime::{SlotProcessor, checkpoint, service_config::FIRST_EPOCH};

use crate::flight::{FLIGHT_COUNT, Flight, MAX_TICKS, config, stage};

/// Committed swap of a slot.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct CommittedSwap {
    /// Name of the new stage.
    pub(crate) stage: String,
    /// Set if the new stage differs from the previous one.
    pub(crate) changes_stage: bool,
    /// First tick after the checkpoint from which the new stage resumed.
    pub(crate) checkpoint_tick: u64,
    /// First tick that the new stage owns.
    pub(crate) from_tick: u64,
}

/// Committed swaps of each slot, in order.
pub(crate) type SwapsBySlot = BTreeMap<&'static str, Vec<CommittedSwap>>;

/// Flight and its attitudes in a run without faults and swaps.
#[derive(Debug)]
pub(crate) struct ReferenceRun {
    pub(crate) flight: Flight,
    pub(crate) attitudes: Vec<AttitudeOutput>,
}

/// Returns a flight with its attitudes. Each flight is computed once.
pub(crate) fn reference_run(number: u64) -> Result<&'static ReferenceRun, String> {
    static RUNS: [OnceLock<Result<ReferenceRun, String>>; FLIGHT_COUNT] = [const { OnceLock::new() }; FLIGHT_COUNT];
    let number = number as usize % FLIGHT_COUNT;
    let run = || {
        let flight = Flight::new(number)?;
        let attitudes = attitudes(&flight, MAX_TICKS, &BTreeMap::new())?;
        Ok(ReferenceRun { flight, attitudes })
    };
    RUNS[number].get_or_init(run).as_ref().map_err(String::clone)
}

/// Computes the attitudes of the first `ticks` ticks with the given swaps.
pub(crate) fn attitudes(flight: &Flight, ticks: u64, swaps: &SwapsBySlot) -> Result<Vec<AttitudeOutput>, String> {
    let text = |error: runtime::RuntimeError| error.to_string();
    let config_with = |slot: Slot, name: &str| {
        let mut launch: Launch = flight.launch.clone();
        *launch.stage_mut(slot) = stage(name);
        config(&launch)
    };
    let initial = config(&flight.launch);
    let swaps_of = |slot: Slot| swaps.get(slot.name()).cloned().unwrap_or_default();
    let mut gyro = SlotChain::new(slots::gyro::slot(&initial).map_err(text)?, swaps_of(Slot::Gyro));
    let mut accel = SlotChain::new(slots::accel::slot(&initial).map_err(text)?, swaps_of(Slot::Accel));
    let mut fuser = SlotChain::new(slots::fuser::slot(&initial).map_err(text)?, swaps_of(Slot::Fuser));
    let mut course = SlotChain::new(slots::course::slot(&initial).map_err(text)?, swaps_of(Slot::Course));
    let mut attitudes = Vec::new();
    for sample in flight.samples.iter().take(ticks as usize) {
        let tick = sample.imu.header.tick;
        gyro.start_candidates(tick, |name| slots::gyro::slot(&config_with(Slot::Gyro, name)).map_err(text))?;
        accel.start_candidates(tick, |name| slots::accel::slot(&config_with(Slot::Accel, name)).map_err(text))?;
        fuser.start_candidates(tick, |name| slots::fuser::slot(&config_with(Slot::Fuser, name)).map_err(text))?;
        course.start_candidates(tick, |name| slots::course::slot(&config_with(Slot::Course, name)).map_err(text))?;
        let mut fused = Vec::new();
        if let Some(fix) = sample.gnss {
            course.offer(|| fix.into(), &mut attitudes);
            fuser.offer(|| fix.into(), &mut fused);
        }
        if let Some(field) = sample.mag {
            fuser.offer(|| field.into(), &mut fused);
        }
        let (mut points, mut steps) = (Vec::new(), Vec::new());
        accel.offer(|| sample.imu, &mut points);
        gyro.offer(|| sample.imu, &mut steps);
        points.into_iter().for_each(|point| fuser.offer(|| point.into(), &mut fused));
        steps.into_iter().for_each(|step| fuser.offer(|| step.into(), &mut fused));
        fused.into_iter().for_each(|state| course.offer(|| state.into(), &mut attitudes));
    }
    Ok(attitudes.into_iter().map(Ticked::canonical).collect())
}

/// Slot with the stages that fill it one after another.
struct SlotChain<S> {
    stages: Vec<StageRun<S>>,
    swaps: Vec<CommittedSwap>,
}

struct StageRun<S> {
    slot: S,
    from_tick: u64,
    epoch: u32,
    /// Set if the next owned output is the first one after a swap to a different stage.
    swapped: bool,
}

impl<S: SlotProcessor> SlotChain<S> {
    fn new(slot: S, swaps: Vec<CommittedSwap>) -> Self {
        let first = StageRun { slot, from_tick: 0, epoch: FIRST_EPOCH, swapped: false };
        Self { stages: vec![first], swaps }
    }

    /// Starts the stages that resume from the checkpoint before `tick`.
    fn start_candidates(&mut self, tick: u64, slot_of: impl Fn(&str) -> Result<S, String>) -> Result<(), String> {
        while let Some(swap) = self.swaps.get(self.stages.len() - 1).filter(|swap| swap.checkpoint_tick == tick) {
            let Some(before) = self.stages.last_mut() else { return Ok(()) };
            let mut checkpoint = Checkpoint::zeroed();
            checkpoint::capture(&mut before.slot, 1, false, &mut checkpoint);
            let mut slot = slot_of(&swap.stage)?;
            let resumed = checkpoint::resume(&mut slot, &checkpoint).map_err(|error| error.to_string())?;
            let (from_tick, epoch) = (swap.from_tick, FIRST_EPOCH + self.stages.len() as u32);
            self.stages.push(StageRun { slot, from_tick, epoch, swapped: resumed == checkpoint::Resumed::Common });
        }
        Ok(())
    }

    /// Passes a message to all stages. For each tick, only the output of the stage that owns the
    /// tick is kept.
    fn offer(&mut self, message: impl Fn() -> S::Input, out: &mut Vec<S::Output>) {
        for number in 0..self.stages.len() {
            let end_tick = self.stages.get(number + 1).map_or(u64::MAX, |next| next.from_tick);
            let StageRun { slot, from_tick, epoch, swapped } = &mut self.stages[number];
            slot.offer(message(), &mut |mut output| {
                let header = output.header_mut();
                if (*from_tick..end_tick).contains(&header.tick) {
                    header.epoch = *epoch;
                    header.flags |= Flags::SWAPPED.when(std::mem::take(swapped));
                    out.push(output);
                }
            });
        }
    }
}
