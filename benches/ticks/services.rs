//! The services of the data path in one process. Each tick passes through them in turn.

use bus::SystemName;
use launch::{Launch, Service, Slot, Source};
use messages::{AttitudeOutput, Checkpoint, Credit, Health};
use runtime::{Pace, ServiceConfig, ServiceContext, ServiceLoop, service_config::CONTROL_BUFFER};

use crate::Failure;

/// Number of counted ticks.
pub(crate) const TICKS: u64 = 1000;
/// Number of ticks before counting starts. By then, all connections exist and every topic is full,
/// so that each message replaces an old one.
const WARM_UP_TICKS: u64 = 1200;
const RATE_HZ: f64 = 1000.0;
/// Names of the functions that run one tick of a service.
pub(crate) const MEASURED: [&str; 5] = ["ingest", "gyro", "accel", "fuser", "course"];

/// Runs the warm-up, and then the ticks that are counted.
pub(crate) fn run() -> Result<(), Failure> {
    let name = SystemName::new(&format!("bench-ticks-{}", std::process::id()))?;
    let claim = name.claim()?;
    let result = run_services(&name);
    drop(claim);
    result
}

fn run_services(name: &SystemName) -> Result<(), Failure> {
    let join = |service| ServiceContext::with_config(service, config(name, service));
    let supervisor = join(Service::Ingest)?;
    // The topics that the supervisor reads.
    let attitudes = supervisor.subscriber::<AttitudeOutput>()?;
    let health = supervisor.subscriber::<Health>()?;
    let checkpoints = supervisor.subscriber::<Checkpoint>()?;
    let credit = supervisor.publisher::<Credit>()?;

    let mut gyro_loop = slots::start(Slot::Gyro, join(Service::Gyro)?)?;
    let mut accel_loop = slots::start(Slot::Accel, join(Service::Accel)?)?;
    let mut fuser_loop = slots::start(Slot::Fuser, join(Service::Fuser)?)?;
    let mut course_loop = slots::start(Slot::Course, join(Service::Course)?)?;

    let mut paced = ::ingest::PacedIngest::start(join(Service::Ingest)?)?;
    let mut received = 0;
    let mut run_tick = |tick: u64| -> Result<(), Failure> {
        credit.send(&Credit { ticks: tick + 1, ends: 0 })?;
        ingest(&mut paced)?;
        gyro(&mut *gyro_loop)?;
        accel(&mut *accel_loop)?;
        fuser(&mut *fuser_loop)?;
        course(&mut *course_loop)?;
        attitudes.drain(CONTROL_BUFFER, |_| received += 1)?;
        health.drain(CONTROL_BUFFER, |_| ())?;
        checkpoints.drain(CONTROL_BUFFER, |_| ())?;
        if received == tick + 1 { Ok(()) } else { Err(format!("tick {tick} did not pass through all services").into()) }
    };
    (0..WARM_UP_TICKS).try_for_each(&mut run_tick)?;
    count(&mut run_tick)
}

/// Runs the ticks that callgrind counts.
#[inline(never)]
fn count(run_tick: &mut dyn FnMut(u64) -> Result<(), Failure>) -> Result<(), Failure> {
    (WARM_UP_TICKS..WARM_UP_TICKS + TICKS).try_for_each(run_tick)
}

#[inline(never)]
fn ingest(paced: &mut ::ingest::PacedIngest) -> Result<(), Failure> {
    paced.run_round()?;
    Ok(())
}

#[inline(never)]
fn gyro(service: &mut dyn ServiceLoop) -> Result<(), Failure> {
    run_round(service)
}

#[inline(never)]
fn accel(service: &mut dyn ServiceLoop) -> Result<(), Failure> {
    run_round(service)
}

#[inline(never)]
fn fuser(service: &mut dyn ServiceLoop) -> Result<(), Failure> {
    run_round(service)
}

#[inline(never)]
fn course(service: &mut dyn ServiceLoop) -> Result<(), Failure> {
    run_round(service)
}

#[inline(always)]
fn run_round(service: &mut dyn ServiceLoop) -> Result<(), Failure> {
    service.wait();
    Ok(service.run_round()?)
}

/// Returns the configuration of a service. The source publishes one tick per credit.
fn config(name: &SystemName, service: Service) -> ServiceConfig {
    let mut launch = Launch { name: name.name().into(), ..Launch::default() };
    launch.ingest.source = Source::Sim;
    launch.ingest.sim.rate_hz = RATE_HZ;
    ServiceConfig {
        incarnation: service as u32 + 1,
        supervisor_pid: std::process::id(),
        ..ServiceConfig::standalone(launch, RATE_HZ, Pace::Max)
    }
}
