//! Per-tick flags for faults, events and restricted validity.

use core::{fmt, ops};

/// Set of flags of a tick, passed on from ingest to the last service.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "bytemuck", derive(bytemuck::Pod, bytemuck::Zeroable))]
#[repr(transparent)]
pub struct Flags(pub u64);

macro_rules! flags {
    ($($(#[doc = $meaning:literal])+ $name:ident = $bit:literal $text:literal,)*) => {
        impl Flags {
            $($(#[doc = $meaning])+ pub const $name: Self = Self(1 << $bit);)*
            /// All flags with their names.
            pub const NAMES: &'static [(Self, &'static str)] = &[$((Self::$name, $text)),*];
            /// Meanings of the flags, in the order of [`NAMES`](Self::NAMES).
            pub const MEANINGS: &'static [&'static str] = &[$(concat!($($meaning),+).trim_ascii_start()),*];
        }
    };
}

flags! {
    /// The rate is not finite and was replaced by the last valid one.
    RATE_INVALID = 0 "rate-invalid",
    /// The specific force is not finite; the last valid one is forwarded but not used.
    FORCE_INVALID = 1 "force-invalid",
    /// A component of the rate is at the limit of the sensor's range.
    RATE_CLIPPED = 2 "rate-clipped",
    /// A component of the specific force is at the limit of the sensor's range.
    FORCE_CLIPPED = 3 "force-clipped",
    /// The gyro has repeated the same value for too long and is considered stuck.
    RATE_STUCK = 4 "rate-stuck",
    /// The accelerometer has repeated the same value for too long; it is considered stuck and not
    /// used.
    FORCE_STUCK = 5 "force-stuck",
    /// The specific force is near zero. It has no direction then, and is not used.
    FORCE_SMALL = 6 "force-small",
    /// The interval before this sample exceeds the gap limit.
    GAP = 7 "gap",
    /// The sensor's clock jumped or ran backwards; time was continued with the usual interval.
    CLOCK_LEAP = 8 "clock-leap",
    /// Earlier readings were rejected because they were duplicated or out of order.
    REFUSED_BEFORE = 9 "refused-before",
    /// The rate is the value at the end of the interval, not its mean.
    RATE_INSTANT = 10 "rate-instant",
    /// The output of the gyro service did not arrive, so the attitude was held.
    GYRO_MISSING = 11 "gyro-missing",
    /// The output of the accel service did not arrive, so the attitude followed the gyro.
    ACCEL_MISSING = 12 "accel-missing",
    /// Ticks before this one were lost in transit.
    LOST_BEFORE = 13 "lost-before",
    /// The attitude was re-initialised at this tick.
    ALIGNED = 14 "aligned",
    /// The estimate was not finite and was reset.
    RESET = 15 "reset",
    /// The body was detected to be at rest.
    AT_REST = 16 "at-rest",
    /// The nose is near the vertical, where yaw and roll cannot be distinguished.
    NEAR_GIMBAL = 17 "near-gimbal",
    /// No accelerometer sample has arrived yet; the attitude is only an initial value.
    UNALIGNED = 18 "unaligned",
    /// The topic `mag` has a magnetic field sample for this tick.
    FIELD = 19 "field",
    /// The topic `gnss` has a fix for this tick.
    FIX = 20 "fix",
    /// The magnetic field was out of range or not finite and was discarded.
    FIELD_INVALID = 21 "field-invalid",
    /// The fix was invalid and was discarded.
    FIX_INVALID = 22 "fix-invalid",
    /// The magnetic field differs from that of the location; the heading follows the gyro.
    FIELD_DISTURBED = 23 "field-disturbed",
    /// A magnetic field sample or a fix did not arrive.
    AIDING_MISSING = 24 "aiding-missing",
    /// The fault script of the launch file altered this tick, or dropped a reading before it.
    FAULT_INJECTED = 25 "fault-injected",
    /// Another stage runs in a slot from this tick on.
    SWAPPED = 26 "swapped",
}

impl Flags {
    /// Empty set of flags.
    pub const NONE: Self = Self(0);

    /// Flags that do not indicate a problem.
    pub const INFORMATIONAL: Self =
        Self(Self::RATE_INSTANT.0 | Self::ALIGNED.0 | Self::AT_REST.0 | Self::FIELD.0 | Self::FIX.0);

    /// Returns `true` if `self` contains at least one flag of `other`.
    pub fn any(self, other: Self) -> bool {
        self.0 & other.0 != 0
    }

    /// Returns `self` if `condition` is true, else [`NONE`](Self::NONE).
    pub fn when(self, condition: bool) -> Self {
        if condition { self } else { Self::NONE }
    }

    /// Returns the names of the flags that are set.
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
