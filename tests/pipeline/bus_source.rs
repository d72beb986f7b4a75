//! Systems of real processes that are fed over the bus: accuracy, order, latency and clean-up.
use std::time::Instant;

use crate::common::{System, inclination_deg, is_alive, signal, wait_for};
use bus::{Bus, Publisher, Subscriber, SystemName};
use launch::Service;
use messages::{AttitudeOutput, Chart, Flags, FusedState, Health, SensorReading};
use runtime::{
    clock::{monotonic_ns, sleep_until_ns},
    service_config::CONTROL_BUFFER,
};
use rustix::process::Signal;
use scenario::{Motion, SensorErrors, Sensors};

pub(crate) const RATE_HZ: f64 = 500.0;
/// Buffer capacity for 30 s of readings, so that results do not depend on the speed of this
/// machine.
pub(crate) const BUFFER_MESSAGES: usize = 15_000;
pub(crate) const BUS_LAUNCH: &str =
    "buffer_s = 30.0\nlateness_s = 20.0\n[ingest]\nsource = \"bus\"\n[ingest.bus]\nrate_hz = 500.0\n";

/// System that reads its sensors from the bus, with the test's own publisher and subscriber.
pub(crate) struct Bench {
    pub(crate) system: System,
    pub(crate) running: Option<crate::common::Running>,
    sensor: Publisher<SensorReading>,
    attitude: Subscriber<AttitudeOutput>,
    pub(crate) bus: Bus,
}

impl Bench {
    fn start(slots: &str) -> Self {
        Self::start_system(System::new(&format!("{BUS_LAUNCH}gyro_samples = \"instants\"\n{slots}")), &[])
    }

    pub(crate) fn start_system(system: System, arguments: &[&str]) -> Self {
        let running = system.start(arguments);
        // Without this wait, the test could join the leftovers of a killed system of the same name.
        wait_for("the system to respond", || !system.ps().is_empty());
        let system_name = SystemName::new(&system.name).unwrap();
        let mut joined = None;
        wait_for("the bus of the system", || {
            joined = joined.take().or_else(|| Bus::join(&system_name, "test").ok());
            joined.is_some()
        });
        let bus = joined.unwrap();
        let health: Subscriber<Health> = bus.subscriber(CONTROL_BUFFER).unwrap();
        let attitude = bus.subscriber(BUFFER_MESSAGES).unwrap();
        let sensor = bus.publisher(BUFFER_MESSAGES).unwrap();
        let mut ready = [false; Service::PATH.len()];
        wait_for("every service to report", || {
            while let Some(message) = health.receive().unwrap() {
                ready[message.service as usize] = true;
            }
            ready.iter().all(|ready| *ready)
        });
        Self { system, running: Some(running), sensor, attitude, bus }
    }

    /// Sends readings at the nominal rate and returns the resulting attitudes.
    fn feed(&self, readings: &[SensorReading]) -> Vec<AttitudeOutput> {
        self.send(readings, |_| {});
        let mut outputs = Vec::new();
        wait_for("every attitude", || {
            while let Some(output) = self.attitude.receive().unwrap() {
                outputs.push(output);
            }
            outputs.len() >= readings.len()
        });
        outputs
    }

    /// Sends readings at the nominal rate. Before each reading, `before` is called with its index.
    fn send(&self, readings: &[SensorReading], before: impl FnMut(usize)) {
        self.send_at(RATE_HZ, readings, before);
    }

    /// Sends readings at the given rate, with timestamps of the nominal rate.
    pub(crate) fn send_at(&self, rate_hz: f64, readings: &[SensorReading], mut before: impl FnMut(usize)) {
        let start_ns = monotonic_ns();
        for (count, reading) in readings.iter().enumerate() {
            sleep_until_ns(start_ns + (count as f64 * 1e9 / rate_hz) as u64);
            before(count);
            self.sensor.send(reading).unwrap();
            self.sensor.wake();
        }
    }

