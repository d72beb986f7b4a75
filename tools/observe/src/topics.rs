//! Which topics there are, who is at them, and what their messages hold.
//!
//! From elsewhere it is not known who is at a topic, how much its readers hold, or which layout it has on board: JSON says null, text `-`.

use std::fmt;

use bus::{Port, Ports};
use messages::{Field, Layout};
use serde_json::{Value, json};

use crate::flow::FlowReport;

/// What is told people who are not on board.
pub const ELSEWHERE: &str = "publishers, readers and buffers are known on board only";

/// A topic of a running system.
#[derive(Debug, Clone)]
pub struct Topic {
    /// Its name.
    pub name: String,
    /// What its messages hold.
    pub layout: Layout,
    /// Who is at it; `None` from elsewhere.
    pub ports: Option<Ports>,
    /// How it flowed for a while.
    pub flow: FlowReport,
}

impl Topic {
    /// The line of a list.
    pub fn line(&self) -> String {
        let Self { name, layout, ports, flow } = self;
        let rate = flow.rate_hz.map_or("-".into(), |rate_hz| format!("{rate_hz:.1}"));
        let count = |of: fn(&Ports) -> usize| ports.as_ref().map_or("-".into(), |ports| of(ports).to_string());
        let (publishers, subscribers) = (count(|ports| ports.publishers.len()), count(|ports| ports.subscribers.len()));
        let buffer = count(|ports| ports.buffer);
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
        let ports = ports.as_ref();
        json!({
            "topic": name, "type": layout.name, "publishers": ports.map(|ports| who(&ports.publishers)),
            "subscribers": ports.map(|ports| who(&ports.subscribers)), "buffer": ports.map(|ports| ports.buffer),
            "rate_hz": flow.rate_hz,
        })
    }

    /// The same with the layout.
    pub fn info_json(&self) -> Value {
        let mut info = self.json();
        let field = |Field { name, kind, offset, description: about, .. }: &Field, unit| json!({ "name": name, "type": kind, "offset": offset, "unit": unit, "meaning": about });
        info["size"] = self.layout.size.into();
        info["fingerprint"] = self.ports.as_ref().map(|_| format!("{:016x}", self.layout.fingerprint())).into();
        info["fields"] = self.layout.fields.iter().map(|it| field(it, it.unit())).collect();
        info
    }
}

fn names(ports: &[Port]) -> String {
    let each = ports.iter().map(|port| {
        let killed = if port.alive { "" } else { ", killed" };
        format!("{} ({}{killed})", port.name, port.pid)
    });
    each.collect::<Vec<_>>().join(", ")
}

/// All of it, for people.
impl fmt::Display for Topic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { name, layout, ports, flow } = self;
        let rate = flow.rate_hz.map_or("-".into(), |rate_hz| format!("{rate_hz:.1}"));
        if let Some(Ports { publishers, subscribers, buffer }) = ports {
            writeln!(f, "{name}: {}, {} bytes, fingerprint {:016x}", layout.name, layout.size, layout.fingerprint())?;
            writeln!(f, "published by {}; read by {}", names(publishers), names(subscribers))?;
            writeln!(f, "each reader holds {buffer} messages; {rate} Hz")?;
        } else {
            writeln!(f, "{name}: {}, {} bytes as this program has it", layout.name, layout.size)?;
            writeln!(f, "{ELSEWHERE}, and so is the fingerprint; {rate} Hz arrive")?;
        }
        write!(f, "{:>8}  {:<20}{:<26}{:<8}meaning", "offset", "field", "type", "unit")?;
        for field in &layout.fields {
            let Field { name, kind, offset, description: about } = field;
            let unit = field.unit().unwrap_or("-");
            write!(f, "\n{offset:>8}  {name:<20}{kind:<26}{unit:<8}{about}")?;
        }
        Ok(())
    }
}
