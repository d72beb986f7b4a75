//! Chapters of `docs/reference` that are rendered from the program.
//!
//! If a chapter is stale, the test updates it and fails. If `CI` is set, it only fails.

use std::{collections::BTreeSet, env, fs};

use clap::Command;
use graph::{Presence, Topic};
use launch::Launch;
use messages::{Chart, CourseReference, Field, Flags, Header, Layout, State};
use score::catalogue::Catalogue;
use serde_json::Value;

use super::{launch_file, root};

/// Command that updates the chapters.
const UPDATE: &str = "cargo test --release --test system docs::reference";
/// Maximum width of a line outside of tables, columns.
const MAX_COLUMNS: usize = 100;

/// Returns the beginning of a chapter: the origin, the title and an introduction.
pub(super) fn chapter(title: &str, introduction: &str) -> String {
    format!("<!-- Generated from the program by `{UPDATE}`; do not edit. -->\n# {title}\n\n{}\n", wrap(introduction))
}

/// Wraps a text to [`MAX_COLUMNS`].
pub(super) fn wrap(text: &str) -> String {
    let (mut wrapped, mut columns) = (String::new(), 0);
    for word in text.split_whitespace() {
        let length = word.chars().count();
        let is_first = columns == 0;
        if !is_first && columns + 1 + length > MAX_COLUMNS {
            wrapped.push('\n');
            columns = 0;
        } else if !is_first {
            wrapped.push(' ');
            columns += 1;
        }
        wrapped += word;
        columns += length;
    }
    wrapped
}

/// Returns a Markdown table.
pub(super) fn table<const N: usize>(header: [&str; N], rows: impl IntoIterator<Item = [String; N]>) -> String {
    let line = |cells: &[String]| {
        let cells = cells.iter().map(|cell| cell.replace('|', "\\|")).collect::<Vec<_>>();
        // An empty cell has one space.
        format!("| {} |\n", cells.join(" | ")).replace("  ", " ")
    };
    let rows = rows.into_iter().map(|row| line(&row));
    [line(&header.map(Into::into)), line(&[(); N].map(|()| "---".into()))].into_iter().chain(rows).collect()
}

/// Returns `text` as inline code, or nothing for an empty text.
pub(super) fn code(text: &str) -> String {
    if text.is_empty() { String::new() } else { format!("`{text}`") }
}

/// Escapes the characters of a text that Markdown would interpret.
pub(super) fn plain(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ").replace('*', "\\*").replace('<', "\\<")
}

fn command_line() -> String {
    let mut command = plumbline::command_line().name("plumb").bin_name("plumb");
    command.build();
    let (mut rows, mut sections) = (Vec::new(), String::new());
    render_command(&mut command, "plumb", &mut rows, &mut sections);
    let introduction = "This chapter has the help text of every command, as printed with `--help`.";
    format!("{}\n{}{sections}", chapter("Command line", introduction), table(["command", "purpose"], rows))
}

/// Renders a command and its subcommands.
fn render_command(command: &mut Command, path: &str, rows: &mut Vec<[String; 2]>, sections: &mut String) {
    let about = command.get_about().map(ToString::to_string).unwrap_or_default();
    rows.push([format!("[{path}](#{})", path.replace(' ', "-")), about]);
    let help = command.render_long_help().to_string();
    let help: Vec<_> = help.trim_end().lines().map(wrap_help_line).collect();
    *sections += &format!("\n## {path}\n\n```text\n{}\n```\n", help.join("\n"));
    for subcommand in command.get_subcommands_mut() {
        let name = subcommand.get_name().to_owned();
        if !subcommand.is_hide_set() && name != "help" {
            render_command(subcommand, &format!("{path} {name}"), rows, sections);
        }
    }
}

