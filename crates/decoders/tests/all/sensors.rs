//! Serial sensors: scales, axes, timestamps and grouping of frames.

use decoders::{
    DeviceTime, Framed, Measurement, Value,
    rvc::Rvc,
    witmotion::{Ranges, WitMotion},
    xsens::Xsens,
};
use xsens_mti::prelude::{Acceleration, BusId, Frame, MagneticField, MessageId, PayloadLength, RateOfTurn};

use crate::streams::{WITMOTION_RANGES, decoded, rvc_frame_with, three_f32, witmotion_frame, xsens_frame};

const GRAVITY_M_S2: f64 = 9.80665;

fn assert_near(found: [f64; 3], wanted: [f64; 3], tolerance: f64) {
    assert!(found.iter().zip(wanted).all(|(a, b)| (a - b).abs() <= tolerance), "{found:?} instead of {wanted:?}");
}

fn witmotion(ranges: Ranges, frames: &[Vec<u8>]) -> Vec<Measurement> {
    decoded(Box::new(Framed::new(WitMotion::new(ranges))), [&frames.concat()[..]]).0
}

/// Returns frames with raw numbers: 2048 is 1 g in a range of ±16 g, and 16384 is 1000 °/s in a
/// range of ±2000 °/s.
fn witmotion_numbers() -> [Vec<u8>; 3] {
    [
        witmotion_frame(0x51, [0, 0, 0, 0, 0x00, 0x08, 0, 0]),
        witmotion_frame(0x52, [0x00, 0x40, 0x00, 0xc0, 0, 0, 0, 0]),
        witmotion_frame(0x54, [0x68, 0x01, 0x69, 0x00, 0x7a, 0x00, 0, 0]),
    ]
}

#[test]
fn witmotion_applies_ranges_and_timestamp() {
    let [force, rate, field] = witmotion_numbers();
    // 2026-11-23 08:12:26.345.
    let time = witmotion_frame(0x50, [26, 11, 23, 8, 12, 26, 0x59, 0x01]);
    let found = witmotion(WITMOTION_RANGES, &[time, force.clone(), rate.clone(), field.clone()]);
    let [Measurement { time, value: Value::Imu { rate_rad_s, force_m_s2, field_ut: None } }, second] = found[..] else {
        panic!("{found:?}")
    };
    assert_near(rate_rad_s, [1000f64.to_radians(), -1000f64.to_radians(), 0.0], 1e-12);
    assert_near(force_m_s2, [0.0, 0.0, GRAVITY_M_S2], 1e-12);
    assert_eq!(time, Some(DeviceTime::Unix { now_ns: 1_795_421_546_345_000_000 }));
    let Value::Field(field_ut) = second.value else { panic!("{second:?}") };
    assert_near(field_ut, [36.0, 10.5, 12.2], 1e-12);
    assert_eq!(second.time, time);

    let found = witmotion(Ranges { force_g: 4.0, rate_deg_s: 500.0, field_ut: None }, &[force, rate, field]);
    let [Measurement { time: None, value: Value::Imu { rate_rad_s: [x, ..], force_m_s2: [.., z], .. } }] = found[..]
    else {
        panic!("{found:?}")
    };
    assert_near([x, z, 0.0], [250f64.to_radians(), GRAVITY_M_S2 / 4.0, 0.0], 1e-12);
}

#[test]
fn witmotion_cycle_without_time_frame_has_no_timestamp() {
    let [force, rate, field] = witmotion_numbers();
    let time = witmotion_frame(0x50, [26, 11, 23, 8, 12, 26, 0x59, 0x01]);
    let [with, without] = [vec![time, force.clone(), rate.clone(), field.clone()], vec![force, rate, field]];
    let found = witmotion(WITMOTION_RANGES, &[with, without].concat());
    assert_eq!(found.iter().map(|found| found.time.is_some()).collect::<Vec<_>>(), [true, true, false, false]);
    let invalid = witmotion_frame(0x50, [26, 13, 23, 8, 12, 26, 0x59, 0x01]);
    let [force, rate, _] = witmotion_numbers();
    assert_eq!(witmotion(WITMOTION_RANGES, &[invalid, force, rate])[0].time, None, "month 13");
}

