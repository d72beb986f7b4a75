//! Xsens MTi on a serial line: MTData2.
//!
//! A message is 0xFA, 0xFF, 0x36, a length of one byte or 0xFF and two, packets, and a byte that makes the sum of all but the first zero
//! (MT Low Level Communication Protocol). Of a packet the identifier's low bits say how numbers are written: float32, fixed point
//! 12.20 or 16.32, double. What is made of them:
//!
//! | packet | what | becomes |
//! | --- | --- | --- |
//! | 0x1060 | SampleTimeFine, a counter of 32 bits at 10 kHz | the time; it begins again after 4.97 days |
//! | 0x8020 | rate of turn, rad/s | body rate |
//! | 0x4020 | acceleration, m/s² | specific force: at rest it is up |
//! | 0xC020 | magnetic field, in arbitrary units | field; one unit is the field where the device was calibrated, [`FIELD_UT`] |
//! | 0x8040, 0x4040 | the same of high rate | where the other ones are not in the message |
//! | others | angles, positions, status … | counted |
//!
//! Axes: those of the sensor, x forward, y left, z up on the housing; the choice of the earth's axes (ENU, NED, NWU) is of no concern.
//! Limits: a message with a rate alone or a force alone makes no measurement; increments (0x8030, 0x4010) are not read.
//! The sum has 8 bits: of 256 messages that the line broke and whose packets still fit, one is taken for good.

use crate::{
    DeviceTime, Measurement, Value,
    framed::{Format, Seen, sum},
};

const BEGIN: u8 = 0xfa;
const MASTER: u8 = 0xff;
const MTDATA2: u8 = 0x36;
/// In place of the length: two bytes of it follow.
const EXTENDED: u8 = 0xff;
/// Of the packets of a message.
const LENGTH_MAX_BYTES: usize = 2048;
const COUNTS_PER_S: u64 = 10_000;
const NS_PER_COUNT: u64 = 1_000_000_000 / COUNTS_PER_S;
/// What one arbitrary unit stands for where Xsens calibrates, µT: 0.49 gauss (Xsens knowledge base).
pub const FIELD_UT: f64 = 49.0;

const SAMPLE_TIME_FINE: u16 = 0x1060;
const RATE: [u16; 2] = [0x8020, 0x8040];
const FORCE: [u16; 2] = [0x4020, 0x4040];
const FIELD: u16 = 0xc020;
/// An identifier without the bits that say how numbers are written.
const WHAT: u16 = 0xfff0;

/// What a unit of the magnetometer stands for.
#[derive(Debug, Clone)]
pub struct Xsens {
    field_ut: f64,
}

impl Xsens {
    /// A device of whose magnetic field one unit is so many µT; [`FIELD_UT`] where nobody knows better.
    pub fn new(field_ut: f64) -> Self {
        Self { field_ut }
    }
}

impl Format for Xsens {
    fn look(&mut self, bytes: &[u8], found: &mut Vec<Measurement>) -> Seen {
        // A length of one byte is told from one of two by its place, which must be there.
        let (length, head_bytes) = match *bytes {
            [BEGIN] | [BEGIN, MASTER] | [BEGIN, MASTER, MTDATA2] => return Seen::More,
            [BEGIN, MASTER, MTDATA2, EXTENDED] | [BEGIN, MASTER, MTDATA2, EXTENDED, _] => return Seen::More,
            [BEGIN, MASTER, MTDATA2, EXTENDED, high, low, ..] => (usize::from(u16::from_be_bytes([high, low])), 6),
            [BEGIN, MASTER, MTDATA2, length, ..] => (usize::from(length), 4),
            _ => return Seen::Nothing(1),
        };
        if length > LENGTH_MAX_BYTES {
            return Seen::Refused;
        }
        let Some(frame) = bytes.get(..head_bytes + length + 1) else { return Seen::More };
        if sum(&frame[1..]) != 0 {
            return Seen::Refused;
        }
        let Some(packets) = Packets::of(&frame[head_bytes..head_bytes + length]) else { return Seen::Refused };
        found.extend(packets.measurement(self.field_ut));
        Seen::Frame(frame.len())
    }
}

/// What is used of a message.
#[derive(Default)]
struct Packets {
    count: Option<u32>,
    rate_rad_s: [Option<[f64; 3]>; 2],
    force_m_s2: [Option<[f64; 3]>; 2],
    field: Option<[f64; 3]>,
}

impl Packets {
    /// `None` of what is not made of whole packets.
    fn of(mut bytes: &[u8]) -> Option<Self> {
        let mut packets = Self::default();
        while !bytes.is_empty() {
            let (&[high, low, length], rest) = bytes.split_first_chunk::<3>()?;
            let (packet, rest) = rest.split_at_checked(length.into())?;
            bytes = rest;
            let id = u16::from_be_bytes([high, low]);
            let kind = id & WHAT;
            let place = |of: [u16; 2]| of.iter().position(|other| *other == kind);
            if kind == SAMPLE_TIME_FINE {
                packets.count = Some(u32::from_be_bytes(packet.try_into().ok()?));
            } else if let Some(place) = place(RATE) {
                packets.rate_rad_s[place] = Some(three(id, packet)?);
            } else if let Some(place) = place(FORCE) {
                packets.force_m_s2[place] = Some(three(id, packet)?);
            } else if kind == FIELD {
                packets.field = Some(three(id, packet)?);
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

/// Three numbers, written as the identifier says; `None` where there are not three.
fn three(id: u16, packet: &[u8]) -> Option<[f64; 3]> {
    fn of<const N: usize>(packet: &[u8], number: impl Fn([u8; N]) -> f64) -> Option<[f64; 3]> {
        match packet.as_chunks::<N>() {
            (&[x, y, z], []) => Some([x, y, z].map(number)),
            _ => None,
        }
    }
    match id & 3 {
        0 => of(packet, |bytes| f32::from_be_bytes(bytes).into()),
        1 => of(packet, |bytes| f64::from(i32::from_be_bytes(bytes)) / f64::from(1 << 20)),
        // The fraction's four bytes come before the whole part's two.
        2 => of(packet, |[a, b, c, d, high, low]| {
            f64::from(i16::from_be_bytes([high, low])) + f64::from(u32::from_be_bytes([a, b, c, d])) / 4_294_967_296.0
        }),
        _ => of(packet, f64::from_be_bytes),
    }
}
