//! The filters of others as stages: their published figures.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;

use attitude::{fuser::Fuser, stage::Stage};
use common::{Rmse, broad, mean};

fn set(name: &str, parameter: &str, value: f64) -> Fuser {
    let mut fuser = Fuser::named(name).unwrap();
    fuser.set(parameter, value).unwrap();
    fuser
}

#[test]
fn sweep() {
    let Some(trials) = broad() else { return };
    for magnetic in [false, true] {
        println!("vqf {:?}", mean(&Fuser::named("vqf").unwrap(), &trials, magnetic));
    }
    for (name, parameter, values) in
        [("madgwick", "beta_rad_s", [0.06, 0.08, 0.12]), ("madgwick-improved", "beta_1_s", [0.15, 0.2, 0.3])]
    {
        for value in values {
            let Rmse { total, heading, inclination } = mean(&set(name, parameter, value), &trials, true);
            println!("{name} {value}: {total:.2}/{heading:.2}/{inclination:.2}");
        }
    }
}
