//! A snapshot restores the whole state, and a damaged snapshot changes nothing.

use plumbline_ahrs::{Ahrs, Attitude, SnapshotError, stages::Fuser};

fn step(ahrs: &mut Ahrs<Fuser>, count: u32) -> Attitude {
    let t_s = f64::from(count) * 0.01;
    if count.is_multiple_of(3) {
        ahrs.update_mag([20.0 * t_s.sin(), 20.0 * t_s.cos(), -40.0]);
    }
    ahrs.update([0.1 * t_s.sin(), 0.02, 1.0], [0.1 * t_s.cos(), 0.2, 9.8], None, 0.01)
}

/// Returns a filter and its snapshot. Both are taken after `count` samples and one magnetometer
/// sample that no update has used yet.
fn filter(stage: &str, count: u32) -> (Ahrs<Fuser>, Vec<u8>) {
    let mut ahrs = Ahrs::<Fuser>::with_stage(stage).unwrap();
    for index in 0..count {
        step(&mut ahrs, index);
    }
    ahrs.update_mag([18.0, 2.0, -41.0]);
    let mut bytes = vec![0; ahrs.snapshot_len()];
    assert_eq!(ahrs.save(&mut bytes), Ok(bytes.len()));
    (ahrs, bytes)
}

#[test]
fn restored_filter_continues_with_the_same_bits() {
    for (stage, count) in Fuser::NAMES.into_iter().flat_map(|stage| [(stage, 0), (stage, 701)]) {
        let (mut ahrs, bytes) = filter(stage, count);
        let mut restored = Ahrs::<Fuser>::with_stage(stage).unwrap();
        restored.restore(&bytes).unwrap();
        assert_eq!(restored.attitude(), ahrs.attitude());
        for index in count + 1..count + 500 {
            assert_eq!(step(&mut restored, index), step(&mut ahrs, index), "{stage}");
        }
    }
}

#[test]
fn damaged_snapshot_is_rejected_and_changes_nothing() {
    let (ahrs, bytes) = filter("wz", 300);
    for index in 0..bytes.len() {
        let mut damaged = bytes.clone();
        damaged[index] ^= 0x40;
        let mut restored = Ahrs::<Fuser>::with_stage("wz").unwrap();
        assert!(restored.restore(&damaged).is_err(), "byte {index}");
        assert_eq!(restored.attitude(), Ahrs::<Fuser>::with_stage("wz").unwrap().attitude());
    }
    let mut other = Ahrs::<Fuser>::with_stage("vqf").unwrap();
    assert_eq!(other.restore(&bytes), Err(SnapshotError::OtherStages));
    let expected = bytes.len();
    let mut restored = ahrs.clone();
    assert_eq!(restored.restore(&bytes[..40]), Err(SnapshotError::Corrupt { expected, found: 40 }));
    assert_eq!(restored.restore(&[]), Err(SnapshotError::NotASnapshot));
    assert_eq!(ahrs.save(&mut [0; 8]), Err(SnapshotError::BufferTooSmall { needed: expected, found: 8 }));
}
