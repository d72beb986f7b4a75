//! Catalogue of sensor, timestamp and motion faults.
//!
//! Input: a script.
//!
//! Output: the script with one fault from [`FAULT_START_S`] on.
//!
//! Time: the timestamps of the ticks.
//!
//! Ingest passes on only increasing timestamps and finite values. A timestamp that is constant,
//! repeated or decreasing therefore appears here as an interval of zero, and a jump as an interval
//! of up to `MAX_INTERVAL_S`. The catalogue nevertheless includes non-finite values, because a
//! stage can also be used without ingest. The stage must treat such values as missing.

use attitude::{GRAVITY_M_S2, Vector3};

use crate::script::{Script, Tick, noise};

/// Start of every fault, s. The estimates have settled by then.
pub const FAULT_START_S: f64 = 20.0;
/// Longest tick interval that is passed to a stage, s.
pub(crate) const MAX_INTERVAL_S: f64 = 1.0;
/// Range limit of the gyro, rad/s (2000 °/s).
const RATE_RANGE_RAD_S: f64 = 34.906_585;
/// Range limit of the accelerometer, m/s² (16 g).
const FORCE_RANGE_M_S2: f64 = 16.0 * GRAVITY_M_S2;
const LATERAL_ACCELERATION_M_S2: f64 = 10.0;
const NON_FINITE: [f64; 3] = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY];

/// Fault of the sensors, the timestamps or the motion.
#[derive(Debug, Clone, Copy)]
pub struct Fault {
    /// Name of the fault and of its row in `recovery.csv`.
    pub name: &'static str,
    /// Duration, s.
    pub duration_s: f64,
    /// Replaces the ticks during the fault. The second argument is the last tick before the fault.
    transform: fn(&[Tick], &Tick) -> Vec<Tick>,
    /// Changes each tick after the fault.
    transform_after: fn(&mut Tick),
}

impl Fault {
    /// Returns the script with this fault applied.
    pub fn apply(&self, script: &Script) -> Script {
        let [start, end] = [FAULT_START_S, FAULT_START_S + self.duration_s].map(|t_s| script.ticks_before(t_s));
        let (before, rest) = script.ticks.split_at(start);
        let (during, after) = rest.split_at(end - start);
        let mut ticks = before.to_vec();
        if let Some(last) = before.last() {
            ticks.extend((self.transform)(during, last));
        }
        ticks.extend(after.iter().copied().map(|mut tick| {
            (self.transform_after)(&mut tick);
            tick
        }));
        Script { name: format!("{}, {}", script.name, self.name), ticks }
    }
}

/// Returns the ticks with `change` applied to each.
fn map_each(ticks: &[Tick], mut change: impl FnMut(usize, &mut Tick)) -> Vec<Tick> {
    let mut changed = ticks.to_vec();
    changed.iter_mut().enumerate().for_each(|(i, tick)| change(i, tick));
    changed
}

macro_rules! catalogue {
    ($($name:literal for $duration_s:literal: $change:expr $(, then $after:expr)?;)*) => {
        /// All faults.
        pub const CATALOGUE: &[Fault] = &[$(Fault {
            name: $name,
            duration_s: $duration_s,
            transform: $change,
            transform_after: catalogue!(@after $($after)?),
        },)*];
    };
    (@after) => { |_| () };
    (@after $after:expr) => { $after };
}

