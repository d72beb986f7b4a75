//! A course stage that does what none may: `faulty FAULT`, started by a system in whose launch file it is a stage of the user's own.
#![allow(clippy::unwrap_used, reason = "a service of tests may panic")]

use std::{io::Write, rc::Rc, time::Duration};

use bus::Subscriber;
use course::{CourseMessage, CourseSlot};
use launch::Service;
use messages::{AttitudeOutput, Control, Field, FusedState, GnssFix, Layout, Message};
use runtime::{Member, Sequence, Slot, serve};

fn main() {
    let fault = std::env::args().nth(1).unwrap();
    if fault == "dies-at-once" {
        panic!("on purpose");
    }
    let mut member = Member::join(Service::Course).unwrap();
    "angles".clone_into(&mut member.orders.launch.course.stage);
    match fault.as_str() {
        "dies-before-ready" => panic!("on purpose"),
        "never-ready" => std::thread::sleep(Duration::from_secs(3600)),
        "other-layout" => drop(member.bus.subscriber::<OtherState>(64).unwrap_or_else(|error| {
            eprintln!("{error}");
            std::process::exit(1)
        })),
        _ => {}
    }
    let slot = Faulty {
        slot: course::slot(&member.orders).unwrap(),
        control: Rc::new(member.control().unwrap()),
        incarnation: member.orders.incarnation,
        fault: fault.clone(),
        ticks: 0,
    };
    let (fused, gnss) = (member.reader::<FusedState>().unwrap(), member.subscriber::<GnssFix>().unwrap());
    serve(member, slot, &[&fused, &gnss]).unwrap();
    if fault == "ignores-sigterm" {
        std::thread::sleep(Duration::from_secs(3600));
    }
}

#[derive(Clone)]
struct Faulty {
    slot: CourseSlot,
    control: Rc<Subscriber<Control>>,
    incarnation: u32,
    fault: String,
    ticks: u64,
}

impl Slot for Faulty {
    type Input = CourseMessage;
    type Output = AttitudeOutput;
    type Stage = <CourseSlot as Slot>::Stage;

    fn offer(&mut self, input: CourseMessage, publish: &mut dyn FnMut(AttitudeOutput)) {
        self.ticks += 1;
        match self.fault.as_str() {
            "dies-when-ready" if self.ticks == 20 => panic!("on purpose"),
            "hangs-when-ready" if self.ticks == 20 => std::thread::sleep(Duration::from_secs(3600)),
            "falls-behind" => std::thread::sleep(Duration::from_millis(2)),
            "misses-the-commit" => self.sleep_when_decided(),
            "talks" => std::io::stderr().write_all(&vec![b'x'; if self.ticks == 20 { 1 << 20 } else { 4096 }]).unwrap(),
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

    fn lacks(&self) -> usize {
        self.slot.lacks()
    }

    fn stage(&self) -> &Self::Stage {
        self.slot.stage()
    }

    fn stage_mut(&mut self) -> &mut Self::Stage {
        self.slot.stage_mut()
    }

    fn visit_own(&mut self, visit: &mut dyn FnMut(&mut u64)) {
        self.slot.visit_own(visit);
    }

    fn expect_until(&mut self, tick: u64) {
        self.slot.expect_until(tick);
    }
}

impl Faulty {
    /// The decision that names this stage finds it asleep.
    fn sleep_when_decided(&mut self) {
        let (mut named, incarnation) = (false, self.incarnation);
        self.control.drain(64, |control| named |= control.owner == incarnation).unwrap();
        if named {
            std::thread::sleep(Duration::from_millis(800));
        }
    }
}

/// `FusedState` as another version might define it.
#[derive(Debug, Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
struct OtherState {
    tick: u64,
}

impl Message for OtherState {
    const TOPIC: &'static str = FusedState::TOPIC;
    const TYPE: &'static str = "plumbline.FusedState.0";

    fn layout() -> Layout {
        let fields = vec![Field { name: "tick", kind: "u64", offset: 0, about: "" }];
        Layout {
            name: Self::TYPE,
            size: size_of::<Self>(),
            fields,
            topic: Some(Self::TOPIC),
            about: "",
            header_fields: 0,
        }
    }
}
