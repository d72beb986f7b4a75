//! `plumb` with a faulty course service and a faulty external course stage.
//!
//! If the launch file sets `command = [FAULTY, FAULT]` for the stage of the course slot, the course
//! service itself has that fault. With `command = [FAULTY, "hosted", FAULT]`, a correct service
//! hosts a program that has the fault.
#![allow(clippy::unwrap_used, reason = "a test executable may panic")]

use std::{io::Write, process::ExitCode, rc::Rc, time::Duration};

use attitude::{
    course::{Course, CourseInput, CourseReading, LastReading},
    stage::{RestoreError, Stage},
};
use bus::Subscriber;
use launch::{Service, Slot};
use messages::{AttitudeOutput, Control, Field, FusedState, Layout, Message};
use runtime::{Sequence, ServiceContext, SlotLoop, SlotProcessor, serve};
use slots::course::{CourseMessage, CourseSlot};

fn main() -> ExitCode {
    let arguments: Vec<_> = std::env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["service", "course"] => service(),
        ["hosted", fault] => return hosted(fault),
        _ => return plumbline::main(),
    }
    ExitCode::SUCCESS
}

/// Runs the external stage, which works correctly until its hundredth step.
fn hosted(fault: &str) -> ExitCode {
    let stage = Course::from_name("angles").unwrap();
    sdk::course(Program { stage, fault: fault.into(), steps: 0 })
}

fn service() {
    let mut context = ServiceContext::join(Service::Course).unwrap();
    let program = context.config.launch.external_stage(Slot::Course).map(|program| program.command[1].clone());
    let Some(fault) = program.filter(|fault| fault != "hosted") else {
        return serve(&mut *slots::start(Slot::Course, context).unwrap()).unwrap();
    };
    "angles".clone_into(&mut context.config.launch.course.stage);
    match fault.as_str() {
        "dies-at-once" | "dies-before-ready" => panic!("on purpose"),
        "never-ready" => std::thread::sleep(Duration::from_secs(3600)),
        "other-layout" => drop(context.bus.subscriber::<OtherState>(64).unwrap_or_else(|error| {
            eprintln!("{error}");
            std::process::exit(1)
        })),
        _ => {}
    }
    let slot = Faulty {
        slot: slots::course::slot(&context.config).unwrap(),
        control: Rc::new(context.control().unwrap()),
        incarnation: context.config.incarnation,
        fault: fault.clone(),
        ticks: 0,
    };
    let inputs = slots::course::subscribe(&context).unwrap();
    serve(&mut SlotLoop::start(context, slot, inputs).unwrap()).unwrap();
    if fault == "ignores-sigterm" {
        std::thread::sleep(Duration::from_secs(3600));
    }
}

/// Stage `angles` with a fault added.
#[derive(Clone)]
struct Program {
    stage: Course,
    fault: String,
    steps: u32,
}

impl Stage for Program {
    type Input = CourseInput;
    type Output = CourseReading;
    type Common = LastReading;

    fn name(&self) -> &'static str {
        "program"
    }

    fn step(&mut self, input: &CourseInput) -> CourseReading {
        self.steps += 1;
        let reading = self.stage.step(input);
        match self.fault.as_str() {
            "prints-endlessly" => {
                std::io::stderr().write_all(&vec![b'x'; if self.steps == 20 { 1 << 20 } else { 4096 }]).unwrap()
            }
            "hangs" if self.steps == 100 => std::thread::sleep(Duration::from_secs(3600)),
            "dies" if self.steps == 100 => panic!("on purpose"),
            "gives-nan" if self.steps == 100 => return CourseReading { course_rad: f64::NAN, ..reading },
            "gives-nan-always" if self.steps >= 100 => return CourseReading { course_rad: f64::NAN, ..reading },
            _ => {}
        }
        reading
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.stage.visit_state(visit);
    }

    fn common(&self) -> LastReading {
        self.stage.common()
    }

    fn adopt(&mut self, common: &LastReading) -> Result<(), RestoreError> {
        self.stage.adopt(common)
    }
}

struct Faulty {
    slot: CourseSlot,
    control: Rc<Subscriber<Control>>,
    incarnation: u32,
    fault: String,
    ticks: u64,
}

impl SlotProcessor for Faulty {
    const SLOT: Slot = Slot::Course;

    type Input = CourseMessage;
    type Output = AttitudeOutput;
    type Stage = <CourseSlot as SlotProcessor>::Stage;

    fn offer(&mut self, input: CourseMessage, publish: &mut dyn FnMut(AttitudeOutput)) {
        self.ticks += 1;
        match self.fault.as_str() {
            "dies-when-ready" if self.ticks == 20 => panic!("on purpose"),
            "hangs-when-ready" if self.ticks == 20 => std::thread::sleep(Duration::from_secs(3600)),
            "falls-behind" => std::thread::sleep(Duration::from_millis(2)),
            "misses-the-commit" => self.sleep_when_decided(),
            _ => {}
        }
        let nan = self.fault == "gives-nan" && self.ticks > 20;
        self.slot.offer(input, &mut |mut output| {
            if nan {
                output.quaternion = [f64::NAN; 4];
            }
            publish(output);
        });
    }

    fn sequence(&self) -> &Sequence {
        self.slot.sequence()
    }

    fn awaited_input(&self) -> usize {
        self.slot.awaited_input()
    }

    fn failure(&self) -> Option<String> {
        self.slot.failure()
    }

    fn stage(&self) -> &Self::Stage {
        self.slot.stage()
    }

    fn stage_mut(&mut self) -> &mut Self::Stage {
        self.slot.stage_mut()
    }

    fn visit_own_state(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        self.slot.visit_own_state(visit);
    }

    fn expect_backlog(&mut self, tick: u64) {
        self.slot.expect_backlog(tick);
    }
}

impl Faulty {
    /// Sleeps if this incarnation has received a decision that makes it the owner.
    fn sleep_when_decided(&mut self) {
        let (mut named, incarnation) = (false, self.incarnation);
        self.control.drain(64, |control| named |= control.owner == incarnation).unwrap();
        if named {
            std::thread::sleep(Duration::from_millis(800));
        }
    }
}

/// `FusedState` as another version of the software might define it.
#[derive(Debug, Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
struct OtherState {
    tick: u64,
}

impl Message for OtherState {
    const TOPIC: &'static graph::Entry = FusedState::TOPIC;
    const TYPE: &'static str = "plumbline.FusedState.0";

    fn layout() -> Layout {
        let fields = vec![Field { name: "tick", kind: "u64", offset: 0, description: "" }];
        Layout {
            name: Self::TYPE,
            size: size_of::<Self>(),
            fields,
            topic: Some(Self::TOPIC.name),
            description: "",
            header_fields: 0,
        }
    }
}
