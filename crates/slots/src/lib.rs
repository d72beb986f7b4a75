//! The slots of the data path: types that turn input messages into output messages.
//!
//! The services run them as processes on the bus. `pipeline` runs them in one process, and the
//! simulator runs them on a simulated bus.
//!
//! | module | contents |
//! | --- | --- |
//! | [`gyro`] | rotation of each tick from the angular rate |
//! | [`accel`] | up direction from the specific force |
//! | [`fuser`] | attitude from rotation, up direction, magnetic field and fixes |
//! | [`course`] | angles, course and quaternion from attitude and fixes |
//! | `true_north` | magnetic declination |
#![forbid(unsafe_code)]

pub mod accel;
pub mod course;
pub mod fuser;
pub mod gyro;
mod true_north;

use launch::Slot;
use messages::ImuSample;
use runtime::{RuntimeError, ServiceConfig, ServiceContext, ServiceLoop, SlotInputs, SlotLoop, SlotProcessor};

/// Starts the main loop of the service of a slot.
///
/// # Errors
///
/// Returns an error if the configuration is invalid, the stage cannot be built, or the bus fails.
pub fn start(slot: Slot, context: ServiceContext) -> Result<Box<dyn ServiceLoop>, RuntimeError> {
    match slot {
        Slot::Gyro => start_loop(context, gyro::slot, subscribe_imu),
        Slot::Accel => start_loop(context, accel::slot, subscribe_imu),
        Slot::Fuser => start_loop(context, fuser::slot, fuser::subscribe),
        Slot::Course => start_loop(context, course::slot, course::subscribe),
    }
}

fn subscribe_imu(context: &ServiceContext) -> Result<SlotInputs<ImuSample>, RuntimeError> {
    Ok(vec![Box::new(context.subscriber::<ImuSample>()?)])
}

fn start_loop<S: SlotProcessor + 'static>(
    context: ServiceContext,
    slot: fn(&ServiceConfig) -> Result<S, RuntimeError>,
    subscribe: fn(&ServiceContext) -> Result<SlotInputs<S::Input>, RuntimeError>,
) -> Result<Box<dyn ServiceLoop>, RuntimeError> {
    let (slot, inputs) = (slot(&context.config)?, subscribe(&context)?);
    Ok(Box::new(SlotLoop::start(context, slot, inputs)?))
}

#[cfg(test)]
mod tests {
    use bus::{Bus, Subscriber, SystemName};
    use launch::{Launch, Service};
    use messages::{GyroStep, Header};
    use runtime::Pace;

    use super::*;

    const RATE_HZ: f64 = 100.0;

    fn sample(tick: u64) -> ImuSample {
        let t_end_ns = (tick as i64 + 1) * 10_000_000;
        let header = Header { tick, t_start_ns: t_end_ns - 10_000_000, t_end_ns, ..bytemuck::Zeroable::zeroed() };
        ImuSample { header, force_m_s2: [0.0, 0.0, 9.8], ..bytemuck::Zeroable::zeroed() }
    }

    fn received_ticks(steps: &Subscriber<GyroStep>) -> Vec<u64> {
        let mut ticks = Vec::new();
        steps.drain(64, |step| ticks.push(step.header.tick)).unwrap();
        ticks
    }

    #[test]
    fn late_subscriber_receives_history_with_and_without_new_output() {
        let name = SystemName::new(&format!("test-history-{}", std::process::id())).unwrap();
        let claim = name.claim().unwrap();
        let bus = Bus::join(&name, "test").unwrap();
        let launch = Launch { name: name.name().into(), ..Launch::default() };
        let config = ServiceConfig::standalone(launch, RATE_HZ, Pace::Speed(1.0));
        let buffer = config.buffer_ticks();
        let samples = bus.publisher::<ImuSample>(buffer).unwrap();
        let mut gyro = start(Slot::Gyro, ServiceContext::with_config(Service::Gyro, config).unwrap()).unwrap();
        let mut run_round = |new_ticks: std::ops::Range<u64>| {
            new_ticks.for_each(|tick| samples.send(&sample(tick)).unwrap());
            gyro.run_round().unwrap();
        };
        run_round(0..3);

        let late = bus.late_subscriber::<GyroStep>(buffer).unwrap();
        run_round(3..3);
        assert_eq!(received_ticks(&late), [0, 1, 2]);

        let later = bus.late_subscriber::<GyroStep>(buffer).unwrap();
        run_round(3..4);
        assert_eq!(received_ticks(&later), [0, 1, 2, 3]);
        drop((gyro, samples, late, later, bus, claim));
    }
}
