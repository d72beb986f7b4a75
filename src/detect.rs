//! `plumb detect`: recognises the sensors and receivers on serial ports.

use std::{fmt, path::PathBuf, process::ExitCode, thread};

use clap::Args;
use drivers::detect::{DetectedDevice, Finding, MAX_PORT_TIME, PortFinding, detect, serial_ports};
use foreign::ForeignText;
use serde_json::json;

use crate::{
    failure::{Failure, Outcome},
    notice::notice,
    stdout::print,
};

/// Maximum number of ports that are read at the same time.
const MAX_PORTS: usize = 16;

/// Arguments of `plumb detect`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  plumb detect
  plumb detect /dev/ttyUSB0
  plumb detect --json

Reads each port at the usual baud rates for at most 11 s and tries all formats
of sensors and receivers. Nothing is sent to the devices. A port that a running
system reads is busy.

Exit codes: 0 device found, 1 no device found.")]
pub(crate) struct Detect {
    /// Serial ports [default: all USB and on-board ports]
    ports: Vec<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(Detect { ports, json }: Detect) -> Outcome {
    let mut ports = if ports.is_empty() { serial_ports() } else { ports };
    if ports.is_empty() {
        let message = "no serial port found; plug the device in and check `ls /dev/serial/by-id`, or name a port";
        return Err(Failure::new(message, 1));
    }
    if ports.len() > MAX_PORTS {
        supervisor::announce(format_args!("{} ports: only the first {MAX_PORTS} are read", ports.len()));
        ports.truncate(MAX_PORTS);
    }
    let number = if ports.len() == 1 { "1 port".into() } else { format!("{} ports", ports.len()) };
    notice(format_args!("reading {number} for at most {} s", MAX_PORT_TIME.as_secs()));
    let findings = Findings(thread::scope(|scope| {
        let readers: Vec<_> = ports.iter().map(|port| scope.spawn(|| detect(port))).collect();
        readers.into_iter().filter_map(|reader| reader.join().ok()).collect()
    }));
    let is_found = findings.0.iter().any(|port| matches!(port.finding, Finding::Device(_)));
    let printed = if json { print(&findings.to_json()) } else { print(&findings) };
    Ok(if is_found { printed } else { ExitCode::FAILURE })
}

struct Findings(Vec<PortFinding>);

impl Findings {
    fn to_json(&self) -> serde_json::Value {
        let ports = self.0.iter().map(|PortFinding { path, finding }| {
            let mut port = match finding {
                Finding::Device(device) => json!({
                    "found": "device", "format": device.format, "baud": device.baud, "rate_hz": device.rate_hz,
                    "sensors": device.sensors, "up_axis": device.up_axis, "notes": device.notes,
                    (if device.is_receiver { "receiver" } else { "source" }): device.line,
                }),
                Finding::Text { line, baud } => json!({ "found": "text", "line": line, "baud": baud }),
                Finding::Unknown { bytes } => json!({ "found": "unknown", "bytes": bytes }),
                Finding::Silent => json!({ "found": "silent" }),
                Finding::Failed { cause, remedy } => json!({ "found": "failed", "cause": cause, "remedy": remedy }),
            };
            port["port"] = path.to_string_lossy().into();
            port
        });
        json!({ "ports": ports.collect::<Vec<_>>() })
    }
}

impl fmt::Display for Findings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, PortFinding { path, finding }) in self.0.iter().enumerate() {
            if index > 0 {
                writeln!(f)?;
            }
            write!(f, "{}: ", foreign::path(path))?;
            match finding {
                Finding::Device(device) => write_device(f, device)?,
                Finding::Text { line, baud } => write!(
                    f,
                    "lines of unknown columns at {baud} baud, such as\n  {}\n  name the columns with --map, see docs/how-to/sensors.md",
                    ForeignText::from(&**line)
                )?,
                Finding::Unknown { bytes } => write!(
                    f,
                    "{bytes} bytes in no known format; check the output format of the device and unusual baud rates"
                )?,
                Finding::Silent => write!(f, "no data; check the power, wiring and settings of the device")?,
                Finding::Failed { cause, remedy } => write!(f, "{cause}; {remedy}")?,
            }
        }
        Ok(())
    }
}

fn write_device(f: &mut fmt::Formatter<'_>, device: &DetectedDevice) -> fmt::Result {
    let DetectedDevice { format, baud, rate_hz, sensors, up_axis, line, is_receiver, notes } = device;
    write!(f, "{format} at {baud} baud")?;
    if let Some(rate_hz) = rate_hz {
        write!(f, ", {rate_hz:.1} Hz")?;
    }
    write!(f, "; {}", sensors.join(", "))?;
    if let Some(axis) = up_axis {
        write!(f, "; sensor axis {axis} is up")?;
    }
    for note in notes {
        write!(f, "\n  {note}")?;
    }
    let option = if *is_receiver { "receiver" } else { "source" };
    write!(f, "\n  --{option} '{}'", ForeignText::from(&**line))
}
