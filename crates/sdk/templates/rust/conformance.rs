//! The stage against the kit that every stage of Plumbline passes.

use @module@::@Class@;

#[test]
fn the_stage_conforms() {
    let report = conformance::@slot@(@Class@::default);
    println!("{report}");
    assert!(report.passed(), "{report}");
}
