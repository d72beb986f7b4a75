//! A stage that proves itself beside the one in its slot takes over by itself, and goes back when it strays.
use crate::common::{System, until};
use serde_json::Value;

fn stage_in(system: &System, slot: &str) -> Option<String> {
    let output = crate::common::plumb(&["ps", "--json", "--system", &system.name]).output().unwrap();
    let services: Vec<Value> = serde_json::from_slice(&output.stdout).ok()?;
    let one = services.iter().find(|one| one["service"] == slot)?;
    Some(one["stage"].as_str()?.to_owned())
}

/// The simulated bias is not known to `wz-open`, which the body's motion takes away from the default by and by.
fn watch(bounds: &str) -> String {
    format!("[[watch]]\nslot = \"fuser\"\nstage = \"wz-open\"\nmeasure = \"inclination\"\n{bounds}\n")
}

#[test]
fn a_stage_that_stays_near_is_promoted_and_one_that_strays_goes_back() {
    let bounds = "promote_below_deg = 20\npromote_after_s = 0.5\nrollback_above_deg = 20.1\nrollback_after_s = 60";
    let system = System::new(&watch(bounds));
    let running = system.start(&[]);
    until("the promotion", || stage_in(&system, "fuser").as_deref() == Some("wz-open"));
    running.interrupt();
    let run = running.wait();
    run.assert_whole();
    assert!(run.people.contains("watch fuser: promoting wz-open"), "{}", run.people);

    let bounds = "promote_below_deg = 0.0001\npromote_after_s = 0.1\nrollback_above_deg = 0.00011\nrollback_after_s = 0.1\nlimit = 2";
    let text = format!("{}[fuser]\nstage = \"madgwick\"\n", watch(bounds).replace("wz-open", "madgwick-improved"));
    let system = System::new(&text);
    let running = system.start(&["--for", "4s"]);
    let run = running.wait();
    run.assert_whole();
    assert!(!run.people.contains("promoting"), "two filters that differ never agree so well: {}", run.people);
}

#[test]
fn a_promoted_stage_that_leaves_the_bound_gives_the_slot_back() {
    // A coarse integrator agrees at once and drifts off from the exact one while the body tumbles.
    let text = "[ingest.sim]\nscenario = \"tumble\"\n[[watch]]\nslot = \"gyro\"\nstage = \"euler\"\nmeasure = \"angle\"\n\
                promote_below_deg = 1\npromote_after_s = 0.2\nrollback_above_deg = 1.01\nrollback_after_s = 0.1\n";
    let system = System::new(text);
    let running = system.start(&[]);
    until("the promotion", || stage_in(&system, "gyro").as_deref() == Some("euler"));
    until("the way back", || stage_in(&system, "gyro").as_deref() == Some("mobius"));
    running.interrupt();
    let run = running.wait();
    run.assert_whole();
    assert!(run.people.contains("watch gyro: rolling back to mobius"), "{}", run.people);
}

#[test]
fn whoever_swaps_by_hand_ends_the_watch() {
    let system = System::new(&watch("promote_below_deg = 0"));
    let running = system.start(&[]);
    until("an answer", || stage_in(&system, "fuser").is_some());
    assert_eq!(system.swap(&["fuser", "kalman"])["outcome"], "refused");
    assert_eq!(system.swap(&["fuser", "aided"])["outcome"], "committed");
    assert_eq!(system.swap(&["fuser", "vqf"])["outcome"], "committed");
    running.interrupt();
    running.wait().assert_whole();
}
