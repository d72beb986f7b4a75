//! The services as processes on the bus, from the first to be started to the last to be reaped.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use bus::{Bus, Claim, Domain, Publisher, SharedMemory, Subscriber};
use launch::{Launch, Service};
use messages::{AttitudeOutput, Checkpoint, Credit, Difference, Health, ImuSample, Reference, State};
use runtime::{Input, Orders, Reader, orders::BUFFER_BESIDE};

use crate::{
    Plan, Report, UpError,
    cleaner::Cleaner,
    collector::Collector,
    crew::{Crew, News, own_cpu_s},
    damage::Damage,
    door::{Ask, Door},
    exchange::{Exchange, published_tick},
    memory::Memory,
    notify::Notifier,
    report::{Account, ServiceReport},
    urgency,
    view::View,
    warm::WarmStart,
    watch::Watches,
};

/// Longest wait before looking at services, signals and messages.
const ROUND: Duration = Duration::from_millis(20);
/// The same while hands change.
const ROUND_BUSY: Duration = Duration::from_millis(2);
/// After the source's end, how long nothing may come before the rest is given up as lost: a service that was killed or has frozen is back by
/// then.
const DRAIN_LIMIT: Duration = Duration::from_secs(2);
/// How often people see something new.
const VIEW_INTERVAL: Duration = Duration::from_millis(100);

/// Runs the plan as processes.
pub fn run(plan: &Plan, asked_to_end: Arc<AtomicBool>) -> Result<Report, UpError> {
    let mut collector = Collector::new(plan.out.as_deref())?;
    let mut system = System::start(plan, asked_to_end)?;
    let ready = system.await_ready(&mut collector);
    if ready.is_ok() {
        (system.since, system.cpu_since_s) = (Instant::now(), own_cpu_s() + system.crew.cpu_s());
    }
    let mut run = ready.and_then(|()| system.operate(plan, &mut collector));
    while let Err(UpError::Damaged { .. }) = run {
        system = system.start_anew(collector.next_tick())?;
        run = system.await_ready(&mut collector).and_then(|()| system.operate(plan, &mut collector));
    }
    let report = system.report(plan, collector, run);
    system.end();
    Ok(report)
}

/// A running system. Its fields are dropped in this order: processes, ports, node, and last the name.
struct System {
    crew: Crew,
    cleaner: Cleaner,
    ports: Ports,
    memory: Memory,
    warm: WarmStart,
    exchange: Exchange,
    watches: Watches,
    door: Door,
    /// Callers who wait for the answer to a request.
    waiting: Vec<Waiting>,
    view: View,
    notifier: Notifier,
    asked_to_end: Arc<AtomicBool>,
    /// From when on the cost of the processes counts, and what it was by then, CPU s.
    since: Instant,
    cpu_since_s: f64,
    damage: Damage,
    claim: Claim,
}

/// A caller who waits for the answer to a request.
struct Waiting {
    caller: u64,
    request: u64,
    /// The slot of a shadow, which ends with its caller.
    shadow: Option<Service>,
}

struct Ports {
    attitude: Reader<AttitudeOutput>,
    reference: Subscriber<Reference>,
    health: Subscriber<Health>,
    checkpoints: Subscriber<Checkpoint>,
    credit: Publisher<Credit>,
    buffer: usize,
    bus: Bus,
}

impl System {
    fn start(plan: &Plan, asked_to_end: Arc<AtomicBool>) -> Result<Self, UpError> {
        let notifier = Notifier::new()?;
        let domain = Domain::new(&plan.orders.launch.name)?;
        SharedMemory::suffices(domain.name(), plan.orders.shared_memory_bytes())?;
        let claim = domain.claim()?;
        let ports = Ports::open(&domain, &plan.orders, 0)?;
        let view = View::new(plan);
        let control = ports.bus.publisher(BUFFER_BESIDE)?;
        let watches = Watches::new(&plan.orders.launch, plan.orders.rate_hz, ports.differences(&plan.orders)?);
        let door = Door::open(&domain)?;
        let damage = Damage::new(domain.clone());
        let cleaner = Cleaner::new(domain)?;
        let (warm, prior) = WarmStart::begin(plan)?;
        let orders = Orders { prior, ..plan.orders.clone() };
        urgency::set_own();
        // All topics of its own are open by now: to wait for one that a service is just making is what a signal would break off.
        let crew = Crew::start(&orders)?;
        let exchange = Exchange::new(control, &orders, &crew);
        let (memory, waiting) = (Memory::default(), Vec::new());
        Ok(Self {
            crew,
            cleaner,
            ports,
            memory,
            warm,
            exchange,
            watches,
            door,
            waiting,
            view,
            notifier,
            asked_to_end,
            since: Instant::now(),
            cpu_since_s: 0.0,
            damage,
            claim,
        })
    }

