//! Checks the declarations of the parameters, and that a stage works with every allowed value.

use attitude::parameters::{Parameter, ParameterError};

use crate::{
    budget::Budget,
    fault::{CATALOGUE, FAULT_START_S},
    repeatability::restored_run_difference,
    report::Check,
    run::{PrefixRun, first_difference, first_invalid_output},
    script::{S1, SHORT_SCRIPTS},
    slot::{SlotSpec, SlotStage},
};

/// Each unit with the required suffix of the parameter name.
const UNIT_SUFFIXES: [(&str, &str); 12] = [
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

pub(crate) fn checks<L: SlotSpec, S: SlotStage<L>>(make: &impl Fn() -> S, budget: &Budget<'_>) -> Vec<Check> {
    let table = make().parameters();
    let undeclared = table
        .iter()
        .find_map(|parameter| declaration_error(parameter).map(|error| format!("{}: {error}", parameter.name)));
    let mut checks = vec![Check::property("parameters declare unit, range and description", undeclared)];
    budget.check_property(&mut checks, "unknown parameters and values out of range are rejected", || {
        rejection_error::<L, S>(make, table)
    });
    budget.check_property(&mut checks, "a parameter set to its default changes nothing", || {
        budget.cases(table).find_map(|parameter| {
            let mut stage = make();
            let errors =
                [parameter.max, parameter.min, parameter.default].map(|value| stage.set(parameter.name, value).err());
            if let Some(error) = errors.into_iter().flatten().next() {
                return Some(error.to_string());
            }
            let tick = first_difference::<L, S>(&mut stage, &mut make(), &L::inputs(&SHORT_SCRIPTS[0]))?;
            Some(format!("{} set to its default: the output differs at tick {tick}", parameter.name))
        })
    });
    for parameter in table {
        for value in [parameter.min, parameter.max] {
            let name = format!("valid and repeatable with {} = {value} {}", parameter.name, parameter.unit);
            budget
                .check_property(&mut checks, name.trim_end(), || invalid_with::<L, S>(make, parameter, value, budget));
        }
    }
    checks
}

fn declaration_error(parameter: &Parameter) -> Option<String> {
    let Parameter { name, unit, default, min, max, description } = parameter;
    if !(min <= default && default <= max && min < max) {
        return Some(format!("default {default} is not within {min} to {max}"));
    }
    if description.is_empty() {
        return Some("it has no description".into());
    }
    let suffix = UNIT_SUFFIXES.iter().find(|(known, _)| known == unit).map(|(_, suffix)| suffix);
    suffix.filter(|suffix| !name.ends_with(**suffix)).map(|suffix| format!("its name does not end in {suffix}"))
}

fn rejection_error<L: SlotSpec, S: SlotStage<L>>(make: &impl Fn() -> S, table: &'static [Parameter]) -> Option<String> {
    let mut stage = make();
    if !matches!(stage.set("no_such_parameter", 1.0), Err(ParameterError::Unknown { .. })) {
        return Some("no_such_parameter is accepted".into());
    }
    for Parameter { name, min, max, .. } in table {
        let margin = |x: f64| x.abs().max(1.0) * 1e-9;
        for value in [min - margin(*min), max + margin(*max), f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            if !matches!(stage.set(name, value), Err(ParameterError::OutOfRange { .. })) {
                return Some(format!("{name} = {value} is accepted"));
            }
        }
    }
    let tick = first_difference::<L, S>(&mut stage, &mut make(), &L::inputs(&SHORT_SCRIPTS[0]))?;
    Some(format!("a rejected value changed the output at tick {tick}"))
}

fn invalid_with<L: SlotSpec, S: SlotStage<L>>(
    make: &impl Fn() -> S,
    parameter: &Parameter,
    value: f64,
    budget: &Budget<'_>,
) -> Option<String> {
    let mut stage = make();
    if let Err(error) = stage.set(parameter.name, value) {
        return Some(error.to_string());
    }
    let in_faults = || {
        let prefix =
            PrefixRun::<L, S>::new(stage.clone(), &SHORT_SCRIPTS[0], SHORT_SCRIPTS[0].ticks_before(FAULT_START_S));
        budget.cases(CATALOGUE).find_map(|fault| prefix.resume(&fault.apply(&SHORT_SCRIPTS[0])).invalid_output)
    };
    first_invalid_output::<L, S>(&mut stage.clone(), &SHORT_SCRIPTS[1])
        .or_else(in_faults)
        .or_else(|| restored_run_difference::<L, S>(&|| stage.clone(), &S1, 500))
}
