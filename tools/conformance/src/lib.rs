//! What a stage must be able to do, whatever it computes: one body of checks for each slot.
//!
//! Input: a way to make a stage. Output: a [`Report`] with each check, its figure and where it failed. Time: the scripts' own; a
//! second or two per stage. Failure: a stage that panics takes the kit with it.
//!
//! ```no_run
//! use attitude::fuser::wz_closed::WzClosed;
//!
//! let report = conformance::fuser(WzClosed::default);
//! println!("{report}");
//! ```
//!
//! | module | what a stage must be able to do |
//! | --- | --- |
//! | `soundness` | stay finite and a rotation, whatever the sensors do |
//! | `repetition` | give the same bits again, also over a snapshot |
//! | `refusal` | refuse what is not a state, unchanged |
//! | `hand_over` | go on where another stage was |
//! | `tumbling` | turn over without a jump |
//! | `settings` | stay sound with every allowed parameter |
//! | `recovery` | be level again after a fault, in the time that `recovery.csv` allows, and sound until then |
//! | [`script`], [`fault`] | what the sensors give, and what goes wrong with them |
//! | `slot`, `run` | what the kit knows of a slot; running a stage |
//! | `program`, `processor` | a stage that is a program of its own, and what a step of it costs |
//! | [`golden`] | what a stage gave when its mathematics was last looked at |
#![forbid(unsafe_code)]

pub mod fault;
pub mod golden;
mod hand_over;
mod processor;
mod program;
mod recovery;
mod refusal;
mod repetition;
pub mod report;
mod run;
pub mod script;
mod settings;
mod slot;
mod soundness;
mod tumbling;

use attitude::{
    Vector3,
    accel::Inclination,
    course::{CourseInput, LastReading, CourseReading},
    fuser::{Estimate, Fused, FuserInput},
    gyro::{Motion, RateSample},
    point::Point,
    stage::Stage,
    state::Attitude,
};
pub use program::program;
pub use report::{Check, Figure, Report};
use slot::{AccelSlot, CourseSlot, Fills, FuserSlot, GyroSlot, Slot};

/// Every stage of every slot, as (slot, stage).
pub fn stages() -> impl Iterator<Item = (&'static str, &'static str)> {
    fn of<L: Slot>() -> impl Iterator<Item = (&'static str, &'static str)> {
        L::NAMES.iter().map(|name| (L::NAME, *name))
    }
    of::<GyroSlot>().chain(of::<AccelSlot>()).chain(of::<FuserSlot>()).chain(of::<CourseSlot>())
}

/// Checks the stage of that name; `None` when there is none.
pub fn run(slot: &str, name: &str) -> Option<Report> {
    match slot {
        GyroSlot::NAME => named::<GyroSlot>(name),
        AccelSlot::NAME => named::<AccelSlot>(name),
        FuserSlot::NAME => named::<FuserSlot>(name),
        CourseSlot::NAME => named::<CourseSlot>(name),
        _ => None,
    }
}

/// Checks a gyro stage.
pub fn gyro<S>(make: impl Fn() -> S) -> Report
where
    S: Stage<Input = RateSample, Output = Motion, Common = Attitude> + Clone,
{
    report::<GyroSlot, S>(&make, &mut |_| {})
}

/// Checks an accelerometer stage.
pub fn accel<S>(make: impl Fn() -> S) -> Report
where
    S: Stage<Input = Vector3<f64>, Output = Inclination, Common = Point> + Clone,
{
    report::<AccelSlot, S>(&make, &mut |_| {})
}

/// Checks a fuser stage.
pub fn fuser<S>(make: impl Fn() -> S) -> Report
where
    S: Stage<Input = FuserInput, Output = Fused, Common = Estimate> + Clone,
{
    report::<FuserSlot, S>(&make, &mut |_| {})
}

/// Checks a course stage.
pub fn course<S>(make: impl Fn() -> S) -> Report
where
    S: Stage<Input = CourseInput, Output = CourseReading, Common = LastReading> + Clone,
{
    report::<CourseSlot, S>(&make, &mut |_| {})
}

fn named<L: Slot>(name: &str) -> Option<Report> {
    let stage = L::named(name)?;
    let mut report = report::<L, L::Own>(&|| stage.clone(), &mut |_| {});
    let own = stage.name();
    let misnamed = (own != name).then(|| format!("it calls itself {own}"));
    report.stage = name.into();
    report.checks.insert(0, Check::holds("its name is the one by which it is chosen", misnamed));
    Some(report)
}

/// Checks of one kind, of the stages that a function makes.
type Checks<M> = fn(&M) -> Vec<Check>;

/// Makes every check; `on_begin` is told which kind of them begins.
fn report<L: Slot, S: Fills<L>>(make: &impl Fn() -> S, on_begin: &mut dyn FnMut(&str)) -> Report {
    let kinds: [(&str, Checks<_>); 7] = [
        ("soundness", soundness::checks::<L, S>),
        ("repetition", repetition::checks::<L, S>),
        ("refusal", refusal::checks::<L, S>),
        ("hand-over", hand_over::checks::<L, S>),
        ("tumbling", tumbling::checks::<L, S>),
        ("settings", settings::checks::<L, S>),
        ("recovery", recovery::checks::<L, S>),
    ];
    let mut checks = Vec::new();
    for (kind, of_kind) in kinds {
        on_begin(kind);
        checks.extend(of_kind(make));
    }
    Report { slot: L::NAME, stage: make().name().into(), checks }
}