    /// Kills the supervisor to simulate a power cut, and waits until its services have exited.
    pub(crate) fn kill(mut self) -> System {
        let running = self.running.take().unwrap();
        let pids: Vec<u32> = running.services().into_iter().map(|(_, pid)| pid).collect();
        signal(running.pid(), Signal::KILL);
        drop(running);
        wait_for("the services to exit", || !pids.iter().any(|pid| is_alive(*pid)));
        self.system
    }

    pub(crate) fn stop(mut self) -> crate::common::Run {
        let running = self.running.take().unwrap();
        let pids: Vec<u32> = running.services().into_iter().map(|(_, pid)| pid).collect();
        assert_eq!(pids.len(), 5);
        running.interrupt();
        let interrupted_at = Instant::now();
        let run = running.wait();
        println!("exited {} ms after Ctrl-C", interrupted_at.elapsed().as_millis());
        assert!(pids.into_iter().all(|pid| !is_alive(pid)), "a process is still running");
        drop((self.sensor, self.attitude, self.bus));
        assert_eq!(self.system.leftovers(), Vec::<String>::new());
        run
    }
}

pub(crate) fn readings(motion: Motion, errors: SensorErrors, count: u64) -> Vec<SensorReading> {
    let mut sensors = Sensors::new(motion, errors, 3);
    (0..count)
        .map(|count| {
            let reading = sensors.read(count as f64 / RATE_HZ);
            SensorReading {
                t_sensor_ns: (count as f64 * 1e9 / RATE_HZ).round() as i64,
                rate_rad_s: reading.rate_rad_s.into(),
                force_m_s2: reading.force_m_s2.into(),
                field_ut: [f64::NAN; 3],
            }
        })
        .collect()
}

fn truth(motion: Motion, tick: u64) -> [f64; 4] {
    let q = motion.at(tick as f64 / RATE_HZ).attitude.quaternion();
    [q.w, q.i, q.j, q.k]
}

fn assert_in_order(outputs: &[AttitudeOutput]) {
    for (tick, output) in (0..).zip(outputs) {
        let header = output.header;
        assert_eq!((header.tick, header.lost_upstream), (tick, 0));
        assert_eq!(header.t_end_ns, (tick as f64 * 1e9 / RATE_HZ).round() as i64);
        assert!(header.t_born_ns > 0 && header.t_sent_ns >= header.t_born_ns, "sent before its creation");
        assert!(tick == 0 || header.t_born_ns >= outputs[tick as usize - 1].header.t_born_ns);
        let norm = output.quaternion.iter().map(|x| x * x).sum::<f64>();
        assert!((norm - 1.0).abs() < 1e-12);
    }
}

fn assert_s1_inclination(fuser: &str, limit_deg: f64) {
    let bench = Bench::start(&format!("[fuser]\nstage = \"{fuser}\"\n"));
    let outputs = bench.feed(&readings(Motion::S1, SensorErrors::S1, 5000));
    assert_in_order(&outputs);
    let errors = outputs[2500..].iter().map(|o| inclination_deg(o.quaternion, truth(Motion::S1, o.header.tick)));
    let rmse_deg = crate::common::rms(errors);
    println!("{fuser}: inclination RMSE from 5 to 10 s {rmse_deg:.3}°");
    assert!(rmse_deg < limit_deg, "{fuser}: {rmse_deg}°");
    let run = bench.stop();
    run.assert_complete();
    assert_eq!(run.number("/ticks_out"), 5000.0);
    let latency = |name: &str| run.number(&format!("/latency_us/{name}"));
    assert!(0.0 < latency("p50") && latency("p50") <= latency("p99"));
    assert!(latency("p99") <= latency("p999") && latency("p999") <= latency("max"));
    assert!(run.json["error_deg"].is_null(), "the bus has no reference");
    assert!(run.stderr.contains("accuracy not measured: the source has no reference attitude"), "{}", run.stderr);
}

#[test]
fn s1_over_bus_with_wz() {
    assert_s1_inclination("wz", 0.35);
}

#[test]
fn s1_over_bus_with_wz_closed() {
    assert_s1_inclination("wz-closed", 0.35);
}

