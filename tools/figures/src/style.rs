//! Colours, sizes of text, how lines differ.

use plotters::style::RGBColor;

/// Colours of Okabe and Ito 2008, which people of any colour vision tell apart.
pub const BLUE: RGBColor = RGBColor(0, 114, 178);
/// Vermilion.
pub const ORANGE: RGBColor = RGBColor(213, 94, 0);
/// Bluish green.
pub const GREEN: RGBColor = RGBColor(0, 158, 115);
/// Reddish purple.
pub const PURPLE: RGBColor = RGBColor(204, 121, 167);
/// Sky blue.
pub const SKY: RGBColor = RGBColor(86, 180, 233);
/// Their orange.
pub const AMBER: RGBColor = RGBColor(230, 159, 0);
/// Of what is beside the data.
pub const GREY: RGBColor = RGBColor(90, 90, 90);
/// Of text, and of the truth.
pub const TEXT_COLOR: RGBColor = RGBColor(26, 26, 26);

/// Size of a title.
pub const TITLE: (&str, u32) = ("sans-serif", 18);
/// Size of other text.
pub const TEXT: (&str, u32) = ("sans-serif", 14);

/// How a line of a curve is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Style {
    /// One pixel wide.
    Thin,
    /// Two.
    Thick,
    /// Four.
    Wide,
    /// A cloud of dots.
    Dots,
    /// Broken: so many pixels along the axis drawn, and so many left out.
    Dashed(u32, u32),
}

impl Style {
    /// Pixels.
    pub(crate) fn width(self) -> u32 {
        match self {
            Self::Wide => 4,
            Self::Thick | Self::Dashed(..) => 2,
            Self::Thin | Self::Dots => 1,
        }
    }
}

/// Of the truth.
pub const REFERENCE: (RGBColor, Style) = (TEXT_COLOR, Style::Dashed(7, 4));

const COLORS: [RGBColor; 6] = [BLUE, PURPLE, GREEN, AMBER, SKY, ORANGE];
const STYLES: [Style; 5] =
    [Style::Thick, Style::Dashed(12, 4), Style::Dashed(5, 3), Style::Dashed(20, 6), Style::Dashed(2, 3)];

/// Of the curve at a place among several: each of the first 30 has a colour and a style that no other one has both of.
pub fn of_place(place: usize) -> (RGBColor, Style) {
    (COLORS[place % COLORS.len()], STYLES[place % STYLES.len()])
}

/// A number as short as it is: 20, 0.5, not 20.0, −0.0.
pub fn number(value: &f64) -> String {
    // What is left of a sum of ticks is none.
    let value = if value.abs() < 1e-9 { &0.0 } else { value };
    let text = if *value != 0.0 && value.abs() < 1e-3 { format!("{value:.0e}") } else { format!("{value:.3}") };
    let short = if text.contains('e') { &text } else { text.trim_end_matches('0').trim_end_matches('.') };
    if short == "-0" { "0".into() } else { short.replace('-', "−") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_differ_by_colour_or_style_and_neighbours_by_both() {
        let places: Vec<_> = (0..COLORS.len() * STYLES.len()).map(of_place).collect();
        for (at, one) in places.iter().enumerate() {
            assert!(places[..at].iter().all(|other| other != one), "{at}");
        }
        assert!(places.windows(2).all(|pair| pair[0].0 != pair[1].0 && pair[0].1 != pair[1].1));
        assert!(places.iter().all(|place| *place != REFERENCE));
    }

    #[test]
    fn numbers_are_as_short_as_they_are() {
        assert_eq!([20.0, 0.5, -0.0, -0.25, 2e-4].map(|x| number(&x)), ["20", "0.5", "0", "−0.25", "2e−4"]);
    }
}
