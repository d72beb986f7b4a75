//! Selects the decoder for a format.

use decoders::{
    Decoder,
    framed::Framed,
    lines::{LineSettings, Lines},
    mavlink::{self, Mavlink, RawScale},
    nmea::Nmea,
    rvc::Rvc,
    ubx::Ubx,
    witmotion::{Ranges, WitMotion},
    xsens::Xsens,
};
use launch::{Autopilot, Columns, FixMessage, Format, ImuMessage, ReceiverFormat};

use crate::{error::DriversError, protobuf::Protobuf};

/// Creates a decoder for the format of a device.
pub(crate) fn decoder(format: &Format) -> Result<Box<dyn Decoder>, DriversError> {
    Ok(match format {
        Format::Csv(columns) => Box::new(Framed::new(line_format(columns)?)),
        Format::Protobuf => Box::new(Framed::new(Protobuf)),
        Format::WitMotion(launch::WitMotion { range_g, range_deg_s, field_unit_ut }) => {
            let field_ut = Some(*field_unit_ut).filter(|unit_ut| *unit_ut > 0.0);
            Box::new(Framed::new(WitMotion::new(Ranges { force_g: *range_g, rate_deg_s: *range_deg_s, field_ut })))
        }
        Format::Xsens(scales) => Box::new(Framed::new(Xsens::new(scales.field_unit_ut))),
        Format::Rvc => Box::new(Framed::new(Rvc::default())),
        Format::Mavlink(autopilot) => Box::new(Framed::new(Mavlink::new(mavlink_settings(autopilot)))),
    })
}

/// Creates a decoder for the format of a receiver.
pub(crate) fn receiver_decoder(format: ReceiverFormat) -> Box<dyn Decoder> {
    match format {
        ReceiverFormat::Ubx => Box::new(Framed::new(Ubx)),
        ReceiverFormat::Nmea => Box::new(Framed::new(Nmea::default())),
    }
}

fn line_format(columns: &Columns) -> Result<Lines, DriversError> {
    let settings = LineSettings {
        mapping: columns.mapping()?,
        columns: columns.names(),
        time_bits: u8::try_from(columns.time_bits).ok().filter(|bits| *bits > 0),
        // The device stream discards a partial first line, so the decoder need not skip it.
        starts_at_line_start: true,
    };
    Ok(Lines::new(&settings)?)
}

fn mavlink_settings(Autopilot { system, imu, fix }: &Autopilot) -> mavlink::MavlinkSettings {
    mavlink::MavlinkSettings {
        system_id: u8::try_from(*system).ok().filter(|system| *system > 0),
        imu: imu.map(|imu| match imu {
            ImuMessage::HighresImu => mavlink::ImuMessage::HighresImu,
            ImuMessage::ScaledImu => mavlink::ImuMessage::ScaledImu,
            ImuMessage::ScaledImu2 => mavlink::ImuMessage::ScaledImu2,
            ImuMessage::ScaledImu3 => mavlink::ImuMessage::ScaledImu3,
            ImuMessage::RawImu => mavlink::ImuMessage::RawImu,
        }),
        fix: match fix {
            Some(FixMessage::GpsRawInt) => mavlink::FixMessage::GpsRawInt,
            Some(FixMessage::GlobalPositionInt) => mavlink::FixMessage::GlobalPositionInt,
            None => mavlink::FixMessage::Disabled,
        },
        raw_scale: Some(RawScale::ARDUPILOT),
    }
}
