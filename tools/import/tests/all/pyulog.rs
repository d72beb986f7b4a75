//! Comparison with pyulog, the PX4 log reader.

use std::{collections::HashMap, path::Path};

use import::Format;

use crate::{
    common::{Folder, Imported, log},
    python::python,
    scripts::run_script,
};

/// Returns the samples of each topic as the time in µs and the fields.
fn samples(log: &Path) -> HashMap<String, Vec<(i64, Vec<f64>)>> {
    let mut topics: HashMap<String, Vec<_>> = HashMap::new();
    for words in run_script("pyulog_reader.py", &[log.as_os_str()]) {
        let fields = words[2..].iter().map(|word| word.parse().unwrap()).collect();
        topics.entry(words[0].clone()).or_default().push((words[1].parse().unwrap(), fields));
    }
    topics
}

/// Checks that every value equals the one read by pyulog, except for the normalisation of
/// quaternions.
fn assert_equal(imported: &Imported, topics: &HashMap<String, Vec<(i64, Vec<f64>)>>) -> (usize, usize, usize) {
    let none = Vec::new();
    let topic_samples = |topic: &str| topics.get(topic).unwrap_or(&none);
    let combined = topic_samples("sensor_combined");
    assert_eq!(imported.rows.len(), combined.len());
    for (row, (t_us, fields)) in imported.rows.iter().zip(combined) {
        let [gx, gy, gz, ax, ay, az, relative] = fields[..] else { panic!("{fields:?}") };
        assert_eq!((row.t_ns, row.rate_rad_s), (t_us * 1000, [gy, gx, -gz]));
        assert_eq!((relative, row.force_m_s2), (0.0, [ay, ax, -az]));
    }

    let attitudes: HashMap<_, _> = topic_samples("vehicle_attitude").iter().map(|(t_us, q)| (t_us * 1000, q)).collect();
    let mut same_time = 0;
    for row in &imported.rows {
        let (Some(reference), Some(q)) = (row.reference, attitudes.get(&row.t_ns)) else { continue };
        let expected = [q[0], q[2], q[1], -q[3]];
        assert!(reference.quaternion.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{row:?} {q:?}");
        same_time += 1;
    }

    // Each magnetic field sample must be at the nearest row only.
    let mut fields: Vec<(i64, [f64; 3])> =
        topic_samples("vehicle_magnetometer").iter().map(|(t, f)| (t * 1000, [f[0], f[1], f[2]])).collect();
    let own = topic_samples("own_field").iter().filter(|(_, f)| f[3] != f64::from(i32::MAX));
    fields.extend(own.map(|(t, f)| ((t + f[3] as i64) * 1000, [f[0], f[1], f[2]])));
    fields.dedup_by_key(|(t_ns, _)| *t_ns);
    let mut expected: HashMap<i64, (u64, [f64; 3])> = HashMap::new();
    for (t_ns, [x, y, z]) in fields {
        let nearest = imported.rows.iter().min_by_key(|row| row.t_ns.abs_diff(t_ns)).unwrap().t_ns;
        let distance_ns = nearest.abs_diff(t_ns);
        let nearest_sample = expected.entry(nearest).or_insert((u64::MAX, [0.0; 3]));
        if distance_ns <= 50_000_000 && distance_ns < nearest_sample.0 {
            *nearest_sample = (distance_ns, [y * 100.0, x * 100.0, -z * 100.0]);
        }
    }
    expected.retain(|_, (distance_ns, _)| *distance_ns < u64::MAX);
    let found: HashMap<_, _> = imported.rows.iter().filter_map(|row| Some((row.t_ns, row.field_ut?))).collect();
    assert_eq!(found, expected.iter().map(|(t_ns, (_, field))| (*t_ns, *field)).collect());

    let fixes = topic_samples("vehicle_gps_position");
    assert_eq!(imported.fixes.len(), fixes.len());
    for (fix, (t_us, fields)) in imported.fixes.iter().zip(fixes) {
        let [north, east, down, latitude, ..] = fields[..] else { panic!("{fields:?}") };
        assert_eq!((fix.t_ns, fix.velocity_m_s), (t_us * 1000, [east, north, -down]));
        assert_eq!(fix.latitude_deg, Some(latitude / 1e7));
    }
    (same_time, found.len(), fixes.len())
}

#[recorded::test]
fn real_logs_match_pyulog() {
    for (name, rows, expected) in
        [("px4_sample.ulg", 17_070, (6_459, 6_551, 0)), ("px4_small.ulg", 1_298, (1_298, 319, 32))]
    {
        let (Some(path), Some(_)) = (log(name), python()) else { return };
        let folder = Folder::new();
        let imported = folder.import(std::slice::from_ref(&path), None).unwrap();
        assert_eq!((imported.summary.format, imported.rows.len()), (Format::Ulog, rows));
        let compared = assert_equal(&imported, &samples(&path));
        assert_eq!(compared, expected, "attitudes, fields, fixes");
    }
}
