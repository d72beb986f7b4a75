//! What cannot be is said of the input, with the remedy to paste, and the remedy helps.
use std::{fmt::Write as _, fs};

use crate::common::{Run, System, plumb, until};
use serde_json::Value;

/// A body that is tilted this way and that about both level axes, seen by sensors of 100 Hz in rad/s and these units of force.
fn recording(system: &System, seconds: u32, per_m_s2: f64) -> String {
    let mut text = String::from("t_s,gx,gy,gz,ax,ay,az\n");
    for row in 0..100 * seconds {
        let t_s = f64::from(row) * 0.01;
        let angle = 0.6 * (1.3 * t_s).sin();
        let (rate, (sin, cos)) = (0.6 * 1.3 * (1.3 * t_s).cos(), angle.sin_cos());
        let [y, z] = [sin, cos].map(|part| part * 9.81 * per_m_s2);
        // No axis of a real sensor stands still.
        let [p, q, r] = [31.0, 37.0, 41.0].map(|rad_s| 1e-3 * (rad_s * t_s).sin());
        writeln!(text, "{t_s:.2},{rate},{p},{q},{r},{y},{z}").unwrap();
    }
    let path = system.path("recording.csv");
    fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

fn warnings(run: &Run) -> Vec<String> {
    run.assert_whole();
    run.json["warnings"].as_array().unwrap().iter().map(|text| text.as_str().unwrap().to_owned()).collect()
}

#[test]
fn forces_in_g_are_named_by_up_and_what_is_pasted_helps() {
    let system = System::new("");
    let file = recording(&system, 20, 1.0 / 9.806_65);
    for how in [&[][..], &["--in-process"]] {
        let run = system.run(&[&["--replay", &file, "--speed", "max"], how].concat());
        let said = warnings(&run);
        assert!(said.len() == 1 && said[0].starts_with("force-unit: "), "{said:?}");
        assert!(run.people.contains("warning: force-unit: the force is "), "{}", run.people);
        let remedy = said[0].split('`').find(|part| part.starts_with("ingest.")).unwrap().to_owned();
        let pasted = System::new(&remedy);
        let arguments = [&["--replay", &file, "--speed", "max"], how].concat();
        assert_eq!(warnings(&pasted.run(&arguments)), Vec::<String>::new(), "{remedy}");
    }
}

#[test]
fn nothing_is_said_of_what_can_be() {
    let system = System::new("");
    let file = recording(&system, 20, 1.0);
    for arguments in [&["--replay", &file, "--speed", "max"][..], &["--for", "6s", "--speed", "max"]] {
        let run = system.run(arguments);
        assert_eq!(warnings(&run), Vec::<String>::new(), "{}", run.people);
    }
}

#[test]
fn the_doctor_of_a_running_system_names_it_too() {
    let system = System::new("");
    let file = recording(&system, 120, 1.0 / 9.806_65);
    let running = system.start(&["--replay", &file]);
    system.all_run();
    let mut said = Value::Null;
    until("the doctor to see enough", || {
        let output = plumb(&["doctor", "--json", "--seconds", "3", "--system", &system.name]).output().unwrap();
        let doctor: Value = serde_json::from_slice(&output.stdout).unwrap();
        let checks = doctor["checks"].as_array().unwrap();
        said = checks.iter().find(|check| check["check"] == "input").cloned().unwrap_or_default();
        said["result"] == "warning"
    });
    assert!(said["found"].as_str().unwrap().starts_with("force-unit: "), "{said}");
    assert!(said["remedy"].as_str().unwrap().contains("ingest.calibration.accel.scale"), "{said}");
    running.interrupt();
    let run = running.wait();
    assert_eq!(warnings(&run).len(), 1, "{}", run.people);
}
