//! Checks that every output is finite and a valid rotation under any sensor fault.

use attitude::{Vector3, gnss::Fix};

use crate::{
    budget::Budget,
    fault::{CATALOGUE, FAULT_START_S, MAX_INTERVAL_S},
    report::Check,
    run::{PrefixRun, first_invalid_output},
    script::{S1, SHORT_SCRIPTS, Script, Tick},
    slot::{SlotSpec, SlotStage},
};

/// Extreme finite numbers, most of them beyond the range of any measurement.
const EXTREME_NUMBERS: [f64; 7] = [0.0, 1e-300, 1e4, -1e9, 1e30, -1e100, f64::MAX];

/// Function that sets one quantity of a tick to a number. If the quantity belongs to a fix, the
/// other values of the fix are copied from the given fix.
type SetNumber = fn(&mut Tick, f64, Option<Fix>);

pub(crate) fn checks<L: SlotSpec, S: SlotStage<L>>(make: &impl Fn() -> S, budget: &Budget<'_>) -> Vec<Check> {
    let mut checks = Vec::new();
    budget.check_property(&mut checks, "outputs are valid without a fault", || {
        let scripts = SHORT_SCRIPTS.iter().chain([&*S1]);
        budget.cases(scripts).find_map(|script| first_invalid_output::<L, S>(&mut make(), script))
    });
    // S1 is left out, because the recovery checks cover it.
    let prefixes = SHORT_SCRIPTS
        .iter()
        .map(|script| (script, PrefixRun::<L, S>::new(make(), script, script.ticks_before(FAULT_START_S))));
    let prefixes: Vec<_> = prefixes.collect();
    for fault in CATALOGUE {
        budget.check_property(&mut checks, format!("outputs are valid under {}", fault.name), || {
            let mut prefixes = budget.cases(&prefixes);
            prefixes.find_map(|(script, prefix)| prefix.resume(&fault.apply(script)).invalid_output)
        });
    }
    let mut without_start = S1.clone();
    without_start.ticks.drain(..300);
    let late = |clear: fn(&mut Tick)| {
        let mut script = without_start.clone();
        script.ticks.iter_mut().take(500).for_each(clear);
        first_invalid_output::<L, S>(&mut make(), &script)
    };
    let starts: [fn(&mut Tick); 4] = [
        |tick| tick.rate_rad_s = None,
        |tick| tick.force_m_s2 = None,
        |tick| (tick.rate_rad_s, tick.force_m_s2) = (None, None),
        |tick| tick.dt_s = 0.0,
    ];
    budget.check_property(&mut checks, "outputs are valid if a sensor or the clock starts late", || {
        budget.cases(starts).find_map(late)
    });
    budget.check_property(&mut checks, "outputs are valid for extreme numbers", || {
        check_extreme_numbers::<L, S>(make, budget)
    });
    checks
}

/// Sets each quantity to each extreme number for ten ticks of an otherwise fault-free run.
fn check_extreme_numbers<L: SlotSpec, S: SlotStage<L>>(make: &impl Fn() -> S, budget: &Budget<'_>) -> Option<String> {
    let base = Script { name: "fault-free".into(), ticks: S1.ticks[..1500].to_vec() };
    let prefix = PrefixRun::<L, S>::new(make(), &base, 1000);
    let fix = S1.ticks[0].fix;
    let setters: [(&str, SetNumber); 6] = [
        ("rate", |tick, x, _| tick.rate_rad_s = Some(Vector3::new(x, -x, 0.1))),
        ("force", |tick, x, _| tick.force_m_s2 = Some(Vector3::new(0.1, x, -x))),
        ("field", |tick, x, _| tick.field_ut = Some(Vector3::new(-x, 0.1, x))),
        ("velocity", |tick, x, fix| {
            tick.fix = fix.map(|fix| Fix { velocity_m_s: Vector3::new(x, 0.1, -x), ..fix });
        }),
        ("velocity SD and age", |tick, x, fix| {
            let sd_or_age = Some(x.abs());
            tick.fix = fix.map(|fix| Fix { sd_m_s: sd_or_age, age_s: sd_or_age, latitude_rad: Some(x), ..fix });
        }),
        ("everything", |tick, x, fix| {
            let vector = Vector3::new(x, x, -x);
            (tick.rate_rad_s, tick.force_m_s2, tick.field_ut) = (Some(vector), Some(vector), Some(vector));
            tick.fix = fix.map(|fix| Fix { velocity_m_s: vector, ..fix });
        }),
    ];
    let intervals_s = [0.01, 0.0, MAX_INTERVAL_S];
    let numbers = intervals_s.into_iter().flat_map(|dt_s| EXTREME_NUMBERS.map(|x| (x, dt_s)));
    let cases = numbers.flat_map(|(x, dt_s)| setters.map(|(name, set)| (name, set, x, dt_s)));
    budget.cases(cases).find_map(|(name, set, x, dt_s)| {
        let mut ticks = base.ticks.clone();
        for tick in &mut ticks[1000..1010] {
            set(tick, x, fix);
            tick.dt_s = dt_s;
        }
        let script = Script { name: format!("{name} {x:e}, interval {dt_s} s"), ticks };
        let run = prefix.resume(&script);
        let rejected = || {
            let error = make().restore(&run.stage.snapshot()).err()?;
            Some(format!("{}: the snapshot after it is rejected: {error}", script.name))
        };
        run.invalid_output.clone().or_else(rejected)
    })
}
