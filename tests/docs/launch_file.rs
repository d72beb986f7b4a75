//! Chapter on the launch file. It lists the keys, defaults and comments of `launch.toml`, and the
//! allowed values that the launch crate reports when a value is invalid.

use launch::Launch;

use super::reference::{self, code, plain, table, wrap};

/// Built-in launch file. Its comments describe the keys.
const BUILT_IN: &str = include_str!("../../launch.toml");
/// Key that no section has.
const UNKNOWN: &str = "__";
/// Settings that make further keys valid in a section. They are tried one at a time.
const CONTEXTS: &[&str] = &[
    "",
    "format = \"witmotion\"",
    "format = \"xsens\"",
    "endpoint = \"serial:/dev/ttyACM0\"",
    "slot = \"fuser\"\ncommand = [\"program\"]",
    "sensor = \"gyro\"\nkind = \"garbage\"",
    "sensor = \"gyro\"\nkind = \"miscalibrated\"",
    "sensor = \"gyro\"\nkind = \"slow\"",
    "sensor = \"gyro\"\nkind = \"delayed\"",
    "sensor = \"gyro\"\nkind = \"intermittent\"",
];
/// Values of each type that are not allowed for any key.
const INVALID: &[(&str, &str)] = &[
    ("a number", "1e300"),
    ("an integer", "-9000000000000000000"),
    ("a string", "\"\\u0001\""),
    ("a string", "\"\""),
    ("an array", "[\"\\u0001\"]"),
    ("an array of strings", "[\"\\u0001\"]"),
];

/// Meanings of keys without a comment in `launch.toml`, by key or by section and key.
const MEANINGS: &[(&str, &str)] = &[
    ("restart.backoff_max_s", "longest pause"),
    ("set", "parameters of the stage that differ from their defaults"),
    ("cert", "file with the certificate, PEM"),
    ("key", "file with the private key, PEM"),
    ("gateway.tls.ca", "file with the certificate of the authority, PEM"),
    ("gateway.export", "topics sent to the slots of other hosts, every tick"),
    ("gateway.cache_s", "time for which exported ticks are kept for a disconnected host"),
    ("gateway.import.vehicle", "vehicle name of the other host's gateway"),
    ("gateway.import.topics", "topics received from the other host"),
    ("ingest.sim.rate_hz", "samples a second"),
    ("ingest.sim.seed", "seed of the noise; the same seed gives the same samples"),
    ("ingest.replay.file", "recording; `--replay` overrides it"),
    ("units", "units of CSV columns; without it SI units"),
    ("frame", "axes of CSV columns: `rfu` (default), `flu`, `frd`"),
    ("columns", "names of CSV columns in order, for lines without a header"),
    ("time_bits", "width of the CSV time counter, bits; without it the time does not wrap"),
    ("range_g", "format `witmotion`: measuring range of the accelerometer, g"),
    ("range_deg_s", "format `witmotion`: measuring range of the gyro, °/s"),
    ("field_unit_ut", "formats `witmotion` and `xsens`: µT per unit of the magnetometer"),
    ("ingest.iio.root", "folder of the devices in sysfs"),
    ("ingest.iio.dev", "folder of the character devices"),
    ("ingest.limits.force_max_g", "specific forces at or beyond it are flagged as clipped"),
    ("ingest.calibration.gyro.bias", "rad/s"),
    ("ingest.calibration.mag.bias", "µT"),
    ("misalignment", "matrix that is multiplied with the scale"),
    ("ingest.mounting.matrix", "rotation from sensor axes to body axes, instead of `axes`"),
    ("matrix", "calibration matrix, instead of `scale` and `misalignment`"),
    ("ingest.mounting.quaternion", "rotation from sensor axes to body axes, w x y z, instead of `axes`"),
    ("ingest.mounting.yaw_deg", "attitude of the sensor in the body, instead of `axes`: yaw"),
    ("ingest.mounting.pitch_deg", "pitch"),
    ("ingest.mounting.roll_deg", "roll"),
    ("ingest.fault.until_s", "end of the fault, exclusive"),
    ("ingest.fault.seed", "kinds `garbage` and `intermittent`: seed of the random values"),
    ("ingest.fault.factor", "kind `miscalibrated`: factor"),
    ("ingest.fault.offset", "kind `miscalibrated`: offset in the sensor's units"),
    ("ingest.fault.every", "kind `slow`: only each n-th value is output"),
    ("ingest.fault.delay_s", "kind `delayed`: delay"),
    ("ingest.fault.share", "kind `intermittent`: share of the values that are output"),
    ("watch.slot", "slot of the shadow stage; at most one rule per slot"),
    ("watch.stage", "shadow stage"),
    ("course.position.latitude_deg", "geodetic latitude, north positive"),
    ("course.position.longitude_deg", "longitude, east positive"),
    ("course.position.altitude_m", "altitude"),
    ("stages.my-fuser.slot", "slot of the stage"),
];

