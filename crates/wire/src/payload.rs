//! A topic's message as protobuf, and back: the same to the last bit, but that −0 arrives as 0, which protobuf leaves out.

use messages::{
    AccelPoint, AttitudeOutput, CHECKPOINT_WORDS, Checkpoint, Control, Credit, Difference, FusedState, GnssFix,
    GyroStep, Health, ImuSample, MagSample, Message, ReceiverReading, Reference, SensorReading, SystemEvent,
    TakenReading,
};
use prost::Message as _;

use crate::{Refusal, field::Field, refusal, v1};

/// A message with a form in the schema.
pub trait Payload: Message {
    /// The form's name in `plumbline.v1`.
    const NAME: &'static str;
    /// The form.
    type Form: prost::Message + Default;

    /// The form of this message.
    fn form(&self) -> Self::Form;

    /// The message of a form, checked.
    fn of_form(form: Self::Form) -> Result<Self, Refusal>;

    /// The message as bytes.
    fn encoded(&self) -> Vec<u8> {
        self.form().encode_to_vec()
    }

    /// The message of bytes from anywhere, checked.
    fn decoded(bytes: &[u8]) -> Result<Self, Refusal> {
        refusal::within_size(bytes)?;
        Self::of_form(Self::Form::decode(bytes).map_err(refusal::malformed(Self::NAME))?)
    }
}

/// A quaternion of which nothing is known.
const UNKNOWN: v1::Quaternion = v1::Quaternion { w: f64::NAN, x: f64::NAN, y: f64::NAN, z: f64::NAN };

/// Numbers of `any` may be NaN: what a sensor says, and what may be unknown. So may quaternions of `later`, which recorded flights need not have.
macro_rules! payloads {
    ($($name:ident { $($field:ident),* } $(any { $($any:ident),* })? $(later { $($later:ident),* })?;)*) => { $(
        impl Payload for $name {
            const NAME: &'static str = stringify!($name);
            type Form = v1::$name;

            fn form(&self) -> v1::$name {
                v1::$name {
                    $($field: Field::put(self.$field),)*
                    $($($any: Field::put(self.$any),)*)?
                    $($($later: Field::put(self.$later),)*)?
                }
            }

            fn of_form(form: v1::$name) -> Result<Self, Refusal> {
                Ok(Self {
                    $($field: take_checked(form.$field, stringify!($field))?,)*
                    $($($any: Field::take(form.$any, stringify!($any))?,)*)?
                    $($($later: Field::take(form.$later.or(Some(UNKNOWN)), stringify!($later))?,)*)?
                })
            }
        }
    )* };
}

fn take_checked<P, F: Field<P>>(form: P, field: &'static str) -> Result<F, Refusal> {
    F::take(form, field)?.checked(field)
}

