//! The fuser `multiple-model`: two stages on the same input, of which each is right for one kind of motion, and one attitude.
//!
//! `wz` holds that the mean acceleration of some seconds is zero: what a hand, a robot's arm or a hovering vehicle moves. `aided` holds
//! that a velocity lasts, which a receiver tells or, without one, the turns reveal: what flies or drives. Both run all the time. The
//! level is that of `aided` as long as the body was seen to be carried over ground within five minutes: a velocity was used in a
//! heading that counts from north, or a coordinated turn lasted (`turns`); else that of `wz`. The heading is that of `aided` where it
//! counts from true north, of `wz` where it knows magnetic north and nothing is carried, and of `wz` where nobody knows north.
//!
//! From one to the other the attitude goes on where it was, and what is left between the two is taken back by and by (`transition`).
//!
//! | file | what it does |
//! | --- | --- |
//! | `turns` | coordinated turns, seen without an attitude |
//! | `transition` | from the attitude of one stage to that of another without a step |

mod transition;
mod turns;

use super::{
    aided::{self, Aided},
    estimate::Estimate,
    fused::{Corrections, Fused},
    input::FuserInput,
    wz::{self, Wz},
};
use crate::{
    course::Reference,
    numbers::Numbers,
    parameters::{Parameter, ParameterError, Parameters},
    stage::{RestoreError, Stage},
};
use {transition::Transition, turns::Turns};

/// How long a body that was carried over ground is taken to be carried on, s.
const CARRIED_S: f64 = 300.0;
/// Those of `wz`, then those of `aided`. What both have stands among the second and is set in both; the magnetometer's of `aided` are left out, since
/// the magnetic heading is that of `wz`.
const PARAMETERS: &[Parameter] = &joined::<{ OF_WZ.len() + OF_AIDED.len() }>(OF_WZ, OF_AIDED);
const OF_WZ: &[Parameter] = Wz::PARAMETERS.split_at(Wz::PARAMETERS.len() - wz::OF_AIDED_TOO).0;
const OF_AIDED: &[Parameter] =
    aided::Settings::TABLE.split_at(aided::Settings::TABLE.len() - aided::OF_THE_MAGNETOMETER).0;

const fn joined<const COUNT: usize>(first: &[Parameter], second: &[Parameter]) -> [Parameter; COUNT] {
    let mut all = [first[0]; COUNT];
    let mut i = 0;
    while i < COUNT {
        all[i] = if i < first.len() { first[i] } else { second[i - first.len()] };
        i += 1;
    }
    all
}

/// One of the two.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Model {
    Wz,
    Aided,
}

/// Which stage gives what.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Chosen {
    level: Model,
    heading: Model,
}

impl Chosen {
    const WZ: Self = Self { level: Model::Wz, heading: Model::Wz };

    fn of<T>(self, wz: T, aided: T) -> Both<T>
    where
        T: Copy,
    {
        let by = |model| if model == Model::Wz { wz } else { aided };
        Both { level: by(self.level), heading: by(self.heading) }
    }
}

/// What the chosen stages have.
#[derive(Debug, Clone, Copy)]
struct Both<T> {
    level: T,
    heading: T,
}

/// The fuser stage `multiple-model`.
#[derive(Debug, Clone, PartialEq)]
pub struct MultipleModel {
    wz: Wz,
    aided: Aided,
    turns: Turns,
    /// Since the body was last seen to be carried over ground, s.
    since_carried_s: f64,
    chosen: Chosen,
    transition: Transition,
}

impl Default for MultipleModel {
    fn default() -> Self {
        Self {
            wz: Wz::default(),
            aided: Aided::default(),
            turns: Turns::default(),
            since_carried_s: CARRIED_S,
            chosen: Chosen::WZ,
            transition: Transition::default(),
        }
    }
}

impl MultipleModel {
    pub(super) fn realign(&mut self) {
        self.wz.realign();
        self.aided.realign();
        self.turns = Turns::default();
    }

    /// Which stage gives what, by what their headings count from.
    fn choice(&self, wz: Reference, aided: Reference) -> Chosen {
        let is_carried = self.since_carried_s < CARRIED_S;
        let heading = match (wz, aided) {
            (Reference::Magnetic, Reference::True) if !is_carried => Model::Wz,
            (_, Reference::True) => Model::Aided,
            _ => Model::Wz,
        };
        Chosen { level: if is_carried { Model::Aided } else { Model::Wz }, heading }
    }
}

