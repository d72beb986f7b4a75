//! A program as the only stage of a small system: started as the supervisor does, fed in lockstep, its outputs collected.

use std::{
    io::Write,
    process::{Child, Stdio},
    sync::atomic::{AtomicU32, Ordering},
    time::{Duration, Instant},
};

use bus::{Bus, BusError, Claim, Domain, Publisher, Subscriber};
use launch::Launch;
use messages::{
    AccelPoint, Checkpoint, Control, FusedState, GnssFix, GyroStep, Health, ImuSample, MagSample, Message, Ticked,
};
use runtime::{
    Role,
    orders::{BUFFER_BESIDE, Resume},
    said::Said,
};
use rustix::process::{Pid, Signal, kill_process};

use super::path::{Feed, Place, Tick, orders};

/// From its start until a stage must be ready, and the longest that it may say nothing.
const PATIENCE: Duration = Duration::from_secs(10);
/// From the request until a stage must have ended.
const GRACE: Duration = Duration::from_secs(2);
/// Ticks that the stage may be behind; fewer than a buffer holds.
const WINDOW: usize = 64;

pub(super) struct Bench<P: Place> {
    child: Child,
    said: Said,
    pub(super) outputs: Vec<P::Output>,
    pub(super) checkpoints: Vec<Checkpoint>,
    pub(super) health: Option<Health>,
    ports: Ports<P::Output>,
    _claim: Claim,
}

struct Ports<O: Ticked> {
    imu: Publisher<ImuSample>,
    mag: Publisher<MagSample>,
    gnss: Publisher<GnssFix>,
    gyro: Publisher<GyroStep>,
    accel: Publisher<AccelPoint>,
    fused: Publisher<FusedState>,
    control: Publisher<Control>,
    output: Subscriber<O>,
    checkpoints: Subscriber<Checkpoint>,
    health: Subscriber<Health>,
    // After the ports, which need it to the end.
    _bus: Bus,
}

impl<P: Place> Bench<P> {
    /// Starts the program that `launch` names for the slot and waits until it is ready.
    pub(super) fn start(launch: &Launch, role: Role, resume: Option<Resume>) -> Result<Self, String> {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let name = format!("trial-{}-{}", std::process::id(), COUNT.fetch_add(1, Ordering::SeqCst));
        let orders = orders(&Launch { name: name.clone(), ..launch.clone() }, role, resume);
        let failed = |cause: BusError| cause.to_string();
        let domain = Domain::new(&name).map_err(failed)?;
        let claim = domain.claim().map_err(failed)?;
        let ports = Ports::open(&domain, orders.buffer_ticks()).map_err(failed)?;
        let program = launch.program(P::SERVICE).ok_or("the launch file names no program for the slot")?;
        let text = orders.text(P::SERVICE).map_err(|error| error.to_string())?;
        let mut command = program.command();
        let child = command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn();
        let mut child = child.map_err(|cause| format!("starting {}: {cause}", program.command.join(" ")))?;
        if let Some(mut stdin) = child.stdin.take() {
            // One that has ended before it read its orders is found below.
            let _ = stdin.write_all(text.as_bytes());
        }
        let said = Said::on(child.stderr.take());
        let (outputs, checkpoints) = (Vec::new(), Vec::new());
        let mut bench = Self { child, said, outputs, checkpoints, health: None, ports, _claim: claim };
        bench.until("does not say that it is ready", |bench| bench.health.is_some())?;
        Ok(bench)
    }

    /// Gives these ticks and waits until each has come out. The outputs of earlier calls stay.
    pub(super) fn feed(&mut self, ticks: &[Tick]) -> Result<(), String> {
        let before = self.outputs.len();
        for (given, tick) in ticks.iter().enumerate() {
            tick.feeds.iter().try_for_each(|feed| self.ports.send(feed)).map_err(|cause| cause.to_string())?;
            if given + 1 == ticks.len() || (given + 1).is_multiple_of(WINDOW / 2) {
                self.ports.wake();
                let due =
                    before + if given + 1 == ticks.len() { ticks.len() } else { given.saturating_sub(WINDOW / 2) };
                let at = tick.imu.header.tick;
                self.until(&format!("gives nothing out although it was given tick {at}"), |bench| {
                    bench.outputs.len() >= due
                })?;
            }
        }
        Ok(())
    }

    /// Gives a tick that nothing is to come out of.
    pub(super) fn feed_silently(&mut self, ticks: &[Tick]) -> Result<(), String> {
        let next_tick = ticks.last().map_or(0, |tick| tick.imu.header.tick + 1);
        for tick in ticks {
            tick.feeds.iter().try_for_each(|feed| self.ports.send(feed)).map_err(|cause| cause.to_string())?;
        }
        self.ports.wake();
        self.until("does not say how far it is", |bench| {
            bench.health.is_some_and(|health| health.next_tick >= next_tick)
        })
    }

