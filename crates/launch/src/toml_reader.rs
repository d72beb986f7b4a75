//! Reading of TOML tables key by key. Valid values replace defaults, invalid ones become problems.
//!
//! To describe the keys, the same code visits every section and records the keys instead of reading
//! values.

use crate::{
    description::{Key, KeyDescription, SectionDescription},
    problem::Problem,
};
use std::{
    ops::Range,
    path::{Path, PathBuf},
};
use toml::{
    Spanned,
    de::{DeInteger, DeTable, DeValue},
};

/// File being read, and the results so far.
struct File<'t> {
    root: &'t DeTable<'t>,
    folder: Option<&'t Path>,
    problems: Vec<Problem>,
    visits: Vec<Visit<'t>>,
    /// Descriptions, if keys are described instead of read.
    descriptions: Option<Vec<SectionDescription>>,
}

/// Table that has been read.
struct Visit<'t> {
    path: String,
    table: &'t DeTable<'t>,
    known: Vec<&'t str>,
}

/// TOML table being read.
pub(crate) struct Section<'t, 'f> {
    table: &'t DeTable<'t>,
    file: &'f mut File<'t>,
    /// Index of this table in `File::visits`.
    visit: usize,
    invalid: Vec<&'static str>,
    /// Condition under which the keys being described are allowed, such as `kind = "slow"`.
    condition: Option<String>,
}

/// Description of the values of a key.
#[derive(Default)]
pub(crate) struct Values {
    /// Allowed values in words.
    pub(crate) allowed: String,
    /// Default in TOML, `None` if the key is not set by default.
    pub(crate) default: Option<String>,
    /// Allowed names with their meanings.
    pub(crate) names: Vec<(String, String)>,
}

impl Values {
    pub(crate) fn new(allowed: impl Into<String>, default: Option<String>) -> Self {
        Self { allowed: allowed.into(), default, names: Vec::new() }
    }
}

/// Reads a file and returns its problems. Paths in the file are relative to `folder`.
pub(crate) fn read_root<'t>(
    root: &'t DeTable<'t>,
    folder: Option<&'t Path>,
    read: impl FnOnce(&mut Section<'t, '_>),
) -> Vec<Problem> {
    let mut file = File { root, folder, problems: Vec::new(), visits: Vec::new(), descriptions: None };
    file.read_table(String::new(), root, read);
    file.reject_unknown_keys();
    file.problems
}

/// Describes all keys that `read` would read. `empty` is an empty table.
pub(crate) fn describe<'t>(empty: &'t DeTable<'t>, read: impl FnOnce(&mut Section<'t, '_>)) -> Vec<SectionDescription> {
    let mut file =
        File { root: empty, folder: None, problems: Vec::new(), visits: Vec::new(), descriptions: Some(Vec::new()) };
    file.describe_section("", false, false, "");
    file.read_table(String::new(), empty, read);
    file.descriptions.unwrap_or_default()
}

impl<'t> File<'t> {
    fn read_table(&mut self, path: String, table: &'t DeTable<'t>, read: impl FnOnce(&mut Section<'t, '_>)) {
        let same = |visit: &Visit<'_>| std::ptr::eq(visit.table, table) && visit.path == path;
        let visit = self.visits.iter().position(same).unwrap_or(self.visits.len());
        if visit == self.visits.len() {
            self.visits.push(Visit { path, table, known: Vec::new() });
        }
        read(&mut Section { table, file: self, visit, invalid: Vec::new(), condition: None });
    }

    fn describe_section(&mut self, path: &str, is_array: bool, is_optional: bool, doc: &str) {
        if let Some(sections) = &mut self.descriptions
            && sections.iter().all(|section| section.path != path)
        {
            let keys = Vec::new();
            sections.push(SectionDescription { path: path.into(), is_array, is_optional, doc: words(doc), keys });
        }
    }

    fn reject_unknown_keys(&mut self) {
        for Visit { path, table, known } in &self.visits {
            for key in table.keys().filter(|key| !known.contains(&key.get_ref().as_ref())) {
                let name = key.get_ref();
                let title = if path.is_empty() {
                    format!("unknown key {name:?}")
                } else {
                    format!("unknown key {name:?} in [{path}]")
                };
                self.problems.push(Problem::unknown(key.span(), title, name, known));
            }
        }
    }
}