impl Stage for MultipleModel {
    type Input = FuserInput;
    type Output = Fused;
    type Common = Estimate;

    fn name(&self) -> &'static str {
        "multiple-model"
    }

    fn parts(&self) -> &'static [&'static str] {
        &["wz", "aided"]
    }

    fn parameters(&self) -> &'static [Parameter] {
        PARAMETERS
    }

    fn set(&mut self, name: &str, value: f64) -> Result<(), ParameterError> {
        if PARAMETERS.iter().all(|parameter| parameter.name != name) {
            return Err(ParameterError::Unknown { known: PARAMETERS });
        }
        match (self.wz.set(name, value), self.aided.set(name, value)) {
            (Err(ParameterError::Unknown { .. }), of_aided) => of_aided,
            (of_wz, Err(ParameterError::Unknown { .. })) => of_wz,
            (of_wz, of_aided) => of_wz.and(of_aided),
        }
    }

    fn step(&mut self, input: &FuserInput) -> Fused {
        let mut room = None;
        let input = input.finite(&mut room);
        let (wz, aided) = (self.wz.step(input), self.aided.step(input));
        let dt_s = input.motion.map_or(0.0, |motion| motion.dt_s);
        let told = aided.corrections.velocity && aided.reference == Reference::True;
        if self.turns.lasts(input, aided.bias_rad_s) || told {
            self.since_carried_s = 0.0;
        } else {
            self.since_carried_s = (self.since_carried_s + dt_s).min(CARRIED_S);
        }
        let (before, chosen) = (self.chosen, self.choice(wz.reference, aided.reference));
        self.chosen = chosen;
        let Both { level, heading } = chosen.of(wz, aided);
        let mut aligned = level.corrections.aligned;
        if before.level != chosen.level {
            aligned |= self.transition.begin(before.of(wz, aided).level.attitude, level.attitude);
        }
        if heading.reference != Reference::Arbitrary {
            let other = (chosen.level != chosen.heading).then_some(heading.attitude);
            aligned |= self.transition.follow_heading(level.attitude, other, dt_s);
        }
        self.transition.ease(dt_s);
        Fused {
            attitude: self.transition.attitude(level.attitude),
            heading_sd_rad: heading.heading_sd_rad,
            reference: heading.reference,
            corrections: Corrections {
                velocity: level.corrections.velocity || heading.corrections.velocity,
                magnetic: heading.corrections.magnetic,
                disturbed: heading.corrections.disturbed,
                aligned,
                ..level.corrections
            },
            ..level
        }
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.wz.visit_state(visit);
        self.aided.visit_state(visit);
        self.turns.visit(visit);
        self.since_carried_s.visit(visit);
        self.chosen.visit(visit);
        self.transition.visit(visit);
    }

    fn flaw(&self) -> Option<&'static str> {
        let time = (self.since_carried_s < 0.0).then_some("a time below zero");
        let parts = self.wz.flaw().or_else(|| self.aided.flaw());
        parts.or_else(|| self.turns.flaw()).or_else(|| self.transition.flaw()).or(time)
    }

    fn common(&self) -> Estimate {
        let (wz, aided) = (self.wz.common(), self.aided.common());
        let Both { level, heading } = self.chosen.of(wz, aided);
        Estimate {
            attitude: self.transition.attitude(level.attitude),
            reference: heading.reference,
            heading_sd_rad: heading.heading_sd_rad,
            gyro_scale: wz.gyro_scale,
            hard_iron: wz.hard_iron,
            leaky_velocity: self.transition.turned(level.leaky_velocity),
            ..level
        }
    }

    /// Both go on with what was handed over; whoever hands over true north was carried.
    fn adopt(&mut self, common: &Estimate) -> Result<(), RestoreError> {
        self.wz.adopt(common)?;
        self.aided.adopt(common)?;
        self.turns = Turns::default();
        self.since_carried_s = if common.reference == Reference::True { 0.0 } else { CARRIED_S };
        self.chosen = self.choice(common.reference, common.reference);
        self.transition = Transition::default();
        Ok(())
    }
}

impl Numbers for Chosen {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        for model in [&mut self.level, &mut self.heading] {
            let mut aided = *model == Model::Aided;
            aided.visit(visit);
            *model = if aided { Model::Aided } else { Model::Wz };
        }
    }
}
