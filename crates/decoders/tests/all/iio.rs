//! A tree as the kernel makes it, and the records of its device.

use std::{fs, path::Path};

use decoders::{
    DeviceTime, Framed, Measurement, Value,
    iio::{Clock, Iio, IioError, Pair, sysfs},
};

use crate::streams::decoded;

/// A gyro of big-endian 16 bits, an accelerometer of little-endian 12 bits in the upper ones of 16, a magnetometer of 32 bits, a time.
fn device(root: &Path) -> std::path::PathBuf {
    let device = root.join("iio:device0");
    fs::create_dir_all(device.join("scan_elements")).unwrap();
    fs::create_dir_all(device.join("buffer")).unwrap();
    let put = |name: &str, text: &str| fs::write(device.join(name), format!("{text}\n")).unwrap();
    put("name", "bmi160");
    put("buffer/enable", "1");
    put("buffer/length", "2");
    put("current_timestamp_clock", "realtime");
    put("sampling_frequency", "25");
    put("in_anglvel_scale", "0.001");
    put("in_accel_scale", "0.01");
    put("in_accel_z_scale", "0.02");
    put("in_accel_offset", "10");
    put("in_magn_scale", "0.0005");
    put("in_mount_matrix", "0, 1, 0; -1, 0, 0; 0, 0, 1");
    put("in_accel_mount_matrix", "1, 0, 0; 0, 1, 0; 0, 0, 1");
    let channels = [("in_anglvel", "be:s16/16>>0", 0), ("in_accel", "le:s12/16>>4", 3), ("in_magn", "le:s32/32>>0", 6)];
    for (name, kind, first) in channels {
        for (axis, letter) in ["x", "y", "z"].into_iter().enumerate() {
            let put = |what: &str, text: &str| put(&format!("scan_elements/{name}_{letter}_{what}"), text);
            put("en", "0");
            put("type", kind);
            put("index", &(first + axis).to_string());
        }
    }
    // Between the others, and not wanted.
    for (name, kind, index, en) in [("in_temp", "le:s16/16>>0", 9, "0"), ("in_timestamp", "le:s64/64>>0", 10, "0")] {
        put(&format!("scan_elements/{name}_en"), en);
        put(&format!("scan_elements/{name}_type"), kind);
        put(&format!("scan_elements/{name}_index"), &index.to_string());
    }
    device
}

/// Six numbers of 16 bits are 12 bytes, those of 32 bits the 12 after them, and the stamp the last 8.
fn record(rate: [i16; 3], force: [i16; 3], field: [i32; 3], t_ns: i64) -> Vec<u8> {
    let rate = rate.map(i16::to_be_bytes).concat();
    // The lower four bits do not count.
    let force = force.map(|part| (part << 4 | 0xf).to_le_bytes()).concat();
    [rate, force, field.map(i32::to_le_bytes).concat(), t_ns.to_le_bytes().to_vec()].concat()
}

#[test]
fn a_device_is_switched_on_and_its_records_are_read() {
    let root = tempfile::tempdir().unwrap();
    let device = device(root.path());
    assert_eq!(sysfs::find(root.path(), "bmi160").unwrap(), device);
    assert_eq!(sysfs::find(root.path(), "iio:device0").unwrap(), device);
    let layout = sysfs::prepare(&device, 128, Some(200.0)).unwrap();
    for (file, said) in [
        ("buffer/enable", "1"),
        ("buffer/length", "128"),
        ("current_timestamp_clock", "monotonic"),
        ("sampling_frequency", "200"),
        ("scan_elements/in_accel_z_en", "1"),
        ("scan_elements/in_timestamp_en", "1"),
        ("scan_elements/in_temp_en", "0\n"),
    ] {
        assert_eq!(fs::read_to_string(device.join(file)).unwrap(), said, "{file}");
    }
    assert_eq!((layout.record_bytes, layout.clock), (32, Clock::Monotonic));

    let records = [record([1000, -2000, 3], [2047, -2048, 0], [1000, -2, 0], 5), record([0; 3], [0; 3], [0; 3], -1)];
    let (found, counts) = decoded(Box::new(Framed::new(Iio::new(layout).unwrap())), records.concat().chunks(7));
    assert_eq!(counts.frames, 2);
    let Value::Imu { rate_rad_s, force_m_s2, field_ut } = found[0].value else { panic!("{found:?}") };
    let near = |found: [f64; 3], wanted: [f64; 3]| found.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-12);
    assert!(near(rate_rad_s, [-2.0, -1.0, 0.003]), "{rate_rad_s:?}");
    assert!(near(force_m_s2, [20.57, -20.38, 0.2]), "{force_m_s2:?}");
    assert!(near(field_ut.unwrap(), [-0.1, -50.0, 0.0]), "{field_ut:?}");
    assert_eq!(found[0].time, Some(DeviceTime::SinceBoot { now_ns: 5 }));
    assert_eq!(found[1].time, None);
}

