//! Every stage of every slot through the kit.
fn all_conform(slot: &str) {
    let judge = |stage: &str| {
        let report = conformance::run(slot, stage).unwrap();
        println!("{report}\n");
        report.failures().map(|check| format!("{slot} {stage}\n{check}\n")).collect::<String>()
    };
    let failures: String = std::thread::scope(|scope| {
        let stages = conformance::stages().filter(|(of, _)| *of == slot);
        let judged: Vec<_> = stages.map(|(_, stage)| scope.spawn(move || judge(stage))).collect();
        judged.into_iter().map(|judged| judged.join().unwrap()).collect()
    });
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
