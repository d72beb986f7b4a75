//! Colours of Okabe and Ito 2008, as entries of the 256-colour palette.

use ratatui::style::Color;

/// Colour of the estimate and the sky line.
pub(crate) const BLUE: Color = Color::Indexed(32);
/// Colour of the ground.
pub(crate) const GROUND: Color = Color::Indexed(178);
/// Colour of the state `live`.
pub(crate) const GREEN: Color = Color::Indexed(36);
/// Colour of faults.
pub(crate) const VERMILION: Color = Color::Indexed(166);
/// Colour of secondary text.
pub(crate) const MUTED: Color = Color::Indexed(244);
