//! Reference direction of a course.

use crate::scalars::Scalars;

/// Reference direction of a course or heading.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum CourseReference {
    /// Arbitrary direction: the initial heading, because gyro and accelerometer alone cannot
    /// observe north.
    #[default]
    Arbitrary,
    /// Magnetic north.
    Magnetic,
    /// True north.
    True,
}

impl Scalars for CourseReference {
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
