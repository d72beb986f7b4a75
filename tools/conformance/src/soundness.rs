//! Every output is finite and a rotation, whatever the sensors do.

use attitude::{Vector3, gnss::Fix};

use crate::{
    fault::{BEGIN_S, BRIDGE_S, CATALOGUE},
    report::Check,
    run::{Begun, unsound},
    script::{S1, SHORT, Script, Tick},
    slot::{Fills, Slot},
};

/// Numbers that are finite and no measurement.
const ABSURD: [f64; 7] = [0.0, 1e-300, 1e4, -1e9, 1e30, -1e100, f64::MAX];

/// Puts a number into one place of a tick; a fix is given as a pattern.
type Put = fn(&mut Tick, f64, Option<Fix>);

pub(crate) fn checks<L: Slot, S: Fills<L>>(make: &impl Fn() -> S) -> Vec<Check> {
    let clean = SHORT.iter().chain([&*S1]).find_map(|script| unsound::<L, S>(&mut make(), script));
    let mut checks = vec![Check::holds("outputs are finite and rotations without a fault", clean)];
    // On S1 that is a part of the recovery.
    let begun = SHORT.iter().map(|script| (script, Begun::<L, S>::new(make(), script, script.ticks_before(BEGIN_S))));
    let begun: Vec<_> = begun.collect();
    for fault in CATALOGUE {
        let failed_at = begun.iter().find_map(|(script, begun)| begun.on(&fault.put_in(script)).flaw);
        checks.push(Check::holds(format!("outputs are finite and rotations under {}", fault.name), failed_at));
    }
    let mut from_the_start = S1.clone();
    from_the_start.ticks.drain(..300);
    let late = |clear: fn(&mut Tick)| {
        let mut script = from_the_start.clone();
        script.ticks.iter_mut().take(500).for_each(clear);
        unsound::<L, S>(&mut make(), &script)
    };
    let starts = late(|tick| tick.rate_rad_s = None)
        .or_else(|| late(|tick| tick.force_m_s2 = None))
        .or_else(|| late(|tick| (tick.rate_rad_s, tick.force_m_s2) = (None, None)))
        .or_else(|| late(|tick| tick.dt_s = 0.0));
    checks.push(Check::holds("outputs are finite and rotations when a sensor or the clock starts late", starts));
    checks.push(Check::holds("outputs are finite and rotations for absurd numbers", absurd::<L, S>(make)));
    checks
}

/// Absurd numbers, each by itself in every place, for some ticks in the midst of a good run.
fn absurd<L: Slot, S: Fills<L>>(make: &impl Fn() -> S) -> Option<String> {
    let good = Script { name: "good".into(), ticks: S1.ticks[..1500].to_vec() };
    let begun = Begun::<L, S>::new(make(), &good, 1000);
    let fix = S1.ticks[0].fix;
    let places: [(&str, Put); 6] = [
        ("rate", |tick, x, _| tick.rate_rad_s = Some(Vector3::new(x, -x, 0.1))),
        ("force", |tick, x, _| tick.force_m_s2 = Some(Vector3::new(0.1, x, -x))),
        ("field", |tick, x, _| tick.field_ut = Some(Vector3::new(-x, 0.1, x))),
        ("velocity", |tick, x, fix| {
            tick.fix = fix.map(|fix| Fix { velocity_m_s: Vector3::new(x, 0.1, -x), ..fix });
        }),
        ("accuracy and age", |tick, x, fix| {
            let said = Some(x.abs());
            tick.fix = fix.map(|fix| Fix { sd_m_s: said, age_s: said, latitude_rad: Some(x), ..fix });
        }),
        ("everything", |tick, x, fix| {
            let vector = Vector3::new(x, x, -x);
            (tick.rate_rad_s, tick.force_m_s2, tick.field_ut) = (Some(vector), Some(vector), Some(vector));
            tick.fix = fix.map(|fix| Fix { velocity_m_s: vector, ..fix });
        }),
    ];
    for (place, put) in places {
        for x in ABSURD {
            for dt_s in [0.01, 0.0, BRIDGE_S] {
                let mut ticks = good.ticks.clone();
                for tick in &mut ticks[1000..1010] {
                    put(tick, x, fix);
                    tick.dt_s = dt_s;
                }
                let script = Script { name: format!("{place} {x:e}, interval {dt_s} s"), ticks };
                let outcome = begun.on(&script);
                let refused = || {
                    let refusal = make().restore(&outcome.stage.snapshot()).err()?;
                    Some(format!("{}: then its own record is refused: {refusal}", script.name))
                };
                let failed_at = outcome.flaw.clone().or_else(refused);
                if failed_at.is_some() {
                    return failed_at;
                }
            }
        }
    }
    None
}
