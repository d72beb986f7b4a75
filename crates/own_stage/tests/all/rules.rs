//! The rules of ownership in Python give what those of `swap` give, on whatever comes.
use std::{
    io::Write,
    process::{Command, Stdio},
};

use serde_json::{Value, json};
use swap::{Control, Inlet, Stamped, Tenure};

const CASES: u64 = 400;
const STEPS: u64 = 60;
const ME: u32 = 7;

#[derive(Debug, Clone)]
struct Output {
    tick: u64,
    epoch: u32,
    incarnation: u32,
}

impl Stamped for Output {
    fn tick(&self) -> u64 {
        self.tick
    }

    fn epoch(&self) -> u32 {
        self.epoch
    }

    fn incarnation(&self) -> u32 {
        self.incarnation
    }

    fn stamp(&mut self, epoch: u32, incarnation: u32) {
        (self.epoch, self.incarnation) = (epoch, incarnation);
    }
}

/// Numbers that are the same on every machine.
struct Chance(u64);

impl Chance {
    fn below(&mut self, limit: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % limit
    }
}

/// What is done to a tenure, and what comes of it.
fn tenure(chance: &mut Chance) -> (Value, Value) {
    let (capacity, owner) = (1 + chance.below(12), chance.below(2) == 0);
    let mut tenure = match owner {
        true => Tenure::owner(ME, 1, 3, capacity as usize),
        false => Tenure::candidate(ME, 1, capacity as usize),
    };
    let (mut steps, mut published, mut standings) = (Vec::new(), Vec::new(), Vec::new());
    let (mut tick, mut epoch) = (0, 1);
    for _ in 0..STEPS {
        let mut publish = |out: Output| published.push(json!([out.tick, out.epoch, out.incarnation]));
        if chance.below(4) > 0 {
            tick += if chance.below(10) == 0 { chance.below(4) } else { 1 };
            steps.push(json!([tick]));
            tenure.take(Output { tick, epoch: 0, incarnation: 0 }, &mut publish);
        } else {
            epoch += chance.below(3) as u32;
            let (owner, from_tick) = (ME + chance.below(2) as u32, (tick + chance.below(16)).saturating_sub(6));
            steps.push(json!([epoch, owner, from_tick]));
            tenure.decide(Control { epoch, owner, from_tick }, &mut publish);
        }
        let standing = tenure.standing();
        standings.push(json!([standing.decided_epoch, standing.missed, standing.published_from, tenure.publishes()]));
    }
    (json!({ "capacity": capacity, "owner": owner, "steps": steps }), json!([published, standings]))
}

/// What is offered to an inlet, and what it delivers.
fn inlet(chance: &mut Chance) -> (Value, Value) {
    let lateness_ticks = 1 + chance.below(10);
    let mut inlet = Inlet::starting(chance.below(3), 1, lateness_ticks);
    let first = inlet.counts().next_tick;
    let (mut steps, mut delivered) = (Vec::new(), Vec::new());
    for step in 0..STEPS {
        let tick = (step + chance.below(8)).saturating_sub(4);
        let message =
            Output { tick, epoch: 1 + (step / 20 + chance.below(2)) as u32, incarnation: 3 + chance.below(2) as u32 };
        steps.push(json!([message.tick, message.epoch, message.incarnation]));
        inlet.offer(message, &mut |out, _| delivered.push(json!([out.tick, out.epoch, out.incarnation])));
    }
    let counts = inlet.counts();
    let again = json!([counts.duplicated, counts.repeated + counts.superseded]);
    (json!({ "first": first, "lateness": lateness_ticks, "steps": steps }), json!([delivered, again]))
}

const PYTHON: &str = r#"
import json, sys
from types import SimpleNamespace
from plumbline.rules import Inlet, Tenure

def message(tick, epoch=0, incarnation=0):
    return SimpleNamespace(header=SimpleNamespace(tick=tick, epoch=epoch, incarnation=incarnation))

def into(results):
    return lambda out: results.append([out.header.tick, out.header.epoch, out.header.incarnation])

def tenure(case):
    one, published, standings = Tenure(7, 1, 3 if case["owner"] else None, case["capacity"]), [], []
    for step in case["steps"]:
        if len(step) == 1:
            one.take(message(*step), into(published))
        else:
            one.decide(SimpleNamespace(epoch=step[0], owner=step[1], from_tick=step[2]), into(published))
        standings.append([one.decided_epoch, one.missed, one.published_from, one.publishes()])
    return [published, standings]

def inlet(case):
    one, delivered = Inlet(case["first"], 1, case["lateness"]), []
    for step in case["steps"]:
        one.offer(message(*step), into(delivered))
    return [delivered, [one.duplicated, one.repeated]]

given = json.load(sys.stdin)
json.dump([[tenure(case) for case in given[0]], [inlet(case) for case in given[1]]], sys.stdout)
"#;

#[test]
fn python_publishes_and_delivers_what_rust_does() {
    let mut chance = Chance(1);
    let (tenures, due_of_tenures): (Vec<_>, Vec<_>) = (0..CASES).map(|_| tenure(&mut chance)).unzip();
    let (inlets, due_of_inlets): (Vec<_>, Vec<_>) = (0..CASES).map(|_| inlet(&mut chance)).unzip();
    let package = concat!(env!("CARGO_MANIFEST_DIR"), "/python");
    let mut command = Command::new("python3");
    command.args(["-c", PYTHON]).env("PYTHONPATH", package).env("PYTHONDONTWRITEBYTECODE", "1");
    let Ok(mut child) = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn() else {
        eprintln!("skipped: there is no python3");
        return;
    };
    child.stdin.take().unwrap().write_all(json!([tenures, inlets]).to_string().as_bytes()).unwrap();
    let said: Value = serde_json::from_slice(&child.wait_with_output().unwrap().stdout).unwrap();
    for (place, (cases, due)) in [(tenures, due_of_tenures), (inlets, due_of_inlets)].into_iter().enumerate() {
        for ((case, due), said) in cases.iter().zip(&due).zip(said[place].as_array().unwrap()) {
            assert_eq!(said, due, "{case}");
        }
    }
}
