//! What sensors on a serial line say: scales, axes, times, and what belongs together.

use decoders::{
    DeviceTime, Framed, Measurement, Value,
    rvc::Rvc,
    witmotion::{Ranges, WitMotion},
    xsens::Xsens,
};
use xsens_mti::prelude::{Acceleration, BusId, Frame, MagneticField, MessageId, PayloadLength, RateOfTurn};

use crate::streams::{decoded, rvc_frame_of, three_f32, witmotion_frame, xsens_frame};

const GRAVITY_M_S2: f64 = 9.80665;

fn assert_near(found: [f64; 3], wanted: [f64; 3], tolerance: f64) {
    assert!(found.iter().zip(wanted).all(|(a, b)| (a - b).abs() <= tolerance), "{found:?} instead of {wanted:?}");
}

fn witmotion(ranges: Ranges, frames: &[Vec<u8>]) -> Vec<Measurement> {
    decoded(Box::new(Framed::new(WitMotion::new(ranges))), [&frames.concat()[..]]).0
}

/// 2048 of ±16 g is 1 g; 16384 of ±2000 °/s is 1000 °/s.
fn witmotion_numbers() -> [Vec<u8>; 3] {
    [
        witmotion_frame(0x51, [0, 0, 0, 0, 0x00, 0x08, 0, 0]),
        witmotion_frame(0x52, [0x00, 0x40, 0x00, 0xc0, 0, 0, 0, 0]),
        witmotion_frame(0x54, [0x68, 0x01, 0x69, 0x00, 0x7a, 0x00, 0, 0]),
    ]
}

