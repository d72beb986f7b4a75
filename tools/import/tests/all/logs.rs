//! Clocks, segments and sensors of logs, in several formats.

use decoders::mavlink::frame::{STX_V1, STX_V2, checksum, crc_extra};
use import::{Format, Mapping, Note, Options};

use crate::{
    ardupilot::DataFlashLog,
    common::{ATTITUDE, COMBINED, Folder, Imported, Log},
};

const MS: i64 = 1_000_000;
const NAMES: &str = "t=t,gx=p,gy=q,gz=r,ax=u,ay=v,az=w";

fn notes(imported: &Imported) -> String {
    imported.summary.notes.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n")
}

fn times_ms(imported: &Imported) -> Vec<i64> {
    imported.rows.iter().map(|row| row.t_ns / MS).collect()
}

/// Returns a MAVLink message of version 1 or 2, preceded by its arrival time.
fn tlog_record(arrival_us: u64, version: u8, message: u32, payload: &[u8]) -> Vec<u8> {
    let length = u8::try_from(payload.len()).unwrap();
    let id = message.to_le_bytes();
    let head = match version {
        1 => vec![STX_V1, length, 0, 1, 1, id[0]],
        _ => vec![STX_V2, length, 0, 0, 0, 1, 1, id[0], id[1], id[2]],
    };
    let frame = [&head[..], payload].concat();
    let sum = checksum(&frame[1..], crc_extra(message).unwrap()).to_le_bytes();
    [&arrival_us.to_be_bytes()[..], &frame, &sum].concat()
}

fn scaled_imu(t_ms: u32, numbers: [i16; 9]) -> Vec<u8> {
    let numbers = numbers.iter().flat_map(|number| number.to_le_bytes());
    t_ms.to_le_bytes().into_iter().chain(numbers).collect()
}

#[test]
fn telemetry_logs_of_both_versions_are_read() {
    for version in [1, 2] {
        let mut log = Vec::new();
        for n in 0..100u32 {
            let arrival_us = 1_700_000_000_000_000 + u64::from(n) * 20_300;
            log.extend(tlog_record(arrival_us, version, 0, &[0, 0, 0, 0, 1, 3, 81, 4, 3]));
            log.extend(tlog_record(
                arrival_us,
                version,
                26,
                &scaled_imu(5000 + 20 * n, [0, 0, -1000, 100, 0, 0, 200, 0, 430]),
            ));
            if n % 10 == 5 {
                // GPS_RAW_INT of the same instant, with a UNIX time.
                let mut payload = vec![0; 30];
                payload[..8].copy_from_slice(&1_600_000_000_000_000u64.to_le_bytes());
                payload[24..26].copy_from_slice(&500u16.to_le_bytes());
                payload[28] = 3;
                log.extend(tlog_record(arrival_us, version, 24, &payload));
            }
        }
        log.extend([0; 40]);
        let folder = Folder::new();
        let path = folder.file("a.tlog", &log);
        assert_eq!(Format::detect(&path).unwrap(), Format::Tlog);
        let imported = folder.import(&[path], None).unwrap();
        assert_eq!(times_ms(&imported), (0..100).map(|n| 5000 + 20 * n).collect::<Vec<_>>(), "version {version}");
        let row = imported.rows[0];
        assert!((row.force_m_s2[2] - 9.80665).abs() < 1e-9 && (row.rate_rad_s[1] - 0.1).abs() < 1e-9, "{row:?}");
        assert_eq!(imported.summary.field_rows, 100);
        let fixes: Vec<_> = imported.fixes.iter().map(|fix| (fix.t_ns / MS, fix.velocity_m_s[1])).collect();
        assert_eq!(fixes, (0..10).map(|n| (5100 + 200 * n, 5.0)).collect::<Vec<_>>());
        assert!(notes(&imported).contains("skipped 40 bytes"), "{}", notes(&imported));
    }
}

/// Returns ATTITUDE and ATTITUDE_QUATERNION messages for a body with this roll, pitch and yaw, rad.
fn attitude_messages(t_ms: u32, [roll, pitch, yaw]: [f32; 3]) -> [Vec<u8>; 2] {
    let bytes = |numbers: &[f32]| -> Vec<u8> {
        t_ms.to_le_bytes().into_iter().chain(numbers.iter().flat_map(|number| number.to_le_bytes())).collect()
    };
    let [(sr, cr), (sp, cp), (sy, cy)] = [roll, pitch, yaw].map(|angle| (angle / 2.0).sin_cos());
    let quaternion = [
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    ];
    [bytes(&[roll, pitch, yaw, 0.0, 0.0, 0.0]), bytes(&[quaternion, [0.0; 4]].concat()[..7])]
}