    /// The same system on another bus of its name, where somebody has removed the files of the one it had: every service goes on from its
    /// checkpoint, and `next_tick` comes out next.
    fn start_anew(self, next_tick: u64) -> Result<Self, UpError> {
        let Self { mut crew, cleaner, ports, mut memory, exchange, mut watches, door, claim, .. } = self;
        crew.leave_bus();
        watches.leave_bus();
        // What was open on the old bus is closed first: its topics have the names of the new ones.
        drop((door, exchange, cleaner, ports));
        let claim = claim.renew()?;
        let domain = claim.domain();
        let ports = Ports::open(domain, crew.orders(), next_tick)?;
        let control = ports.bus.publisher(BUFFER_BESIDE)?;
        watches.go_on_at(ports.differences(crew.orders())?);
        let (door, cleaner, damage) = (Door::open(domain)?, Cleaner::new(domain.clone())?, Damage::new(domain.clone()));
        crew.start_anew(&memory)?;
        let mut exchange = Exchange::new(control, crew.orders(), &crew);
        for service in crew.away() {
            exchange.leave_empty(&ports.bus, service, &mut crew, &mut memory);
        }
        let waiting = Vec::new();
        Ok(Self { crew, cleaner, ports, memory, exchange, watches, door, waiting, damage, claim, ..self })
    }

    /// Waits until every service has opened its topics: from then on nothing that is published is missed. How long one may take, and what
    /// comes then, is the rule of its lives.
    fn await_ready(&mut self, collector: &mut Collector) -> Result<(), UpError> {
        self.hear()?;
        while !self.is_ready() && !self.asked_to_end.load(Ordering::SeqCst) {
            self.tend(collector)?;
            self.answer(collector);
            std::thread::sleep(Duration::from_millis(1));
            self.hear()?;
        }
        Ok(())
    }

    /// Runs to the end; what the processes cost until the first of them was asked to end, CPU s per s.
    fn operate(&mut self, plan: &Plan, collector: &mut Collector) -> Result<f64, UpError> {
        let origin = plan.orders.launch.origin();
        // After a cut an import has more to give than a topic holds.
        let lockstep = plan.orders.lockstep() || origin == Service::Gateway;
        let window = plan.orders.window_ticks();
        let mut granted = if lockstep { self.next_tick(collector) + window } else { u64::MAX };
        let mut stopping = false;
        let (mut cpu_s_per_s, mut next_tick) = (None, 0);
        let (mut progress, mut shown) = (Instant::now(), Instant::now());
        // Asked to end before it was ready, it has nothing to give out.
        let mut ended = !self.is_ready();
        if !ended {
            self.ports.grant(granted)?;
            self.notifier.ready();
        }
        while !ended {
            self.wait(lockstep);
            self.ports.credit.greet()?;
            self.collect(collector)?;
            self.hear()?;
            let before = std::mem::replace(&mut next_tick, self.next_tick(collector));
            if next_tick != before {
                progress = Instant::now();
                self.notifier.flowing(next_tick);
            }
            if lockstep && next_tick + window >= granted + window / 4 {
                granted = next_tick + window;
                self.ports.grant(granted)?;
            }
            let asked = self.asked_to_end.load(Ordering::SeqCst);
            let over = plan.stop_after_s.is_some_and(|limit_s| self.since.elapsed().as_secs_f64() > limit_s);
            if (asked || over) && !stopping {
                stopping = true;
                // Before the first process is reaped, and its time with it.
                cpu_s_per_s = Some(self.cpu_s_per_s());
                self.crew.ask_to_end(origin);
                progress = Instant::now();
            }
            let finished = self.health_of(origin).is_some_and(|health| health.state == State::FINISHED);
            let dry = finished || stopping && self.crew.post(origin).has_ended();
            let given_up = (stopping || dry) && progress.elapsed() > DRAIN_LIMIT;
            ended = dry && next_tick >= self.ticks_in(origin) || given_up;
            if !ended {
                self.tend(collector)?;
                self.answer(collector);
                self.watch(collector)?;
            }
            if shown.elapsed() > VIEW_INTERVAL {
                shown = Instant::now();
                self.view.show(collector, Some(&self.crew));
            }
        }
        self.notifier.stopping();
        Ok(cpu_s_per_s.unwrap_or_else(|| self.cpu_s_per_s()))
    }

