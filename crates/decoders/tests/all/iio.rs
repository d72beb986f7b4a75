//! IIO devices in a sysfs-like folder tree, and their records.

use std::{fs, path::Path};

use decoders::{
    DeviceTime, Framed, Measurement, Value,
    iio::{Clock, DevicePair, Iio, IioError, sysfs},
};

use crate::streams::decoded;

/// Creates a device with a gyro, an accelerometer, a magnetometer and a timestamp.
///
/// The gyro values are 16-bit big-endian numbers. The accelerometer values occupy the upper 12 bits
/// of 16-bit little-endian numbers. The magnetometer values have 32 bits.
fn device(root: &Path) -> std::path::PathBuf {
    let device = root.join("iio:device0");
    fs::create_dir_all(device.join("scan_elements")).unwrap();
    fs::create_dir_all(device.join("buffer")).unwrap();
    let write = |name: &str, text: &str| fs::write(device.join(name), format!("{text}\n")).unwrap();
    write("name", "bmi160");
    write("buffer/enable", "1");
    write("buffer/length", "2");
    write("current_timestamp_clock", "realtime");
    write("sampling_frequency", "25");
    write("in_anglvel_scale", "0.001");
    write("in_accel_scale", "0.01");
    write("in_accel_z_scale", "0.02");
    write("in_accel_offset", "10");
    write("in_magn_scale", "0.0005");
    write("in_mount_matrix", "0, 1, 0; -1, 0, 0; 0, 0, 1");
    write("in_accel_mount_matrix", "1, 0, 0; 0, 1, 0; 0, 0, 1");
    let channels = [("in_anglvel", "be:s16/16>>0", 0), ("in_accel", "le:s12/16>>4", 3), ("in_magn", "le:s32/32>>0", 6)];
    for (name, kind, first) in channels {
        for (axis, letter) in ["x", "y", "z"].into_iter().enumerate() {
            let write = |what: &str, text: &str| write(&format!("scan_elements/{name}_{letter}_{what}"), text);
            write("en", "0");
            write("type", kind);
            write("index", &(first + axis).to_string());
        }
    }
    // Adds a disabled channel that is not needed, and the timestamp after it.
    for (name, kind, index, en) in [("in_temp", "le:s16/16>>0", 9, "0"), ("in_timestamp", "le:s64/64>>0", 10, "0")] {
        write(&format!("scan_elements/{name}_en"), en);
        write(&format!("scan_elements/{name}_type"), kind);
        write(&format!("scan_elements/{name}_index"), &index.to_string());
    }
    device
}

/// Returns a record of six 16-bit numbers (12 bytes), three 32-bit numbers (12 bytes) and the
/// timestamp (8 bytes).
fn record(rate: [i16; 3], force: [i16; 3], field: [i32; 3], t_ns: i64) -> Vec<u8> {
    let rate = rate.map(i16::to_be_bytes).concat();
    // The four lowest bits are not significant.
    let force = force.map(|part| (part << 4 | 0xf).to_le_bytes()).concat();
    [rate, force, field.map(i32::to_le_bytes).concat(), t_ns.to_le_bytes().to_vec()].concat()
}