#[test]
fn attitude_of_telemetry_log_is_the_reference() {
    // The attitudes are: level and facing north, facing east, rolled to the right by 90°, and nose
    // up by 0.5 rad.
    let right = std::f32::consts::FRAC_PI_2;
    let half = std::f64::consts::FRAC_1_SQRT_2;
    for (angles, expected) in [
        ([0.0; 3], [1.0, 0.0, 0.0, 0.0]),
        ([0.0, 0.0, right], [half, 0.0, 0.0, -half]),
        ([right, 0.0, 0.0], [half, 0.0, half, 0.0]),
        ([0.0, 0.5, 0.0], [0.25f64.cos(), 0.25f64.sin(), 0.0, 0.0]),
    ] {
        for messages in [&[30][..], &[31], &[30, 31]] {
            let mut log = Vec::new();
            for n in 0..50u32 {
                let arrival_us = 1_700_000_000_000_000 + u64::from(n) * 20_000;
                let motion = scaled_imu(5000 + 20 * n, [0, 0, -1000, 100, 0, 0, 200, 0, 430]);
                log.extend(tlog_record(arrival_us, 2, 26, &motion));
                let [euler, quaternion] = attitude_messages(5000 + 20 * n, angles);
                for message in messages {
                    let payload = if *message == 30 { &euler } else { &quaternion };
                    log.extend(tlog_record(arrival_us, 2, *message, payload));
                }
            }
            let folder = Folder::new();
            let imported = folder.import(&[folder.file("a.tlog", &log)], None).unwrap();
            assert_eq!(imported.summary.reference_rows, 50, "{messages:?}: {}", notes(&imported));
            let found = imported.rows[7].reference.unwrap().quaternion;
            let cosine: f64 = found.iter().zip(expected).map(|(a, b)| a * b).sum();
            assert!((cosine.abs() - 1.0).abs() < 1e-6, "{angles:?} {messages:?}: {found:?}");
            assert!(!notes(&imported).contains("reference"), "{}", notes(&imported));
        }
    }
}

#[test]
fn telemetry_log_with_raw_imu_only_is_read() {
    let mut log = Vec::new();
    for n in 0..50u32 {
        let arrival_us = 1_700_000_000_000_000 + u64::from(n) * 20_000;
        let numbers = [0i16, 0, -1000, 100, 0, 0, 200, 0, 430].map(i16::to_le_bytes);
        let time_us = u64::from(5_000_000 + 20_000 * n).to_le_bytes();
        log.extend(tlog_record(arrival_us, 1, 27, &[&time_us[..], numbers.as_flattened()].concat()));
    }
    let folder = Folder::new();
    let imported = folder.import(&[folder.file("a.tlog", &log)], None).unwrap();
    assert_eq!(times_ms(&imported), (0..50).map(|n| 5000 + 20 * n).collect::<Vec<_>>());
}

#[test]
fn dead_sensor_of_telemetry_log_is_passed_over() {
    let folder = Folder::new();
    for version in [1, 2] {
        let mut log = Vec::new();
        for n in 0..100u32 {
            let arrival_us = 1_700_000_000_000_000 + u64::from(n) * 20_000;
            let numbers = [n as i16, 0, -1000, 100, n as i16, 0, 200, 0, 430];
            log.extend(tlog_record(arrival_us, version, 26, &scaled_imu(5000 + 20 * n, [0; 9])));
            log.extend(tlog_record(arrival_us, version, 116, &scaled_imu(5000 + 20 * n, numbers)));
        }
        let path = folder.file("a.tlog", &log);
        let imported = folder.import(std::slice::from_ref(&path), None).unwrap();
        assert!((imported.rows[0].force_m_s2[2] - 9.80665).abs() < 1e-9, "{:?}", imported.rows[0]);
        assert!(notes(&imported).contains("SCALED_IMU is dead"), "{}", notes(&imported));
        let sensors: Vec<_> = imported.summary.sensors.iter().map(ToString::to_string).collect();
        let expected = [
            "--imu 0: SCALED_IMU, 100 samples at 50.0 Hz, dead: constant",
            "--imu 1: SCALED_IMU2, 100 samples at 50.0 Hz, healthy, read",
        ];
        assert_eq!(sensors, expected);
        let chosen = |imu| Options { imu: Some(imu), ..Options::default() };
        let imported = folder.import_with(std::slice::from_ref(&path), &chosen(0)).unwrap();
        assert_eq!(imported.rows[0].force_m_s2, [0.0; 3]);
        let error = folder.import_with(std::slice::from_ref(&path), &chosen(2)).unwrap_err();
        assert!(error.to_string().contains("--imu 2: no such sensor, expected 0 to 1"), "{error}");
        let error = folder.import_with(&[path], &Options { mag: Some(1), ..Options::default() }).unwrap_err();
        assert!(error.to_string().contains("--mag 1: no such sensor"), "{error}");
    }
}

