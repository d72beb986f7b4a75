//! Kinds of values: numbers, names, texts, arrays and tables.

use std::{
    ops::{Range, RangeInclusive},
    path::PathBuf,
};

use attitude::parameters::Parameter;
use toml::{Spanned, de::DeValue, value::Datetime};

use crate::{
    description::Key,
    keys::{Kind, Named},
    toml_reader::{Section, Values, int, resolve, words},
};

/// Non-negative integers that every TOML parser supports.
pub(crate) const NATURAL: RangeInclusive<u64> = 0..=i64::MAX as u64;

/// A number in a range, with or without a decimal point. A default of
/// NaN means that the key has no default.
impl Kind<f64> for RangeInclusive<f64> {
    fn read(&self, section: &mut Section<'_, '_>, key: Key, out: &mut f64) {
        let values =
            Values::new(format!("{} to {}", self.start(), self.end()), (!out.is_nan()).then(|| out.to_string()));
        section.value(key, values, out, |section, value| section.number(key.name, value, self));
    }
}

/// An integer in a range. If the range excludes 0, a default of 0 means that the key has no
/// default.
impl Kind<u64> for RangeInclusive<u64> {
    fn read(&self, section: &mut Section<'_, '_>, key: Key, out: &mut u64) {
        let range = format!("{} to {}", self.start(), self.end());
        let allowed = if *self == NATURAL { "0 or more" } else { &range };
        let default = (*out > 0 || self.contains(out)).then(|| out.to_string());
        section.value(key, Values::new(allowed, default), out, |section, value| {
            let DeValue::Integer(integer) = value.get_ref() else {
                section.reject_type(key.name, value, "an integer");
                return None;
            };
            let natural = int(integer).and_then(|integer| u64::try_from(integer).ok());
            let natural = natural.filter(|natural| self.contains(natural));
            if natural.is_none() {
                section.reject(key.name, value, &range, &integer.to_string());
            }
            natural
        });
    }
}

/// `true` or `false`.
pub(crate) struct Flag;

impl Kind<bool> for Flag {
    fn read(&self, section: &mut Section<'_, '_>, key: Key, out: &mut bool) {
        section.typed(key, "true or false", DeValue::as_bool, Some(out.to_string()), out);
    }
}

/// One of several names.
pub(crate) struct OneOf<'n, T> {
    names: Vec<(&'n str, T)>,
    docs: &'static [&'static str],
}

/// Returns the kind of a key that takes one of the names of `T`.
pub(crate) fn choice<T: Named + Clone>() -> OneOf<'static, T> {
    OneOf { names: T::NAMES.to_vec(), docs: T::DOCS }
}

/// Returns the kind of a key that takes one of the given names.
pub(crate) fn one_of<'n, T>(names: impl IntoIterator<Item = (&'n str, T)>) -> OneOf<'n, T> {
    OneOf { names: names.into_iter().collect(), docs: &[] }
}

impl<T: Clone + PartialEq> Kind<T> for OneOf<'_, T> {
    fn read(&self, section: &mut Section<'_, '_>, key: Key, out: &mut T) {
        let name = self.names.iter().find(|(_, value)| value == out).map(|(name, _)| *name);
        let docs = self.docs.iter().copied().chain(std::iter::repeat(""));
        let values = Values {
            names: self.names.iter().zip(docs).map(|((name, _), doc)| ((*name).into(), words(doc))).collect(),
            ..Values::new("", name.map(|name| format!("{name:?}")))
        };
        section.value(key, values, out, |section, value| section.choose(key.name, value, &self.names));
    }
}

