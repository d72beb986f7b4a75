//! The catalogue of faults: what sensors, stamps and vehicles do to a stage.
//!
//! Input: a script. Output: the script with one fault from [`BEGIN_S`] on. Time: the ticks' own. Failure: none.
//!
//! A stage stands behind ingest, which makes stamps grow and values finite; so a stamp that stands, repeats or runs backward is an
//! interval of zero here, and a leap is an interval of up to `BRIDGE_S`. A value that is not a number is handed over as it is, for
//! a stage may be used without ingest: to the stage it is a missing one.

use attitude::{GRAVITY_M_S2, Vector3};

use crate::script::{Script, Tick, noise};

/// Where every fault begins, s: estimates have settled.
pub const BEGIN_S: f64 = 20.0;
/// The longest interval that a stage is ever told, s.
pub(crate) const BRIDGE_S: f64 = 1.0;
/// The end of a gyro's range, rad/s: 2000 °/s.
const RATE_RANGE_RAD_S: f64 = 34.906_585;
/// The end of an accelerometer's range, m/s²: 16 g.
const FORCE_RANGE_M_S2: f64 = 16.0 * GRAVITY_M_S2;
const LATERAL_M_S2: f64 = 10.0;
/// What is not a number.
const NOT_FINITE: [f64; 3] = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY];

/// One fault.
#[derive(Debug, Clone, Copy)]
pub struct Fault {
    /// What it is.
    pub name: &'static str,
    /// How long it lasts, s.
    pub duration_s: f64,
    /// What becomes of its ticks; the last good one is given too.
    change: fn(&[Tick], &Tick) -> Vec<Tick>,
    /// What it leaves behind in the ticks after it.
    after: fn(&mut Tick),
}

impl Fault {
    /// The script with this fault in it.
    pub fn put_in(&self, script: &Script) -> Script {
        let [begin, end] = [BEGIN_S, BEGIN_S + self.duration_s].map(|t_s| script.ticks_before(t_s));
        let (before, rest) = script.ticks.split_at(begin);
        let (during, after) = rest.split_at(end - begin);
        let mut ticks = before.to_vec();
        if let Some(last) = before.last() {
            ticks.extend((self.change)(during, last));
        }
        ticks.extend(after.iter().copied().map(|mut tick| {
            (self.after)(&mut tick);
            tick
        }));
        Script { name: format!("{}, {}", script.name, self.name), ticks }
    }
}

/// Every tick changed by itself.
fn each(ticks: &[Tick], mut change: impl FnMut(usize, &mut Tick)) -> Vec<Tick> {
    let mut changed = ticks.to_vec();
    changed.iter_mut().enumerate().for_each(|(i, tick)| change(i, tick));
    changed
}

macro_rules! catalogue {
    ($($name:literal for $duration_s:literal: $change:expr $(, then $after:expr)?;)*) => {
        /// Every fault.
        pub const CATALOGUE: &[Fault] = &[$(Fault {
            name: $name,
            duration_s: $duration_s,
            change: $change,
            after: catalogue!(@after $($after)?),
        },)*];
    };
    (@after) => { |_| () };
    (@after $after:expr) => { $after };
}

