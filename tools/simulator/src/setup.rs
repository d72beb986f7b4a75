//! Setup of a run: its properties and faults, all derived from the seed before the run starts.

use launch::{Launch, Measure, OnLimit, PromotionRule, Service, Slot};
use runtime::Pace;

use crate::{
    flight::{MAX_TICKS, RATE_HZ, stage},
    random::Random,
};

/// Properties and faults of a run.
#[derive(Debug, Clone)]
pub(crate) struct Setup {
    /// Number that selects the flight.
    pub(crate) flight: u64,
    pub(crate) launch: Launch,
    pub(crate) ticks: u64,
    pub(crate) pace: Pace,
    /// Set if the run must lose no tick and must produce the same output bytes as without its
    /// faults.
    pub(crate) strict: bool,
    /// Maximum time from the start of a process to its first poll, ms.
    pub(crate) max_start_ms: u64,
    /// Share of started processes that exit before their first health message, per mille.
    pub(crate) failed_start_per_mille: u64,
    /// Share of started processes that hang before their first health message, per mille.
    pub(crate) hung_start_per_mille: u64,
    /// Share of candidates that report invalid outputs, per mille.
    pub(crate) invalid_output_per_mille: u64,
    /// Share of processes that cannot be spawned, per mille.
    pub(crate) spawn_failure_per_mille: u64,
    /// Share of health and difference messages that are lost, per mille.
    pub(crate) lost_report_per_mille: u64,
    /// Share of checkpoints that are damaged in transit, per mille.
    pub(crate) damaged_checkpoint_per_mille: u64,
    /// Maximum time between two polls of a service, ms.
    pub(crate) max_poll_interval_ms: u64,
    /// Faults and requests with their times, ms.
    pub(crate) faults: Vec<(u64, Fault)>,
}

/// Fault of the system, or request of a client.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Fault {
    /// Kills a process, immediately or during its next poll.
    Kill { service: Service, candidate: bool, deliveries_left: Option<u32> },
    /// Suspends a process for `ms`.
    Freeze { service: Service, candidate: bool, ms: u64 },
    /// Suspends the supervisor for `ms`.
    FreezeSupervisor { ms: u64 },
    /// Removes the files of the bus.
    RemoveFiles,
    /// Damages the files of the bus, which kills a process that has one of them mapped.
    DamageFiles { service: Service, deliveries_left: u32 },
    /// Requests a stage for a slot. If `shadow_ms` is given, the stage runs as a shadow that ends
    /// after this time.
    Swap { slot: Slot, stage: &'static str, shadow_ms: Option<u64>, expected_epoch: Option<u32> },
    /// Requests the end of a slot's shadow.
    Cancel { slot: Slot },
    /// Requests the status of the services.
    Status,
    /// Stops the system.
    Stop,
}

/// Time in ms before a stop in which there are no requests and no long freezes.
const QUIET_BEFORE_STOP_MS: u64 = 6000;
/// Minimum duration of a long freeze, ms.
const LONG_FREEZE_MS: u64 = 300;

/// Stages of each slot that clients may request.
const STAGES: [(Slot, &[&str]); Slot::ALL.len()] = [
    (Slot::Gyro, &["mobius", "mobius-coning", "rk4", "euler"]),
    (Slot::Accel, &["projector", "inclinometer-matrix", "inclinometer-quaternion"]),
    (Slot::Fuser, &["multiple-model", "wz", "madgwick", "madgwick-improved", "levelling", "vqf", "aided"]),
    (Slot::Course, &["angles", "track"]),
];

