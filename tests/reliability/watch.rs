//! Watches: a shadow that agrees with the owner is promoted. A promoted stage that diverges is
//! rolled back.
use std::fs::{self, File};

use crate::common::{Running, System, wait_for};

fn stage_in(system: &System, slot: &str) -> Option<String> {
    let services = system.ps();
    let one = services.iter().find(|one| one["service"] == slot)?;
    Some(one["stage"].as_str()?.to_owned())
}

/// Returns the `[[watch]]` section for the stage `wz-open`.
///
/// That stage ignores the simulated bias, so in motion it slowly diverges from the default stage.
fn watch(bounds: &str) -> String {
    format!("[[watch]]\nslot = \"fuser\"\nstage = \"wz-open\"\nmeasure = \"inclination\"\n{bounds}\n")
}

#[test]
fn watch_promotes_close_stage_only() {
    let bounds = "promote_below_deg = 20\npromote_after_s = 0.5\nrollback_above_deg = 20.1\nrollback_after_s = 60";
    let system = System::new(&watch(bounds));
    let running = system.start(&[]);
    wait_for("the promotion", || stage_in(&system, "fuser").as_deref() == Some("wz-open"));
    running.interrupt();
    let run = running.wait();
    run.assert_complete();
    assert!(run.stderr.contains("watch fuser: promoting wz-open"), "{}", run.stderr);

    let bounds = "promote_below_deg = 0.0001\npromote_after_s = 0.1\nrollback_above_deg = 0.00011\nrollback_after_s = 0.1\nlimit = 2";
    let text = format!("{}[fuser]\nstage = \"madgwick\"\n", watch(bounds).replace("wz-open", "madgwick-improved"));
    let system = System::new(&text);
    let running = system.start(&["--for", "4s"]);
    let run = running.wait();
    run.assert_complete();
    assert!(!run.stderr.contains("promoting"), "different filters never agree so closely: {}", run.stderr);
}

#[test]
fn watch_rolls_back_diverging_stage() {
    // The coarse integrator agrees with the exact one at first and diverges from it while the body
    // tumbles.
    let text = "[ingest.sim]\nscenario = \"tumble\"\n[[watch]]\nslot = \"gyro\"\nstage = \"euler\"\nmeasure = \"angle\"\n\
                promote_below_deg = 1\npromote_after_s = 0.2\nrollback_above_deg = 1.01\nrollback_after_s = 0.1\n";
    let system = System::new(text);
    let log = system.path("log");
    let running = Running::spawn_with_stderr(system.command(&[]), File::create(&log).unwrap());
    // The promoted stage runs only briefly, so requests may miss it.
    for text in ["watch gyro: promoting euler", "watch gyro: rolling back to mobius"] {
        wait_for(text, || fs::read_to_string(&log).is_ok_and(|lines| lines.contains(text)));
    }
    wait_for("the previous stage", || stage_in(&system, "gyro").as_deref() == Some("mobius"));
    running.interrupt();
    running.wait().assert_complete();
}

#[test]
fn manual_swap_ends_watch() {
    let system = System::new(&watch("promote_below_deg = 0"));
    let running = system.start(&[]);
    wait_for("a response", || stage_in(&system, "fuser").is_some());
    assert_eq!(system.swap(&["fuser", "kalman"])["outcome"], "refused");
    assert_eq!(system.swap(&["fuser", "aided"])["outcome"], "committed");
    assert_eq!(system.swap(&["fuser", "vqf"])["outcome"], "committed");
    running.interrupt();
    running.wait().assert_complete();
}