    /// How it went, to the end or to what ended it.
    fn report(&self, plan: &Plan, mut collector: Collector, run: Result<f64, UpError>) -> Report {
        let (cpu_s_per_s, failure) = match run {
            Ok(cpu_s_per_s) => (cpu_s_per_s, None),
            Err(error) => (self.cpu_s_per_s(), Some(error)),
        };
        let failure = failure.or(self.collect(&mut collector).err());
        // What waits for ticks that have not come is counted with them as lost.
        self.ports.attitude.finish(&mut |output| collector.attitude(&output));
        Report::new(collector, self.account(cpu_s_per_s, &plan.orders.launch), failure)
    }

    fn cpu_s_per_s(&self) -> f64 {
        (own_cpu_s() + self.crew.cpu_s() - self.cpu_since_s).max(0.0) / self.since.elapsed().as_secs_f64()
    }

    /// Takes the attitudes that have come, where they are made here.
    fn collect(&self, collector: &mut Collector) -> Result<(), UpError> {
        if self.published_elsewhere().is_none() { self.ports.collect(collector) } else { Ok(()) }
    }

    /// Sees to the services and their slots, and says what happened to them.
    fn tend(&mut self, collector: &mut Collector) -> Result<(), UpError> {
        let Self { crew, cleaner, exchange, memory, warm, ports, view, damage, .. } = self;
        view.announce(&warm.heed(memory));
        let mut news = News::default();
        news.lines.extend(damage.look());
        let mut tended = crew.tend(&mut news);
        if !news.deaths.is_empty() {
            cleaner.heed();
            tended = tended.and_then(|()| damage.assess(crew, &mut news));
        }
        if tended.is_ok() {
            tended = exchange.go_on(&ports.bus, &mut news, collector, crew, memory);
        }
        // Also what led to an error.
        view.announce(&news.lines);
        tended
    }

    /// Lets stages take over that have proved themselves.
    fn watch(&mut self, collector: &mut Collector) -> Result<(), UpError> {
        let Self { watches, exchange, crew, memory, view, .. } = self;
        let mut lines = Vec::new();
        watches.go_on(exchange, collector, crew, memory, &mut lines)?;
        view.announce(&lines);
        Ok(())
    }

    /// Answers whoever asks.
    fn answer(&mut self, collector: &mut Collector) {
        let Self { door, exchange, crew, memory, waiting, watches, view, .. } = self;
        for (caller, question) in door.questions() {
            match question {
                Ask::Swap(wish) => {
                    let shadow = Service::named(&wish.slot).filter(|_| wish.shadow);
                    if exchange.checked(&wish).is_ok() {
                        watches.yield_to(&wish.slot, exchange, crew, memory);
                    }
                    let request = exchange.wish(wish, collector, crew, memory);
                    waiting.push(Waiting { caller, request, shadow });
                }
                Ask::Cancel { slot } => {
                    Service::named(&slot).into_iter().for_each(|slot| exchange.cancel(slot, crew, memory));
                    door.answer(caller, &());
                }
                Ask::Ps => door.answer(caller, &exchange.ps(crew)),
                Ask::Orders => door.answer(caller, crew.orders()),
                Ask::Record => door.answer(caller, &collector.record()),
                Ask::Tell { service, what } => {
                    view.announce(&[format!("{service}: {what}")]);
                    door.answer(caller, &());
                }
                Ask::At { service, at } => {
                    view.announce(&[format!("{service}: {at}")]);
                    crew.found(&service, at);
                    door.answer(caller, &());
                }
            }
        }
        waiting.retain(|Waiting { caller, request, shadow }| match (exchange.take_answer(*request), shadow) {
            (Some(report), _) => {
                view.announce(&[report.to_string()]);
                door.answer(*caller, &report);
                false
            }
            (None, Some(slot)) if !door.is_waiting(*caller) => {
                exchange.cancel(*slot, crew, memory);
                false
            }
            (None, _) => true,
        });
    }

