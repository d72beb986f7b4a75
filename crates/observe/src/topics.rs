//! Topics of a running system: rate, ports and layout.
//!
//! The ports, buffers and layout fingerprint of a remote vehicle are unknown. They are shown as
//! null in JSON and as `-` in text.

use std::fmt;

use bus::{Port, Ports};
use messages::{Field, Layout};
use serde_json::{Value, json};

use crate::flow::FlowReport;

/// Note on the values that are unknown for a remote vehicle.
pub const ONBOARD_ONLY_NOTE: &str = "publishers, subscribers and buffers are known on board only";

/// Description of a topic of a running system.
#[derive(Debug, Clone)]
pub struct TopicInfo {
    /// Name of the topic.
    pub name: String,
    /// Layout of the messages.
    pub layout: Layout,
    /// Publishers, subscribers and buffer size; `None` for a remote vehicle.
    pub ports: Option<Ports>,
    /// Rate and losses during the observation.
    pub flow: FlowReport,
}

impl TopicInfo {
    /// Returns the topic's row of the table.
    pub fn to_row(&self) -> String {
        let Self { name, layout, ports, flow } = self;
        let rate = flow.rate_hz.map_or("-".into(), |rate_hz| format!("{rate_hz:.1}"));
        let count = |field: fn(&Ports) -> usize| ports.as_ref().map_or("-".into(), |ports| field(ports).to_string());
        let (publishers, subscribers) = (count(|ports| ports.publishers.len()), count(|ports| ports.subscribers.len()));
        let buffer = count(|ports| ports.buffer);
        format!("{name:<12}{:<28}{publishers:>11}{subscribers:>12}{buffer:>7}{rate:>9}", layout.name)
    }

    /// Returns the header of the table.
    pub fn table_header() -> String {
        format!("{:<12}{:<28}{:>11}{:>12}{:>7}{:>9}", "topic", "type", "publishers", "subscribers", "buffer", "Hz")
    }

    /// Returns the topic as an entry of the JSON list.
    pub fn to_json(&self) -> Value {
        let Self { name, layout, ports, flow } = self;
        let ports_to_json = |ports: &[Port]| -> Vec<_> {
            ports.iter().map(|Port { name, pid, alive }| json!({ "name": name, "pid": pid, "alive": alive })).collect()
        };
        let ports = ports.as_ref();
        json!({
            "topic": name, "type": layout.name, "publishers": ports.map(|ports| ports_to_json(&ports.publishers)),
            "subscribers": ports.map(|ports| ports_to_json(&ports.subscribers)), "buffer": ports.map(|ports| ports.buffer),
            "rate_hz": flow.rate_hz,
        })
    }

    /// Returns the JSON entry with the layout added.
    pub fn to_json_with_layout(&self) -> Value {
        let mut info = self.to_json();
        let field = |Field { name, kind, offset, description, .. }: &Field, unit| json!({ "name": name, "type": kind, "offset": offset, "unit": unit, "meaning": description });
        info["size"] = self.layout.size.into();
        info["fingerprint"] = self.ports.as_ref().map(|_| format!("{:016x}", self.layout.fingerprint())).into();
        info["fields"] = self.layout.fields.iter().map(|each| field(each, each.unit())).collect();
        info
    }
}

fn port_list(ports: &[Port]) -> String {
    let entries = ports.iter().map(|port| {
        let suffix = if port.alive { "" } else { ", killed" };
        format!("{} ({}{suffix})", port.name, port.pid)
    });
    entries.collect::<Vec<_>>().join(", ")
}

/// Formats the full description, including the layout.
impl fmt::Display for TopicInfo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { name, layout, ports, flow } = self;
        let rate = flow.rate_hz.map_or("-".into(), |rate_hz| format!("{rate_hz:.1}"));
        if let Some(Ports { publishers, subscribers, buffer }) = ports {
            writeln!(f, "{name}: {}, {} bytes, fingerprint {:016x}", layout.name, layout.size, layout.fingerprint())?;
            writeln!(f, "publishers: {}; subscribers: {}", port_list(publishers), port_list(subscribers))?;
            writeln!(f, "buffer: {buffer} messages per subscriber; rate: {rate} Hz")?;
        } else {
            writeln!(f, "{name}: {}, {} bytes in this version of plumb", layout.name, layout.size)?;
            writeln!(f, "{ONBOARD_ONLY_NOTE}, like the fingerprint; received at {rate} Hz")?;
        }
        write!(f, "{:>8}  {:<20}{:<26}{:<8}meaning", "offset", "field", "type", "unit")?;
        for field in &layout.fields {
            let Field { name, kind, offset, description } = field;
            let unit = field.unit().unwrap_or("-");
            write!(f, "\n{offset:>8}  {name:<20}{kind:<26}{unit:<8}{description}")?;
        }
        Ok(())
    }
}
