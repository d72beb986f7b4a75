//! Decoding of messages by their layout.
//!
//! - Input: a layout and the bytes of one message.
//! - Output: values with field names and units, as text or JSON.
//! - Failure: bytes of the wrong length and inconsistent layouts are rejected.

use std::fmt;

use foreign::ForeignText;
use messages::{Chart, CourseReference, EventKind, Field, Flags, Layout, State};
use serde_json::{Map, Value as Json};

/// Maximum number of list elements in the text output.
const MAX_DISPLAYED_ELEMENTS: usize = 4;

/// Message decoded into named fields.
#[derive(Debug, Clone, PartialEq)]
pub struct DecodedMessage {
    fields: Vec<(Field, Value)>,
}

/// Value of a field.
#[derive(Debug, Clone, PartialEq)]
enum Value {
    /// Count, identifier or other unsigned integer.
    Unsigned(u64),
    /// Time or other signed integer.
    Signed(i64),
    /// Physical quantity or other floating-point number.
    Number(f64),
    /// Elements of the same kind.
    List(Vec<Value>),
    /// Flags of the message.
    Flags(Flags),
    /// Name of an enumeration value.
    Name(&'static str),
    /// Text, without its zero padding.
    Text(ForeignText),
}

/// Mismatch between the bytes of a message and its layout.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("decoding a message: {found} bytes, but {layout} has {expected}; is the publisher another version of plumb?")]
pub struct LayoutMismatch {
    layout: &'static str,
    expected: usize,
    found: usize,
}

impl DecodedMessage {
    /// Decodes a message.
    ///
    /// # Errors
    ///
    /// Returns [`LayoutMismatch`] if the number of bytes differs from the size in the layout, or if
    /// the bytes of a field do not fit its kind.
    pub fn decode(layout: &Layout, bytes: &[u8]) -> Result<Self, LayoutMismatch> {
        let mismatch = || LayoutMismatch { layout: layout.name, expected: layout.size, found: bytes.len() };
        if bytes.len() != layout.size {
            return Err(mismatch());
        }
        let ends = layout.fields.iter().skip(1).map(|next| next.offset).chain([layout.size]);
        let fields = layout.fields.iter().zip(ends).map(|(field, end)| {
            let value = bytes.get(field.offset..end).and_then(|bytes| decode_value(field.kind, bytes));
            Ok((*field, value.ok_or_else(mismatch)?))
        });
        Ok(Self { fields: fields.collect::<Result<_, _>>()? })
    }

    /// Appends a field called `name` with the enumeration value `word`.
    pub fn with_name_field(mut self, name: &'static str, word: &'static str) -> Self {
        self.fields.push((Field { name, kind: "", offset: 0, description: "" }, Value::Name(word)));
        self
    }

    /// Returns the message as a JSON object. Non-finite numbers become null. Flags become a list of
    /// names.
    pub fn to_json(&self) -> Json {
        Json::Object(
            self.fields.iter().map(|(field, value)| (field.name.to_owned(), value.to_json())).collect::<Map<_, _>>(),
        )
    }
}

/// Formats the message as one line per field: name, value, unit.
impl fmt::Display for DecodedMessage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (field, value) in &self.fields {
            write!(f, "\n  {:<20} {value}", field.name)?;
            if let Some(unit) = field.unit() {
                write!(f, " {unit}")?;
            }
        }
        Ok(())
    }
}

impl Value {
    fn to_json(&self) -> Json {
        match self {
            Self::Unsigned(number) => (*number).into(),
            Self::Signed(number) => (*number).into(),
            // serde_json converts a non-finite number to null.
            Self::Number(number) => (*number).into(),
            Self::List(values) => values.iter().map(Self::to_json).collect(),
            Self::Flags(flags) => flags.names().collect(),
            Self::Name(word) => (*word).into(),
            Self::Text(text) => text.raw().into(),
        }
    }
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unsigned(number) => write!(f, "{number}"),
            Self::Signed(number) => write!(f, "{number}"),
            Self::Number(number) => write!(f, "{number:.6}"),
            Self::List(values) => {
                for (i, value) in values.iter().take(MAX_DISPLAYED_ELEMENTS).enumerate() {
                    write!(f, "{}{value}", if i > 0 { "  " } else { "" })?;
                }
                if values.len() > MAX_DISPLAYED_ELEMENTS { write!(f, "  … {} in all", values.len()) } else { Ok(()) }
            }
            Self::Flags(Flags::NONE) => write!(f, "-"),
            Self::Flags(flags) => write!(f, "{flags}"),
            Self::Name(word) => write!(f, "{word}"),
            Self::Text(text) => write!(f, "{text}"),
        }
    }
}