    /// Tells the stage who owns the slot, and waits until it has heard it.
    pub(super) fn decide(&mut self, epoch: u32, owner: u32, from_tick: u64) -> Result<(), String> {
        let control = Control { from_tick, epoch, service: P::SERVICE as u32, owner, reserved: 0 };
        self.ports.control.send(&control).map_err(|cause| cause.to_string())?;
        self.until("does not answer a decision", |bench| bench.health.is_some_and(|health| health.epoch == epoch))
    }

    /// Asks it to end.
    pub(super) fn end(mut self) -> Result<(), String> {
        self.signal(Signal::TERM);
        let asked = Instant::now();
        loop {
            self.said.listen();
            match self.child.try_wait() {
                Ok(Some(status)) if status.success() => return Ok(()),
                Ok(Some(status)) => return Err(format!("asked to end, it ended with {status}: {}", self.said.text())),
                Err(cause) => return Err(format!("waiting for its end: {cause}")),
                Ok(None) if asked.elapsed() > GRACE => return Err(format!("asked to end, it lives on for {GRACE:?}")),
                Ok(None) => std::thread::sleep(Duration::from_millis(5)),
            }
        }
    }

    fn until(&mut self, otherwise: &str, done: impl Fn(&Self) -> bool) -> Result<(), String> {
        let mut heard = Instant::now();
        while !done(self) {
            let before = self.outputs.len();
            self.ports.greet().and_then(|()| self.hear()).map_err(|cause| cause.to_string())?;
            if self.outputs.len() > before {
                heard = Instant::now();
            } else if let Ok(Some(status)) = self.child.try_wait() {
                return Err(format!("it ended by itself with {status}: {}", self.said.text()));
            } else if heard.elapsed() > PATIENCE {
                return Err(format!("it {otherwise}, for {} s", PATIENCE.as_secs()));
            } else {
                self.ports.output.wait(Duration::from_millis(2));
            }
        }
        Ok(())
    }

    fn hear(&mut self) -> Result<(), BusError> {
        let Self { ports, said, outputs, checkpoints, health, .. } = self;
        said.listen();
        ports.output.drain(WINDOW * 8, |output| outputs.push(output))?;
        ports.checkpoints.drain(BUFFER_BESIDE, |checkpoint| checkpoints.push(checkpoint))?;
        ports.health.drain(BUFFER_BESIDE, |heard| *health = Some(heard))
    }

    fn signal(&self, signal: Signal) {
        if let Some(pid) = Pid::from_raw(self.child.id() as i32) {
            // A process that has just ended does not need the signal.
            let _ = kill_process(pid, signal);
        }
    }
}

impl<P: Place> Drop for Bench<P> {
    fn drop(&mut self) {
        self.signal(Signal::KILL);
        // A killed process ends; the wait is for the kernel only.
        let _ = self.child.wait();
    }
}

impl<O: Ticked> Ports<O> {
    fn open(domain: &Domain, buffer: usize) -> Result<Self, BusError> {
        let bus = Bus::join(domain, "trial")?;
        Ok(Self {
            imu: bus.publisher(buffer)?,
            mag: bus.publisher(buffer)?,
            gnss: bus.publisher(buffer)?,
            gyro: bus.publisher(buffer)?,
            accel: bus.publisher(buffer)?,
            fused: bus.publisher(buffer)?,
            control: bus.publisher(BUFFER_BESIDE)?,
            output: bus.subscriber(buffer)?,
            checkpoints: bus.subscriber(BUFFER_BESIDE)?,
            health: bus.subscriber(BUFFER_BESIDE)?,
            _bus: bus,
        })
    }

    fn send(&self, feed: &Feed) -> Result<(), BusError> {
        fn send<M: Ticked>(publisher: &Publisher<M>, message: &M) -> Result<(), BusError> {
            publisher.note(message.header().tick);
            publisher.send(message)
        }
        match feed {
            Feed::Imu(message) => send(&self.imu, message),
            Feed::Mag(message) => send(&self.mag, message),
            Feed::Gnss(message) => send(&self.gnss, message),
            Feed::Gyro(message) => send(&self.gyro, message),
            Feed::Accel(message) => send(&self.accel, message),
            Feed::Fused(message) => send(&self.fused, message),
        }
    }

    fn wake(&self) {
        self.imu.wake();
        self.mag.wake();
        self.gnss.wake();
        self.gyro.wake();
        self.accel.wake();
        self.fused.wake();
    }

    /// Hands what is held to a reader that has come.
    fn greet(&self) -> Result<(), BusError> {
        fn greet<M: Message>(publisher: &Publisher<M>) -> Result<(), BusError> {
            publisher.greet()
        }
        greet(&self.imu)?;
        greet(&self.mag)?;
        greet(&self.gnss)?;
        greet(&self.gyro)?;
        greet(&self.accel)?;
        greet(&self.fused)?;
        greet(&self.control)
    }
}