catalogue! {
    "gyro stuck" for 3.0: |ticks, last| each(ticks, |_, tick| {
        (tick.rate_rad_s, tick.rest_credible, tick.rate_credible) = (last.rate_rad_s, false, false);
    });
    "accelerometer stuck" for 3.0: |ticks, last| each(ticks, |_, tick| {
        (tick.force_m_s2, tick.rest_credible) = (last.force_m_s2, false);
    });
    "magnetometer stuck" for 10.0: |ticks, _| {
        let stuck = ticks.iter().find_map(|tick| tick.field_ut);
        each(ticks, |_, tick| tick.field_ut = tick.field_ut.and(stuck))
    };
    "no gyro" for 0.5: |ticks, _| each(ticks, |_, tick| tick.rate_rad_s = None);
    "no gyro for long" for 3.0: |ticks, _| each(ticks, |_, tick| tick.rate_rad_s = None);
    "no accelerometer" for 3.0: |ticks, _| each(ticks, |_, tick| tick.force_m_s2 = None);
    "neither field nor fix" for 10.0: |ticks, _| each(ticks, |_, tick| (tick.field_ut, tick.fix) = (None, None));
    "nothing" for 1.0: |ticks, _| each(ticks, |_, tick| {
        (tick.rate_rad_s, tick.force_m_s2, tick.field_ut, tick.fix) = (None, None, None, None);
    });
    "gap" for 0.9: |ticks, last| match ticks {
        [.., tick] => vec![Tick { dt_s: tick.t_s - last.t_s, ..*tick }],
        [] => Vec::new(),
    };
    "samples in bursts" for 2.0: |ticks, _| each(ticks, |i, tick| tick.dt_s *= if i % 10 == 9 { 10.0 } else { 0.0 });
    "every sample twice" for 1.0: |ticks, _| ticks.iter().flat_map(|tick| [*tick, Tick { dt_s: 0.0, ..*tick }]).collect();
    "samples in swapped pairs" for 1.0: |ticks, _| {
        let swapped = |pair: &[Tick]| pair.iter().rev().copied().collect::<Vec<_>>();
        ticks.chunks(2).flat_map(swapped).collect()
    };
    "stamps that stand" for 1.0: |ticks, _| each(ticks, |_, tick| tick.dt_s = 0.0);
    "one leap of the stamps" for 0.01: |ticks, _| each(ticks, |_, tick| tick.dt_s = BRIDGE_S);
    "leaping stamps" for 1.0: |ticks, _| each(ticks, |i, tick| tick.dt_s = if i % 2 == 0 { BRIDGE_S } else { 1e-9 });
    "gyro clipped" for 1.0: |ticks, _| each(ticks, |_, tick| {
        tick.rate_rad_s = tick.rate_rad_s.map(|rate| Vector3::new(rate.x, rate.y, RATE_RANGE_RAD_S));
        tick.rate_credible = false;
    });
    "accelerometer clipped" for 1.0: |ticks, _| each(ticks, |_, tick| {
        tick.force_m_s2 = tick.force_m_s2.map(|force| Vector3::new(FORCE_RANGE_M_S2, force.y, -FORCE_RANGE_M_S2));
    });
    "rate spike" for 0.01: |ticks, _| each(ticks, |_, tick| {
        tick.rate_rad_s = Some(Vector3::new(RATE_RANGE_RAD_S, -RATE_RANGE_RAD_S, 0.0));
    });
    "force spike" for 0.01: |ticks, _| each(ticks, |_, tick| {
        tick.force_m_s2 = Some(Vector3::new(0.0, -FORCE_RANGE_M_S2, FORCE_RANGE_M_S2));
    });
    "gyro bias step" for 10.0: |ticks, _| each(ticks, |_, tick| {
        tick.rate_rad_s = tick.rate_rad_s.map(|rate| rate.add_scalar(0.5f64.to_radians()));
    });
    "degrees for radians" for 2.0: |ticks, _| each(ticks, |_, tick| {
        tick.rate_rad_s = tick.rate_rad_s.map(|rate| rate.map(f64::to_degrees));
    });
    "swapped axes" for 3.0: |ticks, _| {
        let swapped = |v: Vector3<f64>| Vector3::new(v.y, v.z, v.x);
        each(ticks, |_, tick| {
            (tick.rate_rad_s, tick.force_m_s2) = (tick.rate_rad_s.map(swapped), tick.force_m_s2.map(swapped));
        })
    };
    "noise × 10" for 10.0: |ticks, _| {
        let (mut rate_noise, mut force_noise) = (noise(4), noise(5));
        each(ticks, |_, tick| {
            tick.rate_rad_s = tick.rate_rad_s.map(|rate| rate + rate_noise() * 1f64.to_radians());
            tick.force_m_s2 = tick.force_m_s2.map(|force| force + force_noise() * (0.1 * GRAVITY_M_S2));
        })
    };
    "half the rate" for 10.0: |ticks, _| {
        ticks.iter().skip(1).step_by(2).map(|tick| Tick { dt_s: 2.0 * tick.dt_s, ..*tick }).collect()
    };
    "free fall" for 2.0: |ticks, last| each(ticks, |_, tick| {
        tick.force_m_s2 = Some(Vector3::zeros());
        fall(tick, tick.t_s - last.t_s);
    }), then |tick| fall(tick, 2.0);
    "lateral acceleration" for 10.0: |ticks, last| each(ticks, |_, tick| {
        let acceleration = tick.truth.matrix() * Vector3::new(LATERAL_M_S2, 0.0, 0.0);
        tick.force_m_s2 = tick.force_m_s2.map(|force| force + acceleration);
        sweep(tick, tick.t_s - last.t_s);
    }), then |tick| sweep(tick, 10.0);
    "magnetic disturbance" for 5.0: |ticks, _| each(ticks, |_, tick| {
        tick.field_ut = tick.field_ut.map(|field| field + Vector3::new(100.0, -30.0, 0.0));
    });
    "no magnetic field" for 2.0: |ticks, _| each(ticks, |_, tick| tick.field_ut = tick.field_ut.map(|_| Vector3::zeros()));
    "rate not a number" for 0.1: |ticks, _| each(ticks, |i, tick| tick.rate_rad_s = Some(not_finite(i)));
    "force not a number" for 0.1: |ticks, _| each(ticks, |i, tick| tick.force_m_s2 = Some(not_finite(i)));
    "interval not a number" for 0.03: |ticks, _| each(ticks, |i, tick| tick.dt_s = NOT_FINITE[i % 3]);
    "field not a number" for 2.0: |ticks, _| each(ticks, |i, tick| tick.field_ut = Some(not_finite(i)));
    "fix not a number" for 2.0: |ticks, _| each(ticks, |i, tick| {
        if let Some(fix) = &mut tick.fix {
            let x = NOT_FINITE[i / 20 % 3];
            (fix.sd_m_s, fix.age_s, fix.latitude_rad) = (Some(x), Some(x), Some(x));
            fix.velocity_m_s = if i % 40 == 0 { not_finite(i) } else { fix.velocity_m_s };
        }
    });
    "a wrong velocity" for 2.0: |ticks, _| each(ticks, |i, tick| {
        let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
        if let Some(fix) = &mut tick.fix {
            fix.velocity_m_s = Vector3::new(1000.0 * sign, 300.0, 0.0);
            fix.sd_m_s = Some(0.0);
        }
    });
}

