//! Every stage of every slot through the kit.
fn all_conform(slot: &str) {
    let mut failures = String::new();
    for (_, stage) in conformance::stages().filter(|(of, _)| *of == slot) {
        let report = conformance::run(slot, stage).unwrap();
        println!("{report}\n");
        for check in report.failures() {
            failures += &format!("{slot} {stage}\n{check}\n");
        }
    }
    assert!(failures.is_empty(), "\n{failures}");
}

#[test]
fn every_gyro_stage_conforms() {
    all_conform("gyro");
}

#[test]
fn every_accel_stage_conforms() {
    all_conform("accel");
}

#[test]
fn every_fuser_stage_conforms() {
    all_conform("fuser");
}

#[test]
fn every_course_stage_conforms() {
    all_conform("course");
}
