//! Fault is data: what a message says about how far it can be trusted.

use core::{fmt, ops};

/// A set of flags; they go with a tick from ingest to the end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(transparent)]
pub struct Flags(pub u64);

macro_rules! flags {
    ($($(#[doc = $meaning:literal])+ $name:ident = $bit:literal $text:literal,)*) => {
        impl Flags {
            $($(#[doc = $meaning])+ pub const $name: Self = Self(1 << $bit);)*
            /// Every flag with its name.
            pub const NAMES: &'static [(Self, &'static str)] = &[$((Self::$name, $text)),*];
            /// What each of them means, in the same order.
            pub const MEANINGS: &'static [&'static str] = &[$(concat!($($meaning),+).trim_ascii_start()),*];
        }
    };
}

flags! {
    /// The rate was not finite; the last good one stands in for it.
    RATE_INVALID = 0 "rate-invalid",
    /// The specific force was not finite; the last good one stands in for it and is not used.
    FORCE_INVALID = 1 "force-invalid",
    /// A component of the rate is at the end of its range.
    RATE_CLIPPED = 2 "rate-clipped",
    /// A component of the specific force is at the end of its range.
    FORCE_CLIPPED = 3 "force-clipped",
    /// The gyro has repeated itself for too long to be alive.
    RATE_STUCK = 4 "rate-stuck",
    /// The accelerometer has repeated itself for too long to be alive; it is not used.
    FORCE_STUCK = 5 "force-stuck",
    /// |f| is near zero: it has no direction and is not used.
    FORCE_SMALL = 6 "force-small",
    /// The interval before this sample is longer than a gap's limit.
    GAP = 7 "gap",
    /// The sensor's clock leapt or ran backward; time was continued by the usual interval.
    CLOCK_LEAP = 8 "clock-leap",
    /// Readings before this one came again, or belonged to the past, and were refused.
    REFUSED_BEFORE = 9 "refused-before",
    /// The rate is a value at the interval's end, not the interval's mean.
    RATE_INSTANT = 10 "rate-instant",
    /// The gyro's motion did not arrive; the attitude was held.
    GYRO_MISSING = 11 "gyro-missing",
    /// The accelerometer's point did not arrive; the attitude followed the gyro.
    ACCEL_MISSING = 12 "accel-missing",
    /// Ticks before this one were lost on the way.
    LOST_BEFORE = 13 "lost-before",
    /// The attitude was set anew at this tick.
    ALIGNED = 14 "aligned",
    /// The estimate left the finite numbers and was set anew.
    RESET = 15 "reset",
    /// The body was found to be at rest.
    AT_REST = 16 "at-rest",
    /// Near the vertical: yaw and roll are not told apart.
    NEAR_GIMBAL = 17 "near-gimbal",
    /// No accelerometer has yet been heard: the attitude is only a start.
    UNALIGNED = 18 "unaligned",
    /// A sample of the magnetic field goes with this tick, on the topic `mag`.
    FIELD = 19 "field",
    /// A fix goes with this tick, on the topic `gnss`.
    FIX = 20 "fix",
    /// The magnetic field was beyond its range or not finite, and was left out.
    FIELD_INVALID = 21 "field-invalid",
    /// The fix was not one, and was left out.
    FIX_INVALID = 22 "fix-invalid",
    /// The magnetic field is not that of the place; heading follows the gyro.
    FIELD_DISTURBED = 23 "field-disturbed",
    /// A sample of the magnetic field, or a fix, did not arrive.
    AIDING_MISSING = 24 "aiding-missing",
    /// The launch file's script of faults was at work on this tick or on a reading before it that is gone.
    FAULT_INJECTED = 25 "fault-injected",
    /// Another stage fills a slot from this tick on.
    SWAPPED = 26 "swapped",
}

impl Flags {
    /// No flag.
    pub const NONE: Self = Self(0);

    /// Flags that say nothing bad.
    pub const USUAL: Self =
        Self(Self::RATE_INSTANT.0 | Self::ALIGNED.0 | Self::AT_REST.0 | Self::FIELD.0 | Self::FIX.0);

    /// Any flag of `other` is set.
    pub fn any(self, other: Self) -> bool {
        self.0 & other.0 != 0
    }

    /// `self` when `condition` holds, else none.
    pub fn when(self, condition: bool) -> Self {
        if condition { self } else { Self::NONE }
    }

    /// The names of the flags set, each with what it means.
    pub fn meanings(self) -> impl Iterator<Item = (&'static str, &'static str)> {
        let all = Self::NAMES.iter().zip(Self::MEANINGS);
        all.filter(move |((flag, _), _)| self.any(*flag)).map(|((_, name), meaning)| (*name, *meaning))
    }

    /// The names of the flags set.
    pub fn names(self) -> impl Iterator<Item = &'static str> {
        Self::NAMES.iter().filter(move |(flag, _)| self.any(*flag)).map(|(_, name)| *name)
    }
}

impl ops::BitOr for Flags {
    type Output = Self;
    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

impl ops::BitOrAssign for Flags {
    fn bitor_assign(&mut self, other: Self) {
        self.0 |= other.0;
    }
}

impl fmt::Display for Flags {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut names = self.names();
        if let Some(first) = names.next() {
            write!(f, "{first}")?;
        }
        names.try_for_each(|name| write!(f, " {name}"))
    }
}