/// A vector with one component that is not finite.
fn not_finite(i: usize) -> Vector3<f64> {
    let mut vector = Vector3::new(0.1, 0.2, 0.3);
    vector[i % 3] = NOT_FINITE[i / 3 % 3];
    vector
}

/// Falling, or fallen and not stopped, for so long.
fn fall(tick: &mut Tick, duration_s: f64) {
    if let Some(fix) = &mut tick.fix {
        fix.velocity_m_s.z -= GRAVITY_M_S2 * duration_s;
    }
}

/// The speed that so much lateral acceleration leaves.
fn sweep(tick: &mut Tick, duration_s: f64) {
    if let Some(fix) = &mut tick.fix {
        fix.velocity_m_s.x += LATERAL_M_S2 * duration_s;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::script::S1;

    #[test]
    fn every_fault_changes_its_own_time_and_nothing_before() {
        for fault in CATALOGUE {
            let faulty = fault.put_in(&S1);
            let begin = S1.ticks_before(BEGIN_S);
            assert_eq!(faulty.ticks[..begin], S1.ticks[..begin], "{}", fault.name);
            assert_ne!(faulty.ticks[begin..], S1.ticks[begin..], "{}", fault.name);
            assert_eq!(faulty.ticks.last().map(|tick| tick.t_s), S1.ticks.last().map(|tick| tick.t_s));
        }
    }

    #[test]
    fn no_stage_is_told_an_interval_beyond_the_bridge() {
        for tick in CATALOGUE.iter().flat_map(|fault| fault.put_in(&S1).ticks) {
            assert!((0.0..=BRIDGE_S).contains(&tick.dt_s) || !tick.dt_s.is_finite(), "{tick:?}");
        }
    }
}
