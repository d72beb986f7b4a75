//! Xsens MTi on a serial line: MTData2.
//!
//! A message consists of 0xFA, 0xFF, 0x36, the length (one byte, or 0xFF and two bytes), packets,
//! and a checksum byte. The checksum is chosen so that the sum of all bytes except the first is 0
//! modulo 256 (MT Low Level Communication Protocol). The low bits of a packet identifier give the
//! number format: float32, fixed point 12.20 or 16.32, double.
//!
//! | packet | content | result |
//! | --- | --- | --- |
//! | 0x1060 | SampleTimeFine, 32-bit counter at 10 kHz | timestamp, wraps after 4.97 days |
//! | 0x8020 | rate of turn, rad/s | body rate |
//! | 0x4020 | acceleration, m/s² | specific force, up at rest |
//! | 0xC020 | magnetic field, in arbitrary units | magnetic field; one unit is the field strength at Xsens's calibration site, 0.49 gauss (Xsens knowledge base) |
//! | 0x8040, 0x4040 | high-rate rate of turn and acceleration | used if 0x8020 or 0x4020 is not in the message |
//! | others | angles, positions, status … | counted |
//!
//! Axes: those of the sensor, on the housing x forward, y left, z up. The configured earth frame
//! (ENU, NED, NWU) has no effect.
//!
//! Limits: a message with only a rate or only a force yields no IMU measurement. Increments
//! (0x8030, 0x4010) are not decoded. Because the checksum has only 8 bits, one in 256 corrupted
//! messages is accepted if its packets are still well-formed.

use crate::{
    DeviceTime, Measurement, Value,
    framed::{Format, ParseOutcome, wrapping_sum},
};

const PREAMBLE: u8 = 0xfa;
const MASTER_BUS_ID: u8 = 0xff;
const MTDATA2: u8 = 0x36;
/// Length byte that announces a two-byte length.
const EXTENDED_LENGTH: u8 = 0xff;
/// Maximum total length of the packets of a message.
const MAX_LENGTH_BYTES: usize = 2048;
const COUNTS_PER_S: u64 = 10_000;
const NS_PER_COUNT: u64 = 1_000_000_000 / COUNTS_PER_S;

const SAMPLE_TIME_FINE: u16 = 0x1060;
const RATE: [u16; 2] = [0x8020, 0x8040];
const FORCE: [u16; 2] = [0x4020, 0x4040];
const FIELD: u16 = 0xc020;
/// Mask that removes the number format from a packet identifier.
const KIND_MASK: u16 = 0xfff0;

/// MTData2 format of a device.
#[derive(Debug, Clone)]
pub struct Xsens {
    field_ut: f64,
}

impl Xsens {
    /// Creates the format of a device. `field_ut` is the magnetic field strength in µT that one
    /// magnetometer unit represents.
    pub fn new(field_ut: f64) -> Self {
        Self { field_ut }
    }
}

impl Format for Xsens {
    fn parse(&mut self, bytes: &[u8], measurements: &mut Vec<Measurement>) -> ParseOutcome {
        // The fourth byte decides whether the length has one or two bytes.
        let (length, head_bytes) = match *bytes {
            [PREAMBLE] | [PREAMBLE, MASTER_BUS_ID] | [PREAMBLE, MASTER_BUS_ID, MTDATA2] => {
                return ParseOutcome::Incomplete;
            }
            [PREAMBLE, MASTER_BUS_ID, MTDATA2, EXTENDED_LENGTH]
            | [PREAMBLE, MASTER_BUS_ID, MTDATA2, EXTENDED_LENGTH, _] => return ParseOutcome::Incomplete,
            [PREAMBLE, MASTER_BUS_ID, MTDATA2, EXTENDED_LENGTH, high, low, ..] => {
                (usize::from(u16::from_be_bytes([high, low])), 6)
            }
            [PREAMBLE, MASTER_BUS_ID, MTDATA2, length, ..] => (usize::from(length), 4),
            _ => return ParseOutcome::Skip(1),
        };
        if length > MAX_LENGTH_BYTES {
            return ParseOutcome::Rejected;
        }
        let Some(frame) = bytes.get(..head_bytes + length + 1) else { return ParseOutcome::Incomplete };
        if wrapping_sum(&frame[1..]) != 0 {
            return ParseOutcome::Rejected;
        }
        let Some(packets) = Packets::parse(&frame[head_bytes..head_bytes + length]) else {
            return ParseOutcome::Rejected;
        };
        measurements.extend(packets.measurement(self.field_ut));
        ParseOutcome::Frame(frame.len())
    }
}