/// An array of names.
pub(crate) struct ManyOf<T>(Vec<(&'static str, T)>);

/// Returns the kind of a key that takes an array of the given names.
pub(crate) fn many_of<T>(names: impl IntoIterator<Item = (&'static str, T)>) -> ManyOf<T> {
    ManyOf(names.into_iter().collect())
}

impl<T: Clone + PartialEq> Kind<Vec<T>> for ManyOf<T> {
    fn read(&self, section: &mut Section<'_, '_>, key: Key, out: &mut Vec<T>) {
        let name = |item: &T| self.0.iter().find(|(_, value)| value == item).map(|(name, _)| *name);
        let values = Values {
            names: self.0.iter().map(|(name, _)| ((*name).into(), String::new())).collect(),
            ..Values::new("array of", text_array(out.iter().filter_map(name)))
        };
        section.value(key, values, out, |section, value| {
            let DeValue::Array(array) = value.get_ref() else {
                section.reject_type(key.name, value, "an array");
                return None;
            };
            // Every unknown name is reported.
            let chosen: Vec<_> = array.iter().map(|value| section.choose(key.name, value, &self.0)).collect();
            chosen.into_iter().collect()
        });
    }
}

/// A string that `parse` accepts. `show` returns the text of a default, or `None` if the key is
/// not set by default.
pub(crate) struct Text<T> {
    pub(crate) expected: &'static str,
    pub(crate) parse: fn(&str) -> Option<T>,
    pub(crate) show: fn(&T) -> Option<String>,
}

impl<T> Kind<T> for Text<T> {
    fn read(&self, section: &mut Section<'_, '_>, key: Key, out: &mut T) {
        section.text(key, self.expected, self.parse, (self.show)(out), out);
    }
}

/// Returns the kind of a key that takes a string. A string is valid if `accepts` returns a value
/// for it. An empty default stands for a key that is not set.
pub(crate) const fn text(expected: &'static str, accepts: fn(&str) -> Option<String>) -> Text<String> {
    Text { expected, parse: accepts, show: |text| Some(text.clone()).filter(|text| !text.is_empty()) }
}

/// The name of a system, vehicle or stage.
pub(crate) const NAME: Text<String> = text(r#"1 to 32 of a-z, 0-9, "_" and "-""#, |name| {
    let allowed = |byte: u8| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'_' | b'-');
    ((1..=32).contains(&name.len()) && name.bytes().all(allowed)).then(|| name.into())
});

/// A path, relative to the folder of the launch file. An empty default stands for a key that is not
/// set.
pub(crate) struct File;

impl Kind<PathBuf> for File {
    fn read(&self, section: &mut Section<'_, '_>, key: Key, out: &mut PathBuf) {
        let folder = section.folder();
        let default = Some(out.to_string_lossy().into_owned()).filter(|path| !path.is_empty());
        section.text(key, "a path", |path| Some(resolve(folder, path)), default, out);
    }
}

/// A path, or one of the names `"auto"` and `"off"`, each of which has a fixed value.
pub(crate) struct FileOr<T> {
    pub(crate) auto: T,
    pub(crate) off: T,
    pub(crate) file: fn(PathBuf) -> T,
}

impl<T: Clone + PartialEq> Kind<T> for FileOr<T> {
    fn read(&self, section: &mut Section<'_, '_>, key: Key, out: &mut T) {
        let folder = section.folder();
        let default = (*out == self.auto).then(|| "auto".to_owned());
        let parse = |text: &str| match text {
            "" => None,
            "auto" => Some(self.auto.clone()),
            "off" => Some(self.off.clone()),
            path => Some((self.file)(resolve(folder, path))),
        };
        section.text(key, r#""auto", "off" or a path"#, parse, default, out);
    }
}

/// An array of at most `N` strings.
pub(crate) struct Texts<const N: usize>;

impl<const N: usize> Kind<Vec<String>> for Texts<N> {
    fn read(&self, section: &mut Section<'_, '_>, key: Key, out: &mut Vec<String>) {
        let expected =
            if N < usize::MAX { format!("an array of at most {N} strings") } else { "an array of strings".into() };
        let strings = |value: &DeValue<'_>| {
            let array = value.as_array().filter(|array| array.len() <= N)?;
            array.iter().map(|value| value.get_ref().as_str().map(str::to_owned)).collect()
        };
        section.typed(key, &expected, strings, text_array(out.iter().map(String::as_str)), out);
    }
}

/// Returns an array in TOML, or `None` for an empty one.
fn text_array<'n>(texts: impl Iterator<Item = &'n str>) -> Option<String> {
    let texts: Vec<_> = texts.map(|text| format!("{text:?}")).collect();
    (!texts.is_empty()).then(|| format!("[{}]", texts.join(", ")))
}

/// An array of finite numbers.
pub(crate) struct Vector;

impl<const N: usize> Kind<[f64; N]> for Vector {
    fn read(&self, section: &mut Section<'_, '_>, key: Key, out: &mut [f64; N]) {
        let expected = format!("an array of {N} finite numbers");
        section.typed(key, &expected, numbers, Some(format!("{out:?}")), out);
    }
}

/// A 3×3 matrix as an array of rows.
pub(crate) struct Matrix;

impl Kind<[[f64; 3]; 3]> for Matrix {
    fn read(&self, section: &mut Section<'_, '_>, key: Key, out: &mut [[f64; 3]; 3]) {
        let matrix = |value: &DeValue<'_>| {
            let rows = value.as_array()?.iter().map(|row| numbers(row.get_ref()));
            rows.collect::<Option<Vec<_>>>()?.try_into().ok()
        };
        section.typed(key, "three rows of three finite numbers", matrix, Some(format!("{out:?}")), out);
    }
}

