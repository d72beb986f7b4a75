//! Which stage has which slot from which tick on, as the topic `event` of a flight tells it.
//!
//! Input: events in the order in which they were told. Output: the schedule by which [`Path`](crate::Path) changes stages. Time: ticks. Failure: what
//! the events of a flight do not determine is a [`Doubt`]: from its tick on the attitude may be another than in flight.

use std::collections::BTreeMap;

use launch::{Service, StageConfig};
use messages::{EventKind, SystemEvent};

/// The swaps of a flight.
#[derive(Debug, Clone, Default)]
pub struct Schedule {
    slots: BTreeMap<u32, SlotSchedule>,
    doubts: Vec<Doubt>,
    end_tick: Option<u64>,
}

/// The swaps of one slot.
#[derive(Debug, Clone, Default)]
pub(crate) struct SlotSchedule {
    /// The stages beside that of the launch file, by their numbers.
    pub(crate) fillings: BTreeMap<u32, Filling>,
    /// In the order of ticks.
    pub(crate) turns: Vec<Turn>,
}

/// A stage, and where it begins.
#[derive(Debug, Clone)]
pub(crate) struct Filling {
    pub(crate) stage: StageConfig,
    /// It goes on with the state before this tick; anew where there is none.
    pub(crate) adopted_tick: Option<u64>,
    /// Of the stage with this number.
    pub(crate) adopted_filling: u32,
    /// It began in the place of one that had ended.
    pub(crate) alone: bool,
}

/// From a tick on the slot is that of a stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Turn {
    pub(crate) from_tick: u64,
    pub(crate) filling: u32,
}

/// Something that a replay may do otherwise than the flight did.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Doubt {
    /// From this tick on.
    pub tick: u64,
    /// Why, for people.
    pub why: String,
}

impl std::fmt::Display for Doubt {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "from tick {} on the attitude may be another than in flight: {}", self.tick, self.why)
    }
}

impl Schedule {
    /// The schedule of a flight's events.
    pub fn new<'a>(events: impl IntoIterator<Item = &'a SystemEvent>) -> Self {
        let mut schedule = Self::default();
        events.into_iter().for_each(|event| schedule.take(event));
        schedule
    }

    /// What the events do not determine.
    pub fn doubts(&self) -> &[Doubt] {
        &self.doubts
    }

    /// The tick before which the flight ended, where it did so in order.
    pub fn end_tick(&self) -> Option<u64> {
        self.end_tick
    }

    /// Turns of all slots.
    pub fn turns(&self) -> usize {
        self.slots.values().map(|slot| slot.turns.len()).sum()
    }

    /// The swaps of a slot.
    pub(crate) fn of(&self, slot: Service) -> Option<&SlotSchedule> {
        self.slots.get(&(slot as u32)).filter(|slot| !slot.turns.is_empty())
    }

    fn take(&mut self, event: &SystemEvent) {
        let slot = Service::from_index(event.service);
        match (event.kind, slot) {
            (EventKind::OWNER, Some(slot)) => self.on_owner(slot, event),
            (EventKind::RESTARTED, Some(slot)) if slot.is_slot() => self.on_restarted(slot, event),
            (EventKind::LOST, _) => self.doubt(event.tick.saturating_sub(event.ticks), "ticks were lost"),
            (EventKind::NOT_RECORDED, _) => {
                self.doubt(event.tick.saturating_sub(event.ticks), "the supervisor did not take some of the attitudes");
            }
            (EventKind::FINISHED, _) => self.end_tick = Some(event.tick),
            _ => {}
        }
    }

    /// A decision counts in the place of all that are about its ticks.
    fn on_owner(&mut self, slot: Service, event: &SystemEvent) {
        if event.filling == SystemEvent::NONE_U32 {
            return self.doubt(event.tick, &format!("nobody had the slot `{slot}`"));
        }
        let last_tick = self.of(slot).and_then(|own| own.turns.last()).map(|turn| turn.from_tick);
        if last_tick.is_some_and(|last_tick| last_tick >= event.tick) {
            let why = format!("a swap of the slot `{slot}` was taken back after its first tick was told");
            self.doubt(event.tick, &why);
        }
        let own = self.slots.entry(slot as u32).or_default();
        own.turns.retain(|turn| turn.from_tick < event.tick);
        own.turns.push(Turn { from_tick: event.tick, filling: event.filling });
        if event.filling == 0 {
            return;
        }
        let Some(set) = event.settings() else {
            return self.doubt(event.tick, &format!("the settings of `{}` are not all recorded", event.stage()));
        };
        let set = set.into_iter().map(|(name, value)| (name.to_owned(), value)).collect();
        let adopted_tick = Some(event.adopted_tick).filter(|tick| *tick != SystemEvent::NONE);
        let filling = Filling {
            stage: StageConfig { stage: event.stage().into(), set },
            adopted_tick,
            adopted_filling: event.adopted_filling,
            alone: event.alone != 0,
        };
        own.fillings.insert(event.filling, filling);
        if adopted_tick.is_none() {
            self.doubt(event.tick, &format!("`{}` began anew in the slot `{slot}`", event.stage()));
        }
    }

    /// A restart changes nothing where it goes on from a state of its own.
    fn on_restarted(&mut self, slot: Service, event: &SystemEvent) {
        let anew = event.adopted_tick == SystemEvent::NONE && event.filling != 0;
        if anew || event.adopted_filling != event.filling {
            let from_tick = self.of(slot).and_then(|own| own.turns.last()).map_or(0, |turn| turn.from_tick);
            let tick = if anew { from_tick } else { event.adopted_tick };
            self.doubt(tick, &format!("the slot `{slot}` was restarted without a state of its own"));
        }
    }

    /// Notes something else that the events do not determine.
    pub fn doubt(&mut self, tick: u64, why: &str) {
        self.doubts.push(Doubt { tick, why: why.into() });
    }
}