impl Setup {
    /// Derives the setup of a run from its seed.
    pub(crate) fn new(random: &mut Random, launches: &dyn Fn(u64) -> Result<Launch, String>) -> Result<Self, String> {
        let flight = random.between(0, 3);
        let mut launch = launches(flight)?;
        let ticks = random.between(150, MAX_TICKS);
        let lockstep = random.chance(550);
        let strict = random.chance(920);
        (launch.buffer_s, launch.lateness_s) = if lockstep {
            let lateness_s = random.between(5, 20) as f64 * 0.1;
            (lateness_s + random.between(5, 30) as f64 * 0.1, lateness_s)
        } else {
            (4.0, 2.5)
        };
        let pace = if lockstep { Pace::Speed(random.pick(&[0.8, 1.5, 2.0, 4.0])) } else { Pace::Speed(1.0) };
        let Pace::Speed(speed) = pace else { return Err("no speed".into()) };
        let flight_ms = (ticks as f64 / RATE_HZ / speed * 1e3) as u64;
        if random.chance(80) {
            launch.watch.push(promotion_rule(random, &launch));
        }
        if !strict {
            launch.restart.limit = random.pick(&[1, 3, 10]);
            launch.restart.on_limit = random.pick(&[OnLimit::Stop, OnLimit::Degrade, OnLimit::Retry]);
        }
        let calm = random.chance(100);
        let up_to = |random: &mut Random, per_mille: u64| if calm { 0 } else { random.between(0, per_mille) };
        let mut setup = Self {
            flight,
            ticks,
            pace,
            strict,
            max_start_ms: random.pick(&[5, 30, 120]),
            failed_start_per_mille: if lockstep || !strict { up_to(random, 150) } else { 0 },
            hung_start_per_mille: if lockstep || !strict { up_to(random, 60) } else { 0 },
            invalid_output_per_mille: up_to(random, 150),
            spawn_failure_per_mille: if lockstep || !strict { up_to(random, 60) } else { 0 },
            lost_report_per_mille: up_to(random, 100),
            damaged_checkpoint_per_mille: up_to(random, 100),
            max_poll_interval_ms: random.pick(&[2, 8, 20]),
            faults: Vec::new(),
            launch,
        };
        setup.add_requests(random, flight_ms);
        if !calm {
            setup.add_faults(random, flight_ms, lockstep);
            if lockstep || !strict {
                // The rare faults use a separate generator, so that they do not affect any other
                // random choice.
                let mut rare = Random::new(random.clone().between(0, 1 << 60));
                setup.add_renewal_at_stop(&mut rare);
                setup.add_kills_at_owner_change(&mut rare);
            }
        }
        setup.drop_long_faults_before_stop();
        setup.faults.sort_by_key(|(at_ms, _)| *at_ms);
        Ok(setup)
    }

    fn add_requests(&mut self, random: &mut Random, flight_ms: u64) {
        let same_kind = random.chance(400);
        for _ in 0..random.between(0, 4) {
            let at_ms = random.between(0, flight_ms);
            let (slot, stages) = random.pick(&STAGES);
            let same = &self.launch.stage(slot).stage;
            let same = stages.iter().find(|name| **name == same).copied().unwrap_or(stages[0]);
            let stage = if random.chance(20) {
                "wzz"
            } else if same_kind {
                same
            } else {
                random.pick(stages)
            };
            let shadow_ms = random.chance(250).then(|| random.between(50, 3000));
            let expected_epoch = random.chance(100).then(|| random.between(1, 3) as u32);
            self.faults.push((at_ms, Fault::Swap { slot, stage, shadow_ms, expected_epoch }));
            // A later request asks for the same stage without a shadow. It promotes an existing
            // shadow or repeats the first request.
            if random.chance(300) {
                let again = Fault::Swap { slot, stage, shadow_ms: None, expected_epoch: None };
                self.faults.push((at_ms + random.between(0, 1500), again));
            }
            if random.chance(100) {
                self.faults.push((at_ms + random.between(0, 1000), Fault::Cancel { slot }));
            }
        }
        if random.chance(200) {
            self.faults.push((random.between(0, flight_ms), Fault::Status));
        }
        if random.chance(80) {
            self.faults.push((random.between(0, flight_ms), Fault::Stop));
        }
    }

    /// Adds faults.
    ///
    /// In lockstep the source waits, so faults may occur at any time. A live source does not wait.
    /// In a strict live run, each fault therefore ends before the next one starts.
    fn add_faults(&mut self, random: &mut Random, flight_ms: u64, lockstep: bool) {
        let max_faults = if self.strict && !lockstep { flight_ms / 2500 } else { 7 };
        let first_ms = random.between(0, 2000);
        for number in 0..random.between(0, max_faults) {
            let at_ms = match lockstep || !self.strict {
                true if random.chance(500) => self.time_near_request(random, flight_ms),
                true => random.between(0, flight_ms),
                false => first_ms + number * 2500,
            };
            let service = random.pick(&Service::PATH);
            let candidate = random.chance(250);
            let fault = match random.between(0, 99) {
                0..55 => Fault::Kill {
                    service,
                    candidate,
                    deliveries_left: random.chance(600).then(|| random.between(0, 30) as u32),
                },
                55..80 => {
                    let ms = if random.chance(500) { random.between(1, 120) } else { random.between(100, 1500) };
                    Fault::Freeze { service, candidate, ms }
                }
                80..95 => {
                    let longest_ms = if lockstep { 3000 } else { 300 };
                    Fault::FreezeSupervisor { ms: random.between(1, longest_ms) }
                }
                _ => file_fault(random),
            };
            self.faults.push((at_ms, fault));
        }
    }

