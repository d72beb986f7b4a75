//! The messages as a C header.

use std::fmt::Write;

use messages::Layout;

use crate::{class_name, constants, flags, kind, plain, structs};

const HEAD: &str = r#"/*
 * Plumbline's messages. Written by `plumb stage header`; not to be edited.
 *
 * A topic is an iceoryx2 publish-subscribe service of the name PLUMBLINE_TOPIC_*. A payload is a slice of bytes (uint8_t) that holds
 * one struct; the attributes layout.0, layout.1, ... hold PLUMBLINE_LAYOUT_* in pieces. How a program joins a system: docs/own-stage.md.
 */
#ifndef PLUMBLINE_H
#define PLUMBLINE_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
#define PLUMBLINE_ASSERT(condition, text) static_assert(condition, text)
#else
#define PLUMBLINE_ASSERT(condition, text) _Static_assert(condition, text)
#endif

"#;

/// `plumbline.h`.
pub fn header() -> String {
    let mut text = HEAD.to_owned();
    for (about, names) in constants() {
        for (name, value) in names {
            line(&mut text, format_args!("#define PLUMBLINE_{about}_{name} {value}u"));
        }
        text.push('\n');
    }
    for (name, bit) in flags() {
        line(&mut text, format_args!("#define PLUMBLINE_FLAG_{name} (UINT64_C(1) << {bit})"));
    }
    structs().iter().for_each(|layout| payload(&mut text, layout));
    text + "\n#endif\n"
}

fn payload(text: &mut String, layout: &Layout) {
    let name = snake(class_name(layout));
    let constant = name.to_uppercase();
    line(text, format_args!("\n/* {} */", plain(layout.about)));
    if let Some(topic) = layout.topic {
        line(text, format_args!("#define PLUMBLINE_TOPIC_{constant} \"{topic}\""));
        line(text, format_args!("#define PLUMBLINE_LAYOUT_{constant} \\\n    \"{layout}\""));
    }
    line(text, format_args!("struct plumbline_{name} {{"));
    let own = &layout.fields[layout.header_fields..];
    if layout.header_fields > 0 {
        line(text, format_args!("    struct plumbline_header header;"));
    }
    for field in own {
        let kind = kind(field);
        let scalar = match kind.scalar {
            "f64" => "double".into(),
            scalar => format!("{}int{}_t", if scalar.starts_with('u') { "u" } else { "" }, &scalar[1..]),
        };
        let count = kind.count.map_or(String::new(), |count| format!("[{count}]"));
        line(text, format_args!("    /* {} */\n    {scalar} {}{count};", plain(field.about), field.name));
    }
    line(text, format_args!("}};"));
    let of = format!("struct plumbline_{name}");
    line(text, format_args!("PLUMBLINE_ASSERT(sizeof({of}) == {}, \"size of {name}\");", layout.size));
    for field in own {
        let (name, offset) = (field.name, field.offset);
        line(text, format_args!("PLUMBLINE_ASSERT(offsetof({of}, {name}) == {offset}, \"place of {name}\");"));
    }
}

fn line(text: &mut String, line: std::fmt::Arguments<'_>) {
    // A string takes every line.
    let _ = writeln!(text, "{line}");
}

/// `imu_sample` of `ImuSample`.
fn snake(name: &str) -> String {
    let mut snake = String::new();
    for letter in name.chars() {
        if letter.is_uppercase() && !snake.is_empty() {
            snake.push('_');
        }
        snake.extend(letter.to_lowercase());
    }
    snake
}
