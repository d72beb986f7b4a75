//! The direction from which a course is counted.

use crate::numbers::Numbers;

/// From which direction a course is counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Reference {
    /// From wherever the attitude began: gyro and accelerometer alone cannot know north.
    #[default]
    Arbitrary,
    /// From magnetic north.
    Magnetic,
    /// From true north.
    True,
}

impl Numbers for Reference {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let mut value = match self {
            Self::Arbitrary => 0.0,
            Self::Magnetic => 1.0,
            Self::True => 2.0,
        };
        visit(&mut value);
        *self = match value {
            value if value > 1.5 => Self::True,
            value if value > 0.5 => Self::Magnetic,
            _ => Self::Arbitrary,
        };
    }
}
