//! Compares the outputs of every stage with its golden trace.
//!
//! After an intended change, run the command that the failing test shows, and review the diff of
//! `golden/SLOT/STAGE.csv`.
use std::{collections::BTreeSet, fs, path::Path};

use conformance::golden::{difference, trace};

const GOLDEN: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/golden");

#[test]
fn stages_match_their_golden_traces() {
    let actual = Path::new(env!("CARGO_TARGET_TMPDIR")).join("golden");
    // Only the traces that differ are written, so that the command below changes no others.
    let _ = fs::remove_dir_all(&actual);
    let mut differences = String::new();
    for (slot, stage) in conformance::stages() {
        let trace = trace(slot, stage).unwrap();
        let golden = fs::read_to_string(Path::new(GOLDEN).join(slot.name()).join(stage).with_extension("csv"));
        let difference = golden.map_or(Some("no golden trace".into()), |golden| difference(&trace, &golden));
        if let Some(difference) = difference {
            fs::create_dir_all(actual.join(slot.name())).unwrap();
            fs::write(actual.join(slot.name()).join(stage).with_extension("csv"), &trace).unwrap();
            differences += &format!("{slot} {stage}: {difference}\n");
        }
    }
    let actual = actual.display();
    assert!(
        differences.is_empty(),
        "\n{differences}to accept the changes, run cp -r {actual}/. {GOLDEN} and review the diff"
    );
}

#[test]
fn golden_traces_belong_to_existing_stages() {
    let stages: BTreeSet<_> = conformance::stages().map(|(slot, stage)| format!("{slot}/{stage}.csv")).collect();
    for slot in fs::read_dir(GOLDEN).unwrap() {
        let slot = slot.unwrap();
        for trace in fs::read_dir(slot.path()).unwrap() {
            let name = format!("{}/{}", slot.file_name().display(), trace.unwrap().file_name().display());
            assert!(stages.contains(&name), "{name} belongs to no stage; remove it");
        }
    }
}

#[test]
fn difference_tolerates_1e_10_but_not_1e_8() {
    let golden = "t_s,u\n0,0.5\n1,0.25\n";
    assert_eq!(difference("t_s,u\n0,0.5\n1,0.2500000001\n", golden), None);
    assert!(difference("t_s,u\n0,0.5\n1,0.25000001\n", golden).unwrap().contains("u: found 0.25000001"));
    assert!(difference("t_s,u\n0,0.5\n1,NaN\n", golden).is_some());
    assert!(difference("t_s,v\n0,0.5\n1,0.25\n", golden).is_some());
    assert!(difference("t_s,u\n0,0.5\n", golden).is_some());
}
