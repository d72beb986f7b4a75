//! Conversion of topic messages to and from protobuf.
//!
//! The conversion is bit-exact, except that −0 is received as 0, because protobuf omits default
//! values.

use messages::{
    AccelPoint, AttitudeOutput, CHECKPOINT_WORDS, Checkpoint, Control, Credit, Difference, FusedState, GnssFix,
    GyroStep, Health, ImuSample, MagSample, Message, ReceiverReading, Reference, SensorReading, SystemEvent,
    TakenReading,
};
use prost::Message as _;

use crate::{DecodeError, error, field::Field, v1};

/// Topic message that has a protobuf counterpart in the schema.
pub trait Payload: Message {
    /// Name of the protobuf message in the package `plumbline.v1`.
    const NAME: &'static str;
    /// Corresponding protobuf message.
    type Proto: prost::Message + Default;

    /// Converts the message to protobuf.
    fn to_proto(&self) -> Self::Proto;

    /// Converts and validates a protobuf message.
    ///
    /// # Errors
    ///
    /// Returns the first missing or invalid field.
    fn from_proto(proto: Self::Proto) -> Result<Self, DecodeError>;

    /// Encodes the message as protobuf.
    fn to_bytes(&self) -> Vec<u8> {
        self.to_proto().encode_to_vec()
    }

    /// Decodes and validates a message from untrusted bytes.
    ///
    /// # Errors
    ///
    /// Returns an error if the bytes exceed the size limit, are not a message of this type, or have
    /// an invalid field.
    fn from_bytes(bytes: &[u8]) -> Result<Self, DecodeError> {
        error::check_size(bytes)?;
        Self::from_proto(Self::Proto::decode(bytes).map_err(error::malformed(Self::NAME))?)
    }
}

const UNKNOWN_QUATERNION: v1::Quaternion = v1::Quaternion { w: f64::NAN, x: f64::NAN, y: f64::NAN, z: f64::NAN };

/// Implements [`Payload`] field by field.
///
/// `unchecked` fields may be NaN: raw sensor values, and values that may be unknown. `optional`
/// quaternions may be missing, for example in recordings of earlier versions; a missing quaternion
/// is read as NaN.
macro_rules! payloads {
    ($($name:ident { $($field:ident),* } $(unchecked { $($unchecked:ident),* })? $(optional { $($optional:ident),* })?;)*) => { $(
        impl Payload for $name {
            const NAME: &'static str = stringify!($name);
            type Proto = v1::$name;

            fn to_proto(&self) -> v1::$name {
                v1::$name {
                    $($field: Field::to_proto(self.$field),)*
                    $($($unchecked: Field::to_proto(self.$unchecked),)*)?
                    $($($optional: Field::to_proto(self.$optional),)*)?
                }
            }

            fn from_proto(proto: v1::$name) -> Result<Self, DecodeError> {
                Ok(Self {
                    $($field: decode_field(proto.$field, stringify!($field))?,)*
                    $($($unchecked: Field::from_proto(proto.$unchecked, stringify!($unchecked))?,)*)?
                    $($($optional: Field::from_proto(proto.$optional.or(Some(UNKNOWN_QUATERNION)), stringify!($optional))?,)*)?
                })
            }
        }
    )* };
}

fn decode_field<P, F: Field<P>>(proto: P, field: &'static str) -> Result<F, DecodeError> {
    F::from_proto(proto, field)?.validated(field)
}

payloads! {
    SensorReading { t_sensor_ns } unchecked { rate_rad_s, force_m_s2, field_ut };
    ReceiverReading {} unchecked { velocity_m_s, velocity_sd_m_s, age_s, latitude_rad, longitude_rad, altitude_m };
    ImuSample { header, rate_rad_s, force_m_s2 };
    MagSample { header, field_ut };
    GnssFix { header, velocity_m_s } unchecked { velocity_sd_m_s, age_s, latitude_rad, longitude_rad, altitude_m };
    Reference { tick, t_end_ns, scored, quaternion };
    TakenReading { number, tick, t_sensor_ns, offset_ns } unchecked {
        rate_rad_s, force_m_s2, field_ut, velocity_m_s, velocity_sd_m_s, age_s, latitude_rad, longitude_rad,
        altitude_m, quaternion, present, incarnation
    };
    GyroStep { header, w, z_rad, chart, p, s, rate_rad_s };
    AccelPoint { header, w, chart, norm_m_s2, trust, force_m_s2 };
    FusedState {
        header, w, z_rad, chart, rate_rad_s, bias_rad_s, innovation_rad, inclination_sd_rad, heading_sd_rad, course_reference,
        reset_counter
    };
    AttitudeOutput {
        header, quaternion, yaw_rad, pitch_rad, roll_rad, course_rad, course_reference, course_sd_rad, declination_rad,
        rate_rad_s, inclination_sd_rad, reset_counter, jump
    };
    Credit { ticks, ends };
    Difference { tick, ticks, now_rad, mean_rad, rms_rad, max_rad, service, incarnation } optional { rotation };
    Health {
        ticks, lost, duplicated, repeated, next_tick, refused, late_wakes, flags, service, state, incarnation, pid, epoch, missed,
        published_from, invalid_outputs, clock_offset_ns, clock_jitter_ns, clock_steps
    };
}