#[test]
fn s1_over_bus_with_wz_open() {
    assert_s1_inclination("wz-open", 0.35);
}

#[test]
fn tumbling_over_bus_is_exact_in_both_charts() {
    let motion = Motion::from_name("tumble").unwrap();
    let bench = Bench::start("");
    let fused: Subscriber<FusedState> = bench.bus.subscriber(BUFFER_MESSAGES).unwrap();
    let outputs = bench.feed(&readings(motion, SensorErrors::default(), 5000));
    assert_in_order(&outputs);
    for output in &outputs {
        let error_deg = inclination_deg(output.quaternion, truth(motion, output.header.tick));
        assert!(error_deg < 1e-6, "tick {}: {error_deg}°", output.header.tick);
    }
    let charts: Vec<Chart> = core::iter::from_fn(|| fused.receive().unwrap()).map(|state| state.chart).collect();
    let inverted = charts.iter().filter(|chart| **chart == Chart::INVERTED).count();
    let changes = charts.windows(2).filter(|pair| pair[0] != pair[1]).count();
    println!("{inverted} of {} ticks inverted, {changes} chart changes", charts.len());
    assert_eq!(charts.len(), outputs.len());
    assert!(
        inverted > 1000 && charts.len() - inverted > 1000 && changes > 20,
        "{inverted} inverted, {changes} changes"
    );
    drop(fused);
    bench.stop().assert_complete();
}

#[test]
fn killed_ingest_leaves_one_flagged_gap() {
    let bench = Bench::start("");
    let all = readings(Motion::S1, SensorErrors::S1, 2000);
    bench.send(&all, |count| {
        if count == 700 {
            signal(bench.running.as_ref().unwrap().service("ingest"), Signal::KILL);
        }
    });
    let last_ns = all.last().unwrap().t_sensor_ns;
    let mut outputs: Vec<AttitudeOutput> = Vec::new();
    wait_for("the attitude of the last reading", || {
        while let Some(output) = bench.attitude.receive().unwrap() {
            outputs.push(output);
        }
        outputs.last().is_some_and(|output| output.header.t_end_ns >= last_ns)
    });
    let ticks: Vec<_> = outputs.iter().map(|output| output.header.tick).collect();
    assert_eq!(ticks, (0..outputs.len() as u64).collect::<Vec<_>>());
    let flagged: Vec<_> = outputs.iter().filter(|output| output.header.flags.any(Flags::GAP)).collect();
    assert_eq!(flagged.len(), 1, "{:?}", flagged.iter().map(|output| output.header.tick).collect::<Vec<_>>());
    assert!((600..=700).contains(&flagged[0].header.tick), "at tick {}", flagged[0].header.tick);
    println!("{} of {} readings have no tick", all.len() - outputs.len(), all.len());
    let run = bench.stop();
    assert_eq!((run.code, run.number("/lost"), run.number("/duplicated")), (Some(0), 0.0, 0.0), "{}", run.stderr);
}

#[test]
fn invalid_readings_over_bus_are_flagged() {
    let bench = Bench::start("");
    let mut readings = readings(Motion::S1, SensorErrors::S1, 1500);
    readings[400].rate_rad_s[1] = f64::NAN;
    readings[500].force_m_s2 = [f64::INFINITY; 3];
    readings[600].force_m_s2 = [0.0; 3];
    let outputs = bench.feed(&readings);
    assert_in_order(&outputs);
    let flags = |tick: usize| outputs[tick].header.flags;
    assert!(flags(400).any(Flags::RATE_INVALID) && !flags(401).any(Flags::RATE_INVALID));
    assert!(flags(500).any(Flags::FORCE_INVALID) && !flags(501).any(Flags::FORCE_INVALID));
    assert!(flags(600).any(Flags::FORCE_SMALL) && !flags(601).any(Flags::FORCE_SMALL));
    let run = bench.stop();
    run.assert_complete();
    assert!(run.line("flags").contains("rate-invalid force-invalid force-small"), "{}", run.stderr);
}