/// Wraps a line of a help text to [`MAX_COLUMNS`], with the indentation of the description.
fn wrap_help_line(line: &str) -> String {
    let line = line.trim_end();
    let start = line.len() - line.trim_start().len();
    let gap = line[start..].find("  ").map(|gap| start + gap);
    let description = gap.map(|gap| gap + line[gap..].len() - line[gap..].trim_start().len());
    let indentation = description.filter(|column| *column < MAX_COLUMNS / 2).unwrap_or(start);
    let (first, rest) = line.split_at(indentation);
    let (mut wrapped, mut columns) = (first.to_owned(), indentation);
    for (index, word) in rest.split(' ').enumerate() {
        let length = word.chars().count() + usize::from(index > 0);
        if index > 0 && columns + length > MAX_COLUMNS {
            wrapped += &format!("\n{}{word}", " ".repeat(indentation));
            columns = indentation + length - 1;
        } else {
            wrapped += if index > 0 { " " } else { "" };
            wrapped += word;
            columns += length;
        }
    }
    wrapped
}

fn stages() -> String {
    let catalogue: Value = serde_json::from_str(&Catalogue::new(&Launch::default()).unwrap().json()).unwrap();
    let introduction = "This chapter lists the built-in stages of every slot with their parameters. \
        `plumb stage list` prints the same list, and adds your own stages. A parameter is set in the section \
        of the slot, such as `[fuser]`, by `set = { NAME = VALUE }`, or with `--set` of `plumb score` and \
        `plumb swap`. [Choosing a stage](choosing-a-stage.md) explains which stage to use.";
    let mut text = chapter("Stages and parameters", introduction);
    for slot in catalogue["slots"].as_array().unwrap() {
        let name = string(&slot["slot"]);
        text += &format!("\n## Slot {name}\n");
        for stage in slot["stages"].as_array().unwrap() {
            text += &format!("\n### {}\n\n", string(&stage["name"]));
            let parts: Vec<_> = stage["parts"].as_array().unwrap().iter().map(|part| code(string(part))).collect();
            let parameters = stage["parameters"].as_array().unwrap();
            let mut sentences = Vec::new();
            sentences.extend((stage["is_default"] == true).then(|| format!("Default stage of the slot `{name}`.")));
            sentences.extend((!parts.is_empty()).then(|| format!("Combines {}.", parts.join(" and "))));
            sentences.extend(parameters.is_empty().then(|| "No parameters.".into()));
            if !sentences.is_empty() {
                text += &format!("{}\n", sentences.join(" "));
            }
            if !parameters.is_empty() {
                let separator = if sentences.is_empty() { "" } else { "\n" };
                let header = ["parameter", "unit", "range", "default", "meaning"];
                text += &format!("{separator}{}", table(header, parameters.iter().map(parameter_row)));
            }
        }
    }
    text
}

fn parameter_row(parameter: &Value) -> [String; 5] {
    let [min, max, default] = ["min", "max", "default"].map(|name| parameter[name].as_f64().unwrap());
    let [name, unit, description] = ["name", "unit", "description"].map(|name| string(&parameter[name]));
    [code(name), unit.into(), format!("{min} to {max}"), default.to_string(), plain(description)]
}

fn string(value: &Value) -> &str {
    value.as_str().unwrap()
}