    /// In lockstep the source waits for this reader, so it is woken; else it only looks from time to time, and when a service ends.
    fn wait(&self, lockstep: bool) {
        let round = if self.exchange.is_busy() { ROUND_BUSY } else { ROUND };
        if lockstep {
            Input::<AttitudeOutput>::wait(&self.ports.attitude, round);
        } else {
            self.crew.wait(round);
        }
    }

    fn end(mut self) {
        self.crew.end();
        self.view.announce(&self.warm.end(&self.memory));
        self.view.end();
    }

    fn hear(&mut self) -> Result<(), UpError> {
        let Self { ports, crew, memory, exchange, .. } = self;
        ports.health.drain(BUFFER_BESIDE * Service::ALL.len(), |health| crew.hear(health))?;
        ports.checkpoints.drain(BUFFER_BESIDE * Service::ALL.len(), |checkpoint| {
            let Checkpoint { service, incarnation, next_tick, .. } = checkpoint;
            if !exchange.admits(service, incarnation, next_tick) {
                return;
            }
            if crew.is_candidate(service, incarnation) {
                memory.keep_candidate(checkpoint);
            } else {
                memory.keep(checkpoint);
            }
        })?;
        Ok(())
    }

    fn is_ready(&self) -> bool {
        self.crew.path().all(|(_, post)| post.is_settled())
    }

    fn health_of(&self, service: Service) -> Option<&Health> {
        self.crew.post(service).heard()
    }

    /// The tick that comes out next.
    fn next_tick(&self, collector: &Collector) -> u64 {
        self.published_elsewhere().unwrap_or(collector.next_tick())
    }

    /// How far every slot here has published, if the attitude is made on another host.
    fn published_elsewhere(&self) -> Option<u64> {
        let path = || self.crew.path().map(|(service, _)| service).filter(|service| !service.is_beside());
        let has_attitude = path().any(|service| service == Service::Course);
        (!has_attitude).then(|| path().map(|service| published_tick(&self.ports.bus, service)).min()).flatten()
    }

    /// Ticks that have come in.
    fn ticks_in(&self, origin: Service) -> u64 {
        match origin {
            // What ingest has published counts, whether or not it lives to say so.
            Service::Ingest => self.ports.bus.next_tick::<ImuSample>(),
            _ => self.health_of(origin).map_or(0, |health| health.ticks),
        }
    }

    fn account(&self, cpu_s_per_s: f64, launch: &Launch) -> Account {
        Account {
            ticks_in: self.ticks_in(launch.origin()),
            ticks_out: self.published_elsewhere(),
            refused: self.health_of(launch.origin()).map_or(0, |health| health.refused),
            cpu_s_per_s,
            services: self
                .crew
                .posts()
                .map(|(service, post)| ServiceReport {
                    name: service.name(),
                    pid: post.pid(),
                    restarts: post.restarts(),
                })
                .collect(),
        }
    }
}

impl Ports {
    /// The first attitude to come is that of `next_tick`.
    fn open(domain: &Domain, orders: &Orders, next_tick: u64) -> Result<Self, UpError> {
        let bus = Bus::join(domain, "supervisor")?;
        let buffer = orders.buffer_ticks();
        Ok(Self {
            attitude: Reader::new(bus.subscriber(buffer)?, next_tick, orders),
            reference: bus.subscriber(buffer)?,
            health: bus.subscriber(BUFFER_BESIDE)?,
            checkpoints: bus.subscriber(BUFFER_BESIDE)?,
            credit: bus.publisher(BUFFER_BESIDE)?,
            buffer,
            bus,
        })
    }

    /// Where shadows say how far they are, if anybody wants to know.
    fn differences(&self, orders: &Orders) -> Result<Option<Subscriber<Difference>>, UpError> {
        let watched = !orders.launch.watch.is_empty();
        Ok(watched.then(|| self.bus.subscriber(BUFFER_BESIDE)).transpose()?)
    }

    fn grant(&self, ticks: u64) -> Result<(), UpError> {
        self.credit.send(&Credit { ticks })?;
        self.credit.wake();
        Ok(())
    }

    fn collect(&self, collector: &mut Collector) -> Result<(), UpError> {
        let mut outputs: Vec<AttitudeOutput> = Vec::new();
        self.attitude.drain(self.buffer, &mut |output| outputs.push(output))?;
        // A reference is published before its tick, so those of all these ticks are there.
        self.reference.drain(self.buffer, |reference| collector.reference(reference))?;
        outputs.iter().for_each(|output| collector.attitude(output));
        Ok(())
    }
}