/// Packets of a message that the decoder uses. For rate and force, index 0 is the standard packet
/// and index 1 the high-rate packet.
#[derive(Default)]
struct Packets {
    count: Option<u32>,
    rate_rad_s: [Option<[f64; 3]>; 2],
    force_m_s2: [Option<[f64; 3]>; 2],
    field: Option<[f64; 3]>,
}

impl Packets {
    /// Parses a sequence of packets, or returns `None` if a packet is truncated or has a wrong
    /// size.
    fn parse(mut bytes: &[u8]) -> Option<Self> {
        let mut packets = Self::default();
        while !bytes.is_empty() {
            let (&[high, low, length], rest) = bytes.split_first_chunk::<3>()?;
            let (packet, rest) = rest.split_at_checked(length.into())?;
            bytes = rest;
            let id = u16::from_be_bytes([high, low]);
            let kind = id & KIND_MASK;
            let index_in = |kinds: [u16; 2]| kinds.iter().position(|other| *other == kind);
            if kind == SAMPLE_TIME_FINE {
                packets.count = Some(u32::from_be_bytes(packet.try_into().ok()?));
            } else if let Some(index) = index_in(RATE) {
                packets.rate_rad_s[index] = Some(parse_vector(id, packet)?);
            } else if let Some(index) = index_in(FORCE) {
                packets.force_m_s2[index] = Some(parse_vector(id, packet)?);
            } else if kind == FIELD {
                packets.field = Some(parse_vector(id, packet)?);
            }
        }
        Some(packets)
    }

    fn measurement(&self, field_ut: f64) -> Option<Measurement> {
        let rate_rad_s = self.rate_rad_s[0].or(self.rate_rad_s[1]);
        let force_m_s2 = self.force_m_s2[0].or(self.force_m_s2[1]);
        let field_ut = self.field.map(|field| field.map(|part| part * field_ut));
        let value = match (rate_rad_s, force_m_s2) {
            (Some(rate_rad_s), Some(force_m_s2)) => Value::Imu { rate_rad_s, force_m_s2, field_ut },
            _ => Value::Field(field_ut?),
        };
        let time = self.count.map(|count| DeviceTime::Counter {
            now_ns: u64::from(count) * NS_PER_COUNT,
            period_ns: (1 << 32) * NS_PER_COUNT,
        });
        Some(Measurement { time, value })
    }
}

/// Returns three numbers in the format given by `id`, or `None` if `packet` has another size.
fn parse_vector(id: u16, packet: &[u8]) -> Option<[f64; 3]> {
    fn read<const N: usize>(packet: &[u8], parse_number: impl Fn([u8; N]) -> f64) -> Option<[f64; 3]> {
        match packet.as_chunks::<N>() {
            (&[x, y, z], []) => Some([x, y, z].map(parse_number)),
            _ => None,
        }
    }
    match id & 3 {
        0 => read(packet, |bytes| f32::from_be_bytes(bytes).into()),
        1 => read(packet, |bytes| f64::from(i32::from_be_bytes(bytes)) / f64::from(1 << 20)),
        // The four bytes of the fraction precede the two of the integer part.
        2 => read(packet, |[a, b, c, d, high, low]| {
            f64::from(i16::from_be_bytes([high, low])) + f64::from(u32::from_be_bytes([a, b, c, d])) / 4_294_967_296.0
        }),
        _ => read(packet, f64::from_be_bytes),
    }
}