/// Decodes the bytes of a field, or returns `None` if they do not fit `kind`.
fn decode_value(kind: &str, bytes: &[u8]) -> Option<Value> {
    if let Some(element_kind) = kind.strip_prefix('[').and_then(|list| list.split(';').next()) {
        let size = element_size(element_kind)?;
        if !bytes.len().is_multiple_of(size) {
            return None;
        }
        if element_kind == "u8" {
            let text = bytes.split(|byte| *byte == 0).next().unwrap_or_default();
            return Some(Value::Text(ForeignText::from_bytes(text)));
        }
        return bytes
            .chunks_exact(size)
            .map(|bytes| decode_value(element_kind, bytes))
            .collect::<Option<_>>()
            .map(Value::List);
    }
    let long = || Some(u64::from_ne_bytes(bytes.try_into().ok()?));
    let short = || Some(u32::from_ne_bytes(bytes.try_into().ok()?));
    Some(match kind {
        "u64" => Value::Unsigned(long()?),
        "i64" => Value::Signed(long()?.cast_signed()),
        "f64" => Value::Number(f64::from_bits(long()?)),
        "u32" => Value::Unsigned(short()?.into()),
        "Flags" => Value::Flags(Flags(long()?)),
        "Chart" => Value::Name(Chart(long()?).name()),
        "CourseReference" => Value::Name(CourseReference(long()?).name()),
        "State" => Value::Name(State(short()?).name()),
        "EventKind" => Value::Name(EventKind(short()?).name()),
        _ => return None,
    })
}

/// Returns the size of a list element in bytes, or `None` if `kind` cannot be in a list.
fn element_size(kind: &str) -> Option<usize> {
    match kind {
        "u8" => Some(1),
        "u32" => Some(4),
        "u64" | "i64" | "f64" => Some(8),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use messages::{Checkpoint, Health, ImuSample, Message, SensorReading};

    use super::*;

    #[test]
    fn all_fields_of_all_layouts_decode() {
        for layout in messages::layouts() {
            let record = DecodedMessage::decode(&layout, &vec![0; layout.size]).unwrap();
            assert_eq!(record.fields.len(), layout.fields.len(), "{}", layout.name);
        }
    }

    #[test]
    fn hostile_text_in_message_is_escaped_except_in_json() {
        let event = messages::SystemEvent::new(messages::EventKind::ENDED).with_reason("\x1b[2J\nforged");
        let record = DecodedMessage::decode(&messages::SystemEvent::layout(), bytemuck::bytes_of(&event)).unwrap();
        assert!(record.to_string().contains(r"\u{1b}[2J\nforged"), "{record}");
        assert_eq!(record.to_json()["reason"], "\x1b[2J\nforged");
    }

    #[test]
    fn message_shows_names_units_and_flags() {
        let mut sample: ImuSample = bytemuck::Zeroable::zeroed();
        (sample.header.tick, sample.header.t_start_ns) = (7, -5);
        sample.header.flags = Flags::GAP | Flags::AT_REST;
        sample.force_m_s2 = [0.0, 0.0, 9.81];
        let record = DecodedMessage::decode(&ImuSample::layout(), bytemuck::bytes_of(&sample)).unwrap();
        let json = record.to_json();
        assert_eq!((&json["tick"], &json["t_start_ns"]), (&7.into(), &Json::from(-5)));
        assert_eq!(json["flags"], serde_json::json!(["gap", "at-rest"]));
        assert_eq!(json["force_m_s2"], serde_json::json!([0.0, 0.0, 9.81]));
        let text = record.to_string();
        assert!(text.contains("force_m_s2           0.000000  0.000000  9.810000 m/s²"), "{text}");
        assert!(text.contains("flags                gap at-rest"), "{text}");
    }

    #[test]
    fn non_finite_number_is_json_null() {
        let reading = SensorReading {
            t_sensor_ns: 1,
            rate_rad_s: [f64::NAN, f64::INFINITY, 1.5],
            force_m_s2: [f64::NEG_INFINITY; 3],
            field_ut: [f64::NAN; 3],
        };
        let record = DecodedMessage::decode(&SensorReading::layout(), bytemuck::bytes_of(&reading)).unwrap();
        let json: Json = serde_json::from_str(&record.to_json().to_string()).unwrap();
        assert_eq!(json["rate_rad_s"], serde_json::json!([null, null, 1.5]));
    }

    #[test]
    fn enum_and_text_fields_decode_to_names() {
        let mut checkpoint: Checkpoint = bytemuck::Zeroable::zeroed();
        checkpoint.stage[..2].copy_from_slice(b"wz");
        let json = DecodedMessage::decode(&Checkpoint::layout(), bytemuck::bytes_of(&checkpoint)).unwrap().to_json();
        assert_eq!(json["stage"], "wz");
        assert_eq!(json["words"].as_array().unwrap().len(), messages::CHECKPOINT_WORDS);
        let health = Health { state: State::RUNNING, published_from: u64::MAX, ..bytemuck::Zeroable::zeroed() };
        let json = DecodedMessage::decode(&Health::layout(), bytemuck::bytes_of(&health)).unwrap().to_json();
        assert_eq!((json["state"].as_str(), json["published_from"].as_u64()), (Some("running"), Some(u64::MAX)));
    }

    #[test]
    fn wrong_length_is_rejected() {
        let error = DecodedMessage::decode(&ImuSample::layout(), &[0; 111]).unwrap_err();
        assert!(error.to_string().contains("111 bytes, but plumbline.ImuSample.1 has 112"), "{error}");
    }
}
