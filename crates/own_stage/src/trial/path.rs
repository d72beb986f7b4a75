//! What a slot is given on a script, as messages; and Plumbline's own stages on the same.

use attitude::{Quaternion, metrics::AttitudeError};
use conformance::script::Script;
use ingest::{conditioner::Conditioner, source::Reading};
use launch::{GyroSamples, Launch, Service};
use messages::{AccelPoint, AttitudeOutput, FusedState, GnssFix, GyroStep, ImuSample, MagSample, Ticked};
use runtime::{EachTick, Orders, Pace, Role, RuntimeError, Slot, orders::Resume, shadow::Comparable};

/// Samples per second of every trial.
pub(super) const RATE_HZ: f64 = 100.0;
const USUAL_NS: i64 = 10_000_000;

/// A message that a slot reads.
#[derive(Debug, Clone, Copy)]
pub(super) enum Feed {
    Imu(ImuSample),
    Mag(MagSample),
    Gnss(GnssFix),
    Gyro(GyroStep),
    Accel(AccelPoint),
    Fused(FusedState),
}

/// What a slot is given at a tick, and the truth.
#[derive(Debug, Clone)]
pub(super) struct Tick {
    pub(super) imu: ImuSample,
    pub(super) feeds: Vec<Feed>,
    pub(super) truth: Quaternion<f64>,
}

/// A slot with what fills it.
pub(super) trait Place {
    type Output: Ticked + Comparable;
    type Slot: Slot<Output = Self::Output> + Clone;
    const SERVICE: Service;
    const NAMES: &'static [&'static str];
    /// What an inclination error means here.
    const LEVELS: bool;

    fn slot(orders: &Orders) -> Result<Self::Slot, RuntimeError>;
    fn offer(slot: &mut Self::Slot, feed: &Feed, publish: &mut dyn FnMut(Self::Output));
}

macro_rules! place {
    ($Place:ident, $service:ident, $names:expr, $levels:literal, $module:ident, $Slot:ty, $Output:ty, $($Feed:ident),*) => {
        pub(super) struct $Place;

        impl Place for $Place {
            type Output = $Output;
            type Slot = $Slot;
            const SERVICE: Service = Service::$service;
            const NAMES: &'static [&'static str] = &$names;
            const LEVELS: bool = $levels;

            fn slot(orders: &Orders) -> Result<Self::Slot, RuntimeError> {
                $module::slot(orders)
            }

            fn offer(slot: &mut Self::Slot, feed: &Feed, publish: &mut dyn FnMut(Self::Output)) {
                match *feed {
                    $(Feed::$Feed(message) => slot.offer(message.into(), publish),)*
                    _ => {}
                }
            }
        }
    };
}

place!(GyroPlace, Gyro, attitude::gyro::Gyro::NAMES, false, gyro, EachTick<gyro::GyroWork>, GyroStep, Imu);
place!(
    AccelPlace,
    Accel,
    attitude::accel::Accelerometer::NAMES,
    true,
    accel,
    EachTick<accel::AccelWork>,
    AccelPoint,
    Imu
);
place!(
    FuserPlace,
    Fuser,
    attitude::fuser::Fuser::NAMES,
    true,
    fuser,
    fuser::FuserSlot,
    FusedState,
    Gyro,
    Accel,
    Mag,
    Gnss
);
place!(
    CoursePlace,
    Course,
    attitude::course::Course::NAMES,
    true,
    course,
    course::CourseSlot,
    AttitudeOutput,
    Fused,
    Gnss
);

/// Orders of a trial.
pub(super) fn orders(launch: &Launch, role: Role, resume: Option<Resume>) -> Orders {
    Orders {
        launch: launch.clone(),
        rate_hz: RATE_HZ,
        pace: Pace::Speed(1.0),
        ticks_max: None,
        incarnation: super::INCARNATION,
        epoch: runtime::service::FIRST_EPOCH,
        role,
        prior: None,
        resume,
        supervisor_pid: std::process::id(),
    }
}

/// What `P`'s slot is given on a script: readings through ingest and Plumbline's own stages before the slot.
pub(super) fn ticks<P: Place>(script: &Script) -> Result<Vec<Tick>, String> {
    let launch = Launch::default();
    let failed = |error: &dyn std::fmt::Display| error.to_string();
    let orders = orders(&launch, Role::Owner { from_tick: 0 }, None);
    let conditioner = Conditioner::new(&launch.ingest, RATE_HZ, GyroSamples::Instants);
    let mut conditioner = conditioner.map_err(|error| failed(&error))?;
    let (mut gyro, mut accel) = (gyro::slot(&orders), accel::slot(&orders));
    let mut fuser = fuser::slot(&orders).map_err(|error| failed(&error))?;
    let (gyro, accel) = (gyro.as_mut().map_err(|error| failed(error))?, accel.as_mut().map_err(|error| failed(error))?);
    let mut t_ns = 0;
    let mut ticks = Vec::new();
    for tick in &script.ticks {
        t_ns += if tick.dt_s.is_finite() { (tick.dt_s * 1e9).round() as i64 } else { USUAL_NS };
        let reading = Reading {
            t_ns,
            rate_rad_s: tick.rate_rad_s.map_or([f64::NAN; 3], Into::into),
            force_m_s2: tick.force_m_s2.map_or([f64::NAN; 3], Into::into),
            field_ut: tick.field_ut.map(Into::into),
            fix: tick.fix,
            reference: None,
        };
        let Some(mut sample) = conditioner.condition(&reading) else { continue };
        sample.imu.header.t_born_ns = sample.imu.header.tick + 1;
        (sample.imu.header.epoch, sample.imu.header.incarnation) = (orders.epoch, 1);
        let (mut to_fuser, mut fused) = (Vec::new(), Vec::new());
        to_fuser.extend(sample.mag.map(Feed::Mag));
        to_fuser.extend(sample.gnss.map(Feed::Gnss));
        gyro.offer(sample.imu, &mut |step| to_fuser.push(Feed::Gyro(step)));
        accel.offer(sample.imu, &mut |point| to_fuser.push(Feed::Accel(point)));
        to_fuser
            .iter()
            .for_each(|feed| FuserPlace::offer(&mut fuser, feed, &mut |state| fused.push(Feed::Fused(state))));
        let feeds = match P::SERVICE {
            Service::Fuser => to_fuser,
            Service::Course => sample.gnss.map(Feed::Gnss).into_iter().chain(fused).collect(),
            _ => vec![Feed::Imu(sample.imu)],
        };
        ticks.push(Tick { imu: sample.imu, feeds, truth: tick.truth.quaternion() });
    }
    Ok(ticks)
}

/// How far two outputs are apart.
pub(super) fn error<O: Comparable>(one: &O, other: &O) -> Option<AttitudeError> {
    Some(AttitudeError::between(one.attitude()?, other.attitude()?))
}
