//! Sample streams of all formats. A stream has a decoder, and units (frames or cycles of frames),
//! each of which is valid without the others.

use decoders::{
    Counts, Decoder, Framed, Measurement,
    iio::{Channel, Clock, Iio, Layout, Vector},
    lines::{self, Lines},
    mavlink::{Mavlink, MavlinkSettings},
    nmea::Nmea,
    rvc::Rvc,
    ubx::Ubx,
    witmotion::{Ranges, WitMotion},
    xsens::Xsens,
};
use mavlink::{MAVLinkV1MessageRaw, MAVLinkV2MessageRaw, MavHeader, dialects::common as dialect};

/// Factory settings of a WitMotion sensor.
pub(crate) const WITMOTION_RANGES: Ranges = Ranges { force_g: 16.0, rate_deg_s: 2000.0, field_ut: Some(0.1) };

/// Sample stream of one format.
pub(crate) struct Stream {
    pub(crate) name: &'static str,
    pub(crate) decoder: fn() -> Box<dyn Decoder>,
    /// Frames, or cycles of related frames.
    pub(crate) units: Vec<Vec<u8>>,
    /// Number of checksum bits, which determines how likely it is that a corrupted frame is
    /// accepted. 0 for formats that have neither a checksum nor a start marker.
    pub(crate) checksum_bits: u32,
    /// `true` if the unit after a damaged one yields the same measurements as without the damage.
    pub(crate) is_stateless: bool,
}

/// Returns a stream of `count` units for each format.
pub(crate) fn all(count: u32) -> Vec<Stream> {
    let stream = |name, decoder, unit: fn(u32) -> Vec<u8>, checksum_bits, is_stateless| Stream {
        name,
        decoder,
        units: (0..count).map(unit).collect(),
        checksum_bits,
        is_stateless,
    };
    vec![
        stream("witmotion", || Box::new(Framed::new(WitMotion::new(WITMOTION_RANGES))), witmotion_cycle, 8, true),
        stream("xsens", || Box::new(Framed::new(Xsens::new(49.0))), xsens_message, 8, true),
        stream("rvc", || Box::new(Framed::new(Rvc::default())), rvc_frame, 8, false),
        stream("lines", || Box::new(Framed::new(named_lines())), line, 0, false),
        stream("mavlink", || Box::new(Framed::new(Mavlink::new(MavlinkSettings::default()))), mavlink_frames, 16, true),
        stream("ubx", || Box::new(Framed::new(Ubx)), nav_pvt, 16, true),
        stream("nmea", || Box::new(Framed::new(Nmea::default())), sentence, 8, true),
        stream("iio", || Box::new(Framed::new(Iio::new(layout()).unwrap())), record, 0, false),
    ]
}

/// Decodes chunks and returns the measurements and totals.
pub(crate) fn decoded<'a>(
    mut decoder: Box<dyn Decoder>,
    chunks: impl IntoIterator<Item = &'a [u8]>,
) -> (Vec<Measurement>, Counts) {
    let mut found = Vec::new();
    chunks.into_iter().for_each(|chunk| decoder.push(chunk, &mut found));
    (found, decoder.counts())
}

/// Returns a pseudorandom number that depends on `n` and `index`.
fn number(n: u32, index: u32) -> i16 {
    let mixed = n.wrapping_mul(2_654_435_761).wrapping_add(index.wrapping_mul(40_503)) >> 12;
    (mixed % 16_001) as i16 - 8_000
}

fn three_i16(n: u32, index: u32) -> [u8; 6] {
    let [a, b, c] = [0, 1, 2].map(|axis| number(n, index + axis).to_le_bytes());
    [a[0], a[1], b[0], b[1], c[0], c[1]]
}

pub(crate) fn witmotion_frame(kind: u8, numbers: [u8; 8]) -> Vec<u8> {
    let mut frame = vec![0x55, kind];
    frame.extend(numbers);
    frame.push(frame.iter().fold(0, |sum: u8, byte| sum.wrapping_add(*byte)));
    frame
}

