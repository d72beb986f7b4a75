//! What is drawn: plain data.

use std::time::Duration;

use crate::Trends;

/// Data older than this are stale.
pub const STALE_AFTER: Duration = Duration::from_millis(500);

/// One picture of a system.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Picture {
    /// The system's or the vehicle's name.
    pub name: String,
    /// How the data are.
    pub state: State,
    /// Numbers of the system as a whole.
    pub facts: Facts,
    /// How it lies, as far as known.
    pub attitude: Option<Attitude>,
    /// The last minute.
    pub trends: Trends,
    /// Lines of text below one another; the last takes the room that is left.
    pub panels: Vec<Panel>,
    /// What the keys do.
    pub keys: &'static str,
}

/// How the data are.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub enum State {
    /// Nothing has come yet.
    #[default]
    Connecting,
    /// They come.
    Live,
    /// They have stopped for so long.
    Stale(Duration),
    /// No more will come, for this reason.
    Ended(String),
}

impl State {
    /// Of data whose newest has this age; `None` where nothing has come.
    pub fn of_age(age: Option<Duration>) -> Self {
        match age {
            None => Self::Connecting,
            Some(age) if age < STALE_AFTER => Self::Live,
            Some(age) => Self::Stale(age),
        }
    }

    /// The word for it.
    pub fn word(&self) -> String {
        match self {
            Self::Connecting => "connecting".into(),
            Self::Live => "live".into(),
            Self::Stale(age) => format!("stale {:.1} s", age.as_secs_f64()),
            Self::Ended(reason) => format!("ended: {reason}"),
        }
    }
}

/// Numbers of a system as a whole; what is unknown is `None`.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Facts {
    /// The newest tick.
    pub tick: Option<u64>,
    /// Attitudes per second.
    pub rate_hz: Option<f64>,
    /// From birth to attitude, median and 99 %, µs.
    pub latency_us: Option<[f64; 2]>,
    /// What was lost.
    pub lost: Option<u64>,
}

/// How a body lies. Angles and rate are of the frame that is named.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Attitude {
    /// The direction up in the body's axes right, forward, up; of unit length.
    pub up: [f64; 3],
    /// Roll, pitch, yaw, °.
    pub roll_pitch_yaw_deg: [f64; 3],
    /// Standard deviation of the inclination, °.
    pub inclination_sd_deg: Option<f64>,
    /// Course, ° clockwise from above.
    pub course_deg: f64,
    /// Its standard deviation, °; `None` where nothing is known.
    pub course_sd_deg: Option<f64>,
    /// What it is counted from: arb., mag., true.
    pub course_reference: &'static str,
    /// Body rate less the bias, °/s.
    pub rate_deg_s: [f64; 3],
    /// The frame's name.
    pub frame: &'static str,
    /// Names of what is not as it should be.
    pub flags: Vec<&'static str>,
}

/// Lines of text with a title.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Panel {
    /// What they are.
    pub title: String,
    /// The lines.
    pub rows: Vec<Row>,
}

/// A line.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Row {
    /// The text.
    pub text: String,
    /// What it is.
    pub mark: Mark,
}

/// What a line is, which its words say as well.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mark {
    /// Names of columns.
    Head,
    /// As usual.
    Usual,
    /// Something is wrong.
    Bad,
    /// The one that is shown in detail.
    Chosen,
}

impl Row {
    /// A line.
    pub fn new(mark: Mark, text: impl Into<String>) -> Self {
        Self { text: text.into(), mark }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_state_is_told_by_its_word() {
        let ms = |ms| State::of_age(Some(Duration::from_millis(ms))).word();
        assert_eq!([ms(0), ms(499), ms(500), ms(1234)], ["live", "live", "stale 0.5 s", "stale 1.2 s"]);
        assert_eq!(State::of_age(None).word(), "connecting");
        assert_eq!(State::Ended("stopped".into()).word(), "ended: stopped");
    }
}