#[test]
fn a_witmotion_has_its_ranges_and_its_time() {
    let [force, rate, field] = witmotion_numbers();
    // 2026-11-23 08:12:26.345.
    let time = witmotion_frame(0x50, [26, 11, 23, 8, 12, 26, 0x59, 0x01]);
    let found = witmotion(Ranges::default(), &[time, force.clone(), rate.clone(), field.clone()]);
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
fn a_cycle_of_a_witmotion_whose_time_was_lost_has_none() {
    let [force, rate, field] = witmotion_numbers();
    let time = witmotion_frame(0x50, [26, 11, 23, 8, 12, 26, 0x59, 0x01]);
    let [with, without] = [vec![time, force.clone(), rate.clone(), field.clone()], vec![force, rate, field]];
    let found = witmotion(Ranges::default(), &[with, without].concat());
    assert_eq!(found.iter().map(|found| found.time.is_some()).collect::<Vec<_>>(), [true, true, false, false]);
    let none = witmotion_frame(0x50, [26, 13, 23, 8, 12, 26, 0x59, 0x01]);
    let [force, rate, _] = witmotion_numbers();
    assert_eq!(witmotion(Ranges::default(), &[none, force, rate])[0].time, None, "no month of a calendar");
}

#[test]
fn rate_and_force_of_a_witmotion_are_of_one_cycle() {
    let [force, rate, field] = witmotion_numbers();
    let imus = |frames: &[&[u8]]| {
        let found = witmotion(
            Ranges { field_ut: None, ..Ranges::default() },
            &frames.iter().map(|f| f.to_vec()).collect::<Vec<_>>(),
        );
        found.len()
    };
    assert_eq!(imus(&[&force, &rate]), 1);
    assert_eq!(imus(&[&rate]), 0);
    assert_eq!(imus(&[&force, &field, &rate]), 0, "the rate of a later cycle");
    assert_eq!(imus(&[&force, &rate, &rate]), 1);
    assert_eq!(imus(&[&force, &[0; 5], &rate]), 1, "less than a frame is missing");
    let mut damaged = [rate.clone(), force.clone()].concat();
    (damaged[3], damaged[14]) = (1, 1);
    assert_eq!(imus(&[&force, &damaged, &rate]), 0, "a rate and a force are missing");
}

#[test]
fn a_frame_that_another_encodes_is_an_xsens_message_and_says_the_same() {
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
    let theirs = (
        RateOfTurn::<f32>::from_be_slice(&three_f32(rate)).unwrap(),
        Acceleration::<f32>::from_be_slice(&three_f32(force)).unwrap(),
        MagneticField::<f32>::from_be_slice(&three_f32(field)).unwrap(),
    );
    let [x, y, z] = [theirs.2.x, theirs.2.y, theirs.2.z].map(|part| f64::from(part) * 49.0);
    let value = Value::Imu {
        rate_rad_s: [theirs.0.x, theirs.0.y, theirs.0.z].map(f64::from),
        force_m_s2: [theirs.1.x, theirs.1.y, theirs.1.z].map(f64::from),
        field_ut: Some([x, y, z]),
    };
    let time = DeviceTime::Counter { now_ns: 2_000_000_000, period_ns: (1 << 32) * 100_000 };
    assert_eq!(found, [Measurement { time: Some(time), value }]);
    assert_eq!((counts.frames, counts.refused, counts.skipped_bytes), (1, 0, 0));
}

#[test]
fn an_xsens_writes_numbers_in_four_ways() {
    let (rate, force) = ([1.5, -0.25, 0.125], [-9.75, 0.5, 3.0]);
    let fixed_20 = |number: f64| ((number * f64::from(1 << 20)) as i32).to_be_bytes().to_vec();
    let fixed_32 = |number: f64| {
        let whole = (number * 4_294_967_296.0) as i64;
        [&(whole as u32).to_be_bytes()[..], &((whole >> 32) as i16).to_be_bytes()].concat()
    };
    let ways: [&dyn Fn(f64) -> Vec<u8>; 4] =
        [&|number| (number as f32).to_be_bytes().to_vec(), &fixed_20, &fixed_32, &|number| {
            number.to_be_bytes().to_vec()
        }];
    for (format, way) in ways.into_iter().enumerate() {
        // High rate, and with the bits of other axes of the earth.
        let id = |base: u16| base | format as u16 | 4;
        let packet = |three: [f64; 3]| three.map(way).concat();
        let frame = xsens_frame(&[(id(0x8040), packet(rate)), (id(0x4020), packet(force))]);
        let (found, _) = decoded(Box::new(Framed::new(Xsens::new(49.0))), [&frame[..]]);
        let value = Value::Imu { rate_rad_s: rate, force_m_s2: force, field_ut: None };
        assert_eq!(found, [Measurement { time: None, value }], "{format}");
    }
    // Two numbers where three belong, and a packet longer than the message.
    for packets in [vec![(0x8020, vec![0; 8])], vec![(0x8020, vec![0; 12]), (0x1060, vec![0; 3])]] {
        let (found, counts) = decoded(Box::new(Framed::new(Xsens::new(49.0))), [&xsens_frame(&packets)[..]]);
        assert_eq!((found.len(), counts.frames, counts.refused), (0, 0, 1));
    }
    let long = xsens_frame(&[(0x8020, three_f32([0.0; 3])), (0x4020, three_f32([0.0; 3])), (0x7020, vec![0; 250])]);
    let (found, _) = decoded(Box::new(Framed::new(Xsens::new(49.0))), [&long[..]]);
    assert_eq!(found.len(), 1, "with a length of two bytes");
}

/// BNO08X datasheet, 1.3.5.2.
const OF_THE_DATASHEET: [u8; 19] =
    [0xaa, 0xaa, 0xde, 0x01, 0x00, 0x92, 0xff, 0x25, 0x08, 0x8d, 0xfe, 0xec, 0xff, 0xd1, 0x03, 0x00, 0x00, 0x00, 0xe7];

fn rvc(frames: &[Vec<u8>]) -> Vec<Measurement> {
    decoded(Box::new(Framed::new(Rvc::default())), [&frames.concat()[..]]).0
}

#[test]
fn the_frame_of_the_datasheet_has_its_force_and_its_axes() {
    assert_eq!(rvc_frame_of(0xde, [1, -110, 2085], [-371, -20, 977]), OF_THE_DATASHEET);
    // Its frame, and a frame before it that lies flat: the turn between the two is the attitude.
    let found = rvc(&[rvc_frame_of(0xdd, [1, 0, 0], [0, 0, 1000]), OF_THE_DATASHEET.to_vec()]);
    let [Measurement { time, value: Value::Imu { rate_rad_s, force_m_s2, field_ut: None } }] = found[..] else {
        panic!("{found:?}")
    };
    assert_eq!(time, Some(DeviceTime::Counter { now_ns: 2_220_000_000, period_ns: 2_560_000_000 }));
    assert_near(force_m_s2, [-371.0, -20.0, 977.0].map(|mg| mg / 1000.0 * GRAVITY_M_S2), 1e-12);
    // The up of the flat frame, turned back by the turn, is where the force points.
    let angle = rate_rad_s.iter().map(|part| part * part).sum::<f64>().sqrt() * 0.01;
    let [x, y, z] = rate_rad_s.map(|part| part * 0.01 / angle);
    let (sine, cosine) = (-angle).sin_cos();
    let up = [y * sine + x * z * (1.0 - cosine), -x * sine + y * z * (1.0 - cosine), cosine + z * z * (1.0 - cosine)];
    let norm = force_m_s2.iter().map(|part| part * part).sum::<f64>().sqrt();
    // Roll before pitch would be 1.2e-3 off.
    assert_near(up, force_m_s2.map(|part| part / norm), 1e-3);
}

#[test]
fn the_rates_of_a_bno_add_up_to_its_turn_though_frames_are_lost() {
    // About z at 50 °/s, through ±180°, with every seventh frame missing.
    let angle = |n: u32| ((17_000 + n * 50) % 36_000) as i32;
    let frames: Vec<_> = (0..200u32)
        .filter(|n| n % 7 != 3)
        .map(|n| {
            let yaw = if angle(n) >= 18_000 { angle(n) - 36_000 } else { angle(n) };
            rvc_frame_of(n as u8, [yaw as i16, 0, 0], [0, 0, 1000])
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
fn after_a_long_loss_a_bno_begins_anew_and_a_frame_twice_is_none() {
    let frame = |number| rvc_frame_of(number, [0; 3], [0, 0, 1000]);
    assert_eq!(rvc(&[frame(0), frame(10)]).len(), 1);
    assert_eq!(rvc(&[frame(0), frame(11), frame(12)]).len(), 1);
    assert_eq!(rvc(&[frame(5), frame(5)]).len(), 0);
    assert_eq!(rvc(&[frame(255), frame(0)]).len(), 1);
}
