//! Checks how long the inclination error takes to recover after each fault.
//!
//! `recovery.csv` lists the limits for each stage. A fuser without its own column uses the column
//! `any`. In the other slots, a stage without its own column uses the column of the slot's first
//! stage. Gyro stages have no limits, because an open-loop attitude never recovers.
//!
//! Failure: an invalid output also fails the check.

use std::sync::LazyLock;

use launch::Slot;

use crate::{
    budget::Budget,
    fault::{CATALOGUE, FAULT_START_S, Fault},
    report::{Check, Measurement},
    run::{PrefixRun, rms},
    script::{ROUNDING_S, S1},
    slot::{SlotSpec, SlotStage},
};

/// Margin of the error bound, degrees. The bound is a multiple of the undisturbed RMSE plus this
/// margin.
const MARGIN_DEG: f64 = 0.05;
/// Column for fusers that have no separate column.
const OTHER_FUSERS: &str = "any";
/// Row with the upper limit of the undisturbed RMSE, degrees.
const RMSE_ROW: &str = "undisturbed RMSE °";
/// Row with the multiple of the undisturbed RMSE below which a stage counts as recovered.
const FACTOR_ROW: &str = "multiple of undisturbed RMSE";

/// Table with one column per stage. [`RMSE_ROW`] and [`FACTOR_ROW`] are followed by one row per
/// fault with the maximum recovery time, s. An entry is `none` without a limit.
static TABLE: LazyLock<Vec<Vec<&'static str>>> = LazyLock::new(|| {
    let rows = include_str!("../recovery.csv").lines().filter(|line| !line.starts_with('#'));
    rows.map(|row| row.split(',').map(str::trim).collect()).collect()
});

/// Returns an entry of the table, or `None` if it is `none` or missing.
fn table_value<L: SlotSpec>(row: &str, stage: &str) -> Option<f64> {
    let column = |name: &str| TABLE.first()?.iter().position(|column| *column == name);
    let default = if L::SLOT == Slot::Fuser { OTHER_FUSERS } else { L::SLOT.stages().first()? };
    let column = column(stage).or_else(|| column(default))?;
    TABLE.iter().find(|cells| cells.first() == Some(&row))?.get(column)?.parse().ok()
}

pub(crate) fn checks<L: SlotSpec, S: SlotStage<L>>(make: &impl Fn() -> S, budget: &Budget<'_>) -> Vec<Check> {
    if !budget.starts("inclination RMSE on S1 with sensor errors") {
        return Vec::new();
    }
    let stage = make();
    let prefix = PrefixRun::<L, S>::new(make(), &S1, S1.ticks_before(FAULT_START_S));
    let undisturbed = prefix.resume(&S1);
    if undisturbed.invalid_output.is_some() {
        return vec![Check::property("recovers from faults on S1 with sensor errors", undisturbed.invalid_output)];
    }
    let rmse_deg = rms(undisturbed.errors_deg.iter().map(|(_, error_deg)| *error_deg));
    let bound_deg = table_value::<L>(FACTOR_ROW, stage.name()).unwrap_or(f64::INFINITY) * rmse_deg + MARGIN_DEG;
    let undisturbed =
        Measurement { value: Some(rmse_deg), limit: table_value::<L>(RMSE_ROW, stage.name()), unit: "°" };
    let mut checks =
        vec![Check::at_most("inclination RMSE on S1 with sensor errors", undisturbed, || "undisturbed".into())];
    for fault in CATALOGUE {
        let name = format!("recovers from {} to within {bound_deg:.2}°", fault.name);
        if !budget.starts(&name) {
            continue;
        }
        let limit = table_value::<L>(fault.name, stage.name());
        let run = prefix.resume(&fault.apply(&S1));
        checks.push(match run.invalid_output {
            Some(error) => Check::property(name, Some(error)),
            None => {
                let measurement =
                    Measurement { value: recovery_s(fault, &run.errors_deg, bound_deg), limit, unit: "s" };
                Check::at_most(name, measurement, || "the inclination error stays above the bound".into())
            }
        });
    }
    checks
}

/// Returns the time in seconds from the end of the fault until the error stays within the bound.
/// Returns `None` if the last error of the script exceeds the bound.
///
/// `errors_deg` begins at the start of the fault.
fn recovery_s(fault: &Fault, errors_deg: &[(f64, f64)], bound_deg: f64) -> Option<f64> {
    let last = errors_deg.iter().rposition(|(_, error_deg)| !(0.0..=bound_deg).contains(error_deg));
    let Some(last) = last else { return Some(0.0) };
    let (t_s, _) = errors_deg.get(last + 1)?;
    Some((t_s - FAULT_START_S - fault.duration_s - ROUNDING_S).max(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn table_has_exactly_one_row_per_fault() {
        let rows: Vec<_> = TABLE.iter().skip(1).map(|cells| cells[0]).collect();
        let faults: Vec<_> =
            [RMSE_ROW, FACTOR_ROW].into_iter().chain(CATALOGUE.iter().map(|fault| fault.name)).collect();
        assert_eq!(rows, faults);
        assert!(TABLE.iter().all(|cells| cells.len() == TABLE[0].len()), "rows differ in length");
    }

    #[test]
    fn table_entries_are_numbers_or_none() {
        for cell in TABLE.iter().skip(1).flat_map(|cells| &cells[1..]) {
            assert!(*cell == "none" || cell.parse::<f64>().is_ok_and(|x| x >= 0.0), "{cell}");
        }
    }

    #[test]
    fn recovery_time_is_from_fault_end_to_last_exceedance() {
        let fault = &CATALOGUE[0];
        let end_s = FAULT_START_S + fault.duration_s;
        let errors =
            [(FAULT_START_S, 9.0), (end_s + 1.0, 2.0), (end_s + 2.0, 0.5), (end_s + 3.0, 2.0), (end_s + 4.0, 0.5)];
        assert!((recovery_s(fault, &errors, 1.0).unwrap() - 4.0).abs() < 1e-6);
        assert_eq!(recovery_s(fault, &errors, 0.1), None);
        assert_eq!(recovery_s(fault, &errors, 10.0), Some(0.0));
    }
}