impl<'t> Section<'t, '_> {
    /// Reads a nested table.
    pub(crate) fn section(&mut self, key: Key, read: impl FnOnce(&mut Section<'t, '_>)) {
        let path = self.full_key(key.name);
        if self.is_description() {
            self.file.describe_section(&path, false, false, key.doc);
            return self.file.read_table(path, self.table, read);
        }
        let Some(value) = self.get(key.name) else { return };
        match value.get_ref() {
            DeValue::Table(table) => self.file.read_table(path, table, read),
            _ => self.reject_type(key.name, value, "a table"),
        }
    }

    /// Reads an array of tables. `read` receives each table and its span.
    pub(crate) fn tables(&mut self, key: Key, mut read: impl FnMut(&mut Section<'t, '_>, Range<usize>)) {
        let path = self.full_key(key.name);
        if self.is_description() {
            self.file.describe_section(&path, true, true, key.doc);
            return self.file.read_table(path, self.table, |section| read(section, 0..0));
        }
        let Some(value) = self.get(key.name) else { return };
        let DeValue::Array(tables) = value.get_ref() else {
            return self.reject_type(key.name, value, "an array of tables");
        };
        for value in tables.iter() {
            match value.get_ref() {
                DeValue::Table(table) => {
                    self.file.read_table(path.clone(), table, |section| read(section, value.span()));
                }
                _ => self.reject_type(key.name, value, "a table"),
            }
        }
    }

    /// Reads a table of tables with arbitrary names. `read` receives each table, its name and the
    /// span of the name.
    pub(crate) fn named_tables(
        &mut self,
        key: Key,
        example: &'static str,
        mut read: impl FnMut(&mut Section<'t, '_>, &'t str, Range<usize>),
    ) {
        if self.is_description() {
            let path = format!("{}.{example}", self.full_key(key.name));
            self.file.describe_section(&path, false, true, key.doc);
            return self.file.read_table(path, self.table, |section| read(section, example, 0..0));
        }
        let Some(value) = self.get(key.name) else { return };
        let DeValue::Table(tables) = value.get_ref() else { return self.reject_type(key.name, value, "a table") };
        for (name, value) in tables.iter() {
            let path = format!("{}.{}", self.full_key(key.name), name.get_ref());
            match value.get_ref() {
                DeValue::Table(table) => {
                    self.file.read_table(path, table, |section| read(section, name.get_ref(), name.span()));
                }
                _ => self.reject_type(&path, value, "a table"),
            }
        }
    }

    /// Reads a table of numbers with arbitrary names.
    pub(crate) fn numbers(&mut self, mut number: impl FnMut(&'t str, f64)) {
        for key in self.table.keys() {
            let Some(value) = self.get(key.get_ref()) else { continue };
            if let Some(value) = self.number(key.get_ref(), value, &(f64::MIN..=f64::MAX)) {
                number(key.get_ref(), value);
            }
        }
    }

    /// Converts the value of a key with `convert`. In description mode, describes the key instead.
    pub(crate) fn value<T>(
        &mut self,
        key: Key,
        values: Values,
        out: &mut T,
        convert: impl FnOnce(&mut Self, &'t Spanned<DeValue<'t>>) -> Option<T>,
    ) {
        if self.is_description() {
            return self.describe_key(key, values);
        }
        let Some(value) = self.get(key.name) else { return };
        match convert(self, value) {
            Some(value) => *out = value,
            None => self.invalid.push(key.name),
        }
    }

    /// Reads a string and converts it with `parse`. `expected` describes valid strings.
    pub(crate) fn text<T>(
        &mut self,
        key: Key,
        expected: &str,
        parse: impl FnOnce(&str) -> Option<T>,
        default: Option<String>,
        out: &mut T,
    ) {
        let default = default.map(|text| format!("{text:?}"));
        let values = Values::new(expected, default);
        self.value(key, values, out, |section, value| section.parse(key.name, value, expected, parse));
    }

    /// Reads a value and converts it with `convert`. `expected` describes the type of the value.
    pub(crate) fn typed<T>(
        &mut self,
        key: Key,
        expected: &str,
        convert: impl FnOnce(&'t DeValue<'t>) -> Option<T>,
        default: Option<String>,
        out: &mut T,
    ) {
        self.value(key, Values::new(expected, default), out, |section, value| {
            let converted = convert(value.get_ref());
            if converted.is_none() {
                section.reject_type(key.name, value, expected);
            }
            converted
        });
    }

    /// Reads the keys of the variant that was chosen by `key`. In description mode, describes the
    /// keys of all variants.
    pub(crate) fn variants<'n, T: 'n>(
        &mut self,
        key: &str,
        chosen: &mut T,
        all: impl IntoIterator<Item = (&'n str, T)>,
        read: impl Fn(&mut Self, &mut T),
    ) {
        if !self.is_description() {
            return read(self, chosen);
        }
        for (name, mut variant) in all {
            self.condition = Some(format!("{key} = {name:?}"));
            read(self, &mut variant);
        }
        self.condition = None;
    }

    /// Calls `read` only to mark its keys as known. Problems are not reported.
    pub(crate) fn allow(&mut self, read: impl FnOnce(&mut Self)) {
        let before = self.file.problems.len();
        read(self);
        self.file.problems.truncate(before);
    }

    /// Marks a key as unknown, because other settings exclude it.
    pub(crate) fn exclude(&mut self, key: &str) {
        self.file.visits[self.visit].known.retain(|known| *known != key);
    }

    /// Returns `true` if keys are described instead of read.
    pub(crate) fn is_description(&self) -> bool {
        self.file.descriptions.is_some()
    }

    /// Removes the default from the description of a key or a nested table.
    pub(crate) fn describe_as_not_set(&mut self, key: Key) {
        let path = self.full_key(key.name);
        let sections = self.file.descriptions.iter_mut().flatten();
        sections.filter(|section| section.path == path).for_each(|section| section.is_optional = true);
        let described = self.description().into_iter().flat_map(|section| &mut section.keys);
        described.filter(|described| described.name == key.name).for_each(|described| described.default = None);
    }

    /// Returns the outermost table of the file.
    pub(crate) fn root(&self) -> &'t DeTable<'t> {
        self.file.root
    }

    /// Returns the path of the section, such as `ingest.sim`.
    pub(crate) fn path(&self) -> &str {
        &self.file.visits[self.visit].path
    }

    /// Returns the folder to which paths are relative, if known.
    pub(crate) fn folder(&self) -> Option<&'t Path> {
        self.file.folder
    }

    /// Returns `true` if the key is present.
    pub(crate) fn has(&self, key: &str) -> bool {
        self.table.contains_key(key)
    }

    /// Returns the text of a key, or `None` if it is missing or not a string.
    pub(crate) fn peek(&self, key: &str) -> Option<&'t str> {
        self.table.get(key)?.get_ref().as_str()
    }

    /// Returns `true` if the key is present with a valid value.
    pub(crate) fn is_set(&self, key: &str) -> bool {
        self.has(key) && self.are_valid(&[key])
    }

    /// Returns `true` if none of the keys has an invalid value.
    pub(crate) fn are_valid(&self, keys: &[&str]) -> bool {
        !self.invalid.iter().any(|invalid| keys.contains(invalid))
    }

    /// Returns the strings of an array with their spans. Other elements are left out.
    pub(crate) fn elements(&self, key: &str) -> Vec<(&'t str, Range<usize>)> {
        let array = self.table.get(key).and_then(|array| array.get_ref().as_array());
        let strings = array.into_iter().flat_map(|values| values.iter());
        strings.filter_map(|value| Some((value.get_ref().as_str()?, value.span()))).collect()
    }

    /// Returns the span of the key's value, if present.
    pub(crate) fn span(&self, key: &str) -> Option<Range<usize>> {
        self.table.get(key).map(Spanned::span)
    }

    /// Returns the span of the value of a key in a nested table, if present.
    pub(crate) fn table_span(&self, table: &str, key: &str) -> Option<Range<usize>> {
        self.table.get(table)?.get_ref().as_table()?.get(key).map(Spanned::span)
    }

    /// Returns the first of the required keys that is missing.
    pub(crate) fn missing<'k>(&mut self, required: &[&'k str]) -> Option<&'k str> {
        let described = self.description().into_iter().flat_map(|section| &mut section.keys);
        for key in described.filter(|key| required.contains(&key.name.as_str())) {
            (key.default, key.is_required) = (None, true);
        }
        required.iter().copied().find(|key| !self.has(key))
    }

    /// Returns the number of problems reported so far in any table.
    pub(crate) fn problem_count(&self) -> usize {
        self.file.problems.len()
    }

    /// Reports a problem, unless an earlier visit of the same table has reported it.
    pub(crate) fn report(&mut self, problem: Problem) {
        if !self.file.problems.contains(&problem) {
            self.file.problems.push(problem);
        }
    }

    /// Reports the first required key that is missing. `label` describes the requirement.
    pub(crate) fn require(&mut self, required: &[&str], label: &str) {
        if let Some(key) = self.missing(required) {
            self.report_table(&format!("{}: {key:?} is missing", self.path()), label);
        }
    }

    /// Reports a problem of the whole table at its first key.
    pub(crate) fn report_table(&mut self, title: &str, label: &str) {
        let span = self.table.keys().map(Spanned::span).min_by_key(|span| span.start).unwrap_or_default();
        self.report(Problem::new(span, title, label));
    }

    /// Converts a number within `range`, written with or without a decimal point.
    pub(crate) fn number(
        &mut self,
        key: &str,
        value: &Spanned<DeValue<'_>>,
        range: &std::ops::RangeInclusive<f64>,
    ) -> Option<f64> {
        let (number, found) = match value.get_ref() {
            DeValue::Float(float) => (float.as_str().parse().ok(), float.as_str().to_owned()),
            DeValue::Integer(integer) => (int(integer).map(|integer| integer as f64), integer.to_string()),
            _ => {
                self.reject_type(key, value, "a number");
                return None;
            }
        };
        let number = number.filter(|number| range.contains(number));
        if number.is_none() {
            self.reject(key, value, &format!("{} to {}", range.start(), range.end()), &found);
        }
        number
    }

    /// Converts one of the allowed names to its value.
    pub(crate) fn choose<T: Clone>(
        &mut self,
        key: &str,
        value: &Spanned<DeValue<'_>>,
        allowed: &[(&str, T)],
    ) -> Option<T> {
        let text = self.string(key, value)?;
        let item = allowed.iter().find(|(name, _)| *name == text).map(|(_, item)| item.clone());
        if item.is_none() {
            let names: Vec<_> = allowed.iter().map(|&(name, _)| name).collect();
            let title = format!("{}: unknown value {text:?}", self.full_key(key));
            self.report(Problem::unknown(value.span(), title, text, &names));
        }
        item
    }

    /// Converts a string with `parse`. `expected` describes valid strings.
    pub(crate) fn parse<T>(
        &mut self,
        key: &str,
        value: &Spanned<DeValue<'_>>,
        expected: &str,
        parse: impl FnOnce(&str) -> Option<T>,
    ) -> Option<T> {
        let text = self.string(key, value)?;
        let parsed = parse(text);
        if parsed.is_none() {
            self.reject(key, value, expected, &format!("{text:?}"));
        }
        parsed
    }

    fn string<'v>(&mut self, key: &str, value: &'v Spanned<DeValue<'_>>) -> Option<&'v str> {
        let text = value.get_ref().as_str();
        if text.is_none() {
            self.reject_type(key, value, "a string");
        }
        text
    }

    /// Reports that the value is not of the expected type.
    pub(crate) fn reject_type(&mut self, key: &str, value: &Spanned<DeValue<'_>>, expected: &str) {
        let found = match value.get_ref() {
            DeValue::String(_) => "a string",
            DeValue::Integer(_) => "an integer",
            DeValue::Float(_) => "a float",
            DeValue::Boolean(_) => "a boolean",
            DeValue::Datetime(_) => "a date or time",
            DeValue::Array(_) => "an array",
            DeValue::Table(_) => "a table",
        };
        self.reject(key, value, expected, found);
    }

    /// Reports that the value is not allowed.
    pub(crate) fn reject(&mut self, key: &str, value: &Spanned<DeValue<'_>>, expected: &str, found: &str) {
        let title = format!("{}: expected {expected}, found {found}", self.full_key(key));
        self.report(Problem::new(value.span(), title, format!("expected {expected}")));
    }

    fn get(&mut self, key: &'t str) -> Option<&'t Spanned<DeValue<'t>>> {
        let known = &mut self.file.visits[self.visit].known;
        if !known.contains(&key) {
            known.push(key);
        }
        self.table.get(key)
    }

    fn full_key(&self, key: &str) -> String {
        if self.path().is_empty() { key.into() } else { format!("{}.{key}", self.path()) }
    }

    fn description(&mut self) -> Option<&mut SectionDescription> {
        let path = &self.file.visits[self.visit].path;
        self.file.descriptions.as_mut()?.iter_mut().find(|section| section.path == *path)
    }

    fn describe_key(&mut self, key: Key, Values { allowed, default, names }: Values) {
        let conditions: Vec<_> = self.condition.clone().into_iter().collect();
        let Some(section) = self.description() else { return };
        let doc = words(key.doc);
        // A key that several variants share is described once.
        if let Some(known) = section.keys.iter_mut().find(|known| known.name == key.name && known.doc == doc) {
            return known.conditions.extend(conditions);
        }
        let Key { name, unit, example, .. } = key;
        section.keys.push(KeyDescription {
            name: name.into(),
            default,
            allowed,
            unit,
            doc,
            values: names,
            example,
            is_required: false,
            conditions,
        });
    }
}

/// Joins a relative path to the folder, if the folder is known. An empty path stays empty.
pub(crate) fn resolve(folder: Option<&Path>, path: &str) -> PathBuf {
    folder.filter(|_| !path.is_empty()).map_or_else(|| path.into(), |folder| folder.join(path))
}

/// Replaces each run of white space, including line breaks, with a single space.
pub(crate) fn words(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Converts an integer of any radix.
pub(crate) fn int(integer: &DeInteger<'_>) -> Option<i64> {
    i64::from_str_radix(integer.as_str(), integer.radix()).ok()
}