    /// Adds a fault in the bus files shortly before a stop, so that the stop arrives during the
    /// restart.
    fn add_renewal_at_stop(&mut self, random: &mut Random) {
        let Some(stop_ms) = self.stop_ms().filter(|_| random.chance(400)) else { return };
        let at_ms = stop_ms.saturating_sub(random.between(0, self.max_start_ms + 20));
        let kill = Fault::Kill { service: random.pick(&Service::PATH), candidate: false, deliveries_left: None };
        self.faults.extend([(at_ms, file_fault(random)), (at_ms, kill)]);
    }

    /// Adds two kills at about the time of a swap. One kills the owner of the slot, the other one
    /// kills a subscriber of the slot; for the course, the publisher of its input.
    fn add_kills_at_owner_change(&mut self, random: &mut Random) {
        let swaps = self.faults.iter().filter_map(|(at_ms, fault)| match fault {
            Fault::Swap { slot, shadow_ms: None, .. } => Some((*at_ms, *slot)),
            _ => None,
        });
        let swaps: Vec<_> = swaps.collect();
        if swaps.is_empty() || !random.chance(200) {
            return;
        }
        let (request_ms, slot) = random.pick(&swaps);
        let neighbour = match slot {
            Slot::Gyro | Slot::Accel | Slot::Course => Service::Fuser,
            Slot::Fuser => Service::Course,
        };
        let at_ms = request_ms + random.between(100, 900);
        for service in [slot.into(), neighbour] {
            let deliveries_left = random.chance(500).then(|| random.between(0, 30) as u32);
            let kill = Fault::Kill { service, candidate: false, deliveries_left };
            self.faults.push((at_ms + random.between(0, 300), kill));
        }
    }

    /// Returns the time of the first stop request, ms.
    fn stop_ms(&self) -> Option<u64> {
        self.faults.iter().filter(|(_, fault)| *fault == Fault::Stop).map(|(at_ms, _)| *at_ms).min()
    }

    /// Removes the requests and long faults that occur shortly before a stop.
    ///
    /// After a stop request, the supervisor gives up on services that do not respond soon.
    fn drop_long_faults_before_stop(&mut self) {
        let Some(stop_ms) = self.stop_ms().filter(|_| self.strict) else { return };
        let is_short = |fault: &Fault| match fault {
            Fault::Kill { .. } | Fault::RemoveFiles | Fault::DamageFiles { .. } | Fault::Stop => true,
            Fault::Freeze { ms, .. } | Fault::FreezeSupervisor { ms } => *ms < LONG_FREEZE_MS,
            _ => false,
        };
        self.faults.retain(|(at_ms, fault)| is_short(fault) || at_ms + QUIET_BEFORE_STOP_MS < stop_ms);
        (self.hung_start_per_mille, self.failed_start_per_mille, self.spawn_failure_per_mille) = (0, 0, 0);
    }

    /// Returns a time in ms at which a swap or a stop is probably in progress.
    fn time_near_request(&self, random: &mut Random, flight_ms: u64) -> u64 {
        let requests = self.faults.iter().filter(|(_, fault)| matches!(fault, Fault::Swap { .. } | Fault::Stop));
        let times: Vec<_> = requests.map(|(at_ms, _)| *at_ms).collect();
        if times.is_empty() {
            random.between(0, flight_ms)
        } else {
            (random.pick(&times) + random.between(0, 900)).saturating_sub(100)
        }
    }
}

/// Returns a random fault of the bus files. Uses a copy of the generator, so that later random
/// choices do not depend on the fault.
fn file_fault(random: &Random) -> Fault {
    let mut random = random.clone();
    if random.chance(500) {
        return Fault::RemoveFiles;
    }
    Fault::DamageFiles { service: random.pick(&Service::PATH), deliveries_left: random.between(0, 30) as u32 }
}

fn promotion_rule(random: &mut Random, launch: &Launch) -> PromotionRule {
    let (slot, stages) = random.pick(&STAGES);
    let current = &launch.stage(slot).stage;
    let another = stages.iter().find(|name| **name != current).copied().unwrap_or(stages[0]);
    PromotionRule {
        slot,
        stage: stage(another),
        measure: Measure::Angle,
        promote_below_deg: random.between(1, 6) as f64,
        promote_after_s: 0.2,
        rollback_above_deg: 7.0,
        rollback_after_s: 0.2,
        limit: random.between(1, 3),
    }
}