catalogue! {
    "gyro stuck" for 3.0: |ticks, last| map_each(ticks, |_, tick| {
        (tick.rate_rad_s, tick.rest_credible, tick.rate_credible) = (last.rate_rad_s, false, false);
    });
    "accelerometer stuck" for 3.0: |ticks, last| map_each(ticks, |_, tick| {
        (tick.force_m_s2, tick.rest_credible) = (last.force_m_s2, false);
    });
    "magnetometer stuck" for 10.0: |ticks, _| {
        let stuck = ticks.iter().find_map(|tick| tick.field_ut);
        map_each(ticks, |_, tick| tick.field_ut = tick.field_ut.and(stuck))
    };
    "gyro outage" for 0.5: |ticks, _| map_each(ticks, |_, tick| tick.rate_rad_s = None);
    "long gyro outage" for 3.0: |ticks, _| map_each(ticks, |_, tick| tick.rate_rad_s = None);
    "accelerometer outage" for 3.0: |ticks, _| map_each(ticks, |_, tick| tick.force_m_s2 = None);
    "field and fix outage" for 10.0: |ticks, _| map_each(ticks, |_, tick| (tick.field_ut, tick.fix) = (None, None));
    "outage of all sensors" for 1.0: |ticks, _| map_each(ticks, |_, tick| {
        (tick.rate_rad_s, tick.force_m_s2, tick.field_ut, tick.fix) = (None, None, None, None);
    });
    "gap" for 0.9: |ticks, last| match ticks {
        [.., tick] => vec![Tick { dt_s: tick.t_s - last.t_s, ..*tick }],
        [] => Vec::new(),
    };
    "samples in bursts" for 2.0: |ticks, _| map_each(ticks, |i, tick| tick.dt_s *= if i % 10 == 9 { 10.0 } else { 0.0 });
    "duplicated samples" for 1.0: |ticks, _| ticks.iter().flat_map(|tick| [*tick, Tick { dt_s: 0.0, ..*tick }]).collect();
    "samples in swapped pairs" for 1.0: |ticks, _| {
        let swapped = |pair: &[Tick]| pair.iter().rev().copied().collect::<Vec<_>>();
        ticks.chunks(2).flat_map(swapped).collect()
    };
    "constant timestamps" for 1.0: |ticks, _| map_each(ticks, |_, tick| tick.dt_s = 0.0);
    "one timestamp jump" for 0.01: |ticks, _| map_each(ticks, |_, tick| tick.dt_s = MAX_INTERVAL_S);
    "repeated timestamp jumps" for 1.0: |ticks, _| map_each(ticks, |i, tick| tick.dt_s = if i % 2 == 0 { MAX_INTERVAL_S } else { 1e-9 });
    "gyro clipped" for 1.0: |ticks, _| map_each(ticks, |_, tick| {
        tick.rate_rad_s = tick.rate_rad_s.map(|rate| Vector3::new(rate.x, rate.y, RATE_RANGE_RAD_S));
        tick.rate_credible = false;
    });
    "accelerometer clipped" for 1.0: |ticks, _| map_each(ticks, |_, tick| {
        tick.force_m_s2 = tick.force_m_s2.map(|force| Vector3::new(FORCE_RANGE_M_S2, force.y, -FORCE_RANGE_M_S2));
    });
    "rate spike" for 0.01: |ticks, _| map_each(ticks, |_, tick| {
        tick.rate_rad_s = Some(Vector3::new(RATE_RANGE_RAD_S, -RATE_RANGE_RAD_S, 0.0));
    });
    "force spike" for 0.01: |ticks, _| map_each(ticks, |_, tick| {
        tick.force_m_s2 = Some(Vector3::new(0.0, -FORCE_RANGE_M_S2, FORCE_RANGE_M_S2));
    });
    "gyro bias step" for 10.0: |ticks, _| map_each(ticks, |_, tick| {
        tick.rate_rad_s = tick.rate_rad_s.map(|rate| rate.add_scalar(0.5f64.to_radians()));
    });
    "degrees for radians" for 2.0: |ticks, _| map_each(ticks, |_, tick| {
        tick.rate_rad_s = tick.rate_rad_s.map(|rate| rate.map(f64::to_degrees));
    });
    "swapped axes" for 3.0: |ticks, _| {
        let swapped = |v: Vector3<f64>| Vector3::new(v.y, v.z, v.x);
        map_each(ticks, |_, tick| {
            (tick.rate_rad_s, tick.force_m_s2) = (tick.rate_rad_s.map(swapped), tick.force_m_s2.map(swapped));
        })
    };
    "noise × 10" for 10.0: |ticks, _| {
        let (mut rate_noise, mut force_noise) = (noise(4), noise(5));
        map_each(ticks, |_, tick| {
            tick.rate_rad_s = tick.rate_rad_s.map(|rate| rate + rate_noise() * 1f64.to_radians());
            tick.force_m_s2 = tick.force_m_s2.map(|force| force + force_noise() * (0.1 * GRAVITY_M_S2));
        })
    };
    "half the sample rate" for 10.0: |ticks, _| {
        ticks.iter().skip(1).step_by(2).map(|tick| Tick { dt_s: 2.0 * tick.dt_s, ..*tick }).collect()
    };
    "free fall" for 2.0: |ticks, last| map_each(ticks, |_, tick| {
        tick.force_m_s2 = Some(Vector3::zeros());
        add_fall_velocity(tick, tick.t_s - last.t_s);
    }), then |tick| add_fall_velocity(tick, 2.0);
    "lateral acceleration" for 10.0: |ticks, last| map_each(ticks, |_, tick| {
        let acceleration = tick.truth.matrix() * Vector3::new(LATERAL_ACCELERATION_M_S2, 0.0, 0.0);
        tick.force_m_s2 = tick.force_m_s2.map(|force| force + acceleration);
        add_lateral_velocity(tick, tick.t_s - last.t_s);
    }), then |tick| add_lateral_velocity(tick, 10.0);
    "magnetic disturbance" for 5.0: |ticks, _| map_each(ticks, |_, tick| {
        tick.field_ut = tick.field_ut.map(|field| field + Vector3::new(100.0, -30.0, 0.0));
    });
    "zero magnetic field" for 2.0: |ticks, _| map_each(ticks, |_, tick| tick.field_ut = tick.field_ut.map(|_| Vector3::zeros()));
    "non-finite rate" for 0.1: |ticks, _| map_each(ticks, |i, tick| tick.rate_rad_s = Some(non_finite_vector(i)));
    "non-finite force" for 0.1: |ticks, _| map_each(ticks, |i, tick| tick.force_m_s2 = Some(non_finite_vector(i)));
    "non-finite interval" for 0.03: |ticks, _| map_each(ticks, |i, tick| tick.dt_s = NON_FINITE[i % 3]);
    "non-finite field" for 2.0: |ticks, _| map_each(ticks, |i, tick| tick.field_ut = Some(non_finite_vector(i)));
    "non-finite fix" for 2.0: |ticks, _| map_each(ticks, |i, tick| {
        if let Some(fix) = &mut tick.fix {
            let x = NON_FINITE[i / 20 % 3];
            (fix.sd_m_s, fix.age_s, fix.latitude_rad) = (Some(x), Some(x), Some(x));
            fix.velocity_m_s = if i % 40 == 0 { non_finite_vector(i) } else { fix.velocity_m_s };
        }
    });
    "wrong velocity" for 2.0: |ticks, _| map_each(ticks, |i, tick| {
        let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
        if let Some(fix) = &mut tick.fix {
            fix.velocity_m_s = Vector3::new(1000.0 * sign, 300.0, 0.0);
            fix.sd_m_s = Some(0.0);
        }
    });
}