#[test]
fn witmotion_pairs_rate_and_force_of_one_cycle() {
    let [force, rate, field] = witmotion_numbers();
    let imu_count = |frames: &[&[u8]]| {
        let found = witmotion(
            Ranges { field_ut: None, ..WITMOTION_RANGES },
            &frames.iter().map(|f| f.to_vec()).collect::<Vec<_>>(),
        );
        found.len()
    };
    assert_eq!(imu_count(&[&force, &rate]), 1);
    assert_eq!(imu_count(&[&rate]), 0);
    assert_eq!(imu_count(&[&force, &field, &rate]), 0, "the rate of a later cycle");
    assert_eq!(imu_count(&[&force, &rate, &rate]), 1);
    assert_eq!(imu_count(&[&force, &[0; 5], &rate]), 1, "less than a frame is missing");
    let mut damaged = [rate.clone(), force.clone()].concat();
    (damaged[3], damaged[14]) = (1, 1);
    assert_eq!(imu_count(&[&force, &damaged, &rate]), 0, "a rate and a force are missing");
}

#[test]
fn xsens_matches_third_party_encoder() {
    let (rate, force, field) = ([0.25f32, -1.5, 3.0], [0.1f32, -0.2, 9.81], [0.5f32, 0.25, -0.75]);
    let packet = |id: u16, bytes: Vec<u8>| [&id.to_be_bytes()[..], &[bytes.len() as u8], &bytes].concat();
    let data = [
        packet(0x1020, vec![0, 9]),
        packet(0x1060, 20_000u32.to_be_bytes().to_vec()),
        packet(0x4020, three_f32(force)),
        packet(0x8020, three_f32(rate)),
        packet(0xc020, three_f32(field)),
        packet(0xe020, vec![0; 4]),
    ]
    .concat();
    let mut bytes = vec![0; 4 + data.len() + 1];
    let mut frame = Frame::new_unchecked(&mut bytes[..]);
    frame.set_preamble();
    frame.set_bus_id(BusId::MASTER);
    frame.set_message_id(MessageId(0x36));
    frame.set_payload_length(PayloadLength::new_standard(data.len() as u8).unwrap());
    frame.payload_mut().unwrap().copy_from_slice(&data);
    let sum = frame.compute_checksum_byte().unwrap();
    frame.set_checksum(sum).unwrap();

    let (found, counts) = decoded(Box::new(Framed::new(Xsens::new(49.0))), [&bytes[..]]);
    let reference = (
        RateOfTurn::<f32>::from_be_slice(&three_f32(rate)).unwrap(),
        Acceleration::<f32>::from_be_slice(&three_f32(force)).unwrap(),
        MagneticField::<f32>::from_be_slice(&three_f32(field)).unwrap(),
    );
    let [x, y, z] = [reference.2.x, reference.2.y, reference.2.z].map(|part| f64::from(part) * 49.0);
    let value = Value::Imu {
        rate_rad_s: [reference.0.x, reference.0.y, reference.0.z].map(f64::from),
        force_m_s2: [reference.1.x, reference.1.y, reference.1.z].map(f64::from),
        field_ut: Some([x, y, z]),
    };
    let time = DeviceTime::Counter { now_ns: 2_000_000_000, period_ns: (1 << 32) * 100_000 };
    assert_eq!(found, [Measurement { time: Some(time), value }]);
    assert_eq!((counts.frames, counts.rejected, counts.skipped_bytes), (1, 0, 0));
}

#[test]
fn xsens_decodes_all_number_formats() {
    let (rate, force) = ([1.5, -0.25, 0.125], [-9.75, 0.5, 3.0]);
    let fixed_20 = |number: f64| ((number * f64::from(1 << 20)) as i32).to_be_bytes().to_vec();
    let fixed_32 = |number: f64| {
        let whole = (number * 4_294_967_296.0) as i64;
        [&(whole as u32).to_be_bytes()[..], &((whole >> 32) as i16).to_be_bytes()].concat()
    };
    let encoders: [&dyn Fn(f64) -> Vec<u8>; 4] =
        [&|number| (number as f32).to_be_bytes().to_vec(), &fixed_20, &fixed_32, &|number| {
            number.to_be_bytes().to_vec()
        }];
    for (format, encode) in encoders.into_iter().enumerate() {
        // High-rate packets, with the earth-frame bits set.
        let id = |base: u16| base | format as u16 | 4;
        let packet = |three: [f64; 3]| three.map(encode).concat();
        let frame = xsens_frame(&[(id(0x8040), packet(rate)), (id(0x4020), packet(force))]);
        let (found, _) = decoded(Box::new(Framed::new(Xsens::new(49.0))), [&frame[..]]);
        let value = Value::Imu { rate_rad_s: rate, force_m_s2: force, field_ut: None };
        assert_eq!(found, [Measurement { time: None, value }], "{format}");
    }
    // The first message has two numbers instead of three. In the second, a packet is longer than
    // the message.
    for packets in [vec![(0x8020, vec![0; 8])], vec![(0x8020, vec![0; 12]), (0x1060, vec![0; 3])]] {
        let (found, counts) = decoded(Box::new(Framed::new(Xsens::new(49.0))), [&xsens_frame(&packets)[..]]);
        assert_eq!((found.len(), counts.frames, counts.rejected), (0, 0, 1));
    }
    let long = xsens_frame(&[(0x8020, three_f32([0.0; 3])), (0x4020, three_f32([0.0; 3])), (0x7020, vec![0; 250])]);
    let (found, _) = decoded(Box::new(Framed::new(Xsens::new(49.0))), [&long[..]]);
    assert_eq!(found.len(), 1, "two-byte length");
}

