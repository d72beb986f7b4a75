"""Values that the native classes return."""

from enum import IntFlag
from typing import Any, NamedTuple, TypedDict


class Angles(NamedTuple):
    """Yaw, pitch and roll, rad."""

    yaw_rad: float
    """Yaw by the convention of the frame; native: counter-clockwise from above."""
    pitch_rad: float
    """Pitch by the convention of the frame; native: nose up."""
    roll_rad: float
    """Roll by the convention of the frame; native: right side down."""


class Parameter(NamedTuple):
    """Adjustable parameter of a stage."""

    name: str
    """Name, with the unit as its suffix."""
    unit: str
    """Unit; empty for a dimensionless number."""
    default: float
    """Default value."""
    min: float
    """Minimum allowed value."""
    max: float
    """Maximum allowed value."""
    description: str
    """Meaning in one sentence."""


class Segment(NamedTuple):
    """Part of a log between two restarts of its clock."""

    first_ns: int
    """Time of the first sample, ns."""
    last_ns: int
    """Time of the last sample, ns."""
    samples: int
    """Number of samples."""


class RecordedSensor(NamedTuple):
    """Sensor of a log, one of several that can be read."""

    option: str
    """Kind and index, such as "--imu 1"; the argument of `read` is then imu=1."""
    name: str
    """Name of the sensor in the log."""
    samples: int
    """Number of samples."""
    rate_hz: float
    """Mean rate, Hz; NaN if unknown."""
    state: str
    """State, such as "healthy"."""
    is_read: bool
    """True if the samples are those of this sensor."""


class Errors(TypedDict):
    """Root mean square errors over the scored samples; None if there is no reference."""

    total: float | None
    """Angle of the total rotation, degrees; None if the heading is arbitrary."""
    heading: float | None
    """Rotation about the vertical, degrees; None if the heading is arbitrary."""
    inclination: float | None
    """Angle between the estimated and the true vertical, degrees."""
    roll: float | None
    """Error of the roll, degrees."""
    pitch: float | None
    """Error of the pitch, degrees."""
    yaw: float | None
    """Error of the yaw, degrees; None if the heading is arbitrary."""
    course: float | None
    """Error of the published course, degrees; None if its reference is arbitrary."""
    gyro_bias_deg_s: float | None
    """Error of the gyro bias, °/s; known in simulations only."""
    drift_deg_min: float | None
    """Drift rate of an arbitrary heading, °/min, counter-clockwise from above."""
    drift_end_deg: float | None
    """Drift of an arbitrary heading at the end, degrees."""


class TrialScore(Errors):
    """Score of one recording, or of a segment."""

    name: str
    """File name without its extension."""
    heading_is_known: bool
    """True if the heading is known at the end."""
    normalised: dict[str, Any]
    """Errors divided by their reported standard deviations."""
    scored: int
    """Number of scored samples."""
    ticks: int
    """Number of samples."""
    ns_per_update: float | None
    """CPU time per update, ns. It differs between runs."""


class Score(TypedDict):
    """Score of a fuser stage."""

    fuser: str
    """Name of the fuser stage."""
    gyro: str
    """Name of the gyro stage."""
    accel: str
    """Name of the accel stage."""
    course: str
    """Name of the course stage."""
    settings: dict[str, float]
    """Parameters that differ from the defaults, as slot.name."""
    trials: list[TrialScore]
    """Score of each recording."""
    mean: Errors
    """Mean over the recordings with a reference."""
    normalised: dict[str, Any]
    """Normalised errors over the samples of all recordings."""
    ns_per_update: float | None
    """Mean CPU time per update, ns. It differs between runs."""
    warnings: list[str]
    """Findings that make the score doubtful, such as an implausible unit."""


class Flags(IntFlag):
    """Faults and events of a sample."""

    RATE_INVALID = 1 << 0
    """The rate is not finite and was replaced by the last valid one."""
    FORCE_INVALID = 1 << 1
    """The specific force is not finite; the last valid one is forwarded but not used."""
    RATE_CLIPPED = 1 << 2
    """A component of the rate is at the limit of the sensor's range."""
    FORCE_CLIPPED = 1 << 3
    """A component of the specific force is at the limit of the sensor's range."""
    RATE_STUCK = 1 << 4
    """The gyro has repeated the same value for too long and is considered stuck."""
    FORCE_STUCK = 1 << 5
    """The accelerometer has repeated the same value for too long; it is considered stuck and not used."""
    FORCE_SMALL = 1 << 6
    """The specific force is near zero. It has no direction then, and is not used."""
    GAP = 1 << 7
    """The interval before this sample exceeds the gap limit."""
    CLOCK_LEAP = 1 << 8
    """The sensor's clock jumped or ran backwards; time was continued with the usual interval."""
    REFUSED_BEFORE = 1 << 9
    """Earlier readings were rejected because they were duplicated or out of order."""
    RATE_INSTANT = 1 << 10
    """The rate is the value at the end of the interval, not its mean."""
    GYRO_MISSING = 1 << 11
    """The output of the gyro service did not arrive, so the attitude was held."""
    ACCEL_MISSING = 1 << 12
    """The output of the accel service did not arrive, so the attitude followed the gyro."""
    LOST_BEFORE = 1 << 13
    """Ticks before this one were lost in transit."""
    ALIGNED = 1 << 14
    """The attitude was re-initialised at this tick."""
    RESET = 1 << 15
    """The estimate was not finite and was reset."""
    AT_REST = 1 << 16
    """The body was detected to be at rest."""
    NEAR_GIMBAL = 1 << 17
    """The nose is near the vertical, where yaw and roll cannot be distinguished."""
    UNALIGNED = 1 << 18
    """No accelerometer sample has arrived yet; the attitude is only an initial value."""
    FIELD = 1 << 19
    """The topic `mag` has a magnetic field sample for this tick."""
    FIX = 1 << 20
    """The topic `gnss` has a fix for this tick."""
    FIELD_INVALID = 1 << 21
    """The magnetic field was out of range or not finite and was discarded."""
    FIX_INVALID = 1 << 22
    """The fix was invalid and was discarded."""
    FIELD_DISTURBED = 1 << 23
    """The magnetic field differs from that of the location; the heading follows the gyro."""
    AIDING_MISSING = 1 << 24
    """A magnetic field sample or a fix did not arrive."""
    FAULT_INJECTED = 1 << 25
    """The fault script of the launch file altered this tick, or dropped a reading before it."""
    SWAPPED = 1 << 26
    """Another stage runs in a slot from this tick on."""
