//! Reconstructs which stage owned each slot at each tick of a flight. The source is the flight's
//! `event` topic.
//!
//! Input: events in the order in which they were published.
//!
//! Output: the schedule by which [`Path`](crate::Path) changes stages.
//!
//! Time: ticks.
//!
//! Failure: if the events do not show everything that affected the attitude, the schedule has a
//! [`ReplayWarning`]. From the tick of the warning onwards, the replayed attitude may differ from
//! that of the flight.

use std::collections::BTreeMap;

use launch::{Service, Slot, StageConfig};
use messages::{EventKind, SystemEvent};

/// Stage changes of a flight.
#[derive(Debug, Clone, Default)]
pub struct Schedule {
    slots: BTreeMap<Slot, SlotSchedule>,
    warnings: Vec<ReplayWarning>,
    end_tick: Option<u64>,
}

/// Stage changes of one slot.
#[derive(Debug, Clone, Default)]
pub(crate) struct SlotSchedule {
    /// Stages other than the one in the launch file, by instance number.
    pub(crate) activations: BTreeMap<u32, StageActivation>,
    /// Changes of the owner, in tick order.
    pub(crate) owner_changes: Vec<OwnerChange>,
}

/// Stage with its initial state.
#[derive(Debug, Clone)]
pub(crate) struct StageActivation {
    pub(crate) stage: StageConfig,
    /// Tick of the checkpoint that the stage starts from; `None` for a fresh start.
    pub(crate) adopted_tick: Option<u64>,
    /// Instance that wrote the checkpoint.
    pub(crate) source_instance: u32,
    /// `true` if the stage started as owner, because the previous owner had ended.
    pub(crate) replaces_ended: bool,
}

/// Change of a slot's owner to another stage instance.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct OwnerChange {
    pub(crate) from_tick: u64,
    pub(crate) instance: u32,
}

/// Reason why a replay may differ from the flight.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ReplayWarning {
    /// First tick at which the replay may differ from the flight.
    pub tick: u64,
    /// Cause, as a text for the user.
    pub cause: String,
}

impl std::fmt::Display for ReplayWarning {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "from tick {} on the replayed attitude may differ from the flight: {}", self.tick, self.cause)
    }
}

impl Schedule {
    /// Builds the schedule from the events of a flight.
    pub fn from_events<'a>(events: impl IntoIterator<Item = &'a SystemEvent>) -> Self {
        let mut schedule = Self::default();
        events.into_iter().for_each(|event| schedule.handle(event));
        schedule
    }

    /// Returns the reasons why the replayed attitude may differ from that of the flight.
    pub fn warnings(&self) -> &[ReplayWarning] {
        &self.warnings
    }

    /// Returns the tick that follows the last tick of the flight; `None` if the end of the flight
    /// was not recorded.
    pub fn end_tick(&self) -> Option<u64> {
        self.end_tick
    }

    /// Returns the names of the stages that the flight changed to.
    pub fn stage_names(&self) -> impl Iterator<Item = &str> {
        self.slots.values().flat_map(|slot| slot.activations.values()).map(|activation| activation.stage.stage.as_str())
    }

    /// Returns the stage changes of a slot, or `None` if it kept its stage.
    pub(crate) fn slot(&self, slot: Slot) -> Option<&SlotSchedule> {
        self.slots.get(&slot).filter(|slot| !slot.owner_changes.is_empty())
    }

    fn handle(&mut self, event: &SystemEvent) {
        let slot = Service::from_index(event.service).and_then(Service::slot);
        match (event.kind, slot) {
            (EventKind::OWNER, Some(slot)) => self.on_owner(slot, event),
            (EventKind::RESTARTED, Some(slot)) => self.on_restarted(slot, event),
            (EventKind::LOST, _) => self.add_warning(event.tick.saturating_sub(event.ticks), "ticks were lost"),
            (EventKind::NOT_RECORDED, _) => {
                let tick = event.tick.saturating_sub(event.ticks);
                self.add_warning(tick, "the supervisor did not record some of the attitudes");
            }
            (EventKind::FINISHED, _) => self.end_tick = Some(event.tick),
            _ => {}
        }
    }

    /// Records an owner change, which replaces all earlier decisions about its tick and later
    /// ticks.
    fn on_owner(&mut self, slot: Slot, event: &SystemEvent) {
        if event.instance == SystemEvent::NONE_U32 {
            return self.add_warning(event.tick, &format!("the slot `{slot}` had no owner"));
        }
        let last_tick = self.slot(slot).and_then(|own| own.owner_changes.last()).map(|change| change.from_tick);
        if last_tick.is_some_and(|last_tick| last_tick >= event.tick) {
            let cause = format!("a swap of the slot `{slot}` was reverted after its first tick had been announced");
            self.add_warning(event.tick, &cause);
        }
        let schedule = self.slots.entry(slot).or_default();
        schedule.owner_changes.retain(|change| change.from_tick < event.tick);
        schedule.owner_changes.push(OwnerChange { from_tick: event.tick, instance: event.instance });
        if event.instance == 0 {
            return;
        }
        let Some(settings) = event.settings() else {
            let cause = format!("the settings of `{}` are recorded incompletely", event.stage());
            return self.add_warning(event.tick, &cause);
        };
        let set = settings.into_iter().map(|(name, value)| (name.to_owned(), value)).collect();
        let adopted_tick = Some(event.adopted_tick).filter(|tick| *tick != SystemEvent::NONE);
        let activation = StageActivation {
            stage: StageConfig { stage: event.stage().into(), set },
            adopted_tick,
            source_instance: event.adopted_instance,
            replaces_ended: event.replaces_ended != 0,
        };
        schedule.activations.insert(event.instance, activation);
        if adopted_tick.is_none() {
            let cause = format!("`{}` started in the slot `{slot}` without the state of another stage", event.stage());
            self.add_warning(event.tick, &cause);
        }
    }

    /// Records a restart and adds a warning, unless the service resumed from a checkpoint of the
    /// same instance. Such a restart does not affect the attitude.
    fn on_restarted(&mut self, slot: Slot, event: &SystemEvent) {
        let is_fresh = event.adopted_tick == SystemEvent::NONE && event.instance != 0;
        if is_fresh || event.adopted_instance != event.instance {
            let from_tick =
                self.slot(slot).and_then(|own| own.owner_changes.last()).map_or(0, |change| change.from_tick);
            let tick = if is_fresh { from_tick } else { event.adopted_tick };
            self.add_warning(tick, &format!("the slot `{slot}` was restarted without a checkpoint of its own"));
        }
    }

    /// Adds a warning about a difference that the events do not show.
    pub fn add_warning(&mut self, tick: u64, cause: &str) {
        self.warnings.push(ReplayWarning { tick, cause: cause.into() });
    }
}