#[test]
fn arrival_times_replace_a_stopped_clock_of_a_tlog() {
    let mut log = Vec::new();
    for n in 0..100u32 {
        let numbers = [n as i16, 0, -1000, 100, n as i16, 0, 200, 0, 430];
        log.extend(tlog_record(1_700_000_000_000_000 + u64::from(n) * 20_000, 1, 26, &scaled_imu(0, numbers)));
    }
    let folder = Folder::new();
    let imported = folder.import(&[folder.file("a.tlog", &log)], None).unwrap();
    let start_ms = 1_700_000_000_000;
    assert_eq!(times_ms(&imported), (0..100).map(|n| start_ms + 20 * n).collect::<Vec<_>>());
    assert!(notes(&imported).contains("the timestamps of SCALED_IMU never change"), "{}", notes(&imported));
}

#[test]
fn segments_of_logs_never_mix() {
    let mut log = Log::new(&[COMBINED, ATTITUDE]);
    for (start_ms, count) in [(500_000u64, 50u64), (100, 30)] {
        for n in 0..count {
            let t_us = (start_ms + 20 * n) * 1000;
            log.combined(t_us, [0.0; 3], 0, [0.0, 0.0, -9.8]);
            log.sample(1, t_us, &[&[1.0f32, 0.0, 0.0, 0.0], &0u8]);
        }
    }
    let folder = Folder::new();
    let path = folder.file("a.ulg", log.0);
    for (segment, first_ms, count) in [(None, 500_000, 50), (Some(1), 500_000, 50), (Some(2), 100, 30)] {
        let options = Options { segment, ..Options::default() };
        let imported = folder.import_with(std::slice::from_ref(&path), &options).unwrap();
        assert_eq!(times_ms(&imported), (0..count).map(|n| first_ms + 20 * n).collect::<Vec<_>>());
        assert_eq!(imported.summary.reference_rows, count as u64);
        assert!(notes(&imported).contains("the log has 2 segments"), "{}", notes(&imported));
    }
    let options = Options { segment: Some(3), ..Options::default() };
    let error = folder.import_with(&[path], &options).unwrap_err();
    assert!(error.to_string().contains("no segment 3, expected 1 to 2") && error.exit_code() == 2, "{error}");
}

#[test]
fn segments_of_two_files_are_joined_by_number() {
    let folder = Folder::new();
    let row = |t: i64, value: i64| format!("{t},{value},0,9\n");
    let both = |value: i64| {
        let times = (0..40).map(|n| 1000 + 20 * n).chain((0..60).map(|n| 10 + 20 * n));
        times.enumerate().map(|(n, t)| row(t, if n < 40 { value } else { value + 1 })).collect::<String>()
    };
    let gyro = folder.file("gyro.csv", format!("t,p,q,r\n{}", both(1)));
    let force = folder.file("force.csv", format!("t,u,v,w\n{}", both(5)));
    let mapping = Mapping::parse(&[NAMES], Some("ms"), None).unwrap();
    for (segment, first_ms, count, values) in [(Some(1), 1000, 40, [1.0, 5.0]), (Some(2), 10, 60, [2.0, 6.0])] {
        let options = Options { mapping: Some(mapping.clone()), segment, ..Options::default() };
        let imported = folder.import_with(&[gyro.clone(), force.clone()], &options).unwrap();
        assert_eq!(times_ms(&imported), (0..count).map(|n| first_ms + 20 * n).collect::<Vec<_>>());
        assert!(imported.rows.iter().all(|row| [row.rate_rad_s[0], row.force_m_s2[0]] == values), "{segment:?}");
    }
}

