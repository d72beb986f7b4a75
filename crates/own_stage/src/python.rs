//! The messages as `ctypes`, and the package that runs a stage.

use std::fmt::Write;

use messages::Layout;

use crate::{class_name, constants, flags, kind, plain, structs};

/// The package `plumbline`: file names and what they hold.
pub fn package() -> Vec<(&'static str, String)> {
    let mut files: Vec<_> = WRITTEN.iter().map(|(name, text)| (*name, (*text).to_owned())).collect();
    files.push(("messages.py", messages()));
    files
}

macro_rules! written {
    ($($name:literal),*) => { &[$(($name, include_str!(concat!("../python/plumbline/", $name)))),*] };
}

const WRITTEN: &[(&str, &str)] = written!(
    "__init__.py",
    "attitude.py",
    "bus.py",
    "fuser.py",
    "rules.py",
    "service.py",
    "slots.py",
    "stage.py",
    "state.py",
    "trial.py",
    "values.py"
);

const HEAD: &str = r#""""The payloads of Plumbline's topics. Written by `plumb stage header --lang python`; not to be edited."""

import ctypes

"#;

/// `messages.py`.
pub fn messages() -> String {
    let mut text = HEAD.to_owned();
    let names = |names: Vec<String>| names.join(", ");
    let quoted = |names: &[&str]| names.iter().map(|name| format!("\"{name}\"")).collect();
    line(&mut text, format_args!("CHECKPOINT_WORDS = {}", messages::CHECKPOINT_WORDS));
    line(
        &mut text,
        format_args!("# In the order of their wake words.\nTOPICS = ({})", names(quoted(messages::TOPICS))),
    );
    let services = launch::Service::PATH.map(launch::Service::name);
    line(&mut text, format_args!("# In the order of the field `service`.\nSLOTS = ({})", names(quoted(&services))));
    for (about, names) in constants().into_iter().filter(|(about, _)| *about != "SERVICE") {
        for (name, value) in names {
            line(&mut text, format_args!("{about}_{name} = {value}"));
        }
    }
    line(
        &mut text,
        format_args!(
            "\n\nclass Flag:\n    \"\"\"Fault is data: what a message says about how far it can be trusted.\"\"\"\n"
        ),
    );
    for (name, bit) in flags() {
        line(&mut text, format_args!("    {name} = 1 << {bit}"));
    }
    let structs = structs();
    structs.iter().for_each(|layout| class(&mut text, layout));
    let topics = structs.iter().filter(|layout| layout.topic.is_some()).map(|layout| class_name(layout).to_owned());
    line(&mut text, format_args!("\n\nMESSAGES = ({})", names(topics.collect())));
    text
}

fn class(text: &mut String, layout: &Layout) {
    let name = class_name(layout);
    line(text, format_args!("\n\nclass {name}(ctypes.Structure):\n    \"\"\"{}\"\"\"\n", plain(layout.about)));
    if let Some(topic) = layout.topic {
        line(text, format_args!("    TOPIC = \"{topic}\"\n    LAYOUT = \"{layout}\""));
    }
    line(text, format_args!("    _fields_ = ["));
    if layout.header_fields > 0 {
        line(text, format_args!("        (\"header\", Header),"));
    }
    for field in &layout.fields[layout.header_fields..] {
        let kind = kind(field);
        let scalar = match kind.scalar {
            "f64" => "c_double".into(),
            scalar => format!("c_{}int{}", if scalar.starts_with('u') { "u" } else { "" }, &scalar[1..]),
        };
        let count = kind.count.map_or(String::new(), |count| format!(" * {count}"));
        line(text, format_args!("        # {}", plain(field.about)));
        line(text, format_args!("        (\"{}\", ctypes.{scalar}{count}),", field.name));
    }
    line(text, format_args!("    ]"));
    if layout.topic.is_some() {
        line(text, format_args!("\n    @staticmethod\n    def type_name():\n        return \"{}\"", layout.name));
    }
}

fn line(text: &mut String, line: std::fmt::Arguments<'_>) {
    // A string takes every line.
    let _ = writeln!(text, "{line}");
}
