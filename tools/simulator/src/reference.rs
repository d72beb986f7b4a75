//! What the slots make of a flight when nothing disturbs them, with the swaps that were committed.

use std::{collections::BTreeMap, sync::OnceLock};

use launch::{Launch, Service};
use messages::{AttitudeOutput, Flags, Ticked};
use runtime::{Slot, checkpoint, service_config::FIRST_EPOCH};

use crate::flight::{FLIGHTS, Flight, MAX_TICKS, config, stage};

/// A swap that was committed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Committed {
    /// The new stage.
    pub(crate) stage: String,
    /// It is another than before.
    pub(crate) other: bool,
    /// The tick of the checkpoint of the former stage that it began with.
    pub(crate) checkpoint_tick: u64,
    /// Its first tick.
    pub(crate) from_tick: u64,
}

/// The swaps of each slot, in their order.
pub(crate) type Swaps = BTreeMap<&'static str, Vec<Committed>>;

/// A flight, and what comes of it when nothing disturbs it.
#[derive(Debug)]
pub(crate) struct Undisturbed {
    pub(crate) flight: Flight,
    pub(crate) attitudes: Vec<AttitudeOutput>,
}

/// One of the flights; each is made once.
pub(crate) fn undisturbed(number: u64) -> Result<&'static Undisturbed, String> {
    static FLOWN: [OnceLock<Result<Undisturbed, String>>; FLIGHTS] = [const { OnceLock::new() }; FLIGHTS];
    let number = number as usize % FLIGHTS;
    let fly = || {
        let flight = Flight::new(number)?;
        let attitudes = attitudes(&flight, MAX_TICKS, &BTreeMap::new())?;
        Ok(Undisturbed { flight, attitudes })
    };
    FLOWN[number].get_or_init(fly).as_ref().map_err(String::clone)
}

/// The attitudes of the first ticks.
pub(crate) fn attitudes(flight: &Flight, ticks: u64, swaps: &Swaps) -> Result<Vec<AttitudeOutput>, String> {
    let text = |error: runtime::RuntimeError| error.to_string();
    let with = |service: Service, name: &str| {
        let mut launch: Launch = flight.launch.clone();
        if let Some(slot) = launch.stage_mut(service) {
            *slot = stage(name);
        }
        config(&launch)
    };
    let own = config(&flight.launch);
    let of = |service: Service| swaps.get(service.name()).cloned().unwrap_or_default();
    let mut gyro = Lane::new(Service::Gyro, gyro::slot(&own).map_err(text)?, of(Service::Gyro));
    let mut accel = Lane::new(Service::Accel, accel::slot(&own).map_err(text)?, of(Service::Accel));
    let mut fuser = Lane::new(Service::Fuser, fuser::slot(&own).map_err(text)?, of(Service::Fuser));
    let mut course = Lane::new(Service::Course, course::slot(&own).map_err(text)?, of(Service::Course));
    let mut attitudes = Vec::new();
    for sample in flight.samples.iter().take(ticks as usize) {
        let tick = sample.imu.header.tick;
        gyro.begin_candidates(tick, |name| gyro::slot(&with(Service::Gyro, name)).map_err(text))?;
        accel.begin_candidates(tick, |name| accel::slot(&with(Service::Accel, name)).map_err(text))?;
        fuser.begin_candidates(tick, |name| fuser::slot(&with(Service::Fuser, name)).map_err(text))?;
        course.begin_candidates(tick, |name| course::slot(&with(Service::Course, name)).map_err(text))?;
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

/// One slot with the stages that fill it one after the other.
struct Lane<S> {
    service: Service,
    stages: Vec<Running<S>>,
    swaps: Vec<Committed>,
}

struct Running<S> {
    slot: S,
    from_tick: u64,
    epoch: u32,
    /// Its next output is the first that is another stage's than before.
    swapped: bool,
}

impl<S: Slot> Lane<S> {
    fn new(service: Service, slot: S, swaps: Vec<Committed>) -> Self {
        let first = Running { slot, from_tick: 0, epoch: FIRST_EPOCH, swapped: false };
        Self { service, stages: vec![first], swaps }
    }

    /// Starts the stages whose checkpoint is the state before this tick.
    fn begin_candidates(&mut self, tick: u64, named: impl Fn(&str) -> Result<S, String>) -> Result<(), String> {
        while let Some(swap) = self.swaps.get(self.stages.len() - 1).filter(|swap| swap.checkpoint_tick == tick) {
            let Some(before) = self.stages.last_mut() else { return Ok(()) };
            let checkpoint = checkpoint::capture(&mut before.slot, self.service, 1, false);
            let mut slot = named(&swap.stage)?;
            let resumed =
                checkpoint::resume(&mut slot, self.service, &checkpoint).map_err(|error| error.to_string())?;
            let (from_tick, epoch) = (swap.from_tick, FIRST_EPOCH + self.stages.len() as u32);
            self.stages.push(Running { slot, from_tick, epoch, swapped: resumed == checkpoint::Resumed::Common });
        }
        Ok(())
    }

    /// Offers a message to all stages; the output of each tick is that of the last one that owns it.
    fn offer(&mut self, message: impl Fn() -> S::Input, out: &mut Vec<S::Output>) {
        for number in 0..self.stages.len() {
            let until = self.stages.get(number + 1).map_or(u64::MAX, |next| next.from_tick);
            let Running { slot, from_tick, epoch, swapped } = &mut self.stages[number];
            slot.offer(message(), &mut |mut output| {
                let header = output.header_mut();
                if (*from_tick..until).contains(&header.tick) {
                    header.epoch = *epoch;
                    header.flags |= Flags::SWAPPED.when(std::mem::take(swapped));
                    out.push(output);
                }
            });
        }
    }
}