/// Section of the launch file.
struct Section {
    /// Path, such as `ingest.sim`; empty for the top level.
    path: String,
    is_array: bool,
    introduction: Vec<String>,
    keys: Vec<Key>,
}

#[derive(Clone, Default)]
struct Key {
    name: String,
    /// Default value; `None` if the key is not set by default.
    default: Option<String>,
    /// Values in lines that are commented out.
    examples: Vec<String>,
    comment: String,
}

/// Renders the chapter.
pub(super) fn chapter() -> String {
    let introduction = "This chapter lists every key of `launch.toml`. All keys are optional: the defaults are those of \
        the built-in file. `plumb config check` reports each invalid key with its line.";
    let mut text = reference::chapter("Launch file", introduction);
    text += "\n    plumb config check launch.toml\n";
    let mut sections = parse(BUILT_IN);
    add_schema(&mut sections, "", false);
    describe(&mut sections);
    for section in &sections {
        let Section { path, is_array, introduction, keys } = section;
        if keys.is_empty() {
            continue;
        }
        let title = display_path(path);
        text += &match (path.as_str(), is_array) {
            ("", _) => "\n## Top level\n".into(),
            (_, true) => format!("\n## [[{title}]]\n"),
            (_, false) => format!("\n## [{title}]\n"),
        };
        for paragraph in introduction {
            text += &format!("\n{}\n", wrap(&with_links(&plain(&sentence(paragraph)))));
        }
        let rows = keys.iter().map(|key| row(section, key));
        text += &format!("\n{}", table(["key", "default", "allowed", "meaning"], rows));
    }
    text
}

fn row(section: &Section, key: &Key) -> [String; 4] {
    let examples: Vec<_> =
        key.examples.iter().filter(|example| *example != "\"\"").map(|example| code(example)).collect();
    let allowed = allowed_values(section, &key.name);
    // Some comments only list the allowed values.
    let is_list = key.comment.split(", ").all(|part| allowed.contains(&code(part)));
    let mut meaning = vec![if is_list { String::new() } else { with_links(&plain(&key.comment)) }];
    if !examples.is_empty() {
        meaning.push(format!("example: {}", examples.join(", ")));
    }
    meaning.retain(|part| !part.is_empty());
    let default = match &key.default {
        Some(default) => code(default),
        None if section.path == "gateway.rates" => code("\"off\""),
        None => "not set".into(),
    };
    [code(&key.name), default, allowed, meaning.join("; ")]
}

/// Reads the sections and keys of a launch file, including those in comments.
fn parse(text: &str) -> Vec<Section> {
    let section =
        |path: &str, is_array, introduction| Section { path: path.into(), is_array, introduction, keys: Vec::new() };
    let mut sections = vec![section("", false, Vec::new())];
    let mut remarks = Vec::new();
    for line in text.lines() {
        let (is_comment, content) = match line.strip_prefix('#') {
            Some(content) => (true, content.strip_prefix(' ').unwrap_or(content)),
            None => (false, line),
        };
        let (content, comment) = split_comment(content);
        let last = sections.last_mut().unwrap();
        if line.is_empty() {
            // A remark before an empty line belongs to the section before it.
            last.introduction.append(&mut remarks);
        } else if content.trim().is_empty() {
            // This line continues the comment of the previous key.
            let key = last.keys.last_mut().unwrap();
            key.comment = format!("{} {comment}", key.comment);
        } else if let Some(header) = content.strip_prefix('[') {
            remarks.extend(Some(comment.to_owned()).filter(|comment| !comment.is_empty()));
            let path = header.trim_end().trim_matches(['[', ']']);
            sections.push(section(path, header.starts_with('['), std::mem::take(&mut remarks)));
        } else if let Some((name, value)) = content.split_once(" = ").filter(|(name, _)| is_key(name)) {
            last.add_line(name, value.trim(), is_comment, comment);
        } else {
            remarks.push(content.to_owned());
        }
    }
    sections
}

fn is_key(name: &str) -> bool {
    name.chars().all(|letter| letter.is_ascii_lowercase() || letter.is_ascii_digit() || letter == '_')
}

/// Splits a line at the `#` of its comment.
fn split_comment(line: &str) -> (&str, &str) {
    let mut is_quoted = false;
    let start = line.char_indices().find(|(_, letter)| {
        is_quoted ^= *letter == '"';
        *letter == '#' && !is_quoted
    });
    start.map_or((line, ""), |(start, _)| (&line[..start], line[start + 1..].trim()))
}

