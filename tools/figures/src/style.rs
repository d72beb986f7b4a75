//! Colours, text sizes and line styles.
//!
//! The palette is that of Okabe and Ito 2008. Its colours can also be distinguished by people with
//! colour vision deficiency.

use plotters::style::RGBColor;

/// Blue of the palette.
pub const BLUE: RGBColor = RGBColor(0, 114, 178);
/// Vermilion of the palette.
pub const ORANGE: RGBColor = RGBColor(213, 94, 0);
/// Bluish green of the palette.
pub const GREEN: RGBColor = RGBColor(0, 158, 115);
/// Reddish purple of the palette.
pub const PURPLE: RGBColor = RGBColor(204, 121, 167);
/// Sky blue of the palette.
pub const SKY: RGBColor = RGBColor(86, 180, 233);
/// Orange of the palette.
pub const AMBER: RGBColor = RGBColor(230, 159, 0);
/// Grey for annotations.
pub const GREY: RGBColor = RGBColor(90, 90, 90);
/// Near-black for text and the reference.
pub const TEXT_COLOR: RGBColor = RGBColor(26, 26, 26);

/// Font family and size of titles.
pub const TITLE: (&str, u32) = ("sans-serif", 18);
/// Font family and size of all text except titles.
pub const TEXT: (&str, u32) = ("sans-serif", 14);

/// Line style of a curve.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LineStyle {
    /// Line one pixel wide.
    Thin,
    /// Line two pixels wide.
    Thick,
    /// Line four pixels wide.
    Wide,
    /// Cloud of dots instead of a line.
    Dots,
    /// Dashed line, two pixels wide. The fields are the lengths of a dash and of a gap along the
    /// horizontal axis, in pixels.
    Dashed(u32, u32),
}

impl LineStyle {
    /// Returns the line width, pixels.
    pub(crate) fn width(self) -> u32 {
        match self {
            Self::Wide => 4,
            Self::Thick | Self::Dashed(..) => 2,
            Self::Thin | Self::Dots => 1,
        }
    }
}

/// Colour and line style of the reference curve.
pub const REFERENCE: (RGBColor, LineStyle) = (TEXT_COLOR, LineStyle::Dashed(7, 4));

const COLORS: [RGBColor; 6] = [BLUE, PURPLE, GREEN, AMBER, SKY, ORANGE];
const STYLES: [LineStyle; 5] = [
    LineStyle::Thick,
    LineStyle::Dashed(12, 4),
    LineStyle::Dashed(5, 3),
    LineStyle::Dashed(20, 6),
    LineStyle::Dashed(2, 3),
];

/// Returns the colour and line style of the curve with this index. The first 30 combinations are
/// unique.
pub fn series_style(index: usize) -> (RGBColor, LineStyle) {
    (COLORS[index % COLORS.len()], STYLES[index % STYLES.len()])
}

/// Formats a number without trailing zeros or a negative zero, for example 20 instead of 20.0.
pub fn format_number(value: &f64) -> String {
    // The tick labels of an axis are sums with rounding errors, so tiny values count as zero.
    let value = if value.abs() < 1e-9 { &0.0 } else { value };
    let text = if *value != 0.0 && value.abs() < 1e-3 { format!("{value:.0e}") } else { format!("{value:.3}") };
    let short = if text.contains('e') { &text } else { text.trim_end_matches('0').trim_end_matches('.') };
    if short == "-0" { "0".into() } else { short.replace('-', "−") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn series_styles_are_unique_and_neighbours_differ_in_both() {
        let places: Vec<_> = (0..COLORS.len() * STYLES.len()).map(series_style).collect();
        for (at, one) in places.iter().enumerate() {
            assert!(places[..at].iter().all(|other| other != one), "{at}");
        }
        assert!(places.windows(2).all(|pair| pair[0].0 != pair[1].0 && pair[0].1 != pair[1].1));
        assert!(places.iter().all(|place| *place != REFERENCE));
    }

    #[test]
    fn numbers_are_formatted_without_trailing_zeros() {
        assert_eq!([20.0, 0.5, -0.0, -0.25, 2e-4].map(|x| format_number(&x)), ["20", "0.5", "0", "−0.25", "2e−4"]);
    }
}