#[test]
fn a_channel_more_moves_those_behind_it() {
    let root = tempfile::tempdir().unwrap();
    let device = device(root.path());
    let before = sysfs::prepare(&device, 2, None).unwrap();
    fs::write(device.join("scan_elements/in_temp_en"), "1").unwrap();
    let after = sysfs::read(&device).unwrap();
    // 24 bytes of others, 2 of the temperature, 6 of nothing, 8 of the stamp.
    assert_eq!((before.time.unwrap().at, before.record_bytes), (24, 32));
    assert_eq!((after.time.unwrap().at, after.record_bytes), (32, 40));
    assert_eq!(fs::read_to_string(device.join("sampling_frequency")).unwrap(), "25\n");
}

#[test]
fn channels_are_also_found_where_newer_kernels_have_them() {
    let root = tempfile::tempdir().unwrap();
    let device = device(root.path());
    fs::rename(device.join("scan_elements"), device.join("buffer0")).unwrap();
    let layout = sysfs::prepare(&device, 2, None).unwrap();
    assert_eq!(layout.record_bytes, 32);
}

#[test]
fn what_is_wrong_is_said_with_its_file() {
    let root = tempfile::tempdir().unwrap();
    let device = device(root.path());
    let none = sysfs::find(root.path(), "bmi161").unwrap_err().to_string();
    assert!(none.ends_with("there is none; there are bmi160"), "{none}");
    let Err(IioError::Missing { .. }) = sysfs::read(&device) else { panic!("nothing is enabled") };
    for (file, text, said) in [
        ("scan_elements/in_accel_x_type", "le:s17/16>>0", "found \"le:s17/16>>0\", expected such as le:s16/16>>0"),
        ("scan_elements/in_accel_x_index", "-1", "found \"-1\", expected a whole number"),
        ("in_accel_scale", "nan", "found \"nan\", expected a number"),
        ("in_mount_matrix", "1, 0, 0; 0, 1, 0; 0, 0, -1", "expected a rotation"),
        ("in_mount_matrix", "1, 0, 0; 0, 1, 0", "expected a rotation"),
    ] {
        let path = device.join(file);
        let before = fs::read(&path).unwrap();
        fs::write(&path, text).unwrap();
        let error = sysfs::prepare(&device, 2, None).unwrap_err().to_string();
        assert!(error.contains(&format!("reading {}", path.display())) && error.contains(said), "{error}");
        fs::write(&path, before).unwrap();
    }
    // What is no device is not made one.
    let empty = root.path().join("empty");
    fs::create_dir(&empty).unwrap();
    assert!(matches!(sysfs::prepare(&empty, 2, None), Err(IioError::Write { .. })));
    assert_eq!(fs::read_dir(&empty).unwrap().count(), 0);
}

/// A device of one quantity: three numbers of 16 bits, two bytes of nothing, a time.
fn half(root: &Path, folder: &str, name: &str) -> decoders::iio::Layout {
    let device = root.join(folder);
    fs::create_dir_all(device.join("scan_elements")).unwrap();
    fs::create_dir_all(device.join("buffer")).unwrap();
    let put = |file: &str, text: &str| fs::write(device.join(file), text).unwrap();
    for file in ["buffer/enable", "buffer/length"] {
        put(file, "0");
    }
    put("current_timestamp_clock", "realtime");
    put(&format!("{name}_scale"), "0.5");
    let channels = ["x", "y", "z"].map(|axis| format!("{name}_{axis}"));
    for (index, channel) in channels.iter().enumerate() {
        put(&format!("scan_elements/{channel}_en"), "0");
        put(&format!("scan_elements/{channel}_type"), "le:s16/16>>0");
        put(&format!("scan_elements/{channel}_index"), &index.to_string());
    }
    put("scan_elements/in_timestamp_en", "0");
    put("scan_elements/in_timestamp_type", "le:s64/64>>0");
    put("scan_elements/in_timestamp_index", "3");
    sysfs::prepare(&device, 64, None).unwrap()
}