/// Example frame from the BNO08X datasheet, 1.3.5.2.
const DATASHEET_FRAME: [u8; 19] =
    [0xaa, 0xaa, 0xde, 0x01, 0x00, 0x92, 0xff, 0x25, 0x08, 0x8d, 0xfe, 0xec, 0xff, 0xd1, 0x03, 0x00, 0x00, 0x00, 0xe7];

fn rvc(frames: &[Vec<u8>]) -> Vec<Measurement> {
    decoded(Box::new(Framed::new(Rvc::default())), [&frames.concat()[..]]).0
}

#[test]
fn rvc_datasheet_frame_gives_force_and_axes() {
    assert_eq!(rvc_frame_with(0xde, [1, -110, 2085], [-371, -20, 977]), DATASHEET_FRAME);
    // The first message reports a level attitude. The rotation between the two messages therefore
    // equals the attitude in the datasheet's message.
    let found = rvc(&[rvc_frame_with(0xdd, [1, 0, 0], [0, 0, 1000]), DATASHEET_FRAME.to_vec()]);
    let [Measurement { time, value: Value::Imu { rate_rad_s, force_m_s2, field_ut: None } }] = found[..] else {
        panic!("{found:?}")
    };
    assert_eq!(time, Some(DeviceTime::Counter { now_ns: 2_220_000_000, period_ns: 2_560_000_000 }));
    assert_near(force_m_s2, [-371.0, -20.0, 977.0].map(|mg| mg / 1000.0 * GRAVITY_M_S2), 1e-12);
    // The up axis of the level attitude, rotated back, must point along the force.
    let angle = rate_rad_s.iter().map(|part| part * part).sum::<f64>().sqrt() * 0.01;
    let [x, y, z] = rate_rad_s.map(|part| part * 0.01 / angle);
    let (sine, cosine) = (-angle).sin_cos();
    let up = [y * sine + x * z * (1.0 - cosine), -x * sine + y * z * (1.0 - cosine), cosine + z * z * (1.0 - cosine)];
    let norm = force_m_s2.iter().map(|part| part * part).sum::<f64>().sqrt();
    // The tolerance is small enough to detect a wrong order of rotations: with roll before pitch
    // the error would be 1.2e-3.
    assert_near(up, force_m_s2.map(|part| part / norm), 1e-3);
}

#[test]
fn rvc_rates_integrate_to_rotation_despite_lost_frames() {
    // 50 °/s about z through ±180°, with every seventh frame missing.
    let angle = |n: u32| ((17_000 + n * 50) % 36_000) as i32;
    let frames: Vec<_> = (0..200u32)
        .filter(|n| n % 7 != 3)
        .map(|n| {
            let yaw = if angle(n) >= 18_000 { angle(n) - 36_000 } else { angle(n) };
            rvc_frame_with(n as u8, [yaw as i16, 0, 0], [0, 0, 1000])
        })
        .collect();
    let found = rvc(&frames);
    assert_eq!(found.len(), frames.len() - 1);
    for found in &found {
        let Value::Imu { rate_rad_s, .. } = found.value else { panic!("{found:?}") };
        assert_near(rate_rad_s, [0.0, 0.0, 50f64.to_radians()], 1e-9);
    }
}

#[test]
fn rvc_restarts_after_long_loss_and_ignores_duplicates() {
    let frame = |number| rvc_frame_with(number, [0; 3], [0, 0, 1000]);
    assert_eq!(rvc(&[frame(0), frame(10)]).len(), 1);
    assert_eq!(rvc(&[frame(0), frame(11), frame(12)]).len(), 1);
    assert_eq!(rvc(&[frame(5), frame(5)]).len(), 0);
    assert_eq!(rvc(&[frame(255), frame(0)]).len(), 1);
}