#[test]
fn counters_and_times_of_day_are_continued() {
    let folder = Folder::new();
    let table = |times: &[String]| {
        let rows: String = times.iter().map(|t| format!("{t},0,0,0,0,0,9.8\n")).collect();
        folder.file("a.csv", format!("t,p,q,r,u,v,w\n{rows}"))
    };
    let wrapped =
        |bits: u32, start: u64| (0..50u64).map(|n| ((start + 20 * n) % (1 << bits)).to_string()).collect::<Vec<_>>();
    for (times, units, time_bits) in [
        (wrapped(32, (1 << 32) - 500), "ms", None),
        (wrapped(32, (1 << 32) - 500), "ms", Some(32)),
        (wrapped(16, (1 << 16) - 500), "ms", Some(16)),
        ((0..50).map(|n| format!("{:02}:59:59.{:03}", 23, n * 20)).take(50).collect(), "s", None),
    ] {
        let mapping = Some(Mapping::parse(&[NAMES], Some(units), None).unwrap());
        let options = Options { mapping, time_bits, ..Options::default() };
        let imported = folder.import_with(&[table(&times)], &options).unwrap();
        let times = times_ms(&imported);
        assert!(
            times.len() == 50 && times.windows(2).all(|pair| (19..=21).contains(&(pair[1] - pair[0]))),
            "{times:?}"
        );
    }
    let midnight: Vec<_> = ["23:59:59.98", "00:00:00.00", "00:00:00.02"].map(str::to_owned).into();
    let mapping = Some(Mapping::parse(&[NAMES], None, None).unwrap());
    let imported = folder.import(&[table(&midnight)], mapping).unwrap();
    assert_eq!(times_ms(&imported), [86_399_980, 86_400_000, 86_400_020]);
}

/// Returns a `sensor_msgs/msg/Imu` in CDR with a rate and a force along the z axis.
fn imu(t_ms: u32, rate: f64, force: f64) -> Vec<u8> {
    let mut message = vec![0, 1, 0, 0];
    for word in [10 + t_ms / 1000, t_ms % 1000 * 1_000_000, 4, u32::from_le_bytes(*b"imu\0")] {
        message.extend(word.to_le_bytes());
    }
    let mut numbers = [0.0_f64; 37];
    (numbers[3], numbers[15], numbers[27]) = (1.0, rate, force);
    message.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
    message
}

/// Name of a topic, and a function that returns the topic's message with the given number.
type TopicMessages<'a> = (&'a str, &'a dyn Fn(u32) -> Vec<u8>);

/// Returns a `sensor_msgs/msg/MagneticField` in CDR.
fn magnetic_field(t_ms: u32, field: [f64; 3]) -> Vec<u8> {
    let mut message = vec![0, 1, 0, 0];
    for word in [10 + t_ms / 1000, t_ms % 1000 * 1_000_000, 4, u32::from_le_bytes(*b"imu\0")] {
        message.extend(word.to_le_bytes());
    }
    let numbers = field.into_iter().chain([0.0; 9]);
    message.extend(numbers.flat_map(f64::to_le_bytes));
    message
}

