//! Conformance of every built-in stage.
use launch::Slot;

fn assert_all_conform(slot: Slot) {
    let check = |stage: &str| {
        let report = conformance::run(slot, stage).unwrap();
        println!("{report}\n");
        report.failures().map(|check| format!("{slot} {stage}\n{check}\n")).collect::<String>()
    };
    let failures: String = std::thread::scope(|scope| {
        let stages = conformance::stages().filter(|(stage_slot, _)| *stage_slot == slot);
        let threads: Vec<_> = stages.map(|(_, stage)| scope.spawn(move || check(stage))).collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    });
    assert!(failures.is_empty(), "\n{failures}");
}

#[test]
fn gyro_stages_conform() {
    assert_all_conform(Slot::Gyro);
}

#[test]
fn accel_stages_conform() {
    assert_all_conform(Slot::Accel);
}

#[test]
fn fuser_stages_conform() {
    assert_all_conform(Slot::Fuser);
}

#[test]
fn course_stages_conform() {
    assert_all_conform(Slot::Course);
}