/// Returns frames with time, force, rate, angles and magnetic field.
fn witmotion_cycle(n: u32) -> Vec<u8> {
    let with = |three: [u8; 6]| [three[0], three[1], three[2], three[3], three[4], three[5], 0x10, 0x0a];
    let [low, high] = ((n * 10 % 1000) as u16).to_le_bytes();
    let time = [26, 11, 23, 8, 12, (n / 100 % 60) as u8, low, high];
    let cycle = [
        witmotion_frame(0x50, time),
        witmotion_frame(0x51, with(three_i16(n, 0))),
        witmotion_frame(0x52, with(three_i16(n, 3))),
        witmotion_frame(0x53, with(three_i16(n, 6))),
        witmotion_frame(0x54, with(three_i16(n, 9))),
    ];
    cycle.concat()
}

pub(crate) fn xsens_frame(packets: &[(u16, Vec<u8>)]) -> Vec<u8> {
    let data: Vec<u8> = packets
        .iter()
        .flat_map(|(id, packet)| [&id.to_be_bytes()[..], &[packet.len() as u8], &packet[..]].concat())
        .collect();
    let mut frame = vec![0xfa, 0xff, 0x36];
    match u8::try_from(data.len()) {
        Ok(length) if length < 0xff => frame.push(length),
        _ => frame.extend([0xff, (data.len() >> 8) as u8, data.len() as u8]),
    }
    frame.extend(data);
    let sum = frame[1..].iter().fold(0, |sum: u8, byte| sum.wrapping_add(*byte));
    frame.push(sum.wrapping_neg());
    frame
}

pub(crate) fn three_f32(three: [f32; 3]) -> Vec<u8> {
    three.map(f32::to_be_bytes).concat()
}

fn xsens_message(n: u32) -> Vec<u8> {
    let three = |index: u32| three_f32([0, 1, 2].map(|axis| f32::from(number(n, index + axis)) / 1000.0));
    let mut packets = vec![
        (0x1020, (n as u16).to_be_bytes().to_vec()),
        (0x1060, (n * 100).to_be_bytes().to_vec()),
        (0x4020, three(0)),
        (0x8020, three(3)),
    ];
    if n.is_multiple_of(2) {
        packets.push((0xc020, three(6)));
    }
    xsens_frame(&packets)
}

pub(crate) fn rvc_frame_with(number: u8, angles: [i16; 3], force: [i16; 3]) -> Vec<u8> {
    let mut frame = vec![0xaa, 0xaa, number];
    angles.iter().chain(&force).for_each(|part| frame.extend(part.to_le_bytes()));
    frame.extend([0; 3]);
    frame.push(frame[2..].iter().fold(0, |sum: u8, byte| sum.wrapping_add(*byte)));
    frame
}

fn rvc_frame(n: u32) -> Vec<u8> {
    rvc_frame_with(n as u8, [0, 1, 2].map(|index| number(n, index)), [3, 4, 5].map(|index| number(n, index) / 8))
}

fn named_lines() -> Lines {
    let columns = ["t", "gx", "gy", "gz", "ax", "ay", "az", "mx", "my", "mz"].map(str::to_owned).to_vec();
    Lines::new(&lines::LineSettings { columns: Some(columns), ..lines::LineSettings::default() }).unwrap()
}

fn line(n: u32) -> Vec<u8> {
    let numbers: Vec<_> = (0..9).map(|index| format!("{}", f64::from(number(n, index)) / 1000.0)).collect();
    format!("{}.{:03},{}\r\n", n / 100, n % 100 * 10, numbers.join(",")).into_bytes()
}

pub(crate) fn in_mavlink_2(message: &dialect::MavMessage, sequence: u8) -> Vec<u8> {
    let mut raw = MAVLinkV2MessageRaw::new();
    raw.serialize_message(MavHeader { system_id: 1, component_id: 1, sequence }, message);
    raw.raw_bytes().to_vec()
}

pub(crate) fn in_mavlink_1(message: &dialect::MavMessage, sequence: u8) -> Vec<u8> {
    let mut raw = MAVLinkV1MessageRaw::new();
    raw.serialize_message(MavHeader { system_id: 1, component_id: 1, sequence }, message);
    raw.raw_bytes().to_vec()
}

