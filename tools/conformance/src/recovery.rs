//! How long after a fault the inclination is as good as without it; a bad output fails as well.
//!
//! What is demanded of which stage is one table, `recovery.csv`; a fuser that it does not name is measured against the column `any`, a
//! stage of another slot against the slot's first: a gyro by itself never recovers.

use std::sync::LazyLock;

use crate::{
    fault::{BEGIN_S, CATALOGUE, Fault},
    report::{Check, Figure},
    run::{Begun, rms},
    script::{ROUNDING_S, S1},
    slot::{Fills, Slot},
};

/// Added to the multiple of the undisturbed RMSE, degrees.
const ABOVE_DEG: f64 = 0.05;
/// The column for every fuser that has none.
const ANY: &str = "any";
/// The row with the largest undisturbed RMSE, degrees.
const RMSE: &str = "undisturbed RMSE °";
/// The row with the multiple of the undisturbed RMSE.
const FACTOR: &str = "times the undisturbed RMSE";

/// Rows of faults, columns of stages; seconds, or `none`.
static TABLE: LazyLock<Vec<Vec<&'static str>>> = LazyLock::new(|| {
    let rows = include_str!("../recovery.csv").lines().filter(|line| !line.starts_with('#'));
    rows.map(|row| row.split(',').map(str::trim).collect()).collect()
});

/// The table's entry; `None` where it says `none` or nothing.
fn entry<L: Slot>(row: &str, stage: &str) -> Option<f64> {
    let column = |name: &str| TABLE.first()?.iter().position(|column| *column == name);
    let other = if L::NAME == "fuser" { ANY } else { L::NAMES.first()? };
    let column = column(stage).or_else(|| column(other))?;
    TABLE.iter().find(|cells| cells.first() == Some(&row))?.get(column)?.parse().ok()
}

pub(crate) fn checks<L: Slot, S: Fills<L>>(make: &impl Fn() -> S) -> Vec<Check> {
    let stage = make();
    let begun = Begun::<L, S>::new(make(), &S1, S1.ticks_before(BEGIN_S));
    let undisturbed = begun.on(&S1);
    if undisturbed.flaw.is_some() {
        return vec![Check::holds("recovers from faults on S1 with its errors", undisturbed.flaw)];
    }
    let rmse_deg = rms(undisturbed.errors_deg.iter().map(|(_, error_deg)| *error_deg));
    let bound_deg = entry::<L>(FACTOR, stage.name()).unwrap_or(f64::INFINITY) * rmse_deg + ABOVE_DEG;
    let undisturbed = Figure { value: Some(rmse_deg), limit: entry::<L>(RMSE, stage.name()), unit: "°" };
    let mut checks = vec![Check::most("inclination RMSE on S1 with its errors", undisturbed, || "undisturbed".into())];
    for fault in CATALOGUE {
        let limit = entry::<L>(fault.name, stage.name());
        let outcome = begun.on(&fault.put_in(&S1));
        let name = format!("recovers from {} to {bound_deg:.2}°", fault.name);
        checks.push(match outcome.flaw {
            Some(flaw) => Check::holds(name, Some(flaw)),
            None => {
                let figure = Figure { value: recovery_s(fault, &outcome.errors_deg, bound_deg), limit, unit: "s" };
                Check::most(name, figure, || "the inclination error stays above".into())
            }
        });
    }
    checks
}

/// From the fault's end to the last error above the bound, s; `None` when the error is above it at the script's end. The errors are
/// those from the fault's begin on.
fn recovery_s(fault: &Fault, errors_deg: &[(f64, f64)], bound_deg: f64) -> Option<f64> {
    let last = errors_deg.iter().rposition(|(_, error_deg)| !(0.0..=bound_deg).contains(error_deg));
    let Some(last) = last else { return Some(0.0) };
    let (t_s, _) = errors_deg.get(last + 1)?;
    Some((t_s - BEGIN_S - fault.duration_s - ROUNDING_S).max(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_has_a_row_for_every_fault_and_no_other() {
        let rows: Vec<_> = TABLE.iter().skip(1).map(|cells| cells[0]).collect();
        let faults: Vec<_> = [RMSE, FACTOR].into_iter().chain(CATALOGUE.iter().map(|fault| fault.name)).collect();
        assert_eq!(rows, faults);
        assert!(TABLE.iter().all(|cells| cells.len() == TABLE[0].len()), "a row with too few or too many columns");
    }

    #[test]
    fn an_entry_is_a_number_or_none() {
        for cell in TABLE.iter().skip(1).flat_map(|cells| &cells[1..]) {
            assert!(*cell == "none" || cell.parse::<f64>().is_ok_and(|x| x >= 0.0), "{cell}");
        }
    }

    #[test]
    fn recovery_is_counted_from_the_end_of_the_fault_to_the_last_error_above_the_bound() {
        let fault = &CATALOGUE[0];
        let end_s = BEGIN_S + fault.duration_s;
        let errors = [(BEGIN_S, 9.0), (end_s + 1.0, 2.0), (end_s + 2.0, 0.5), (end_s + 3.0, 2.0), (end_s + 4.0, 0.5)];
        assert!((recovery_s(fault, &errors, 1.0).unwrap() - 4.0).abs() < 1e-6);
        assert_eq!(recovery_s(fault, &errors, 0.1), None);
        assert_eq!(recovery_s(fault, &errors, 10.0), Some(0.0));
    }
}