/// Returns a vector with one non-finite component.
fn non_finite_vector(i: usize) -> Vector3<f64> {
    let mut vector = Vector3::new(0.1, 0.2, 0.3);
    vector[i % 3] = NON_FINITE[i / 3 % 3];
    vector
}

/// Adds to the fix the velocity gained in a fall that lasts `duration_s`.
fn add_fall_velocity(tick: &mut Tick, duration_s: f64) {
    if let Some(fix) = &mut tick.fix {
        fix.velocity_m_s.z -= GRAVITY_M_S2 * duration_s;
    }
}

/// Adds to the fix the velocity gained by a lateral acceleration that lasts `duration_s`.
fn add_lateral_velocity(tick: &mut Tick, duration_s: f64) {
    if let Some(fix) = &mut tick.fix {
        fix.velocity_m_s.x += LATERAL_ACCELERATION_M_S2 * duration_s;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::script::S1;

    #[test]
    fn faults_change_only_ticks_from_fault_start() {
        for fault in CATALOGUE {
            let faulty = fault.apply(&S1);
            let start = S1.ticks_before(FAULT_START_S);
            assert_eq!(faulty.ticks[..start], S1.ticks[..start], "{}", fault.name);
            assert_ne!(faulty.ticks[start..], S1.ticks[start..], "{}", fault.name);
            assert_eq!(faulty.ticks.last().map(|tick| tick.t_s), S1.ticks.last().map(|tick| tick.t_s));
        }
    }

    #[test]
    fn fault_intervals_do_not_exceed_max_interval() {
        for tick in CATALOGUE.iter().flat_map(|fault| fault.apply(&S1).ticks) {
            assert!((0.0..=MAX_INTERVAL_S).contains(&tick.dt_s) || !tick.dt_s.is_finite(), "{tick:?}");
        }
    }
}