impl SlotSchedule {
    /// Returns the first tick at which the stage instance is no longer needed, neither as owner nor
    /// as source of a checkpoint.
    pub(crate) fn needed_until(&self, instance: u32) -> u64 {
        let ends = self.owner_changes.iter().skip(1).map(|next| next.from_tick).chain([u64::MAX]);
        let owned = self.owner_changes.iter().zip(ends).filter(|(change, _)| change.instance == instance);
        let ownership_ends = owned.map(|(_, end)| end);
        let first = self.owner_changes.first().filter(|_| instance == 0).map(|change| change.from_tick);
        let adoptions = self.activations.values().filter(|other| other.source_instance == instance);
        let adoption_ends = adoptions.map(|other| other.adopted_tick.unwrap_or(0).saturating_add(1));
        ownership_ends.chain(first).chain(adoption_ends).max().unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn owner(tick: u64, instance: u32, adopted: (u64, u32)) -> SystemEvent {
        let event = SystemEvent { tick, service: Service::Fuser as u32, ..SystemEvent::new(EventKind::OWNER) };
        event
            .with_instance(instance, Some(adopted.0), adopted.1, false)
            .with_stage("vqf", [("gain", 0.1), ("fade_s", 1e-9)])
    }

    #[test]
    fn decision_replaces_those_about_later_ticks() {
        // The first candidate is abandoned before it owns the slot. The second becomes the owner,
        // followed later by a third.
        let events = [owner(90, 1, (50, 0)), owner(90, 0, (0, 0)), owner(140, 2, (100, 0)), owner(300, 3, (250, 2))];
        let schedule = Schedule::from_events(&events);
        let fuser = schedule.slot(Slot::Fuser).unwrap();
        let changes: Vec<_> = fuser.owner_changes.iter().map(|change| (change.from_tick, change.instance)).collect();
        assert_eq!(changes, [(90, 0), (140, 2), (300, 3)]);
        assert_eq!([0, 2, 3].map(|instance| fuser.needed_until(instance)), [140, 300, u64::MAX]);
        assert_eq!(fuser.activations[&2].stage.set.iter().collect::<Vec<_>>().len(), 2);
        let warnings: Vec<_> = schedule.warnings().iter().map(|warning| warning.tick).collect();
        assert_eq!(
            (warnings, schedule.slot(Slot::Gyro).is_none()),
            (vec![90], true),
            "the subscribers of the first decision are unknown"
        );
    }

    #[test]
    fn undetermined_events_give_warnings_with_tick() {
        let lost = SystemEvent { tick: 70, ticks: 3, ..SystemEvent::new(EventKind::LOST) };
        let mut truncated = owner(90, 1, (50, 0)).with_stage("vqf", [("a".repeat(600).as_str(), 1.0)]);
        truncated.tick = 91;
        let mut restarted = SystemEvent { service: Service::Fuser as u32, ..SystemEvent::new(EventKind::RESTARTED) };
        (restarted.instance, restarted.adopted_instance, restarted.adopted_tick) = (1, 0, 40);
        let schedule = Schedule::from_events(&[lost, truncated, restarted]);
        assert_eq!(schedule.warnings().iter().map(|warning| warning.tick).collect::<Vec<_>>(), [67, 91, 40]);
    }
}
