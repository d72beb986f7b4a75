//! Conformance checks that every stage of Plumbline must pass.

use @module@::@Class@;

#[test]
fn stage_conforms() {
    let report = conformance::@slot@(@Class@::default);
    println!("{report}");
    assert!(report.passed(), "{report}");
}
