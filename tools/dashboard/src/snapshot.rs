//! Data of one frame of the display.

use std::time::Duration;

use crate::{
    orientation::Attitude,
    trend::{Figures, Trends},
};

/// Age at which data become stale.
pub const STALE_AFTER: Duration = Duration::from_millis(500);

/// Data of one frame.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Snapshot {
    /// Name of the system or vehicle.
    pub name: String,
    /// State of the data.
    pub state: DataState,
    /// Key figures of the system.
    pub figures: Figures,
    /// Newest attitude, if any.
    pub attitude: Option<Attitude>,
    /// Trends of the last minute.
    pub trends: Trends,
    /// Panels from top to bottom. The last one takes the remaining height.
    pub panels: Vec<Panel>,
    /// Line that explains the keys.
    pub key_help: &'static str,
}

/// State of the data.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub enum DataState {
    /// No data received yet.
    #[default]
    Connecting,
    /// Data are being received.
    Live,
    /// Data have been received, but not recently. The field is the age of the newest data.
    Stale(Duration),
    /// The data have ended. The field is the reason.
    Ended(String),
}

impl DataState {
    /// Returns the state for the age of the newest data, or [`DataState::Connecting`] if there are
    /// no data.
    pub fn from_age(age: Option<Duration>) -> Self {
        match age {
            None => Self::Connecting,
            Some(age) if age < STALE_AFTER => Self::Live,
            Some(age) => Self::Stale(age),
        }
    }

    /// Returns the label for display.
    pub fn label(&self) -> String {
        match self {
            Self::Connecting => "connecting".into(),
            Self::Live => "live".into(),
            Self::Stale(age) => format!("stale {:.1} s", age.as_secs_f64()),
            Self::Ended(reason) => format!("ended: {reason}"),
        }
    }
}

/// Table with a title.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Panel {
    /// Title.
    pub title: String,
    /// Rows from top to bottom.
    pub rows: Vec<Row>,
}

/// Row of a panel.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Row {
    /// Text.
    pub text: String,
    /// Style.
    pub style: RowStyle,
}

/// Style of a row. The style only emphasises what the text states.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RowStyle {
    /// Column headers.
    Header,
    /// Normal row.
    Normal,
    /// Row with a fault.
    Alert,
    /// Row of the item shown in detail.
    Selected,
}

impl Row {
    /// Creates a row.
    pub fn new(style: RowStyle, text: impl Into<String>) -> Self {
        Self { text: text.into(), style }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn data_state_labels() {
        let label = |ms| DataState::from_age(Some(Duration::from_millis(ms))).label();
        assert_eq!([label(0), label(499), label(500), label(1234)], ["live", "live", "stale 0.5 s", "stale 1.2 s"]);
        assert_eq!(DataState::from_age(None).label(), "connecting");
        assert_eq!(DataState::Ended("stopped".into()).label(), "ended: stopped");
    }
}
