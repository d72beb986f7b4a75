//! Conformance checks that every stage must pass, with one set of checks per slot.
//!
//! Input: a function that creates a stage.
//!
//! Output: a [`Report`] with the result of each check.
//!
//! Time: the timestamps of the scripts. Checking a stage takes one or two seconds. The system clock
//! limits the checks of a stage in a separate program.
//!
//! Failure: a panic in a stage is not caught.
//!
//! ```no_run
//! use attitude::fuser::wz_closed::WzClosed;
//!
//! let report = conformance::fuser(WzClosed::default);
//! println!("{report}");
//! ```
//!
//! | module | contents |
//! | --- | --- |
//! | `validity` | outputs are finite and valid rotations under any fault |
//! | `repeatability` | equal inputs yield bit-identical outputs, even after a restore |
//! | `rejection` | invalid states are rejected and leave the stage unchanged |
//! | `hand_over` | a stage continues from the state of another stage |
//! | `tumbling` | the attitude is continuous in any orientation |
//! | `settings` | every allowed parameter value works |
//! | `recovery` | the level recovers from each fault within the limits of `recovery.csv` |
//! | [`script`], [`fault`] | simulated sensors and their faults |
//! | `budget` | time for the checks of a stage |
//! | `slot`, `run` | properties of the slots, and runs of a stage |
//! | `external`, `cpu_affinity` | stages in a separate program, and the cost of their steps |
//! | [`golden`] | golden traces of the outputs |
#![forbid(unsafe_code)]

mod budget;
mod cpu_affinity;
mod external;
pub mod fault;
pub mod golden;
mod hand_over;
mod recovery;
mod rejection;
mod repeatability;
pub mod report;
mod run;
pub mod script;
mod settings;
mod slot;
mod tumbling;
mod validity;

use attitude::{
    Vector3,
    accel::Inclination,
    course::{CourseInput, CourseReading, LastReading},
    fuser::{Estimate, Fused, FuserInput},
    gyro::{Motion, RateSample},
    point::Point,
    stage::Stage,
    state::Attitude,
};
use budget::Budget;
pub use external::run_external;
use launch::Slot;
pub use report::{Check, LeftOut, Measurement, Report};
use slot::{AccelSlot, CourseSlot, FuserSlot, GyroSlot, SlotSpec, SlotStage};

/// Returns every built-in stage as (slot, stage).
pub fn stages() -> impl Iterator<Item = (Slot, &'static str)> {
    Slot::ALL.into_iter().flat_map(|slot| slot.stages().iter().map(move |name| (slot, *name)))
}

/// Checks a built-in stage. Returns `None` for an unknown name.
pub fn run(slot: Slot, name: &str) -> Option<Report> {
    match slot {
        Slot::Gyro => run_in_slot::<GyroSlot>(name),
        Slot::Accel => run_in_slot::<AccelSlot>(name),
        Slot::Fuser => run_in_slot::<FuserSlot>(name),
        Slot::Course => run_in_slot::<CourseSlot>(name),
    }
}

/// Checks a gyro stage.
pub fn gyro<S>(make: impl Fn() -> S) -> Report
where
    S: Stage<Input = RateSample, Output = Motion, Common = Attitude> + Clone,
{
    report::<GyroSlot, S>(&make, &Budget::new(None, &|_| {}))
}

/// Checks an accelerometer stage.
pub fn accel<S>(make: impl Fn() -> S) -> Report
where
    S: Stage<Input = Vector3<f64>, Output = Inclination, Common = Point> + Clone,
{
    report::<AccelSlot, S>(&make, &Budget::new(None, &|_| {}))
}

/// Checks a fuser stage.
pub fn fuser<S>(make: impl Fn() -> S) -> Report
where
    S: Stage<Input = FuserInput, Output = Fused, Common = Estimate> + Clone,
{
    report::<FuserSlot, S>(&make, &Budget::new(None, &|_| {}))
}

/// Checks a course stage.
pub fn course<S>(make: impl Fn() -> S) -> Report
where
    S: Stage<Input = CourseInput, Output = CourseReading, Common = LastReading> + Clone,
{
    report::<CourseSlot, S>(&make, &Budget::new(None, &|_| {}))
}

fn run_in_slot<L: SlotSpec>(name: &str) -> Option<Report> {
    let stage = L::from_name(name)?;
    let mut report = report::<L, L::BuiltIn>(&|| stage.clone(), &Budget::new(None, &|_| {}));
    let reported = stage.name();
    let misnamed = (reported != name).then(|| format!("it reports {reported}"));
    report.stage = name.into();
    report.checks.insert(0, Check::property("the stage reports the name that selects it", misnamed));
    Some(report)
}

/// Function that runs one group of checks on stages created by the given constructor.
type CheckGroup<M> = fn(&M, &Budget<'_>) -> Vec<Check>;

/// Number of groups of checks.
const GROUPS: u32 = 7;

/// Runs the checks that the budget has time for.
fn report<L: SlotSpec, S: SlotStage<L>>(make: &impl Fn() -> S, budget: &Budget<'_>) -> Report {
    let groups: [(&str, CheckGroup<_>); GROUPS as usize] = [
        ("validity", validity::checks::<L, S>),
        ("repeatability", repeatability::checks::<L, S>),
        ("rejection", rejection::checks::<L, S>),
        ("hand-over", hand_over::checks::<L, S>),
        ("tumbling", tumbling::checks::<L, S>),
        ("settings", settings::checks::<L, S>),
        ("recovery", recovery::checks::<L, S>),
    ];
    let (mut checks, mut left_out) = (Vec::new(), Vec::new());
    for ((group, run_group), groups_left) in groups.into_iter().zip((1..=GROUPS).rev()) {
        budget.start_group(groups_left);
        let group_checks = run_group(make, budget);
        let (count, is_whole) = (budget.left_out(), group_checks.is_empty());
        left_out.extend((count > 0).then(|| LeftOut { group: group.into(), count, is_whole }));
        checks.extend(group_checks);
    }
    Report { slot: L::SLOT, stage: make().name().into(), checks, left_out }
}
