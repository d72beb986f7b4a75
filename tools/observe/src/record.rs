//! A message by its layout: every field with its name, its unit and what it holds.
//!
//! Input: a layout and as many bytes. Output: values with names; text for people, JSON for scripts. Failure: bytes of another length,
//! and a layout that does not fit into itself, are refused.

use std::fmt;

use messages::{Chart, CourseReference, EventKind, Field, Flags, Layout, State};
use serde_json::{Map, Value as Json};

/// Numbers of a list that people are shown.
const SHOWN: usize = 4;

/// A message taken apart.
#[derive(Debug, Clone, PartialEq)]
pub struct Record {
    fields: Vec<(Field, Value)>,
}

/// What a field holds.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// A count or a name's number.
    Unsigned(u64),
    /// A time, or another integer with a sign.
    Signed(i64),
    /// A quantity.
    Number(f64),
    /// Several of one kind.
    List(Vec<Value>),
    /// What is to be said about the message.
    Flags(Flags),
    /// One of a few, by its word.
    Word(&'static str),
    /// Text filled up with zeros.
    Text(String),
}

/// Bytes that are not a message of the layout.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NotOfLayout {
    layout: &'static str,
    expected: usize,
    found: usize,
}

impl fmt::Display for NotOfLayout {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { layout, expected, found } = self;
        write!(
            f,
            "decoding a message: {found} bytes are no {layout}, which has {expected}; is the sender another version?"
        )
    }
}

impl std::error::Error for NotOfLayout {}

impl Record {
    /// Takes a message apart.
    pub fn new(layout: &Layout, bytes: &[u8]) -> Result<Self, NotOfLayout> {
        let refused = || NotOfLayout { layout: layout.name, expected: layout.size, found: bytes.len() };
        if bytes.len() != layout.size {
            return Err(refused());
        }
        let ends = layout.fields.iter().skip(1).map(|next| next.offset).chain([layout.size]);
        let fields = layout.fields.iter().zip(ends).map(|(field, end)| {
            let value = bytes.get(field.offset..end).and_then(|bytes| value(field.kind, bytes));
            Ok((*field, value.ok_or_else(refused)?))
        });
        Ok(Self { fields: fields.collect::<Result<_, _>>()? })
    }

    /// What a field holds.
    pub fn get(&self, name: &str) -> Option<&Value> {
        self.fields.iter().find(|(field, _)| field.name == name).map(|(_, value)| value)
    }

    /// What a field holds, where that is a number without a sign.
    pub fn unsigned(&self, name: &str) -> Option<u64> {
        match self.get(name) {
            Some(Value::Unsigned(number)) => Some(*number),
            _ => None,
        }
    }

    /// The record with one more word after its fields.
    pub fn with_word(mut self, name: &'static str, word: &'static str) -> Self {
        self.fields.push((Field { name, kind: "", offset: 0, description: "" }, Value::Word(word)));
        self
    }

    /// One object; what is not finite is null, flags are their names.
    pub fn json(&self) -> Json {
        Json::Object(
            self.fields.iter().map(|(field, value)| (field.name.to_owned(), value.json())).collect::<Map<_, _>>(),
        )
    }
}

/// A line for each field: name, value, unit.
impl fmt::Display for Record {
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
    fn json(&self) -> Json {
        match self {
            Self::Unsigned(number) => (*number).into(),
            Self::Signed(number) => (*number).into(),
            // A number that is not finite becomes null.
            Self::Number(number) => (*number).into(),
            Self::List(values) => values.iter().map(Self::json).collect(),
            Self::Flags(flags) => flags.names().collect(),
            Self::Word(word) => (*word).into(),
            Self::Text(text) => text.as_str().into(),
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
                for (i, value) in values.iter().take(SHOWN).enumerate() {
                    write!(f, "{}{value}", if i > 0 { "  " } else { "" })?;
                }
                if values.len() > SHOWN { write!(f, "  … {} in all", values.len()) } else { Ok(()) }
            }
            Self::Flags(Flags::NONE) => write!(f, "-"),
            Self::Flags(flags) => write!(f, "{flags}"),
            Self::Word(word) => write!(f, "{word}"),
            Self::Text(text) => write!(f, "{text}"),
        }
    }
}