fn numbers<const N: usize>(value: &DeValue<'_>) -> Option<[f64; N]> {
    let finite = |value: &Spanned<DeValue<'_>>| {
        let number = match value.get_ref() {
            DeValue::Float(float) => float.as_str().parse().ok()?,
            DeValue::Integer(integer) => int(integer)? as f64,
            _ => return None,
        };
        Some(number).filter(|number: &f64| number.is_finite())
    };
    value.as_array()?.iter().map(finite).collect::<Option<Vec<_>>>()?.try_into().ok()
}

/// A date without a time, from year, month and day.
pub(crate) struct Day<T> {
    pub(crate) expected: String,
    pub(crate) parse: fn(u16, u8, u8) -> Option<T>,
}

impl<T> Kind<Option<T>> for Day<T> {
    fn read(&self, section: &mut Section<'_, '_>, key: Key, out: &mut Option<T>) {
        section.value(key, Values::new(&self.expected, None), out, |section, value| {
            let day = match value.get_ref() {
                DeValue::Datetime(day) => Some(*day),
                DeValue::String(text) => text.parse::<Datetime>().ok(),
                _ => {
                    section.reject_type(key.name, value, &self.expected);
                    return None;
                }
            };
            let date = day.filter(|day| day.time.is_none()).and_then(|day| day.date);
            let parsed = date.and_then(|date| (self.parse)(date.year, date.month, date.day));
            if parsed.is_none() {
                let day = day.map_or_else(String::new, |day| day.to_string());
                let found = value.get_ref().as_str().map_or(day, |text| format!("{text:?}"));
                section.reject(key.name, value, &self.expected, &found);
            }
            parsed.map(Some)
        });
    }
}

/// A key that is not set by default.
pub(crate) struct Optional<K>(pub(crate) K);

impl<T: Default, K: Kind<T>> Kind<Option<T>> for Optional<K> {
    fn read(&self, section: &mut Section<'_, '_>, key: Key, out: &mut Option<T>) {
        let mut value = T::default();
        let before = section.problem_count();
        self.0.read(section, key, &mut value);
        section.describe_as_not_set(key);
        if section.has(key.name) && section.problem_count() == before {
            *out = Some(value);
        }
    }
}

/// A table with the keys that the function reads.
pub(crate) struct Table<T>(pub(crate) fn(&mut T, &mut Section<'_, '_>));

impl<T> Kind<T> for Table<T> {
    fn read(&self, section: &mut Section<'_, '_>, key: Key, out: &mut T) {
        section.section(key, |section| (self.0)(out, section));
    }
}

/// An array of tables.
pub(crate) struct Tables<T> {
    /// Reads one table, which has the given span.
    pub(crate) read: fn(&mut Section<'_, '_>, Range<usize>) -> Option<T>,
    /// Checks all valid tables against each other. The section contains the array.
    pub(crate) check: fn(&mut Section<'_, '_>, &[Spanned<T>]),
}

impl<T> Kind<Vec<T>> for Tables<T> {
    fn read(&self, section: &mut Section<'_, '_>, key: Key, out: &mut Vec<T>) {
        let mut tables = Vec::new();
        section.tables(key, |section, span| {
            tables.extend((self.read)(section, span.clone()).map(|table| Spanned::new(span, table)));
        });
        (self.check)(section, &tables);
        out.extend(tables.into_iter().map(Spanned::into_inner));
    }
}

/// Reads parameters that the mathematics declares, and passes those that are set to `set`.
pub(crate) fn read_parameters(
    section: &mut Section<'_, '_>,
    parameters: &[Parameter],
    mut set: impl FnMut(&'static str, f64),
) {
    for Parameter { name, unit, min, max, mut default, description } in parameters.iter().copied() {
        let key = Key { name, doc: description, unit, example: "" };
        (min..=max).read(section, key, &mut default);
        if section.is_set(name) {
            set(name, default);
        }
    }
}

/// Settings without a separate table. The function reads their keys from the enclosing table.
pub(crate) struct Inline<T>(pub(crate) fn(&mut T, &mut Section<'_, '_>));

impl<T> Kind<T> for Inline<T> {
    fn read(&self, section: &mut Section<'_, '_>, _: Key, out: &mut T) {
        (self.0)(out, section);
    }
}

/// Field that no key sets. The function returns its value.
pub(crate) struct NoKey<T>(pub(crate) fn(&Section<'_, '_>) -> T);

impl<T> Kind<T> for NoKey<T> {
    fn read(&self, section: &mut Section<'_, '_>, _: Key, out: &mut T) {
        *out = (self.0)(section);
    }
}

/// Key that the function reads, because its allowed values depend on other keys.
pub(crate) struct By<T>(pub(crate) fn(&mut Section<'_, '_>, Key, &mut T));

impl<T> Kind<T> for By<T> {
    fn read(&self, section: &mut Section<'_, '_>, key: Key, out: &mut T) {
        (self.0)(section, key, out);
    }
}
