//! Text from outside: names and messages from files, from the network and from other programs.
//!
//! Input: any text.
//!
//! Output: [`ForeignText`], which cannot control a terminal, a log or a page when it is printed.
//!
//! Failure: bytes that are not UTF-8 are replaced by U+FFFD.
#![forbid(unsafe_code)]

use std::{
    borrow::Borrow,
    fmt::{self, Write},
    path::Path,
};

use serde::{Deserialize, Serialize};

/// Text from an untrusted source.
///
/// `Display` escapes control characters, including line breaks, and characters that reorder text.
/// The escapes have the form `\n` or `\u{1b}`. The text therefore cannot control a terminal or
/// imitate another line. `Debug` also adds quotes. `Serialize` writes the text unchanged, because
/// formats such as JSON have their own escapes.
#[derive(Clone, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct ForeignText(String);

impl ForeignText {
    /// Creates a text from bytes. Bytes that are not UTF-8 are replaced by U+FFFD.
    pub fn from_bytes(bytes: &[u8]) -> Self {
        Self(String::from_utf8_lossy(bytes).into_owned())
    }

    /// Returns the text unchanged, for comparison and for formats with their own escapes.
    pub fn raw(&self) -> &str {
        &self.0
    }

    /// Returns the text with its line breaks. Every line after the first begins with `  | `, which
    /// distinguishes it from the lines of this program.
    pub fn with_lines(&self) -> impl fmt::Display + use<> {
        self.0.lines().map(|line| Self::from(line).to_string()).collect::<Vec<_>>().join("\n  | ")
    }
}

/// Returns a path as text that is safe to display, because a file name may come from an untrusted
/// source.
pub fn path(path: &Path) -> ForeignText {
    ForeignText(path.to_string_lossy().into_owned())
}

/// Quotes a text as a single shell word and escapes control characters.
pub fn shell_word(text: &str) -> String {
    let is_plain = |found: char| found.is_ascii_alphanumeric() || "_-.,:=/".contains(found);
    let text = ForeignText::from(text).to_string();
    if text.chars().all(is_plain) { text } else { format!("'{}'", text.replace('\'', "'\\''")) }
}

/// Formats texts as a list with commas.
pub fn list<'a>(texts: impl IntoIterator<Item = &'a ForeignText>) -> String {
    texts.into_iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
}

/// Replaces the characters that [`ForeignText`] escapes with visible characters of equal length, so
/// that offsets in the text remain valid. Line breaks and tabs are kept.
pub fn masked(text: &str) -> String {
    let mask = |letter: char| match letter.len_utf8() {
        _ if !is_escaped(letter) || matches!(letter, '\n' | '\t') => letter,
        1 => '?',
        2 => '¿',
        _ => '\u{fffd}',
    };
    text.chars().map(mask).collect()
}

/// Returns `true` for characters that control a terminal, end a line or reorder text.
fn is_escaped(letter: char) -> bool {
    letter.is_control()
        || matches!(letter,
            // Line and paragraph separator.
            '\u{2028}' | '\u{2029}'
            // Marks, embeddings, overrides and isolates of the Unicode bidirectional algorithm.
            | '\u{061c}' | '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

impl fmt::Display for ForeignText {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut text = String::with_capacity(self.0.len());
        for letter in self.0.chars() {
            if is_escaped(letter) {
                write!(text, "{}", letter.escape_default())?;
            } else {
                text.push(letter);
            }
        }
        f.pad(&text)
    }
}

impl fmt::Debug for ForeignText {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(&self.0, f)
    }
}

impl From<String> for ForeignText {
    fn from(text: String) -> Self {
        Self(text)
    }
}

impl From<&str> for ForeignText {
    fn from(text: &str) -> Self {
        Self(text.to_owned())
    }
}

impl Borrow<str> for ForeignText {
    fn borrow(&self) -> &str {
        &self.0
    }
}

impl PartialEq<str> for ForeignText {
    fn eq(&self, other: &str) -> bool {
        self.0 == *other
    }
}

impl PartialEq<&str> for ForeignText {
    fn eq(&self, other: &&str) -> bool {
        self.0 == **other
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Hostile text: window title, clear screen, forged line, C1 control sequence introducer.
    const HOSTILE: &str = "a\x1b]0;b\x07\x1b[2J\nforged\r\u{9b}2J";

    #[test]
    fn control_characters_and_line_breaks_are_escaped() {
        let escaped = r"a\u{1b}]0;b\u{7}\u{1b}[2J\nforged\r\u{9b}2J";
        assert_eq!(ForeignText::from(HOSTILE).to_string(), escaped);
        assert_eq!(path(Path::new(HOSTILE)).to_string(), escaped);
    }

    #[test]
    fn every_bidirectional_control_is_escaped() {
        // Unicode property Bidi_Control.
        let bidi = [0x61c, 0x200e, 0x200f, 0x202a, 0x202b, 0x202c, 0x202d, 0x202e, 0x2066, 0x2067, 0x2068, 0x2069];
        for code in bidi {
            let text = ForeignText::from(String::from(char::from_u32(code).unwrap()));
            assert_eq!(text.to_string(), format!("\\u{{{code:x}}}"));
            assert_eq!(format!("{text:?}"), format!("\"\\u{{{code:x}}}\""));
        }
    }

    #[test]
    fn other_text_is_unchanged_and_padded() {
        for text in ["/imu", "Größe µT 姿勢", "C:\\a \"b\"", ""] {
            assert_eq!(ForeignText::from(text).to_string(), text);
        }
        assert_eq!(format!("{:<6}|{:>6}", ForeignText::from("é"), ForeignText::from("\n")), "é     |    \\n");
    }

    #[test]
    fn masked_text_has_equal_length_and_lines() {
        let text = "a = \"\x1b[2J\u{9b}2J\u{61c}\u{2028}\u{202e}\"\r\n\tb";
        let masked = masked(text);
        assert_eq!(masked, "a = \"?[2J¿2J¿\u{fffd}\u{fffd}\"?\n\tb");
        assert_eq!(masked.len(), text.len());
    }

    #[test]
    fn each_line_after_the_first_has_the_mark() {
        let text = ForeignText::from("one\n\x1b[31mtwo\r\nerror: three");
        assert_eq!(text.with_lines().to_string(), "one\n  | \\u{1b}[31mtwo\n  | error: three");
    }

    #[test]
    fn json_contains_the_text_unchanged() {
        let json = serde_json::to_string(&ForeignText::from(HOSTILE)).unwrap();
        assert_eq!(serde_json::from_str::<String>(&json).unwrap(), HOSTILE);
    }
}
