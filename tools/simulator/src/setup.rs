//! What one world is like, and what befalls it: all of it drawn from the seed before it begins.

use launch::{Launch, Measure, OnLimit, Service, PromotionRule};
use runtime::Pace;

use crate::{
    flight::{RATE_HZ, MAX_TICKS, stage},
    random::Random,
};

/// What a world is like.
#[derive(Debug, Clone)]
pub(crate) struct Setup {
    /// Which flight.
    pub(crate) flight: u64,
    pub(crate) launch: Launch,
    pub(crate) ticks: u64,
    pub(crate) pace: Pace,
    /// The faults are such that no tick may be lost and no byte may differ.
    pub(crate) strict: bool,
    /// Longest time from a start to the first health, ms.
    pub(crate) start_ms: u64,
    /// Starts that fail before the first health, in a thousand.
    pub(crate) mute_per_mille: u64,
    /// Starts that hang before the first health, in a thousand.
    pub(crate) hang_per_mille: u64,
    /// Candidates that give out what is not an attitude, in a thousand.
    pub(crate) flawed_per_mille: u64,
    /// Processes that cannot be started, in a thousand.
    pub(crate) unspawned_per_mille: u64,
    /// Health and differences that are lost, in a thousand.
    pub(crate) drop_per_mille: u64,
    /// Checkpoints that are damaged on their way, in a thousand.
    pub(crate) damaged_per_mille: u64,
    /// Longest time between two turns of a service, ms.
    pub(crate) turn_ms: u64,
    pub(crate) faults: Vec<(u64, Fault)>,
}

/// What befalls a world.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Fault {
    /// A process is killed, at once or in the midst of its next turn.
    Kill { service: Service, candidate: bool, deliveries: Option<u32> },
    /// A process does nothing for so long.
    Freeze { service: Service, candidate: bool, ms: u64 },
    /// Nor does the supervisor.
    FreezeSupervisor { ms: u64 },
    /// Somebody removes the files of the bus.
    RemoveFiles,
    /// Somebody asks for a stage in a slot; as a shadow, which ends after so long.
    Swap { service: Service, stage: &'static str, shadow_ms: Option<u64>, expected_epoch: Option<u32> },
    /// Somebody ends the shadow of a slot.
    Cancel { service: Service },
    /// Somebody asks how the services are.
    Ps,
    /// The system is to end.
    End,
}

/// For so long before the end that somebody asks for nothing freezes for longer than [`SHORT_MS`], ms.
const QUIET_MS: u64 = 6000;
const SHORT_MS: u64 = 300;

/// Stages of each slot.
const STAGES: [(Service, &[&str]); 4] = [
    (Service::Gyro, &["mobius", "mobius-coning", "rk4", "euler"]),
    (Service::Accel, &["projector", "inclinometer-matrix", "inclinometer-quaternion"]),
    (Service::Fuser, &["multiple-model", "wz", "madgwick", "madgwick-improved", "levelling", "vqf", "aided"]),
    (Service::Course, &["angles", "track"]),
];