/// Writes an MCAP file with one message of each topic every 20 ms. Topics called `/mag…` contain
/// magnetic fields, all others inertial samples.
fn mcap(folder: &Folder, topics: &[TopicMessages<'_>]) -> std::path::PathBuf {
    let path = folder.path("bag.mcap");
    let mut writer = mcap::Writer::new(std::fs::File::create(&path).unwrap()).unwrap();
    for (name, message) in topics {
        let schema = if name.starts_with("/mag") { "sensor_msgs/msg/MagneticField" } else { "sensor_msgs/msg/Imu" };
        let schema = writer.add_schema(schema, "ros2msg", b"").unwrap();
        let channel_id = writer.add_channel(schema, name, "cdr", &Default::default()).unwrap();
        for n in 0..100u32 {
            let log_time = 1_700_000_000_000_000_000 + u64::from(n) * 20_000_000;
            let header = mcap::records::MessageHeader { channel_id, sequence: n, log_time, publish_time: log_time };
            writer.write_to_known_channel(&header, &message(n)).unwrap();
        }
    }
    writer.finish().unwrap();
    path
}

#[test]
fn rate_and_force_of_two_topics_are_joined() {
    let folder = Folder::new();
    let gyro = |n: u32| imu(20 * n, 0.1, 0.0);
    let accel = |n: u32| imu(20 * n + 7, 0.0, 9.8);
    let path = mcap(&folder, &[("/camera/gyro/sample", &gyro), ("/camera/accel/sample", &accel)]);
    let imported = folder.import(&[path], None).unwrap();
    assert!(
        imported.rows.len() >= 99
            && imported.rows.iter().all(|row| (row.rate_rad_s[2], row.force_m_s2[2]) == (0.1, 9.8))
    );
    assert!(notes(&imported).contains("joined the rate of /camera/gyro/sample with the force of /camera/accel/sample"));
}

#[test]
fn dead_sensor_is_passed_over_and_can_be_chosen() {
    let folder = Folder::new();
    let dead = |n: u32| imu(20 * n, 0.5, 9.8);
    let good = |n: u32| imu(20 * n, f64::from(n), 9.8 + 0.001 * f64::from(n));
    let dead_gyro = |n: u32| imu(20 * n, 0.5, 9.8 + 0.001 * f64::from(n));
    let not_numbers = |n: u32| imu(20 * n, f64::NAN, f64::NAN);
    let readings: [&dyn Fn(u32) -> Vec<u8>; 3] = [&dead_gyro, &not_numbers, &dead];
    for first in readings {
        let path = mcap(&folder, &[("/a", first), ("/b", &good)]);
        assert_eq!(folder.import(&[path], None).unwrap().rows[1].rate_rad_s[2], 1.0);
    }
    let path = mcap(&folder, &[("/a", &dead), ("/b", &good)]);
    let imported = folder.import(std::slice::from_ref(&path), None).unwrap();
    assert!(notes(&imported).contains("/a is dead"), "{}", notes(&imported));
    let sensors: Vec<_> = imported.summary.sensors.iter().map(ToString::to_string).collect();
    assert_eq!(
        sensors,
        ["--imu 0: /a, 100 samples at 50.0 Hz, dead: constant", "--imu 1: /b, 100 samples at 50.0 Hz, healthy, read"]
    );
    let chosen = |imu| Options { imu: Some(imu), ..Options::default() };
    assert_eq!(folder.import_with(std::slice::from_ref(&path), &chosen(0)).unwrap().rows[1].rate_rad_s[2], 0.5);
    let error = folder.import_with(&[path], &chosen(2)).unwrap_err();
    assert!(error.to_string().contains("--imu 2: no such sensor, expected 0 to 1"), "{error}");
}

#[test]
fn sensors_of_older_ardupilot_logs_are_numbered() {
    let folder = Folder::new();
    let mut log = DataFlashLog::default();
    log.add_format(0x80, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns");
    for (kind, name) in [(1, "IMU"), (2, "IMU2"), (3, "IMU3")] {
        log.add_format(kind, name, "QffffffBB", "TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,GH,AH");
    }
    // The first sensor has a dead gyro, and the second one is marked as unhealthy.
    for n in 0..200u64 {
        let value = n as f32;
        log.message(1, &[&(10_000 * n), &[0f32, 0.0, 0.0], &[value, 0.0, -9.8], &1u8, &1u8]);
        log.message(2, &[&(10_000 * n), &[value, 0.0, 2.0], &[value, 0.0, -9.8], &0u8, &1u8]);
        log.message(3, &[&(10_000 * n), &[value, 0.0, 3.0], &[value, 0.0, -9.8], &1u8, &1u8]);
    }
    let path = folder.file("log.bin", &log.0);
    let imported = folder.import(std::slice::from_ref(&path), None).unwrap();
    assert_eq!(imported.rows[1].rate_rad_s[2], -3.0);
    let sensors: Vec<_> = imported.summary.sensors.iter().map(ToString::to_string).collect();
    assert_eq!(
        sensors,
        [
            "--imu 0: IMU 0, 200 samples at 100.0 Hz, dead: constant",
            "--imu 1: IMU 1, 200 samples at 100.0 Hz, unhealthy: marked so in the log",
            "--imu 2: IMU 2, 200 samples at 100.0 Hz, healthy, read",
        ]
    );
    let chosen = Options { imu: Some(1), ..Options::default() };
    assert_eq!(folder.import_with(&[path], &chosen).unwrap().rows[1].rate_rad_s[2], -2.0);
}

#[test]
fn sensors_of_px4_logs_are_numbered() {
    const GYRO: &str =
        "sensor_gyro:uint64_t timestamp;uint64_t timestamp_sample;uint32_t device_id;float x;float y;float z;";
    const INTEGRATED: &str = "vehicle_imu:uint64_t timestamp;uint32_t accel_device_id;uint32_t gyro_device_id;\
        float[3] delta_angle;float[3] delta_velocity;uint32_t delta_angle_dt;uint32_t delta_velocity_dt;";
    const HEALTH: &str = "sensors_status_imu:uint64_t timestamp;uint32_t[2] accel_device_ids;bool[2] accel_healthy;\
        uint32_t[2] gyro_device_ids;bool[2] gyro_healthy;";
    let folder = Folder::new();
    let accel = GYRO.replace("gyro", "accel");
    // Gyro and accelerometer have separate topics. The first gyro is unhealthy.
    let mut log = Log::new(&[GYRO, &accel, HEALTH]);
    log.subscribe(3, 1, "sensor_gyro");
    log.subscribe(4, 1, "sensor_accel");
    for n in 0..200u64 {
        let (t_us, value) = (1_000_000 + 10_000 * n, n as f32);
        log.sample(2, t_us, &[&[11u32, 12], &[1u8, 1], &[21u32, 22], &[0u8, 1]]);
        for (gyro, accel, number) in [(0, 1, 1u32), (3, 4, 2)] {
            log.sample(gyro, t_us, &[&t_us, &(20 + number), &[value, 0.0, number as f32]]);
            log.sample(accel, t_us, &[&t_us, &(10 + number), &[value, 0.0, -9.8f32]]);
        }
    }
    let path = folder.file("separate.ulg", &log.0);
    let imported = folder.import(std::slice::from_ref(&path), None).unwrap();
    assert_eq!((imported.rows.len(), imported.rows[1].rate_rad_s[2]), (200, -2.0));
    let sensors: Vec<_> = imported.summary.sensors.iter().map(ToString::to_string).collect();
    assert_eq!(
        sensors,
        [
            "--imu 0: sensor_gyro 0 and sensor_accel 0, 200 samples at 100.0 Hz, unhealthy: marked so in the log",
            "--imu 1: sensor_gyro 1 and sensor_accel 1, 200 samples at 100.0 Hz, healthy, read",
        ]
    );
    let chosen = |imu| Options { imu: Some(imu), ..Options::default() };
    assert_eq!(folder.import_with(std::slice::from_ref(&path), &chosen(0)).unwrap().rows[1].rate_rad_s[2], -1.0);
    let error = folder.import_with(&[path], &chosen(2)).unwrap_err();
    assert!(error.to_string().contains("--imu 2: no such sensor, expected 0 to 1"), "{error}");
    // Angle and velocity are integrated over 10 ms.
    let mut log = Log::new(&[INTEGRATED]);
    for n in 0..100u64 {
        let delta = [n as f32, 0.0, -0.098];
        log.sample(0, 1_000_000 + 10_000 * n, &[&1u32, &2u32, &[0.0, 0.0, 0.02f32], &delta, &10_000u32, &10_000u32]);
    }
    let imported = folder.import(&[folder.file("integrated.ulg", &log.0)], None).unwrap();
    let row = imported.rows[1];
    assert!((row.rate_rad_s[2] + 2.0).abs() < 1e-6 && (row.force_m_s2[2] - 9.8).abs() < 1e-6, "{row:?}");
}

#[test]
fn log_times_replace_constant_timestamps() {
    let folder = Folder::new();
    let zero = |n: u32| imu(0, f64::from(n), 9.8);
    let path = mcap(&folder, &[("/imu", &zero)]);
    let imported = folder.import(&[path], None).unwrap();
    let expected: Vec<_> = (0..100).map(|n| 1_700_000_000_000 + 20 * n).collect();
    assert_eq!(times_ms(&imported), expected);
    assert!(notes(&imported).contains("the timestamps of /imu never change"), "{}", notes(&imported));
}

#[test]
fn units_and_axes_of_bags_are_changed() {
    let folder = Folder::new();
    let degrees = |n: u32| imu(20 * n, 90.0, 1.0);
    let path = mcap(&folder, &[("/imu", &degrees)]);
    let mapping = Mapping::parse::<&str>(&[], Some("deg/s,g"), Some("frd")).unwrap();
    let imported = folder.import(std::slice::from_ref(&path), Some(mapping)).unwrap();
    let row = imported.rows[0];
    assert_eq!((row.rate_rad_s[2], row.force_m_s2[2]), (-90f64.to_radians(), -9.80665));
    let error = folder.import(&[path], Some(Mapping::parse(&[NAMES], None, None).unwrap())).unwrap_err();
    assert!(error.to_string().contains("defines its own columns"), "{error}");
}

/// Returns the remedy `--units UNIT` of the note on the magnetic field, if any.
fn field_unit(imported: &crate::common::Imported) -> Option<&'static str> {
    let units = imported.summary.notes.iter().find_map(|note| match note {
        Note::ImplausibleField { unit, .. } => Some(*unit),
        _ => None,
    });
    units.map(|unit| unit.expect("a unit"))
}

#[test]
fn unit_of_an_implausible_field_is_named() {
    let folder = Folder::new();
    for (unit, factor_ut) in [("T", 1e6), ("uT", 1.0), ("nT", 1e-3), ("gauss", 100.0), ("mgauss", 0.1), ("mT", 1e3)] {
        for [north, down] in [[20.0, -44.0], [24.0, 1.0], [17.0, -60.0]] {
            let vector = move |n: u32| [0.01 * f64::from(n), north, down].map(|part| part / factor_ut);
            let moving = |n: u32| imu(20 * n, f64::from(n), 9.8);
            let field = |n: u32| magnetic_field(20 * n, vector(n));
            let bag = mcap(&folder, &[("/imu", &moving), ("/mag", &field)]);
            let rows: String = (0..100)
                .map(|n| {
                    let [x, y, z] = vector(n);
                    format!("{},{n},0,0,0,0,9.8,{x},{y},{z}\n", 20 * n)
                })
                .collect();
            let text = folder.file("field.csv", format!("t_ms,gx,gy,gz,ax,ay,az,mx,my,mz\n{rows}"));
            for (path, own) in [(bag, "T"), (text, "uT")] {
                let imported = folder.import(std::slice::from_ref(&path), None).unwrap();
                assert_eq!(field_unit(&imported), (unit != own).then_some(unit), "{}: {unit}", path.display());
                let mapping = Mapping::parse::<&str>(&[], Some(unit), None).unwrap();
                let imported = folder.import(&[path], Some(mapping)).unwrap();
                assert_eq!(field_unit(&imported), None, "{unit}");
                let field = imported.rows[0].field_ut.unwrap();
                assert!((field.iter().map(|part| part * part).sum::<f64>().sqrt() - north.hypot(down)).abs() < 1e-9);
            }
        }
    }
}

#[test]
fn constant_field_is_reported() {
    let folder = Folder::new();
    let text = |rows: u32, field: &dyn Fn(u32) -> f64| {
        let rows: String = (0..rows).map(|n| format!("{},{n},0,0,0,0,9.8,{},20,-44\n", 20 * n, field(n))).collect();
        folder.file("field.csv", format!("t_ms,gx,gy,gz,ax,ay,az,mx,my,mz\n{rows}"))
    };
    let is_reported = |path| {
        let notes = folder.import(&[path], None).unwrap().summary.notes;
        notes.iter().any(|note| matches!(note, Note::ConstantField { .. }))
    };
    assert!(is_reported(text(500, &|_| 1.0)));
    assert!(!is_reported(text(500, &|n| if n == 499 { 1.1 } else { 1.0 })));
    assert!(!is_reported(text(499, &|_| 1.0)), "too few to tell");
}

#[test]
fn fixes_outside_of_the_samples_are_reported() {
    let folder = Folder::new();
    let rows = folder.file("rows.csv", "t,p,q,r,u,v,w\n0,0,0,0,0,0,9.8\n0.01,0,0,0,0,0,9.8\n");
    let fixes = folder.file("fixes.csv", "t,e,n,z\n1000,1,2,3\n1001,1,2,3\n");
    let mapping = Mapping::parse(&[NAMES, "ve=e,vn=n,vu=z"], None, None).unwrap();
    let imported = folder.import(&[rows, fixes], Some(mapping)).unwrap();
    let note = Note::NoOverlap { what: "fixes", series_ns: [1_000_000 * MS, 1_001_000 * MS], rows_ns: [0, 10 * MS] };
    assert!(imported.summary.notes.contains(&note), "{}", notes(&imported));
}