fn half_record(number: i16, t_ms: i64) -> Vec<u8> {
    let numbers = [number, 2 * number, -number].map(i16::to_le_bytes).concat();
    [numbers, vec![0; 2], (t_ms * 1_000_000).to_le_bytes().to_vec()].concat()
}

fn pair() -> Pair {
    let root = tempfile::tempdir().unwrap();
    let gyro = half(root.path(), "iio:device0", "in_anglvel");
    let accel = half(root.path(), "iio:device1", "in_accel");
    assert!(matches!(Iio::new(gyro.clone()), Err(IioError::Missing { missing: "in_accel" })));
    assert!(matches!(Pair::new(accel.clone(), gyro.clone()), Err(IioError::Missing { missing: "in_anglvel" })));
    let other = decoders::iio::Layout { clock: Clock::Realtime, ..accel.clone() };
    assert!(matches!(Pair::new(gyro.clone(), other), Err(IioError::Clocks { .. })));
    Pair::new(gyro, accel).unwrap()
}

/// Time in ms, the rate's x and the force's.
fn xs(found: &[Measurement]) -> Vec<(u64, f64, f64)> {
    let of = |found: &Measurement| match (found.time, found.value) {
        (Some(DeviceTime::SinceBoot { now_ns }), Value::Imu { rate_rad_s, force_m_s2, .. }) => {
            assert_eq!([rate_rad_s[1], force_m_s2[2]], [2.0 * rate_rad_s[0], -force_m_s2[0]]);
            (now_ns / 1_000_000, rate_rad_s[0], force_m_s2[0])
        }
        _ => panic!("{found:?}"),
    };
    found.iter().map(of).collect()
}

#[test]
fn two_devices_of_one_chip_make_one_with_the_force_at_the_time_of_the_rate() {
    let wanted = [(10, 5.0, 50.0), (15, 7.5, 75.0), (20, 10.0, 100.0), (25, 12.5, 125.0), (30, 15.0, 150.0)];
    let gyro: Vec<u8> = wanted.iter().flat_map(|(t_ms, ..)| half_record(*t_ms as i16, *t_ms as i64)).collect();
    let accel: Vec<u8> = [0i16, 8, 16, 24, 32].iter().flat_map(|t_ms| half_record(10 * t_ms, (*t_ms).into())).collect();
    // In bursts of either, and byte by byte.
    for size in [gyro.len(), 1, 17] {
        for gyro_is_first in [true, false] {
            let (mut pair, mut found) = (pair(), Vec::new());
            let pieces = gyro.chunks(size).map(Some).chain(std::iter::repeat(None));
            for (gyro, accel) in pieces.zip(accel.chunks(size)) {
                if gyro_is_first {
                    gyro.into_iter().for_each(|gyro| pair.push_gyro(gyro, &mut found));
                    pair.push_accel(accel, &mut found);
                } else {
                    pair.push_accel(accel, &mut found);
                    gyro.into_iter().for_each(|gyro| pair.push_gyro(gyro, &mut found));
                }
            }
            assert_eq!(xs(&found), wanted, "{size} {gyro_is_first}");
            assert_eq!((pair.counts().frames, pair.counts().refused), (10, 0));
        }
    }
}

#[test]
fn an_accelerometer_that_is_unplugged_is_missed_and_one_that_begins_again_is_followed() {
    let (mut pair, mut found) = (pair(), Vec::new());
    let mut gyro = |pair: &mut Pair, t_ms: i64| pair.push_gyro(&half_record(2, t_ms), &mut found);
    let mut unused = Vec::new();
    pair.push_accel(&half_record(4, 0), &mut unused);
    for t_ms in (10..600).step_by(10) {
        gyro(&mut pair, t_ms);
    }
    // 590 − 200 ms have gone; of those, 100 ms after the force with it. The rest wait.
    assert_eq!((pair.counts().frames, pair.counts().refused), (60, 28));
    // The clock begins again: what waits is lost, and what follows is not.
    gyro(&mut pair, 5);
    pair.push_accel(&half_record(4, 2), &mut unused);
    assert_eq!(pair.counts().refused, 28 + 21);
    pair.push_accel(&half_record(8, 6), &mut unused);
    assert_eq!(xs(&unused), [(5, 1.0, 3.5)]);
    assert_eq!(xs(&found).len(), 10);
}