payloads! {
    SensorReading { t_sensor_ns } any { rate_rad_s, force_m_s2, field_ut };
    ReceiverReading {} any { velocity_m_s, velocity_sd_m_s, age_s, latitude_rad, longitude_rad, altitude_m };
    ImuSample { header, rate_rad_s, force_m_s2 };
    MagSample { header, field_ut };
    GnssFix { header, velocity_m_s } any { velocity_sd_m_s, age_s, latitude_rad, longitude_rad, altitude_m };
    Reference { tick, scored, quaternion };
    TakenReading { number, tick, t_sensor_ns, offset_ns } any {
        rate_rad_s, force_m_s2, field_ut, velocity_m_s, velocity_sd_m_s, age_s, latitude_rad, longitude_rad,
        altitude_m, quaternion, brings, incarnation
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
    Difference { tick, ticks, now_rad, mean_rad, rms_rad, max_rad, service, incarnation } later { turn };
    Health {
        ticks, lost, duplicated, repeated, next_tick, refused, late_wakes, flags, service, state, incarnation, pid, epoch, missed,
        published_from, flawed, clock_offset_ns, clock_jitter_ns, clock_steps
    };
}

impl Payload for Control {
    const NAME: &'static str = "Control";
    type Form = v1::Control;

    fn form(&self) -> v1::Control {
        let Self { from_tick, epoch, service, owner, reserved: _ } = *self;
        v1::Control { from_tick, epoch, service: service.put(), owner }
    }

    fn of_form(form: v1::Control) -> Result<Self, Refusal> {
        let v1::Control { from_tick, epoch, service, owner } = form;
        Ok(Self { from_tick, epoch, service: Field::take(service, "service")?, owner, reserved: 0 })
    }
}

impl Payload for Checkpoint {
    const NAME: &'static str = "Checkpoint";
    type Form = v1::Checkpoint;

    fn form(&self) -> v1::Checkpoint {
        let Self { next_tick, checksum, service, incarnation, slot_words, common_words, stage_words, swapped, .. } =
            *self;
        let len = self.words.iter().rposition(|word| *word != 0).map_or(0, |last| last + 1);
        v1::Checkpoint {
            next_tick,
            checksum,
            service: service.put(),
            incarnation,
            stage: self.stage().into(),
            slot_words,
            common_words,
            stage_words,
            words: self.words.iter().take(len).copied().collect(),
            swapped,
        }
    }

    /// The checksum goes with the message and is not looked at here: whoever goes on from it does.
    fn of_form(form: v1::Checkpoint) -> Result<Self, Refusal> {
        let v1::Checkpoint { next_tick, checksum, service, incarnation, swapped, .. } = form;
        let v1::Checkpoint { slot_words, common_words, stage_words, .. } = form;
        let mut words = [0; CHECKPOINT_WORDS];
        let stage = text_taken(&form.stage, Self::NAME, "stage")?;
        let too_many = Refusal::TooMany { message: Self::NAME, what: "words", max: CHECKPOINT_WORDS };
        let room = words.get_mut(..form.words.len()).ok_or(too_many)?;
        room.copy_from_slice(&form.words);
        let service = Field::take(service, "service")?;
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
    type Form = v1::SystemEvent;

    fn form(&self) -> v1::SystemEvent {
        let Self { number, t_told_ns, tick, ticks, adopted_tick, kind, service, incarnation, .. } = *self;
        let Self { epoch, filling, adopted_filling, alone, cut, .. } = *self;
        v1::SystemEvent {
            number,
            t_told_ns,
            tick,
            ticks,
            adopted_tick,
            kind: kind.put(),
            service: service.put(),
            incarnation,
            epoch,
            filling,
            adopted_filling,
            alone,
            cut,
            stage: self.stage().into(),
            settings: self.settings_text().into(),
            why: self.why().into(),
        }
    }

    fn of_form(form: v1::SystemEvent) -> Result<Self, Refusal> {
        let v1::SystemEvent { number, t_told_ns, tick, ticks, adopted_tick, kind, service, incarnation, .. } = form;
        let v1::SystemEvent { epoch, filling, adopted_filling, alone, cut, .. } = form;
        let about_none = service == v1::Service::Unspecified as i32;
        Ok(Self {
            number,
            t_told_ns,
            tick,
            ticks,
            adopted_tick,
            kind: Field::take(kind, "kind")?,
            service: if about_none { Self::NOBODY } else { Field::take(service, "service")? },
            incarnation,
            epoch,
            filling,
            adopted_filling,
            alone,
            cut,
            stage: text_taken(&form.stage, Self::NAME, "stage")?,
            settings: text_taken(&form.settings, Self::NAME, "settings")?,
            why: text_taken(&form.why, Self::NAME, "why")?,
        })
    }
}

/// A text that is filled up with zeros.
fn text_taken<const N: usize>(text: &str, message: &'static str, field: &'static str) -> Result<[u8; N], Refusal> {
    let letters = text.as_bytes();
    if letters.contains(&0) {
        return Err(Refusal::OutOfRange { field, value: format!("{text:?}"), expected: "a text without zeros" });
    }
    let mut place = [0; N];
    let too_many = Refusal::TooMany { message, what: "letters", max: N };
    place.get_mut(..letters.len()).ok_or(too_many)?.copy_from_slice(letters);
    Ok(place)
}