impl Setup {
    /// The world of a seed.
    pub(crate) fn new(random: &mut Random, launches: &dyn Fn(u64) -> Result<Launch, String>) -> Result<Self, String> {
        let flight = random.between(0, 3);
        let mut launch = launches(flight)?;
        let ticks = random.between(150, MAX_TICKS);
        let lockstep = random.happens(550);
        let strict = random.happens(920);
        (launch.buffer_s, launch.lateness_s) = if lockstep {
            let lateness_s = random.between(5, 20) as f64 * 0.1;
            (lateness_s + random.between(5, 30) as f64 * 0.1, lateness_s)
        } else {
            (4.0, 2.5)
        };
        let pace = if lockstep { Pace::Speed(random.pick(&[0.8, 1.5, 2.0, 4.0])) } else { Pace::Speed(1.0) };
        let Pace::Speed(speed) = pace else { return Err("no speed".into()) };
        let flight_ms = (ticks as f64 / RATE_HZ / speed * 1e3) as u64;
        if random.happens(80) {
            launch.watch.push(watch(random, &launch));
        }
        if !strict {
            launch.restart.limit = random.pick(&[1, 3, 10]);
            launch.restart.on_limit = random.pick(&[OnLimit::Stop, OnLimit::Degrade, OnLimit::Retry]);
        }
        let calm = random.happens(100);
        let often = |random: &mut Random, per_mille: u64| if calm { 0 } else { random.between(0, per_mille) };
        let mut setup = Self {
            flight,
            ticks,
            pace,
            strict,
            start_ms: random.pick(&[5, 30, 120]),
            mute_per_mille: if lockstep || !strict { often(random, 150) } else { 0 },
            hang_per_mille: if lockstep || !strict { often(random, 60) } else { 0 },
            flawed_per_mille: often(random, 150),
            unspawned_per_mille: if lockstep || !strict { often(random, 60) } else { 0 },
            drop_per_mille: often(random, 100),
            damaged_per_mille: often(random, 100),
            turn_ms: random.pick(&[2, 8, 20]),
            faults: Vec::new(),
            launch,
        };
        setup.draw_requests(random, flight_ms);
        if !calm {
            setup.draw_faults(random, flight_ms, lockstep);
            if lockstep || !strict {
                // A chance of its own: the other worlds stay as they were.
                let mut rare = Random::new(random.clone().between(0, 1 << 60));
                setup.draw_renewal_at_the_end(&mut rare);
                setup.draw_deaths_at_a_change(&mut rare);
            }
        }
        setup.end_comes_last();
        setup.faults.sort_by_key(|(at_ms, _)| *at_ms);
        Ok(setup)
    }

    fn draw_requests(&mut self, random: &mut Random, flight_ms: u64) {
        let same_kind = random.happens(400);
        for _ in 0..random.between(0, 4) {
            let at_ms = random.between(0, flight_ms);
            let (service, stages) = random.pick(&STAGES);
            let same = self.launch.stage(service).map_or("", |slot| &slot.stage);
            let same = stages.iter().find(|name| **name == same).copied().unwrap_or(stages[0]);
            let stage = if random.happens(20) {
                "wzz"
            } else if same_kind {
                same
            } else {
                random.pick(stages)
            };
            let shadow_ms = random.happens(250).then(|| random.between(50, 3000));
            let expected_epoch = random.happens(100).then(|| random.between(1, 3) as u32);
            self.faults.push((at_ms, Fault::Swap { service, stage, shadow_ms, expected_epoch }));
            // Somebody promotes the shadow, or asks for it twice.
            if random.happens(300) {
                let again = Fault::Swap { service, stage, shadow_ms: None, expected_epoch: None };
                self.faults.push((at_ms + random.between(0, 1500), again));
            }
            if random.happens(100) {
                self.faults.push((at_ms + random.between(0, 1000), Fault::Cancel { service }));
            }
        }
        if random.happens(200) {
            self.faults.push((random.between(0, flight_ms), Fault::Ps));
        }
        if random.happens(80) {
            self.faults.push((random.between(0, flight_ms), Fault::End));
        }
    }

    /// In lockstep the source waits, so anything may happen at any time. A live source does not: there one outage comes after the other.
    fn draw_faults(&mut self, random: &mut Random, flight_ms: u64, lockstep: bool) {
        let many = if self.strict && !lockstep { flight_ms / 2500 } else { 7 };
        let start_ms = random.between(0, 2000);
        for number in 0..random.between(0, many) {
            let at_ms = match lockstep || !self.strict {
                true if random.happens(500) => self.near_a_request(random, flight_ms),
                true => random.between(0, flight_ms),
                false => start_ms + number * 2500,
            };
            let service = random.pick(&Service::PATH);
            let candidate = random.happens(250);
            let fault = match random.between(0, 99) {
                0..55 => Fault::Kill {
                    service,
                    candidate,
                    deliveries: random.happens(600).then(|| random.between(0, 30) as u32),
                },
                55..80 => {
                    let ms = if random.happens(500) { random.between(1, 120) } else { random.between(100, 1500) };
                    Fault::Freeze { service, candidate, ms }
                }
                80..95 => {
                    let longest_ms = if lockstep { 3000 } else { 300 };
                    Fault::FreezeSupervisor { ms: random.between(1, longest_ms) }
                }
                _ => Fault::RemoveFiles,
            };
            self.faults.push((at_ms, fault));
        }
    }