impl SlotSchedule {
    /// Before this tick the stage with this number has to be there.
    pub(crate) fn needed_until(&self, filling: u32) -> u64 {
        let ends = self.turns.iter().skip(1).map(|next| next.from_tick).chain([u64::MAX]);
        let owns = self.turns.iter().zip(ends).filter(|(turn, _)| turn.filling == filling).map(|(_, end)| end);
        let first = self.turns.first().filter(|_| filling == 0).map(|turn| turn.from_tick);
        let adopts = self.fillings.values().filter(|other| other.adopted_filling == filling);
        let handed_on = adopts.map(|other| other.adopted_tick.unwrap_or(0).saturating_add(1));
        owns.chain(first).chain(handed_on).max().unwrap_or(0)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use super::*;

    fn owner(tick: u64, filling: u32, adopted: (u64, u32)) -> SystemEvent {
        let event = SystemEvent { tick, service: Service::Fuser as u32, ..SystemEvent::new(EventKind::OWNER) };
        event.with_instance(filling, Some(adopted.0), adopted.1, false).with_stage("vqf", [("gain", 0.1), ("fade_s", 1e-9)])
    }

    #[test]
    fn a_decision_takes_the_place_of_those_about_later_ticks() {
        // The first candidate is given up before it has the slot, the second has it, and a third after that.
        let events = [owner(90, 1, (50, 0)), owner(90, 0, (0, 0)), owner(140, 2, (100, 0)), owner(300, 3, (250, 2))];
        let schedule = Schedule::new(&events);
        let fuser = schedule.of(Service::Fuser).unwrap();
        let turns: Vec<_> = fuser.turns.iter().map(|turn| (turn.from_tick, turn.filling)).collect();
        assert_eq!(turns, [(90, 0), (140, 2), (300, 3)]);
        assert_eq!([0, 2, 3].map(|filling| fuser.needed_until(filling)), [140, 300, u64::MAX]);
        assert_eq!(fuser.fillings[&2].stage.set.iter().collect::<Vec<_>>().len(), 2);
        let doubts: Vec<_> = schedule.doubts().iter().map(|doubt| doubt.tick).collect();
        assert_eq!((doubts, schedule.of(Service::Gyro).is_none()), (vec![90], true), "who read the first is not known");
    }

    #[test]
    fn what_the_events_do_not_determine_is_told_with_its_tick() {
        let lost = SystemEvent { tick: 70, ticks: 3, ..SystemEvent::new(EventKind::LOST) };
        let mut cut = owner(90, 1, (50, 0)).with_stage("vqf", [("a".repeat(600).as_str(), 1.0)]);
        cut.tick = 91;
        let mut restarted = SystemEvent { service: Service::Fuser as u32, ..SystemEvent::new(EventKind::RESTARTED) };
        (restarted.filling, restarted.adopted_filling, restarted.adopted_tick) = (1, 0, 40);
        let schedule = Schedule::new(&[lost, cut, restarted]);
        assert_eq!(schedule.doubts().iter().map(|doubt| doubt.tick).collect::<Vec<_>>(), [67, 91, 40]);
    }
}