impl Section {
    /// Adds a line `name = value`. Several examples of a key are combined.
    fn add_line(&mut self, name: &str, value: &str, is_example: bool, comment: &str) {
        let (default, example) = if is_example { (None, Some(value.into())) } else { (Some(value.into()), None) };
        if let Some(key) = self.keys.iter_mut().find(|key| key.name == name) {
            key.examples.extend(example);
            key.comment = [key.comment.as_str(), comment]
                .into_iter()
                .filter(|text| !text.is_empty())
                .collect::<Vec<_>>()
                .join("; ");
        } else {
            let examples = example.into_iter().collect();
            self.keys.push(Key { name: name.into(), default, examples, comment: comment.into() });
        }
    }

    fn header(&self) -> String {
        match (self.path.as_str(), self.is_array) {
            ("", _) => String::new(),
            (path, true) => format!("[[{path}]]"),
            (path, false) => format!("[{path}]"),
        }
    }

    /// Parses the section with these lines once in each context and returns the reported problems.
    fn problems(&self, lines: &str) -> impl Iterator<Item = String> {
        let header = self.header();
        CONTEXTS.iter().filter_map(move |context| {
            let text = format!("{header}\n{context}\n{lines}\n");
            Launch::parse("launch.toml", &text).err().map(|problems| problems.to_string())
        })
    }

    /// Returns the names of all keys and subsections.
    fn known_keys(&self) -> Vec<String> {
        let mut known: Vec<String> = Vec::new();
        for problems in self.problems(&format!("{UNKNOWN} = 1")) {
            let note = problems
                .split_once(&format!("unknown key {UNKNOWN:?}"))
                .and_then(|(_, rest)| rest.split_once("allowed: "));
            let names = note.and_then(|(_, names)| names.lines().next()).unwrap_or_default();
            let names = names.split(", ").map(|name| name.trim_matches('"').to_owned());
            for name in names.filter(|name| !name.is_empty()) {
                if !known.contains(&name) {
                    known.push(name);
                }
            }
        }
        known
    }

    /// Returns the values that the launch crate expects for a key, as reported for an invalid
    /// `value`.
    fn expected(&self, key: &str, value: &str) -> Option<String> {
        let full_key = if self.path.is_empty() { key.into() } else { format!("{}.{key}", self.path) };
        let found = |problems: String| {
            let (_, problem) = problems.split_once(&format!("error: {full_key}: "))?;
            let line = problem.lines().next()?;
            if line.starts_with("unknown value") {
                let (_, names) = problem.split_once("allowed: ")?;
                return Some(names.lines().next()?.split(", ").map(code).collect::<Vec<_>>().join(", "));
            }
            let expected = line.strip_prefix("expected ")?;
            Some(plain(expected.rsplit_once(", found ").map_or(expected, |(expected, _)| expected)))
        };
        self.problems(&format!("{key} = {value}")).find_map(found)
    }
}

/// Returns the values that are allowed for a key.
fn allowed_values(section: &Section, key: &str) -> String {
    match (section.path.as_str(), key) {
        (_, "set") => return "table of [parameters](stages.md)".into(),
        ("watch", "stage") => return "[stage](stages.md) of the slot".into(),
        _ => {}
    }
    // No key accepts a date with a time, so the problem states the expected type.
    let kind = section.expected(key, "1979-05-27T07:32:00").unwrap_or_default();
    let invalid = INVALID.iter().filter(|(name, _)| *name == kind);
    let values = invalid.filter_map(|(_, value)| section.expected(key, value)).next();
    match (kind.as_str(), values) {
        ("an integer", Some(range)) => range.replace(&format!("to {}", i64::MAX), "or more"),
        ("an array", Some(values)) => format!("array of {values}"),
        ("a table", _) => {
            let path = if section.path.is_empty() { key.into() } else { format!("{}.{key}", section.path) };
            format!("[table](#{})", path.replace('.', ""))
        }
        ("true or false", _) => format!("{}, {}", code("true"), code("false")),
        (_, Some(values)) => values,
        (kind, None) => kind.trim_start_matches("a ").trim_start_matches("an ").into(),
    }
}

