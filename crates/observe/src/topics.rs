//! Which topics there are, who is at them, and what their messages hold.

use std::fmt;

use bus::{Port, Ports};
use messages::{Field, Layout};
use serde_json::{Value, json};

use crate::flow::FlowReport;

/// A topic of a running system.
#[derive(Debug, Clone)]
pub struct Topic {
    /// Its name.
    pub name: String,
    /// What its messages hold.
    pub layout: Layout,
    /// Who is at it.
    pub ports: Ports,
    /// How it flowed for a while.
    pub flow: FlowReport,
}

impl Topic {
    /// The line of a list.
    pub fn line(&self) -> String {
        let Self { name, layout, ports: Ports { publishers, subscribers, buffer }, flow } = self;
        let rate = flow.rate_hz.map_or("-".into(), |rate_hz| format!("{rate_hz:.1}"));
        let (publishers, subscribers) = (publishers.len(), subscribers.len());
        format!("{name:<12}{:<30}{publishers:>11}{subscribers:>12}{buffer:>8}{rate:>10}", layout.name)
    }

    /// The head of a list.
    pub fn head() -> String {
        format!("{:<12}{:<30}{:>11}{:>12}{:>8}{:>10}", "topic", "type", "publishers", "subscribers", "buffer", "Hz")
    }

    /// For scripts: the entry of a list.
    pub fn json(&self) -> Value {
        let Self { name, layout, ports, flow } = self;
        let who = |ports: &[Port]| -> Vec<_> {
            ports.iter().map(|Port { name, pid, alive }| json!({ "name": name, "pid": pid, "alive": alive })).collect()
        };
        json!({
            "topic": name, "type": layout.name, "publishers": who(&ports.publishers), "subscribers": who(&ports.subscribers),
            "buffer": ports.buffer, "rate_hz": flow.rate_hz,
        })
    }

    /// The same with the layout.
    pub fn info_json(&self) -> Value {
        let mut info = self.json();
        let field = |Field { name, kind, offset, about, .. }: &Field, unit| json!({ "name": name, "type": kind, "offset": offset, "unit": unit, "meaning": about });
        info["size"] = self.layout.size.into();
        info["fingerprint"] = format!("{:016x}", self.layout.fingerprint()).into();
        info["fields"] = self.layout.fields.iter().map(|it| field(it, it.unit())).collect();
        info
    }
}

/// All of it, for people.
impl fmt::Display for Topic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { name, layout, ports: Ports { publishers, subscribers, buffer }, flow } = self;
        writeln!(f, "{name}: {}, {} bytes, fingerprint {:016x}", layout.name, layout.size, layout.fingerprint())?;
        let who = |ports: &[Port]| {
            let each = ports.iter().map(|port| {
                let killed = if port.alive { "" } else { ", killed" };
                format!("{} ({}{killed})", port.name, port.pid)
            });
            each.collect::<Vec<_>>().join(", ")
        };
        let rate = flow.rate_hz.map_or("-".into(), |rate_hz| format!("{rate_hz:.1}"));
        writeln!(f, "published by {}; read by {}", who(publishers), who(subscribers))?;
        writeln!(f, "each reader holds {buffer} messages; {rate} Hz")?;
        write!(f, "{:>8}  {:<20}{:<26}{:<8}meaning", "offset", "field", "type", "unit")?;
        for field in &layout.fields {
            let Field { name, kind, offset, about } = field;
            let unit = field.unit().unwrap_or("-");
            write!(f, "\n{offset:>8}  {name:<20}{kind:<26}{unit:<8}{about}")?;
        }
        Ok(())
    }
}