    /// Whoever asks for the end may do so while all start on a new bus.
    fn draw_renewal_at_the_end(&mut self, random: &mut Random) {
        let Some(end_ms) = self.end_ms().filter(|_| random.happens(400)) else { return };
        let at_ms = end_ms.saturating_sub(random.between(0, self.start_ms + 20));
        let kill = Fault::Kill { service: random.pick(&Service::PATH), candidate: false, deliveries: None };
        self.faults.extend([(at_ms, Fault::RemoveFiles), (at_ms, kill)]);
    }

    /// Who had a slot may die together with who reads it.
    fn draw_deaths_at_a_change(&mut self, random: &mut Random) {
        let swaps = self.faults.iter().filter_map(|(at_ms, fault)| match fault {
            Fault::Swap { service, shadow_ms: None, .. } => Some((*at_ms, *service)),
            _ => None,
        });
        let swaps: Vec<_> = swaps.collect();
        if swaps.is_empty() || !random.happens(200) {
            return;
        }
        let (asked_ms, service) = random.pick(&swaps);
        let reader = if service == Service::Fuser { Service::Course } else { Service::Fuser };
        let at_ms = asked_ms + random.between(100, 900);
        for service in [service, reader] {
            let deliveries = random.happens(500).then(|| random.between(0, 30) as u32);
            let kill = Fault::Kill { service, candidate: false, deliveries };
            self.faults.push((at_ms + random.between(0, 300), kill));
        }
    }

    /// When somebody asks for the end first.
    fn end_ms(&self) -> Option<u64> {
        self.faults.iter().filter(|(_, fault)| *fault == Fault::End).map(|(at_ms, _)| *at_ms).min()
    }

    /// Once somebody has asked for the end, what does not come back soon is given up.
    fn end_comes_last(&mut self) {
        let Some(end_ms) = self.end_ms().filter(|_| self.strict) else { return };
        let is_short = |fault: &Fault| match fault {
            Fault::Kill { .. } | Fault::RemoveFiles | Fault::End => true,
            Fault::Freeze { ms, .. } | Fault::FreezeSupervisor { ms } => *ms < SHORT_MS,
            _ => false,
        };
        self.faults.retain(|(at_ms, fault)| is_short(fault) || at_ms + QUIET_MS < end_ms);
        (self.hang_per_mille, self.mute_per_mille, self.unspawned_per_mille) = (0, 0, 0);
    }

    /// A moment at which a swap is probably under way, or the end.
    fn near_a_request(&self, random: &mut Random, flight_ms: u64) -> u64 {
        let requests = self.faults.iter().filter(|(_, fault)| matches!(fault, Fault::Swap { .. } | Fault::End));
        let times: Vec<_> = requests.map(|(at_ms, _)| *at_ms).collect();
        if times.is_empty() {
            random.between(0, flight_ms)
        } else {
            (random.pick(&times) + random.between(0, 900)).saturating_sub(100)
        }
    }
}

fn watch(random: &mut Random, launch: &Launch) -> PromotionRule {
    let (slot, stages) = random.pick(&STAGES);
    let home = launch.stage(slot).map_or("", |slot| &slot.stage);
    let other = stages.iter().find(|name| **name != home).copied().unwrap_or(stages[0]);
    PromotionRule {
        slot,
        stage: stage(other),
        measure: Measure::Angle,
        promote_below_deg: random.between(1, 6) as f64,
        promote_after_s: 0.2,
        rollback_above_deg: 7.0,
        rollback_after_s: 0.2,
        limit: random.between(1, 3),
    }
}
