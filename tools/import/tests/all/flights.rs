//! Plumbline flights as MCAP.

use std::collections::BTreeMap;

use bytemuck::Zeroable;
use import::{Format, Note};
use mcap::{Compression, WriteOptions, Writer, records::MessageHeader};
use messages::{AttitudeOutput, Flags, GnssFix, Header, ImuSample, MagSample, Reference};
use recording::Row;
use wire::Payload;

use crate::common::Folder;

const TICKS: u64 = 1000;
const HALF: f64 = std::f64::consts::FRAC_1_SQRT_2;

struct Flight {
    writer: Writer<std::io::Cursor<Vec<u8>>>,
    channels: BTreeMap<&'static str, u16>,
}

impl Flight {
    fn new() -> Self {
        let options = WriteOptions::new().compression(Some(Compression::Zstd)).chunk_size(Some(10_000));
        Self { writer: options.create(std::io::Cursor::new(Vec::new())).unwrap(), channels: BTreeMap::new() }
    }

    fn write<T: Payload>(&mut self, topic: &'static str, message: &T) {
        let channel_id = *self.channels.entry(topic).or_insert_with(|| {
            let schema = self.writer.add_schema(&format!("plumbline.v1.{}", T::NAME), "protobuf", b"").unwrap();
            self.writer.add_channel(schema, topic, "protobuf", &BTreeMap::new()).unwrap()
        });
        let header = MessageHeader { channel_id, sequence: 0, log_time: 0, publish_time: 0 };
        self.writer.write_to_known_channel(&header, &message.to_bytes()).unwrap();
    }
}

/// Returns the MCAP bytes of a flight and its rows.
fn flight() -> (Vec<u8>, Vec<Row>) {
    let mut flight = Flight::new();
    let mut rows = Vec::new();
    for tick in 0..TICKS {
        let fraction = tick as f64 / TICKS as f64;
        let t_ns = 1_700_000_000_000_000_001 + 4_000_003 * tick as i64;
        let header = Header {
            tick,
            t_start_ns: t_ns - 4_000_003,
            t_end_ns: t_ns,
            flags: Flags::RATE_INSTANT,
            ..Header::zeroed()
        };
        let (rate_rad_s, force_m_s2) = ([fraction, -fraction / 3.0, 0.1], [0.1, fraction, 9.8]);
        let field_ut = (tick % 5 == 2).then_some([20.0 * fraction, 1.0 / 3.0, -40.0]);
        let quaternion = if tick % 2 == 0 { [HALF, 0.0, HALF, 0.0] } else { [1.0, 0.0, 0.0, 0.0] };
        let scored = u64::from(tick % 3 == 0);
        let reference = Reference { tick, t_end_ns: t_ns, scored, quaternion };
        if tick % 4 == 0 {
            flight.write("/reference", &reference);
        }
        flight.write("/imu", &ImuSample { header, rate_rad_s, force_m_s2 });
        if let Some(field_ut) = field_ut {
            flight.write("/mag", &MagSample { header, field_ut });
        }
        if tick % 4 != 0 {
            flight.write("/reference", &reference);
        }
        if tick % 50 == 49 {
            let velocity_m_s = [1.0, fraction, -0.5];
            let [velocity_sd_m_s, age_s] = [f64::NAN; 2];
            let [latitude_rad, longitude_rad, altitude_m] = [0.5, -2.0, 120.0];
            let fix = GnssFix { header, velocity_m_s, velocity_sd_m_s, age_s, latitude_rad, longitude_rad, altitude_m };
            flight.write("/gnss", &fix);
        }
        flight.write("/attitude", &AttitudeOutput { header, quaternion, ..AttitudeOutput::zeroed() });
        let reference = Some(recording::Reference { quaternion, scored: scored == 1 });
        rows.push(Row { t_ns, rate_rad_s, force_m_s2, field_ut, reference });
    }
    flight.writer.finish().unwrap();
    (flight.writer.into_inner().into_inner(), rows)
}

#[test]
fn flight_import_restores_recorded_rows() {
    let folder = Folder::new();
    let (bytes, rows) = flight();
    let imported = folder.import(&[folder.file("flight.mcap", &bytes)], None).unwrap();
    assert_eq!(imported.summary.format, Format::Mcap);
    assert_eq!(imported.rows, rows);
    assert_eq!(imported.summary.notes, [Note::InstantRates]);
    let fixes: Vec<_> = imported.fixes.iter().map(|fix| (fix.t_ns, fix.velocity_m_s)).collect();
    let expected = rows.iter().enumerate().filter(|(tick, _)| tick % 50 == 49);
    let expected: Vec<_> = expected.map(|(tick, row)| (row.t_ns, [1.0, tick as f64 / TICKS as f64, -0.5])).collect();
    assert_eq!(fixes, expected);
    assert!(imported.fixes.iter().all(|fix| (fix.latitude_deg.unwrap() - 0.5f64.to_degrees()).abs() < 1e-12));
    assert!(imported.fixes.iter().all(|fix| (fix.longitude_deg.unwrap() + 2.0f64.to_degrees()).abs() < 1e-12));
    assert!(imported.fixes.iter().all(|fix| fix.altitude_m == Some(120.0)));
}

#[test]
fn flight_cut_anywhere_keeps_earlier_rows() {
    let folder = Folder::new();
    let (bytes, rows) = flight();
    let mut before = 0;
    for length in (0..bytes.len()).step_by(997) {
        let path = folder.file("flight.mcap", &bytes[..length]);
        let Ok(imported) = folder.import(&[path], None) else {
            assert_eq!(before, 0, "{length}");
            continue;
        };
        let count = imported.rows.len();
        assert!(count >= before, "{length}: {count} after {before}");
        assert!(imported.rows.iter().zip(&rows).all(|(found, expected)| found.rate_rad_s == expected.rate_rad_s));
        before = count;
    }
    assert!(before > 900, "{before}");
}
