//! The levelling stages on the flight of an aircraft in cruise: with satellite velocity, in gaps, without.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use attitude::{
    accel::Projector,
    course::{Course, CourseInput, Reading, Reference},
    fuser::{Fused, Fuser, FuserInput},
    gyro::{Gyro, RateSample},
    stage::Stage,
    state::wrapped_rad,
};
use scenario::Scenario;

const SEEDS: u64 = 8;

struct Chain {
    gyro: Gyro,
    accel: Projector,
    fuser: Fuser,
    course: Course,
}

impl Chain {
    fn new(fuser: &str, course: &str) -> Self {
        Self {
            gyro: Gyro::named("mobius").unwrap(),
            accel: Projector::default(),
            fuser: Fuser::named(fuser).unwrap(),
            course: Course::named(course).unwrap(),
        }
    }

    fn step(&mut self, sample: &RateSample, reading: &scenario::Reading) -> (Fused, Reading) {
        let inclination = self.accel.step(&reading.force_m_s2);
        let motion = self.gyro.step(sample);
        let fused = self.fuser.step(&FuserInput {
            motion: Some(motion),
            inclination: Some(inclination),
            field_ut: None,
            fix: reading.fix,
            rest_credible: true,
        });
        let course = self.course.step(&CourseInput {
            attitude: fused.attitude,
            reference: fused.reference,
            heading_sd_rad: fused.heading_sd_rad,
            fix: reading.fix,
            dt_s: sample.dt_s,
        });
        (fused, course)
    }
}

/// Mean squares, and the largest.
#[derive(Default, Clone, Copy)]
struct Rms {
    sum: f64,
    count: f64,
    max: f64,
}

impl Rms {
    fn add(&mut self, x: f64) {
        self.sum += x * x;
        self.count += 1.0;
        self.max = self.max.max(x.abs());
    }

    fn get(&self) -> f64 {
        (self.sum / self.count.max(1.0)).sqrt()
    }
}

/// Errors in degrees.
#[derive(Default)]
struct Errors {
    roll: Rms,
    pitch: Rms,
    gap_roll: Rms,
    gap_pitch: Rms,
    course: Rms,
    heading: Rms,
    bias_deg_s: f64,
}

fn fly(text: &str, fuser: &str, seeds: u64, set: &[(&str, f64)]) -> Errors {
    let mut errors = Errors::default();
    for seed in 1..=seeds {
        let scenario = Scenario::named(text).unwrap().with_seed(seed);
        let mut chain = Chain::new(fuser, "track");
        for (name, value) in set {
            chain.fuser.set(name, *value).unwrap();
        }
        let mut since_fix_s = 1e9;
        let (mut before_s, mut last) = (0.0, None);
        for (t_s, reading) in scenario.readings() {
            let sample = RateSample { rate_rad_s: reading.rate_rad_s, dt_s: t_s - before_s, kind: scenario.rate_kind };
            since_fix_s = if reading.fix.is_some() { 0.0 } else { since_fix_s + t_s - before_s };
            before_s = t_s;
            let (fused, course) = chain.step(&sample, &reading);
            let (got, truth) = (fused.attitude.angles(), reading.truth.attitude.angles());
            let roll = wrapped_rad(got.roll_rad - truth.roll_rad).to_degrees();
            let pitch = (got.pitch_rad - truth.pitch_rad).to_degrees();
            if t_s >= scenario.scored_from_s {
                let gap = since_fix_s > 1.5;
                let (roll_rms, pitch_rms) = if gap {
                    (&mut errors.gap_roll, &mut errors.gap_pitch)
                } else {
                    (&mut errors.roll, &mut errors.pitch)
                };
                roll_rms.add(roll);
                pitch_rms.add(pitch);
                if course.reference == Reference::True {
                    errors.course.add(wrapped_rad(course.course_rad + truth.yaw_rad).to_degrees());
                }
                errors.heading.add(wrapped_rad(got.yaw_rad - truth.yaw_rad).to_degrees());
            }
            last = Some(fused.bias_rad_s);
        }
        errors.bias_deg_s = last.unwrap().norm().to_degrees();
    }
    errors
}

#[test]
fn table() {
    for fuser in ["levelling", "levelling-pi"] {
        for flight in [
            "cruise?gnss=always",
            "cruise?gnss=gaps",
            "cruise?gnss=start",
            "cruise?gnss=never",
            "cruise-hard?gnss=always",
            "cruise-hard?gnss=gaps",
        ] {
            let e = fly(flight, fuser, SEEDS, &[]);
            println!(
                "{fuser:13} {flight:26} aided {:.3} {:.3} ({:.2}) gaps {:.3} {:.3} ({:.2}) course {:.2} heading {:.2} bias {:.4}",
                e.roll.get(),
                e.pitch.get(),
                e.roll.max.max(e.pitch.max),
                e.gap_roll.get(),
                e.gap_pitch.get(),
                e.gap_roll.max.max(e.gap_pitch.max),
                e.course.get(),
                e.heading.get(),
                e.bias_deg_s
            );
        }
    }
}