/// Adds the keys and sections of the schema that `launch.toml` does not mention.
fn add_schema(sections: &mut Vec<Section>, path: &str, is_array: bool) {
    let index = match sections.iter().position(|section| section.path == path) {
        Some(index) => index,
        None => {
            let parent = path.rsplit_once('.').map_or("", |(parent, _)| parent);
            let is_within = |section: &Section| {
                section.path == parent || section.path.strip_prefix(parent).is_some_and(|rest| rest.starts_with('.'))
            };
            let first_child = sections.iter().position(|section| section.path.starts_with(&format!("{path}.")));
            let after_parent = || sections.iter().rposition(is_within).map_or(sections.len(), |index| index + 1);
            let index = first_child.unwrap_or_else(after_parent);
            sections.insert(index, Section { path: path.into(), is_array, introduction: Vec::new(), keys: Vec::new() });
            index
        }
    };
    let known = sections[index].known_keys();
    let undocumented = |key: &Key| !known.contains(&key.name);
    let unknown: Vec<_> =
        sections[index].keys.iter().filter(|key| undocumented(key)).map(|key| key.name.clone()).collect();
    assert!(unknown.is_empty(), "launch.toml describes keys of [{path}] that do not exist: {unknown:?}");
    for name in known {
        let section = &sections[index];
        let child = if path.is_empty() { name.clone() } else { format!("{path}.{name}") };
        let kind = section.expected(&name, "1979-05-27T07:32:00").unwrap_or_default();
        let is_listed = section.keys.iter().any(|key| key.name == name);
        match kind.as_str() {
            "a table" if name == "stages" => add_schema(sections, "stages.my-fuser", false),
            "a table" | "an array of tables" if name != "set" => add_schema(sections, &child, kind != "a table"),
            _ if !is_listed => sections[index].keys.push(Key { name, ..Key::default() }),
            _ => {}
        }
    }
}

/// Adds the meanings of keys without a comment.
fn describe(sections: &mut [Section]) {
    let mut missing = Vec::new();
    let mut described: Vec<Key> = Vec::new();
    for Section { path, keys, .. } in sections.iter_mut().filter(|section| section.path != "gateway.rates") {
        for key in keys {
            let full_key = if path.is_empty() { key.name.clone() } else { format!("{path}.{}", key.name) };
            let parameter = scenario::PARAMETERS.iter().find(|parameter| parameter.name == key.name);
            if let Some(parameter) = parameter.filter(|_| path == "ingest.sim") {
                key.comment = format!("{}; replaces that of the scenario", parameter.description);
            } else if key.comment.is_empty() {
                let listed =
                    [&full_key, &key.name].into_iter().find_map(|name| MEANINGS.iter().find(|(key, _)| key == name));
                let same = described.iter().find(|other| other.name == key.name).map(|key| key.comment.as_str());
                key.comment = listed.map(|(_, meaning)| *meaning).or(same).unwrap_or_default().to_owned();
            }
            if key.comment.is_empty() {
                missing.push(full_key);
            } else {
                described.push(key.clone());
            }
        }
    }
    assert!(missing.is_empty(), "describe in launch.toml or in MEANINGS: {missing:#?}");
}

/// Returns a remark as a sentence.
fn sentence(remark: &str) -> String {
    let mut letters = remark.chars();
    let first: String = letters.next().into_iter().flat_map(char::to_uppercase).collect();
    format!("{first}{}{}", letters.as_str(), if remark.ends_with('.') { "" } else { "." })
}

/// Returns the path of a section, with a placeholder for the name of a user-defined stage.
fn display_path(path: &str) -> String {
    path.strip_prefix("stages.").map_or_else(|| path.into(), |_| "stages.NAME".into())
}

/// Replaces names of chapters by links.
fn with_links(text: &str) -> String {
    let link = |word: &str| {
        let end = word.find(".md").map_or(0, |start| start + ".md".len());
        let (path, rest) = word.split_at(end);
        path.strip_prefix("docs/").map_or_else(|| word.to_owned(), |path| format!("[{path}](../{path}){rest}"))
    };
    text.split(' ').map(link).collect::<Vec<_>>().join(" ")
}

#[test]
fn launch_file_comments_are_parsed() {
    let text = "# All.\n\na = 1 # x, # y\n    # z\n#b = \"#\" # w\n\n# Of c.\n#[[c.d]] # v\n#e = 2\n#e = 3 # u\n";
    let sections = parse(text);
    let shown = |section: &Section| {
        let keys = section.keys.iter().map(|Key { name, default, examples, comment }| {
            format!("{name} {} {examples:?} {comment}", default.as_deref().unwrap_or("-"))
        });
        format!("{} {:?} {:?}", section.header(), section.introduction, keys.collect::<Vec<_>>())
    };
    assert_eq!(shown(&sections[0]), r##" ["All."] ["a 1 [] x, # y z", "b - [\"\\\"#\\\"\"] w"]"##);
    assert_eq!(shown(&sections[1]), r#"[[c.d]] ["Of c.", "v"] ["e - [\"2\", \"3\"] u"]"#);
}