#[test]
fn device_is_enabled_and_records_are_decoded() {
    let root = tempfile::tempdir().unwrap();
    let device = device(root.path());
    assert_eq!(sysfs::find(root.path(), "bmi160").unwrap(), device);
    assert_eq!(sysfs::find(root.path(), "iio:device0").unwrap(), device);
    let layout = sysfs::prepare(&device, 128, Some(200.0)).unwrap();
    for (file, expected) in [
        ("buffer/enable", "1"),
        ("buffer/length", "128"),
        ("current_timestamp_clock", "monotonic"),
        ("sampling_frequency", "200"),
        ("scan_elements/in_accel_z_en", "1"),
        ("scan_elements/in_timestamp_en", "1"),
        ("scan_elements/in_temp_en", "0\n"),
    ] {
        assert_eq!(fs::read_to_string(device.join(file)).unwrap(), expected, "{file}");
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
fn enabled_channel_shifts_later_ones() {
    let root = tempfile::tempdir().unwrap();
    let device = device(root.path());
    let before = sysfs::prepare(&device, 2, None).unwrap();
    fs::write(device.join("scan_elements/in_temp_en"), "1").unwrap();
    let after = sysfs::read(&device).unwrap();
    // Without the temperature, a record has 24 bytes of vectors and 8 of timestamp. With it, 2
    // bytes of temperature and 6 of padding are inserted between them.
    assert_eq!((before.time.unwrap().byte_offset, before.record_bytes), (24, 32));
    assert_eq!((after.time.unwrap().byte_offset, after.record_bytes), (32, 40));
    assert_eq!(fs::read_to_string(device.join("sampling_frequency")).unwrap(), "25\n");
}

#[test]
fn channels_in_buffer0_are_found() {
    let root = tempfile::tempdir().unwrap();
    let device = device(root.path());
    fs::rename(device.join("scan_elements"), device.join("buffer0")).unwrap();
    let layout = sysfs::prepare(&device, 2, None).unwrap();
    assert_eq!(layout.record_bytes, 32);
}

#[test]
fn errors_name_the_file_and_expectation() {
    let root = tempfile::tempdir().unwrap();
    let device = device(root.path());
    let none = sysfs::find(root.path(), "bmi161").unwrap_err().to_string();
    assert!(none.contains("no IIO device \"bmi161\"") && none.ends_with("available: bmi160"), "{none}");
    let Err(IioError::MissingChannels { .. }) = sysfs::read(&device) else { panic!("no channel is enabled") };
    for (file, text, expected) in [
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
        assert!(error.contains(&format!("reading {}", path.display())) && error.contains(expected), "{error}");
        fs::write(&path, before).unwrap();
    }
    // A folder that is not a device remains unchanged.
    let empty = root.path().join("empty");
    fs::create_dir(&empty).unwrap();
    assert!(matches!(sysfs::prepare(&empty, 2, None), Err(IioError::Write { .. })));
    assert_eq!(fs::read_dir(&empty).unwrap().count(), 0);
}

/// Creates a device that measures one quantity: three 16-bit numbers, two bytes of padding, a
/// timestamp.
fn single_quantity_device(root: &Path, folder: &str, name: &str) -> decoders::iio::Layout {
    let device = root.join(folder);
    fs::create_dir_all(device.join("scan_elements")).unwrap();
    fs::create_dir_all(device.join("buffer")).unwrap();
    let write = |file: &str, text: &str| fs::write(device.join(file), text).unwrap();
    for file in ["buffer/enable", "buffer/length"] {
        write(file, "0");
    }
    write("current_timestamp_clock", "realtime");
    write(&format!("{name}_scale"), "0.5");
    let channels = ["x", "y", "z"].map(|axis| format!("{name}_{axis}"));
    for (index, channel) in channels.iter().enumerate() {
        write(&format!("scan_elements/{channel}_en"), "0");
        write(&format!("scan_elements/{channel}_type"), "le:s16/16>>0");
        write(&format!("scan_elements/{channel}_index"), &index.to_string());
    }
    write("scan_elements/in_timestamp_en", "0");
    write("scan_elements/in_timestamp_type", "le:s64/64>>0");
    write("scan_elements/in_timestamp_index", "3");
    sysfs::prepare(&device, 64, None).unwrap()
}

fn record_of_one_quantity(number: i16, t_ms: i64) -> Vec<u8> {
    let numbers = [number, 2 * number, -number].map(i16::to_le_bytes).concat();
    [numbers, vec![0; 2], (t_ms * 1_000_000).to_le_bytes().to_vec()].concat()
}

fn pair() -> DevicePair {
    let root = tempfile::tempdir().unwrap();
    let gyro = single_quantity_device(root.path(), "iio:device0", "in_anglvel");
    let accel = single_quantity_device(root.path(), "iio:device1", "in_accel");
    assert!(matches!(Iio::new(gyro.clone()), Err(IioError::MissingChannels { missing: "in_accel" })));
    assert!(matches!(
        DevicePair::new(accel.clone(), gyro.clone()),
        Err(IioError::MissingChannels { missing: "in_anglvel" })
    ));
    let other = decoders::iio::Layout { clock: Clock::Realtime, ..accel.clone() };
    assert!(matches!(DevicePair::new(gyro.clone(), other), Err(IioError::ClockMismatch { .. })));
    DevicePair::new(gyro, accel).unwrap()
}

/// Returns the time in ms and the x components of rate and force.
fn times_and_x_components(found: &[Measurement]) -> Vec<(u64, f64, f64)> {
    let row = |found: &Measurement| match (found.time, found.value) {
        (Some(DeviceTime::SinceBoot { now_ns }), Value::Imu { rate_rad_s, force_m_s2, .. }) => {
            assert_eq!([rate_rad_s[1], force_m_s2[2]], [2.0 * rate_rad_s[0], -force_m_s2[0]]);
            (now_ns / 1_000_000, rate_rad_s[0], force_m_s2[0])
        }
        _ => panic!("{found:?}"),
    };
    found.iter().map(row).collect()
}

#[test]
fn device_pair_interpolates_force_at_rate_time() {
    let wanted = [(10, 5.0, 50.0), (15, 7.5, 75.0), (20, 10.0, 100.0), (25, 12.5, 125.0), (30, 15.0, 150.0)];
    let gyro: Vec<u8> =
        wanted.iter().flat_map(|(t_ms, ..)| record_of_one_quantity(*t_ms as i16, *t_ms as i64)).collect();
    let accel: Vec<u8> =
        [0i16, 8, 16, 24, 32].iter().flat_map(|t_ms| record_of_one_quantity(10 * t_ms, (*t_ms).into())).collect();
    // All bytes in one chunk, byte by byte, and in chunks of 17 bytes.
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
            assert_eq!(times_and_x_components(&found), wanted, "{size} {gyro_is_first}");
            assert_eq!((pair.counts().frames, pair.counts().rejected), (10, 0));
        }
    }
}

#[test]
fn device_pair_handles_accel_loss_and_clock_reset() {
    let (mut pair, mut found) = (pair(), Vec::new());
    let mut gyro = |pair: &mut DevicePair, t_ms: i64| pair.push_gyro(&record_of_one_quantity(2, t_ms), &mut found);
    let mut unused = Vec::new();
    pair.push_accel(&record_of_one_quantity(4, 0), &mut unused);
    for t_ms in (10..600).step_by(10) {
        gyro(&mut pair, t_ms);
    }
    // The gyro records up to 390 ms (590 − 200) are no longer held: those within 100 ms of a force
    // were used, the others rejected. Later records are still held.
    assert_eq!((pair.counts().frames, pair.counts().rejected), (60, 28));
    // After a clock reset the held records are discarded, and decoding continues.
    gyro(&mut pair, 5);
    pair.push_accel(&record_of_one_quantity(4, 2), &mut unused);
    assert_eq!(pair.counts().rejected, 28 + 21);
    pair.push_accel(&record_of_one_quantity(8, 6), &mut unused);
    assert_eq!(times_and_x_components(&unused), [(5, 1.0, 3.5)]);
    assert_eq!(times_and_x_components(&found).len(), 10);
}
