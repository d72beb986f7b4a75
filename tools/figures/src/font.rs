//! Installed typeface used for PNG.
//!
//! Input: the standard typeface folders of the system.
//!
//! Output: the first match in a list of widespread typefaces with Greek letters.
//!
//! Failure: a message with the package to install if no supported typeface is found.

use std::path::{Path, PathBuf};

use ab_glyph::{Font, FontVec, PxScale, ScaleFont, point};

const FOLDERS: [&str; 4] =
    ["/usr/share/fonts", "/usr/local/share/fonts", "/run/current-system/sw/share/X11/fonts", "/Library/Fonts"];
const NAMES: [&str; 5] =
    ["DejaVuSans.ttf", "LiberationSans-Regular.ttf", "NotoSans-Regular.ttf", "FreeSans.ttf", "Arial Unicode.ttf"];
/// Maximum folder depth. Together with [`MAX_ENTRIES`], it bounds the search if symbolic links form
/// a loop.
const MAX_DEPTH: usize = 5;
/// Maximum number of directory entries visited.
const MAX_ENTRIES: usize = 20_000;

/// Typeface for PNG text.
pub struct Typeface(FontVec);

impl Typeface {
    /// Finds the preferred typeface among those installed.
    ///
    /// # Errors
    ///
    /// Returns a message with the remedy if none of the supported typefaces is installed.
    pub fn find() -> Result<Self, String> {
        let mut found = Vec::new();
        let mut left = MAX_ENTRIES;
        FOLDERS.iter().for_each(|folder| collect_typefaces(Path::new(folder), MAX_DEPTH, &mut left, &mut found));
        found.sort();
        let typeface = found.iter().find_map(|(_, path)| FontVec::try_from_vec(std::fs::read(path).ok()?).ok());
        typeface.map(Self).ok_or_else(|| {
            format!(
                "no supported typeface ({}) under {}; install one, for example `apt-get install fonts-dejavu-core`",
                NAMES.join(", "),
                FOLDERS.join(", ")
            )
        })
    }

    /// Returns width and height of a line of text, pixels, for a font size of `em` pixels.
    pub(crate) fn size(&self, text: &str, em: f32) -> (f32, f32) {
        let font = self.0.as_scaled(self.scale(em));
        (text.chars().map(|c| font.h_advance(font.glyph_id(c))).sum(), font.height())
    }

    /// Calls `pixel` with position and coverage, 0 to 1, of each pixel of a line of text. The
    /// origin is the upper left corner.
    pub(crate) fn draw(&self, text: &str, em: f32, mut pixel: impl FnMut(i32, i32, f32)) {
        let font = self.0.as_scaled(self.scale(em));
        let mut x = 0.0;
        for c in text.chars() {
            let id = font.glyph_id(c);
            let glyph = id.with_scale_and_position(self.scale(em), point(x, font.ascent()));
            x += font.h_advance(id);
            if let Some(outline) = font.outline_glyph(glyph) {
                let least = outline.px_bounds().min;
                outline.draw(|dx, dy, covered| pixel(least.x as i32 + dx as i32, least.y as i32 + dy as i32, covered));
            }
        }
    }

    fn scale(&self, em: f32) -> PxScale {
        PxScale::from(em * self.0.height_unscaled() / self.0.units_per_em().unwrap_or(1000.0))
    }
}

/// Collects the files with a name in [`NAMES`], each with the index of its name.
fn collect_typefaces(folder: &Path, depth: usize, left: &mut usize, found: &mut Vec<(usize, PathBuf)>) {
    let Ok(entries) = folder.read_dir() else { return };
    for path in entries.flatten().map(|entry| entry.path()) {
        if *left == 0 {
            return;
        }
        *left -= 1;
        let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        if let Some(rank) = NAMES.iter().position(|known| *known == name) {
            found.push((rank, path));
        } else if depth > 0 && path.is_dir() {
            collect_typefaces(&path, depth - 1, left, found);
        }
    }
}