fn topics() -> String {
    let introduction = "This chapter lists the topics of a system and the fields of their messages. \
        `plumb topic list` and `plumb topic info` show them for a running system. Observers may subscribe to \
        every topic. The gateway sends the topics in [`[gateway.rates]`](launch-file.md#gatewayrates). Axes and \
        signs are in [Conventions](conventions.md).";
    let header_layout = Header::layout();
    let mut text = chapter("Topics", introduction);
    let rows = Topic::ALL.iter().map(|topic| {
        let entry = topic.entry();
        let subscribers: Vec<_> = entry.subscribers.iter().map(ToString::to_string).collect();
        let name = entry.name;
        let kind = code(messages::layout(*topic).name);
        [
            format!("[{name}](#{name})"),
            kind,
            entry.publisher.to_string(),
            subscribers.join(", "),
            presence(entry.presence),
        ]
    });
    text += &format!("\n{}", table(["topic", "type", "publisher", "subscribers", "messages"], rows));
    text += &format!("\n## Header\n\n{}\n", wrap(&plain(header_layout.description)));
    text += &format!("\n{}", fields(&header_layout.fields));
    for topic in Topic::ALL {
        let Layout { name, size, fields: all, description, header_fields, .. } = messages::layout(*topic);
        text += &format!("\n## {}\n\n{}\n\n", topic.name(), wrap(&plain(description)));
        let header = if header_fields > 0 { " It begins with the [header](#header)." } else { "" };
        text += &format!("Type {}, {size} bytes.{header}\n\n{}", code(name), fields(&all[header_fields..]));
    }
    text += "\n## Numbered values\n\n";
    let values = [
        ("Chart", names([Chart::UPRIGHT, Chart::INVERTED].map(|chart| (chart.0, chart.name())))),
        (
            "CourseReference",
            names(
                [CourseReference::ARBITRARY, CourseReference::MAGNETIC, CourseReference::TRUE]
                    .map(|reference| (reference.0, reference.name())),
            ),
        ),
        ("State", names([State::READY, State::RUNNING, State::FINISHED].map(|state| (state.0.into(), state.name())))),
    ];
    text += &table(["type", "values"], values.map(|(name, values)| [code(name), values]));
    text += "\n## Flags\n\nThe header carries these flags. Names are those in JSON and CSV output.\n\n";
    let rows = Flags::NAMES
        .iter()
        .zip(Flags::MEANINGS)
        .map(|((flag, name), meaning)| [code(name), flag.0.trailing_zeros().to_string(), plain(meaning)]);
    text + &table(["flag", "bit", "meaning"], rows)
}

fn names<const N: usize>(values: [(u64, &str); N]) -> String {
    values.map(|(value, name)| format!("{value} {name}")).join(", ")
}

fn presence(presence: Presence) -> String {
    match presence {
        Presence::EveryTick => "dense: every tick".into(),
        Presence::Flagged(flag) => format!("sparse: ticks with the flag `{}`", flag.to_lowercase().replace('_', "-")),
        Presence::NoTick => "not per tick".into(),
    }
}

fn fields(fields: &[Field]) -> String {
    let row = |field: &Field| {
        let Field { name, kind, description, .. } = field;
        [code(name), code(kind), field.unit().unwrap_or_default().into(), plain(description)]
    };
    table(["field", "type", "unit", "meaning"], fields.iter().map(row))
}

#[test]
fn generated_chapters_match_program() {
    let chapters = [
        ("cli.md", command_line()),
        ("launch-file.md", launch_file::chapter()),
        ("stages.md", stages()),
        ("topics.md", topics()),
    ];
    let mut stale = Vec::new();
    for (name, text) in chapters {
        let file = root().join("docs/reference").join(name);
        if fs::read_to_string(&file).ok().as_ref() != Some(&text) {
            if env::var_os("CI").is_none() {
                fs::write(&file, text).unwrap();
            }
            stale.push(file);
        }
    }
    assert!(stale.is_empty(), "chapters do not match the program: {stale:?}; run `{UPDATE}` without CI to update them");
}

#[test]
fn metrics_chapter_lists_every_metric() {
    let metrics = |file: &str| -> BTreeSet<String> {
        let text = fs::read_to_string(root().join(file)).unwrap();
        let words = text.split(|letter: char| !letter.is_ascii_alphanumeric() && letter != '_');
        words.filter(|word| word.starts_with("plumbline_")).map(str::to_owned).collect()
    };
    let exported = metrics("services/cockpit/src/metrics.rs");
    let listed = metrics("docs/reference/metrics.md");
    assert_eq!(exported.difference(&listed).collect::<Vec<_>>(), Vec::<&String>::new(), "missing in metrics.md");
    assert_eq!(listed.difference(&exported).collect::<Vec<_>>(), Vec::<&String>::new(), "unknown to the cockpit");
}

#[test]
fn long_lines_are_wrapped() {
    let word = "x".repeat(30);
    assert_eq!(wrap(&format!("{word} {word}\n {word} {word}")), format!("{word} {word} {word}\n{word}"));
    let line = format!("      --option  {word} {word} {word}");
    assert_eq!(wrap_help_line(&line), format!("      --option  {word} {word}\n                {word}"));
    assert_eq!(wrap_help_line("  plumb up  # x"), "  plumb up  # x");
}
