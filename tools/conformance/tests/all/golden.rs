//! Every stage of every slot gives what it gave when its mathematics was last looked at.
//!
//! A change shows in the diff of `golden/SLOT/STAGE.csv`; the failing test says how to accept it.
use std::{collections::BTreeSet, fs, path::Path};

use conformance::golden::{difference, trace};

const GOLDEN: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/golden");

#[test]
fn every_stage_gives_its_golden_trace() {
    let now = Path::new(env!("CARGO_TARGET_TMPDIR")).join("golden");
    let mut differences = String::new();
    for (slot, stage) in conformance::stages() {
        let trace = trace(slot, stage).unwrap();
        fs::create_dir_all(now.join(slot)).unwrap();
        fs::write(now.join(slot).join(stage).with_extension("csv"), &trace).unwrap();
        let golden = fs::read_to_string(Path::new(GOLDEN).join(slot).join(stage).with_extension("csv"));
        let difference = golden.map_or(Some("no golden trace".into()), |golden| difference(&trace, &golden));
        differences.extend(difference.map(|difference| format!("{slot} {stage}: {difference}\n")));
    }
    let now = now.display();
    assert!(differences.is_empty(), "\n{differences}if that is meant: cp -r {now}/. {GOLDEN}; then read the diff");
}

#[test]
fn every_golden_trace_is_of_a_stage_that_there_is() {
    let stages: BTreeSet<_> = conformance::stages().map(|(slot, stage)| format!("{slot}/{stage}.csv")).collect();
    for slot in fs::read_dir(GOLDEN).unwrap() {
        let slot = slot.unwrap();
        for trace in fs::read_dir(slot.path()).unwrap() {
            let name = format!("{}/{}", slot.file_name().display(), trace.unwrap().file_name().display());
            assert!(stages.contains(&name), "{name} is of no stage: remove it");
        }
    }
}

#[test]
fn a_number_in_the_tenth_digit_is_the_same_and_one_in_the_eighth_is_not() {
    let golden = "t_s,u\n0,0.5\n1,0.25\n";
    assert_eq!(difference("t_s,u\n0,0.5\n1,0.2500000001\n", golden), None);
    assert!(difference("t_s,u\n0,0.5\n1,0.25000001\n", golden).unwrap().contains("u is 0.25000001"));
    assert!(difference("t_s,u\n0,0.5\n1,NaN\n", golden).is_some());
    assert!(difference("t_s,v\n0,0.5\n1,0.25\n", golden).is_some());
    assert!(difference("t_s,u\n0,0.5\n", golden).is_some());
}