/// Returns an IMU message, followed by a fix in every fourth unit. Units alternate between MAVLink
/// 1 and 2.
fn mavlink_frames(n: u32) -> Vec<u8> {
    let value = |index| f32::from(number(n, index)) / 1000.0;
    let imu = dialect::MavMessage::HIGHRES_IMU(dialect::HIGHRES_IMU_DATA {
        time_usec: 1_000_000 + u64::from(n) * 4000,
        xacc: value(0),
        yacc: value(1),
        zacc: value(2),
        xgyro: value(3),
        ygyro: value(4),
        zgyro: value(5),
        xmag: value(6),
        ymag: value(7),
        zmag: value(8),
        fields_updated: dialect::HighresImuUpdatedFlags::from_bits_retain(if n.is_multiple_of(3) {
            0x3f
        } else {
            0x1ff
        }),
        ..Default::default()
    });
    let fix = dialect::MavMessage::GPS_RAW_INT(dialect::GPS_RAW_INT_DATA {
        time_usec: 1_000_000 + u64::from(n) * 4000,
        lat: -375_000_000,
        vel: n as u16 % 3000,
        cog: n as u16 % 36_000,
        fix_type: dialect::GpsFixType::GPS_FIX_TYPE_3D_FIX,
        ..Default::default()
    });
    let encode = if n.is_multiple_of(2) { in_mavlink_2 } else { in_mavlink_1 };
    if n.is_multiple_of(4) { [encode(&imu, n as u8), encode(&fix, n as u8)].concat() } else { encode(&imu, n as u8) }
}

pub(crate) fn ubx_frame(class: u8, id: u8, payload: &[u8]) -> Vec<u8> {
    let [low, high] = (payload.len() as u16).to_le_bytes();
    let covered = [&[class, id, low, high], payload].concat();
    let (mut a, mut b) = (0u8, 0u8);
    for byte in &covered {
        a = a.wrapping_add(*byte);
        b = b.wrapping_add(a);
    }
    [&[0xb5, 0x62], &covered[..], &[a, b]].concat()
}

fn nav_pvt(n: u32) -> Vec<u8> {
    let mut payload = [0; 92];
    payload[4..11].copy_from_slice(&[0xea, 0x07, 11, 23, 8, 12, (n / 10 % 60) as u8]);
    payload[11] = 3;
    (payload[20], payload[21]) = (3, 1);
    payload[28..32].copy_from_slice(&(-375_000_000i32).to_le_bytes());
    for axis in 0..3 {
        let velocity = i32::from(number(n, axis as u32));
        payload[48 + 4 * axis..52 + 4 * axis].copy_from_slice(&velocity.to_le_bytes());
    }
    payload[68..72].copy_from_slice(&120u32.to_le_bytes());
    ubx_frame(1, 7, &payload)
}

pub(crate) fn nmea_sentence(inside: &str) -> Vec<u8> {
    let sum = inside.bytes().fold(0, |sum, byte| sum ^ byte);
    format!("${inside}*{sum:02X}\r\n").into_bytes()
}

fn sentence(n: u32) -> Vec<u8> {
    let (speed, course) = (f64::from(n % 300) / 10.0, n % 360);
    nmea_sentence(&format!(
        "GNRMC,08{:02}{:02}.00,A,3730.0,S,14515.0,E,{speed:.1},{course}.0,231126,,,A,V",
        n / 60 % 60,
        n % 60
    ))
}

/// Returns the layout of a 16-bit big-endian rate, a force of the same type, and a timestamp.
fn layout() -> Layout {
    let channel = |at, bytes, bits| Channel {
        byte_offset: at,
        storage_bytes: bytes,
        bits,
        shift: 0,
        is_signed: true,
        is_big_endian: bytes == 2,
    };
    let vector = |at: usize, scale: f64| Vector {
        channels: [0, 2, 4].map(|axis| channel(at + axis, 2, 16)),
        offset: [0.0; 3],
        scale: [scale; 3],
        mount_matrix: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    };
    Layout {
        record_bytes: 24,
        rate: Some(vector(0, 0.001)),
        force: Some(vector(6, 0.01)),
        field: None,
        time: Some(channel(16, 8, 64)),
        clock: Clock::Monotonic,
    }
}

fn record(n: u32) -> Vec<u8> {
    let numbers = (0..6).flat_map(|index| number(n, index).to_be_bytes());
    numbers.chain([0; 4]).chain((i64::from(n) * 5_000_000).to_le_bytes()).collect()
}