/// The bytes as what the layout says they are; `None` where that cannot be.
fn value(kind: &str, bytes: &[u8]) -> Option<Value> {
    if let Some(each) = kind.strip_prefix('[').and_then(|list| list.split(';').next()) {
        let size = size(each)?;
        if !bytes.len().is_multiple_of(size) {
            return None;
        }
        if each == "u8" {
            let text = bytes.split(|byte| *byte == 0).next().unwrap_or_default();
            return Some(Value::Text(String::from_utf8_lossy(text).into_owned()));
        }
        return bytes.chunks_exact(size).map(|bytes| value(each, bytes)).collect::<Option<_>>().map(Value::List);
    }
    let long = || Some(u64::from_ne_bytes(bytes.try_into().ok()?));
    let short = || Some(u32::from_ne_bytes(bytes.try_into().ok()?));
    Some(match kind {
        "u64" => Value::Unsigned(long()?),
        "i64" => Value::Signed(long()?.cast_signed()),
        "f64" => Value::Number(f64::from_bits(long()?)),
        "u32" => Value::Unsigned(short()?.into()),
        "Flags" => Value::Flags(Flags(long()?)),
        "Chart" => Value::Word(Chart(long()?).name()),
        "CourseReference" => Value::Word(CourseReference(long()?).name()),
        "State" => Value::Word(State(short()?).name()),
        "EventKind" => Value::Word(EventKind(short()?).name()),
        _ => return None,
    })
}

/// Bytes of a kind that lists are made of.
fn size(kind: &str) -> Option<usize> {
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
    fn every_field_of_every_topic_is_understood() {
        for layout in messages::layouts() {
            let record = Record::new(&layout, &vec![0; layout.size]).unwrap();
            assert_eq!(record.fields.len(), layout.fields.len(), "{}", layout.name);
        }
    }

    #[test]
    fn a_message_is_shown_with_names_units_and_flags() {
        let mut sample: ImuSample = bytemuck::Zeroable::zeroed();
        (sample.header.tick, sample.header.t_start_ns) = (7, -5);
        sample.header.flags = Flags::GAP | Flags::AT_REST;
        sample.force_m_s2 = [0.0, 0.0, 9.81];
        let record = Record::new(&ImuSample::layout(), bytemuck::bytes_of(&sample)).unwrap();
        let json = record.json();
        assert_eq!((&json["tick"], &json["t_start_ns"]), (&7.into(), &Json::from(-5)));
        assert_eq!(json["flags"], serde_json::json!(["gap", "at-rest"]));
        assert_eq!(json["force_m_s2"], serde_json::json!([0.0, 0.0, 9.81]));
        let text = record.to_string();
        assert!(text.contains("force_m_s2           0.000000  0.000000  9.810000 m/s²"), "{text}");
        assert!(text.contains("flags                gap at-rest"), "{text}");
    }

    #[test]
    fn what_is_not_finite_is_null_and_every_line_stays_json() {
        let reading = SensorReading {
            t_sensor_ns: 1,
            rate_rad_s: [f64::NAN, f64::INFINITY, 1.5],
            force_m_s2: [f64::NEG_INFINITY; 3],
            field_ut: [f64::NAN; 3],
        };
        let record = Record::new(&SensorReading::layout(), bytemuck::bytes_of(&reading)).unwrap();
        let json: Json = serde_json::from_str(&record.json().to_string()).unwrap();
        assert_eq!(json["rate_rad_s"], serde_json::json!([null, null, 1.5]));
    }

    #[test]
    fn words_and_names_are_words_and_names() {
        let mut checkpoint: Checkpoint = bytemuck::Zeroable::zeroed();
        checkpoint.stage[..2].copy_from_slice(b"wz");
        let json = Record::new(&Checkpoint::layout(), bytemuck::bytes_of(&checkpoint)).unwrap().json();
        assert_eq!(json["stage"], "wz");
        assert_eq!(json["words"].as_array().unwrap().len(), messages::CHECKPOINT_WORDS);
        let health = Health { state: State::RUNNING, published_from: u64::MAX, ..bytemuck::Zeroable::zeroed() };
        let json = Record::new(&Health::layout(), bytemuck::bytes_of(&health)).unwrap().json();
        assert_eq!((json["state"].as_str(), json["published_from"].as_u64()), (Some("running"), Some(u64::MAX)));
    }

    #[test]
    fn bytes_of_another_length_are_refused() {
        let refused = Record::new(&ImuSample::layout(), &[0; 111]).unwrap_err();
        assert!(refused.to_string().contains("111 bytes are no plumbline.ImuSample.1, which has 112"), "{refused}");
    }
}
