//! Reading of a TOML table key by key. Valid values replace defaults, invalid ones become problems.

use crate::problem::Problem;
use std::{
    collections::BTreeMap,
    ops::{Range, RangeInclusive},
};
use toml::{
    Spanned,
    de::{DeInteger, DeTable, DeValue},
    value::Datetime,
};

/// TOML table being read.
///
/// Every reading method returns `true` if the key is absent or its value is valid.
pub(crate) struct Section<'t, 'p> {
    path: String,
    table: &'t DeTable<'t>,
    known: Vec<&'t str>,
    problems: &'p mut Vec<Problem>,
}

/// Reads the outermost table of the file.
pub(crate) fn read_root<'t>(
    table: &'t DeTable<'t>,
    problems: &mut Vec<Problem>,
    read: impl FnOnce(&mut Section<'t, '_>),
) {
    read_table(String::new(), table, problems, read);
}

fn read_table<'t>(
    path: String,
    table: &'t DeTable<'t>,
    problems: &mut Vec<Problem>,
    read: impl FnOnce(&mut Section<'t, '_>),
) {
    let mut section = Section { path, table, known: Vec::new(), problems };
    read(&mut section);
    section.reject_unknown_keys();
}

impl<'t> Section<'t, '_> {
    /// Reads a nested table.
    pub(crate) fn section(&mut self, key: &'static str, read: impl FnOnce(&mut Section<'t, '_>)) {
        let Some(value) = self.get(key) else { return };
        match value.get_ref() {
            DeValue::Table(table) => read_table(self.full_key(key), table, self.problems, read),
            _ => self.reject_type(key, value, "a table"),
        }
    }

    /// Reads an array of tables. `read` receives each table and its span.
    pub(crate) fn tables(&mut self, key: &'static str, mut read: impl FnMut(&mut Section<'t, '_>, Range<usize>)) {
        let Some(value) = self.get(key) else { return };
        let DeValue::Array(tables) = value.get_ref() else { return self.reject_type(key, value, "an array of tables") };
        for value in tables.iter() {
            match value.get_ref() {
                DeValue::Table(table) => {
                    read_table(self.full_key(key), table, self.problems, |section| read(section, value.span()));
                }
                _ => self.reject_type(key, value, "a table"),
            }
        }
    }

    /// Reads a table of tables with arbitrary names. `read` receives each table, its name and the
    /// span of the name.
    pub(crate) fn named_tables(
        &mut self,
        key: &'static str,
        mut read: impl FnMut(&mut Section<'t, '_>, &'t str, Range<usize>),
    ) {
        let Some(value) = self.get(key) else { return };
        let DeValue::Table(tables) = value.get_ref() else { return self.reject_type(key, value, "a table") };
        for (name, value) in tables.iter() {
            let path = format!("{}.{}", self.full_key(key), name.get_ref());
            match value.get_ref() {
                DeValue::Table(table) => {
                    read_table(path, table, self.problems, |section| read(section, name.get_ref(), name.span()));
                }
                _ => self.reject_type(&path, value, "a table"),
            }
        }
    }

    /// Reads a finite number for every key of the table.
    pub(crate) fn numbers(&mut self, out: &mut BTreeMap<String, f64>) {
        for key in self.table.keys() {
            let mut value = 0.0;
            if self.number(key.get_ref(), f64::MIN..=f64::MAX, &mut value) {
                out.insert(key.get_ref().to_string(), value);
            }
        }
    }

    /// Reads an array of strings.
    pub(crate) fn strings(&mut self, key: &'static str, out: &mut Vec<String>) -> bool {
        self.read(key, out, |section, value| {
            let strings = value.get_ref().as_array().and_then(|strings| {
                strings.iter().map(|string| string.get_ref().as_str().map(str::to_owned)).collect::<Option<Vec<_>>>()
            });
            if strings.is_none() {
                section.reject_type(key, value, "an array of strings");
            }
            strings
        })
    }

    /// Reads a finite number in a range, with or without a decimal point.
    pub(crate) fn number(&mut self, key: &'t str, allowed: RangeInclusive<f64>, out: &mut f64) -> bool {
        self.read(key, out, |section, value| {
            let (number, found) = match value.get_ref() {
                DeValue::Float(float) => (float.as_str().parse().ok(), float.as_str().to_owned()),
                DeValue::Integer(integer) => (int(integer).map(|integer| integer as f64), integer.to_string()),
                _ => {
                    section.reject_type(key, value, "a number");
                    return None;
                }
            };
            let number = number.filter(|number| allowed.contains(number));
            if number.is_none() {
                section.reject(key, value, &format!("{} to {}", allowed.start(), allowed.end()), &found);
            }
            number
        })
    }

    /// Reads an array of `N` finite numbers.
    pub(crate) fn vector<const N: usize>(&mut self, key: &'static str, out: &mut [f64; N]) -> bool {
        self.read(key, out, |section, value| {
            let vector = numbers(value.get_ref());
            if vector.is_none() {
                section.reject_type(key, value, &format!("an array of {N} finite numbers"));
            }
            vector
        })
    }

    /// Reads a 3×3 matrix as an array of rows.
    pub(crate) fn matrix(&mut self, key: &'static str, out: &mut [[f64; 3]; 3]) -> bool {
        self.read(key, out, |section, value| {
            let rows = value.get_ref().as_array().filter(|rows| rows.len() == 3);
            let rows: Option<Vec<_>> = rows.and_then(|rows| rows.iter().map(|row| numbers(row.get_ref())).collect());
            let matrix = rows.and_then(|rows| rows.try_into().ok());
            if matrix.is_none() {
                section.reject_type(key, value, "three rows of three finite numbers");
            }
            matrix
        })
    }

    /// Returns `true` if the key is present.
    pub(crate) fn has(&self, key: &str) -> bool {
        self.table.contains_key(key)
    }

    /// Marks a key as known without reading it.
    pub(crate) fn allow(&mut self, key: &'static str) {
        self.known.push(key);
    }

    /// Reads an integer from 0 to the largest that every TOML parser supports.
    pub(crate) fn unsigned(&mut self, key: &'static str, out: &mut u64) -> bool {
        self.integer(key, 0..=i64::MAX as u64, out)
    }

    /// Reads an integer in a range.
    pub(crate) fn integer(&mut self, key: &'static str, allowed: RangeInclusive<u64>, out: &mut u64) -> bool {
        self.read(key, out, |section, value| {
            let DeValue::Integer(integer) = value.get_ref() else {
                section.reject_type(key, value, "an integer");
                return None;
            };
            let natural = int(integer).and_then(|integer| u64::try_from(integer).ok());
            let natural = natural.filter(|natural| allowed.contains(natural));
            if natural.is_none() {
                section.reject(key, value, &format!("{} to {}", allowed.start(), allowed.end()), &integer.to_string());
            }
            natural
        })
    }

    /// Reads `true` or `false`.
    pub(crate) fn boolean(&mut self, key: &'static str, out: &mut bool) -> bool {
        self.read(key, out, |section, value| {
            let flag = value.get_ref().as_bool();
            if flag.is_none() {
                section.reject_type(key, value, "true or false");
            }
            flag
        })
    }

    /// Reads a date and converts it with `accept` from year, month and day. `expected` describes
    /// valid dates.
    pub(crate) fn date<T>(
        &mut self,
        key: &'static str,
        expected: &str,
        accept: impl FnOnce((u16, u8, u8)) -> Option<T>,
        out: &mut Option<T>,
    ) -> bool {
        self.read(key, out, |section, value| {
            let day = match value.get_ref() {
                DeValue::Datetime(day) => Some(*day),
                DeValue::String(text) => text.parse::<Datetime>().ok(),
                _ => {
                    section.reject_type(key, value, expected);
                    return None;
                }
            };
            let date_only = day.filter(|day| day.time.is_none()).and_then(|day| day.date);
            let accepted = date_only.and_then(|date| accept((date.year, date.month, date.day)));
            if accepted.is_none() {
                let found = value
                    .get_ref()
                    .as_str()
                    .map_or_else(|| day.map_or_else(String::new, |day| day.to_string()), |text| format!("{text:?}"));
                section.reject(key, value, expected, &found);
            }
            accepted.map(Some)
        })
    }

    /// Reads a string and converts it with `accept`. `expected` describes valid strings.
    pub(crate) fn parsed<T>(
        &mut self,
        key: &'static str,
        expected: &str,
        accept: impl FnOnce(&str) -> Option<T>,
        out: &mut T,
    ) -> bool {
        self.read(key, out, |section, value| {
            let text = section.string(key, value)?;
            let accepted = accept(text);
            if accepted.is_none() {
                section.reject(key, value, expected, &format!("{text:?}"));
            }
            accepted
        })
    }

    /// Reads one of the allowed names and stores its value.
    pub(crate) fn choice<'n, T: Clone + 'n>(
        &mut self,
        key: &'static str,
        allowed: impl AsRef<[(&'n str, T)]>,
        out: &mut T,
    ) -> bool {
        self.read(key, out, |section, value| section.choose(key, value, allowed.as_ref()))
    }

    /// Reads an array of allowed names. Returns the value and span of each, or `None` in place of
    /// an invalid one.
    pub(crate) fn choices<T: Clone>(
        &mut self,
        key: &'static str,
        allowed: &[(&'static str, T)],
    ) -> Option<Vec<Option<Spanned<T>>>> {
        let array = self.get(key)?;
        let DeValue::Array(values) = array.get_ref() else {
            self.reject_type(key, array, "an array");
            return None;
        };
        let chosen = |value| self.choose(key, value, allowed).map(|item| Spanned::new(value.span(), item));
        Some(values.iter().map(chosen).collect())
    }

    /// Reads an array of at most `max` strings with their spans.
    pub(crate) fn spanned_strings(&mut self, key: &'static str, max: usize) -> Option<Vec<Spanned<String>>> {
        let array = self.get(key)?;
        let texts = array.get_ref().as_array().filter(|values| values.len() <= max).and_then(|values| {
            values.iter().map(|value| Some(Spanned::new(value.span(), value.get_ref().as_str()?.to_owned()))).collect()
        });
        if texts.is_none() {
            self.reject_type(key, array, &format!("an array of at most {max} strings"));
        }
        texts
    }

    /// Returns `true` if the key is present with a number.
    pub(crate) fn is_number(&self, key: &str) -> bool {
        self.table.get(key).is_some_and(|value| matches!(value.get_ref(), DeValue::Integer(_) | DeValue::Float(_)))
    }

    /// Reports a problem of the whole table at its first key.
    pub(crate) fn report_table(&mut self, title: &str, label: &str) {
        let span = self.table.keys().map(Spanned::span).min_by_key(|span| span.start).unwrap_or_default();
        self.problems.push(Problem::new(span, title, label));
    }

    /// Returns the span of the key's value, if present.
    pub(crate) fn span(&self, key: &str) -> Option<Range<usize>> {
        self.table.get(key).map(Spanned::span)
    }

    /// Returns `true` if any problem has been reported so far, here or in another table.
    pub(crate) fn has_problems(&self) -> bool {
        !self.problems.is_empty()
    }

    /// Reports a problem that concerns several values.
    pub(crate) fn report(&mut self, problem: Problem) {
        self.problems.push(problem);
    }

    fn read<T>(
        &mut self,
        key: &'t str,
        out: &mut T,
        convert: impl FnOnce(&mut Self, &'t Spanned<DeValue<'t>>) -> Option<T>,
    ) -> bool {
        let Some(value) = self.get(key) else { return true };
        convert(self, value).map(|value| *out = value).is_some()
    }

    fn get(&mut self, key: &'t str) -> Option<&'t Spanned<DeValue<'t>>> {
        self.known.push(key);
        self.table.get(key)
    }

    fn choose<T: Clone>(&mut self, key: &str, value: &Spanned<DeValue<'_>>, allowed: &[(&str, T)]) -> Option<T> {
        let text = self.string(key, value)?;
        let item = allowed.iter().find(|(name, _)| *name == text).map(|(_, item)| item.clone());
        if item.is_none() {
            let names: Vec<_> = allowed.iter().map(|&(name, _)| name).collect();
            let title = format!("{}: unknown value {text:?}", self.full_key(key));
            self.problems.push(Problem::unknown(value.span(), title, text, &names));
        }
        item
    }

    fn string<'v>(&mut self, key: &str, value: &'v Spanned<DeValue<'_>>) -> Option<&'v str> {
        let text = value.get_ref().as_str();
        if text.is_none() {
            self.reject_type(key, value, "a string");
        }
        text
    }

    fn reject_type(&mut self, key: &str, value: &Spanned<DeValue<'_>>, expected: &str) {
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

    fn reject(&mut self, key: &str, value: &Spanned<DeValue<'_>>, expected: &str, found: &str) {
        let title = format!("{}: expected {expected}, found {found}", self.full_key(key));
        self.problems.push(Problem::new(value.span(), title, format!("expected {expected}")));
    }

    fn reject_unknown_keys(self) {
        for key in self.table.keys().filter(|key| !self.known.contains(&key.get_ref().as_ref())) {
            let name = key.get_ref();
            let title = if self.path.is_empty() {
                format!("unknown key {name:?}")
            } else {
                format!("unknown key {name:?} in [{}]", self.path)
            };
            self.problems.push(Problem::unknown(key.span(), title, name, &self.known));
        }
    }

    fn full_key(&self, key: &str) -> String {
        if self.path.is_empty() { key.into() } else { format!("{}.{key}", self.path) }
    }
}

fn numbers<const N: usize>(value: &DeValue<'_>) -> Option<[f64; N]> {
    let values: Option<Vec<f64>> = value.as_array()?.iter().map(|value| finite(value.get_ref())).collect();
    values?.try_into().ok()
}

fn finite(value: &DeValue<'_>) -> Option<f64> {
    let number = match value {
        DeValue::Float(float) => float.as_str().parse().ok()?,
        DeValue::Integer(integer) => int(integer)? as f64,
        _ => return None,
    };
    Some(number).filter(|number| number.is_finite())
}

fn int(integer: &DeInteger<'_>) -> Option<i64> {
    i64::from_str_radix(integer.as_str(), integer.radix()).ok()
}
