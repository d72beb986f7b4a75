//! Parameters: their table tells the truth, and no allowed value makes a stage unsound.

use attitude::parameters::{Parameter, ParameterError};

use crate::{
    fault::{BEGIN_S, CATALOGUE},
    repetition::resumed,
    report::Check,
    run::{Begun, parting, unsound},
    script::{S1, SHORT},
    slot::{Fills, Slot},
};

/// Units as the end of a name has them.
const UNITS: [(&str, &str); 12] = [
    ("s", "_s"),
    ("Hz", "_hz"),
    ("°", "_deg"),
    ("°/s", "_deg_s"),
    ("rad", "_rad"),
    ("rad/s", "_rad_s"),
    ("m/s²", "_m_s2"),
    ("m/s", "_m_s"),
    ("µT", "_ut"),
    ("g", "_g"),
    ("1/s", "_1_s"),
    ("m", "_m"),
];

pub(crate) fn checks<L: Slot, S: Fills<L>>(make: &impl Fn() -> S) -> Vec<Check> {
    let table = make().parameters();
    let untold = table.iter().find_map(|parameter| told(parameter).map(|flaw| format!("{}: {flaw}", parameter.name)));
    let mut checks = vec![Check::holds("parameters tell unit, range and meaning", untold)];
    checks.push(Check::holds("what is no parameter, or outside its range, is refused", refused::<L, S>(make, table)));
    let same = table.iter().find_map(|parameter| {
        let mut stage = make();
        let set =
            [parameter.max, parameter.min, parameter.default].map(|value| stage.set(parameter.name, value).err());
        if let Some(refusal) = set.into_iter().flatten().next() {
            return Some(refusal.to_string());
        }
        let tick = parting::<L, S>(&mut stage, &mut make(), &L::inputs(&SHORT[0]))?;
        Some(format!("{} set to its default: another output at tick {tick}", parameter.name))
    });
    checks.push(Check::holds("a parameter set to its default changes nothing", same));
    for parameter in table {
        for value in [parameter.min, parameter.max] {
            let name = format!("sound and resumable with {} = {value} {}", parameter.name, parameter.unit);
            checks.push(Check::holds(name.trim_end(), bad_with::<L, S>(make, parameter, value)));
        }
    }
    checks
}

fn told(parameter: &Parameter) -> Option<String> {
    let Parameter { name, unit, default, min: least, max: most, description: about } = parameter;
    if !(least <= default && default <= most && least < most) {
        return Some(format!("default {default} in {least} to {most}"));
    }
    if about.is_empty() {
        return Some("its meaning is not told".into());
    }
    let ending = UNITS.iter().find(|(known, _)| known == unit).map(|(_, ending)| ending);
    ending.filter(|ending| !name.ends_with(**ending)).map(|ending| format!("its name does not end in {ending}"))
}

fn refused<L: Slot, S: Fills<L>>(make: &impl Fn() -> S, table: &'static [Parameter]) -> Option<String> {
    let mut stage = make();
    if !matches!(stage.set("no_such_parameter", 1.0), Err(ParameterError::Unknown { .. })) {
        return Some("no_such_parameter is taken".into());
    }
    for Parameter { name, min: least, max: most, .. } in table {
        let beyond = |x: f64| x.abs().max(1.0) * 1e-9;
        for value in [least - beyond(*least), most + beyond(*most), f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            if !matches!(stage.set(name, value), Err(ParameterError::OutOfRange { .. })) {
                return Some(format!("{name} = {value} is taken"));
            }
        }
    }
    let tick = parting::<L, S>(&mut stage, &mut make(), &L::inputs(&SHORT[0]))?;
    Some(format!("what was refused changed the output at tick {tick}"))
}

fn bad_with<L: Slot, S: Fills<L>>(make: &impl Fn() -> S, parameter: &Parameter, value: f64) -> Option<String> {
    let mut set = make();
    if let Err(refusal) = set.set(parameter.name, value) {
        return Some(refusal.to_string());
    }
    let in_faults = || {
        let begun = Begun::<L, S>::new(set.clone(), &SHORT[0], SHORT[0].ticks_before(BEGIN_S));
        CATALOGUE.iter().find_map(|fault| begun.on(&fault.put_in(&SHORT[0])).flaw)
    };
    unsound::<L, S>(&mut set.clone(), &SHORT[1])
        .or_else(in_faults)
        .or_else(|| resumed::<L, S>(&|| set.clone(), &S1, 500))
}