impl Payload for Control {
    const NAME: &'static str = "Control";
    type Proto = v1::Control;

    fn to_proto(&self) -> v1::Control {
        let Self { from_tick, epoch, service, owner, reserved: _ } = *self;
        v1::Control { from_tick, epoch, service: service.to_proto(), owner }
    }

    fn from_proto(proto: v1::Control) -> Result<Self, DecodeError> {
        let v1::Control { from_tick, epoch, service, owner } = proto;
        Ok(Self { from_tick, epoch, service: Field::from_proto(service, "service")?, owner, reserved: 0 })
    }
}

impl Payload for Checkpoint {
    const NAME: &'static str = "Checkpoint";
    type Proto = v1::Checkpoint;

    fn to_proto(&self) -> v1::Checkpoint {
        let Self { next_tick, checksum, service, incarnation, slot_words, common_words, stage_words, swapped, .. } =
            *self;
        let len = self.words.iter().rposition(|word| *word != 0).map_or(0, |last| last + 1);
        v1::Checkpoint {
            next_tick,
            checksum,
            service: service.to_proto(),
            incarnation,
            stage: self.stage().into(),
            slot_words,
            common_words,
            stage_words,
            words: self.words.iter().take(len).copied().collect(),
            swapped,
        }
    }

    /// Converts a checkpoint without verifying its checksum, because the process that restores the
    /// checkpoint verifies it.
    fn from_proto(proto: v1::Checkpoint) -> Result<Self, DecodeError> {
        let v1::Checkpoint { next_tick, checksum, service, incarnation, swapped, .. } = proto;
        let v1::Checkpoint { slot_words, common_words, stage_words, .. } = proto;
        let mut words = [0; CHECKPOINT_WORDS];
        let stage = fixed_text(&proto.stage, Self::NAME, "stage")?;
        let too_many = DecodeError::TooMany { message: Self::NAME, what: "words", max: CHECKPOINT_WORDS };
        let destination = words.get_mut(..proto.words.len()).ok_or(too_many)?;
        destination.copy_from_slice(&proto.words);
        let service = Field::from_proto(service, "service")?;
        Ok(Self {
            next_tick,
            checksum,
            service,
            incarnation,
            stage,
            slot_words,
            common_words,
            stage_words,
            swapped,
            words,
        })
    }
}

impl Payload for SystemEvent {
    const NAME: &'static str = "SystemEvent";
    type Proto = v1::SystemEvent;

    fn to_proto(&self) -> v1::SystemEvent {
        let Self { number, t_event_ns, tick, ticks, adopted_tick, kind, service, incarnation, .. } = *self;
        let Self { epoch, instance, adopted_instance, replaces_ended, truncated, .. } = *self;
        v1::SystemEvent {
            number,
            t_event_ns,
            tick,
            ticks,
            adopted_tick,
            kind: kind.to_proto(),
            service: service.to_proto(),
            incarnation,
            epoch,
            instance,
            adopted_instance,
            replaces_ended,
            truncated,
            stage: self.stage().into(),
            settings: self.settings_text().into(),
            reason: self.reason().into(),
        }
    }

    fn from_proto(proto: v1::SystemEvent) -> Result<Self, DecodeError> {
        let v1::SystemEvent { number, t_event_ns, tick, ticks, adopted_tick, kind, service, incarnation, .. } = proto;
        let v1::SystemEvent { epoch, instance, adopted_instance, replaces_ended, truncated, .. } = proto;
        let has_no_service = service == v1::Service::Unspecified as i32;
        Ok(Self {
            number,
            t_event_ns,
            tick,
            ticks,
            adopted_tick,
            kind: Field::from_proto(kind, "kind")?,
            service: if has_no_service { Self::NONE_U32 } else { Field::from_proto(service, "service")? },
            incarnation,
            epoch,
            instance,
            adopted_instance,
            replaces_ended,
            truncated,
            stage: fixed_text(&proto.stage, Self::NAME, "stage")?,
            settings: fixed_text(&proto.settings, Self::NAME, "settings")?,
            reason: fixed_text(&proto.reason, Self::NAME, "reason")?,
        })
    }
}

/// Copies a text into an array and pads it with zeros.
fn fixed_text<const N: usize>(text: &str, message: &'static str, field: &'static str) -> Result<[u8; N], DecodeError> {
    let bytes = text.as_bytes();
    if bytes.contains(&0) {
        return Err(DecodeError::OutOfRange { field, value: format!("{text:?}"), expected: "a text without NUL" });
    }
    let mut padded = [0; N];
    let too_many = DecodeError::TooMany { message, what: "bytes", max: N };
    padded.get_mut(..bytes.len()).ok_or(too_many)?.copy_from_slice(bytes);
    Ok(padded)
}
