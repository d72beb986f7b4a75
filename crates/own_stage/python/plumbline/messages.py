"""The payloads of Plumbline's topics. Written by `plumb stage header --lang python`; not to be edited."""

import ctypes

CHECKPOINT_WORDS = 576
# In the order of their wake words.
TOPICS = ("sensor", "receiver", "imu", "mag", "gnss", "reference", "gyro", "accel", "fused", "attitude", "credit", "checkpoint", "difference", "control", "health")
# In the order of the field `service`.
SLOTS = ("ingest", "gyro", "accel", "fuser", "course")
CHART_UPRIGHT = 0
CHART_INVERTED = 1
COURSE_ARBITRARY = 0
COURSE_MAGNETIC = 1
COURSE_TRUE = 2
STATE_READY = 1
STATE_RUNNING = 2
STATE_FINISHED = 3


class Flag:
    """Fault is data: what a message says about how far it can be trusted."""

    RATE_INVALID = 1 << 0
    FORCE_INVALID = 1 << 1
    RATE_CLIPPED = 1 << 2
    FORCE_CLIPPED = 1 << 3
    RATE_STUCK = 1 << 4
    FORCE_STUCK = 1 << 5
    FORCE_SMALL = 1 << 6
    GAP = 1 << 7
    CLOCK_LEAP = 1 << 8
    REFUSED_BEFORE = 1 << 9
    RATE_INSTANT = 1 << 10
    GYRO_MISSING = 1 << 11
    ACCEL_MISSING = 1 << 12
    LOST_BEFORE = 1 << 13
    ALIGNED = 1 << 14
    RESET = 1 << 15
    AT_REST = 1 << 16
    NEAR_GIMBAL = 1 << 17
    UNALIGNED = 1 << 18
    FIELD = 1 << 19
    FIX = 1 << 20
    FIELD_INVALID = 1 << 21
    FIX_INVALID = 1 << 22
    FIELD_DISTURBED = 1 << 23
    AIDING_MISSING = 1 << 24
    FAULT_INJECTED = 1 << 25
    EXCHANGED = 1 << 26


class Header(ctypes.Structure):
    """Where a message comes from: the tick, unchanged from ingest to the end, and what happened to it on the way."""

    _fields_ = [
        # The number ingest gave to the IMU sample, from 0, without a gap.
        ("tick", ctypes.c_uint64),
        # Start of the sample's interval on the source's clock, ns.
        ("t_start_ns", ctypes.c_int64),
        # End of the sample's interval on the source's clock, ns; grows with every tick.
        ("t_end_ns", ctypes.c_int64),
        # When ingest took the sample, CLOCK_MONOTONIC, ns.
        ("t_born_ns", ctypes.c_uint64),
        # When this message was published, CLOCK_MONOTONIC, ns.
        ("t_sent_ns", ctypes.c_uint64),
        # Ticks before this one that its stream does not have.
        ("lost_upstream", ctypes.c_uint64),
        # What is to be said about the sample and what was made of it.
        ("flags", ctypes.c_uint64),
        # The supervisor's decision under which the sender owns its slot.
        ("epoch", ctypes.c_uint32),
        # The life of the sender.
        ("incarnation", ctypes.c_uint32),
    ]


class SensorReading(ctypes.Structure):
    """A reading as it comes from a sensor, before anything was checked: any value may be NaN."""

    TOPIC = "sensor"
    LAYOUT = "plumbline.SensorReading.1 80 t_sensor_ns:i64@0 rate_rad_s:[f64; 3]@8 force_m_s2:[f64; 3]@32 field_ut:[f64; 3]@56"
    _fields_ = [
        # The sensor's own time stamp, ns.
        ("t_sensor_ns", ctypes.c_int64),
        # Body rate, rad/s.
        ("rate_rad_s", ctypes.c_double * 3),
        # Specific force, m/s².
        ("force_m_s2", ctypes.c_double * 3),
        # Magnetic field, µT; NaN where this reading brings none.
        ("field_ut", ctypes.c_double * 3),
    ]

    @staticmethod
    def type_name():
        return "plumbline.SensorReading.1"


class ReceiverReading(ctypes.Structure):
    """A fix as it comes from a satellite receiver, before anything was checked; it belongs to the next sensor reading."""

    TOPIC = "receiver"
    LAYOUT = "plumbline.ReceiverReading.1 48 velocity_m_s:[f64; 3]@0 velocity_sd_m_s:f64@24 age_s:f64@32 latitude_rad:f64@40"
    _fields_ = [
        # Velocity over ground, m/s, east, north, up.
        ("velocity_m_s", ctypes.c_double * 3),
        # Standard deviation of each component, m/s; NaN where unknown.
        ("velocity_sd_m_s", ctypes.c_double),
        # How old the velocity is on arrival, s; NaN where unknown.
        ("age_s", ctypes.c_double),
        # Geodetic latitude, rad, north positive; NaN where unknown.
        ("latitude_rad", ctypes.c_double),
    ]

    @staticmethod
    def type_name():
        return "plumbline.ReceiverReading.1"


class ImuSample(ctypes.Structure):
    """One checked IMU sample: finite, its time grows, what is wrong with it is in the flags."""

    TOPIC = "imu"
    LAYOUT = "plumbline.ImuSample.1 112 tick:u64@0 t_start_ns:i64@8 t_end_ns:i64@16 t_born_ns:u64@24 t_sent_ns:u64@32 lost_upstream:u64@40 flags:Flags@48 epoch:u32@56 incarnation:u32@60 rate_rad_s:[f64; 3]@64 force_m_s2:[f64; 3]@88"
    _fields_ = [
        ("header", Header),
        # Body rate, rad/s, body axes.
        ("rate_rad_s", ctypes.c_double * 3),
        # Specific force, m/s², body axes; up at rest.
        ("force_m_s2", ctypes.c_double * 3),
    ]

    @staticmethod
    def type_name():
        return "plumbline.ImuSample.1"


class MagSample(ctypes.Structure):
    """The magnetic field at a tick; the sample of that tick is flagged field."""

    TOPIC = "mag"
    LAYOUT = "plumbline.MagSample.1 88 tick:u64@0 t_start_ns:i64@8 t_end_ns:i64@16 t_born_ns:u64@24 t_sent_ns:u64@32 lost_upstream:u64@40 flags:Flags@48 epoch:u32@56 incarnation:u32@60 field_ut:[f64; 3]@64"
    _fields_ = [
        ("header", Header),
        # Magnetic field, µT, body axes.
        ("field_ut", ctypes.c_double * 3),
    ]

    @staticmethod
    def type_name():
        return "plumbline.MagSample.1"


class GnssFix(ctypes.Structure):
    """What a satellite receiver said, at the tick at which it arrived; the sample of that tick is flagged fix."""

    TOPIC = "gnss"
    LAYOUT = "plumbline.GnssFix.1 112 tick:u64@0 t_start_ns:i64@8 t_end_ns:i64@16 t_born_ns:u64@24 t_sent_ns:u64@32 lost_upstream:u64@40 flags:Flags@48 epoch:u32@56 incarnation:u32@60 velocity_m_s:[f64; 3]@64 velocity_sd_m_s:f64@88 age_s:f64@96 latitude_rad:f64@104"
    _fields_ = [
        ("header", Header),
        # Velocity over ground, m/s, east, north, up.
        ("velocity_m_s", ctypes.c_double * 3),
        # Standard deviation of each component, m/s; NaN where unknown.
        ("velocity_sd_m_s", ctypes.c_double),
        # How old the velocity was on arrival, s; NaN where unknown.
        ("age_s", ctypes.c_double),
        # Geodetic latitude, rad, north positive; NaN where unknown.
        ("latitude_rad", ctypes.c_double),
    ]

    @staticmethod
    def type_name():
        return "plumbline.GnssFix.1"


class Reference(ctypes.Structure):
    """The true attitude at a tick, as far as the source knows it."""

    TOPIC = "reference"
    LAYOUT = "plumbline.Reference.1 48 tick:u64@0 scored:u64@8 quaternion:[f64; 4]@16"
    _fields_ = [
        # The IMU sample's tick.
        ("tick", ctypes.c_uint64),
        # 1 where an estimate is to be judged by it, else 0.
        ("scored", ctypes.c_uint64),
        # Body → reference, w x y z, unit.
        ("quaternion", ctypes.c_double * 4),
    ]

    @staticmethod
    def type_name():
        return "plumbline.Reference.1"


class GyroStep(ctypes.Structure):
    """The motion over one tick's interval."""

    TOPIC = "gyro"
    LAYOUT = "plumbline.GyroStep.1 152 tick:u64@0 t_start_ns:i64@8 t_end_ns:i64@16 t_born_ns:u64@24 t_sent_ns:u64@32 lost_upstream:u64@40 flags:Flags@48 epoch:u32@56 incarnation:u32@60 w:[f64; 2]@64 z_rad:f64@80 chart:Chart@88 p:[f64; 2]@96 s:[f64; 2]@112 rate_rad_s:[f64; 3]@128"
    _fields_ = [
        ("header", Header),
        # Open-loop point u, v at the interval's end.
        ("w", ctypes.c_double * 2),
        # Open-loop turn about the vertical, rad.
        ("z_rad", ctypes.c_double),
        # The chart of w and z_rad.
        ("chart", ctypes.c_uint64),
        # The body's turn over the interval, p = d0 + j d3.
        ("p", ctypes.c_double * 2),
        # The body's turn over the interval, s = d1 + j d2.
        ("s", ctypes.c_double * 2),
        # Mean rate over the interval, rad/s, body axes.
        ("rate_rad_s", ctypes.c_double * 3),
    ]

    @staticmethod
    def type_name():
        return "plumbline.GyroStep.1"


class AccelPoint(ctypes.Structure):
    """Where the accelerometer sees up."""

    TOPIC = "accel"
    LAYOUT = "plumbline.AccelPoint.1 128 tick:u64@0 t_start_ns:i64@8 t_end_ns:i64@16 t_born_ns:u64@24 t_sent_ns:u64@32 lost_upstream:u64@40 flags:Flags@48 epoch:u32@56 incarnation:u32@60 w:[f64; 2]@64 chart:Chart@80 norm_m_s2:f64@88 trust:f64@96 force_m_s2:[f64; 3]@104"
    _fields_ = [
        ("header", Header),
        # u, v.
        ("w", ctypes.c_double * 2),
        # The chart of w.
        ("chart", ctypes.c_uint64),
        # |f|, m/s².
        ("norm_m_s2", ctypes.c_double),
        # 1 at |f| = g, 0 where the point is not from this sample.
        ("trust", ctypes.c_double),
        # Specific force, m/s², body axes.
        ("force_m_s2", ctypes.c_double * 3),
    ]

    @staticmethod
    def type_name():
        return "plumbline.AccelPoint.1"


class FusedState(ctypes.Structure):
    """The fused attitude."""

    TOPIC = "fused"
    LAYOUT = "plumbline.FusedState.1 184 tick:u64@0 t_start_ns:i64@8 t_end_ns:i64@16 t_born_ns:u64@24 t_sent_ns:u64@32 lost_upstream:u64@40 flags:Flags@48 epoch:u32@56 incarnation:u32@60 w:[f64; 2]@64 z_rad:f64@80 chart:Chart@88 rate_rad_s:[f64; 3]@96 bias_rad_s:[f64; 3]@120 innovation_rad:f64@144 inclination_sd_rad:f64@152 heading_sd_rad:f64@160 course_reference:CourseReference@168 reset_counter:u64@176"
    _fields_ = [
        ("header", Header),
        # u, v.
        ("w", ctypes.c_double * 2),
        # Turn about the vertical, rad.
        ("z_rad", ctypes.c_double),
        # The chart of w and z_rad.
        ("chart", ctypes.c_uint64),
        # Body rate less the bias, rad/s, body axes.
        ("rate_rad_s", ctypes.c_double * 3),
        # Gyro bias, rad/s, body axes; zero where the stage does not estimate it.
        ("bias_rad_s", ctypes.c_double * 3),
        # Angle between the accelerometer's up and the attitude's, rad.
        ("innovation_rad", ctypes.c_double),
        # Standard deviation of the inclination, rad.
        ("inclination_sd_rad", ctypes.c_double),
        # Standard deviation of the heading, rad; π where nothing is known.
        ("heading_sd_rad", ctypes.c_double),
        # What the heading is counted from.
        ("course_reference", ctypes.c_uint64),
        # Times the attitude was set anew.
        ("reset_counter", ctypes.c_uint64),
    ]

    @staticmethod
    def type_name():
        return "plumbline.FusedState.1"


class AttitudeOutput(ctypes.Structure):
    """The attitude as people and autopilots read it."""

    TOPIC = "attitude"
    LAYOUT = "plumbline.AttitudeOutput.1 224 tick:u64@0 t_start_ns:i64@8 t_end_ns:i64@16 t_born_ns:u64@24 t_sent_ns:u64@32 lost_upstream:u64@40 flags:Flags@48 epoch:u32@56 incarnation:u32@60 quaternion:[f64; 4]@64 yaw_rad:f64@96 pitch_rad:f64@104 roll_rad:f64@112 course_rad:f64@120 course_reference:CourseReference@128 course_sd_rad:f64@136 declination_rad:f64@144 rate_rad_s:[f64; 3]@152 inclination_sd_rad:f64@176 reset_counter:u64@184 jump:[f64; 4]@192"
    _fields_ = [
        ("header", Header),
        # Body → reference, w x y z, unit: v_ref = q v_body q*.
        ("quaternion", ctypes.c_double * 4),
        # ψ, rad, counter-clockwise from above, (−π, π.
        ("yaw_rad", ctypes.c_double),
        # ϑ, rad, nose up, −π/2, π/2.
        ("pitch_rad", ctypes.c_double),
        # γ, rad, right side down, (−π, π.
        ("roll_rad", ctypes.c_double),
        # Course, rad, clockwise from above, 0, 2π).
        ("course_rad", ctypes.c_double),
        # What the course is counted from.
        ("course_reference", ctypes.c_uint64),
        # Standard deviation of the course, rad; π where nothing is known.
        ("course_sd_rad", ctypes.c_double),
        # Magnetic declination by which a magnetic course was made true, rad, east positive; 0 where none was.
        ("declination_rad", ctypes.c_double),
        # Body rate less the bias, rad/s, body axes.
        ("rate_rad_s", ctypes.c_double * 3),
        # Standard deviation of the inclination, rad.
        ("inclination_sd_rad", ctypes.c_double),
        # Times the attitude or the course was set anew.
        ("reset_counter", ctypes.c_uint64),
        # The jump of the last time: the turn from the attitude expected to the attitude set, w x y z.
        ("jump", ctypes.c_double * 4),
    ]

    @staticmethod
    def type_name():
        return "plumbline.AttitudeOutput.1"


class Credit(ctypes.Structure):
    """Leave to publish: in live operation without end, in lockstep as far as the slowest reader allows."""

    TOPIC = "credit"
    LAYOUT = "plumbline.Credit.1 8 ticks:u64@0"
    _fields_ = [
        # Ingest may publish the ticks below this one.
        ("ticks", ctypes.c_uint64),
    ]

    @staticmethod
    def type_name():
        return "plumbline.Credit.1"


class Checkpoint(ctypes.Structure):
    """The state of a slot between two ticks: from it the next life of the service goes on, or another stage."""

    TOPIC = "checkpoint"
    LAYOUT = "plumbline.Checkpoint.1 4680 next_tick:u64@0 checksum:u64@8 service:u32@16 incarnation:u32@20 stage:[u8; 32]@24 slot_words:u32@56 common_words:u32@60 stage_words:u32@64 reserved:u32@68 words:[u64; CHECKPOINT_WORDS]@72"
    _fields_ = [
        # The tick that the slot takes next.
        ("next_tick", ctypes.c_uint64),
        # Checkpoint::sum.
        ("checksum", ctypes.c_uint64),
        # The service's place in the order ingest, gyro, accel, fuser, course.
        ("service", ctypes.c_uint32),
        # The life of the sender.
        ("incarnation", ctypes.c_uint32),
        # The stage's name, filled up with zeros.
        ("stage", ctypes.c_uint8 * 32),
        # How many words are the slot's own.
        ("slot_words", ctypes.c_uint32),
        # How many words after them are numbers that every stage of the slot can go on with.
        ("common_words", ctypes.c_uint32),
        # How many words after those are the numbers of this stage.
        ("stage_words", ctypes.c_uint32),
        # Zero.
        ("reserved", ctypes.c_uint32),
        # Numbers, each as its bits.
        ("words", ctypes.c_uint64 * 576),
    ]

    @staticmethod
    def type_name():
        return "plumbline.Checkpoint.1"


class Difference(ctypes.Structure):
    """How far a candidate is from the stage that owns its slot: angle, inclination, heading."""

    TOPIC = "difference"
    LAYOUT = "plumbline.Difference.1 120 tick:u64@0 ticks:u64@8 now_rad:[f64; 3]@16 mean_rad:[f64; 3]@40 rms_rad:[f64; 3]@64 max_rad:[f64; 3]@88 service:u32@112 incarnation:u32@116"
    _fields_ = [
        # The newest tick compared.
        ("tick", ctypes.c_uint64),
        # Ticks compared.
        ("ticks", ctypes.c_uint64),
        # At that tick, rad.
        ("now_rad", ctypes.c_double * 3),
        # Mean, rad.
        ("mean_rad", ctypes.c_double * 3),
        # Root of the mean square, rad.
        ("rms_rad", ctypes.c_double * 3),
        # Largest, rad.
        ("max_rad", ctypes.c_double * 3),
        # The slot's place in the order ingest, gyro, accel, fuser, course.
        ("service", ctypes.c_uint32),
        # The candidate's life.
        ("incarnation", ctypes.c_uint32),
    ]

    @staticmethod
    def type_name():
        return "plumbline.Difference.1"


class Control(ctypes.Structure):
    """Who owns a slot from a tick on: the supervisor's decision."""

    TOPIC = "control"
    LAYOUT = "plumbline.Control.1 24 from_tick:u64@0 epoch:u32@8 service:u32@12 owner:u32@16 reserved:u32@20"
    _fields_ = [
        # The first tick of the decision.
        ("from_tick", ctypes.c_uint64),
        # The decision's number; it grows with every decision about the slot.
        ("epoch", ctypes.c_uint32),
        # The slot's place in the order ingest, gyro, accel, fuser, course.
        ("service", ctypes.c_uint32),
        # The life that owns it.
        ("owner", ctypes.c_uint32),
        # Zero.
        ("reserved", ctypes.c_uint32),
    ]

    @staticmethod
    def type_name():
        return "plumbline.Control.1"


class Health(ctypes.Structure):
    """What a service says of itself."""

    TOPIC = "health"
    LAYOUT = "plumbline.Health.1 104 ticks:u64@0 lost:u64@8 duplicated:u64@16 repeated:u64@24 next_tick:u64@32 refused:u64@40 late_wakes:u64@48 flags:Flags@56 service:u32@64 state:State@68 incarnation:u32@72 pid:u32@76 epoch:u32@80 missed:u32@84 published_from:u64@88 flawed:u64@96"
    _fields_ = [
        # Ticks published since the start.
        ("ticks", ctypes.c_uint64),
        # Ticks that never came.
        ("lost", ctypes.c_uint64),
        # Messages that came twice or too late, and were left out.
        ("duplicated", ctypes.c_uint64),
        # Messages that a restarted service sent again, and that were left out.
        ("repeated", ctypes.c_uint64),
        # The tick that the service takes next.
        ("next_tick", ctypes.c_uint64),
        # Readings refused at the source.
        ("refused", ctypes.c_uint64),
        # Waits that ended by their limit although there was work: lost wake-ups.
        ("late_wakes", ctypes.c_uint64),
        # Every flag seen since the start.
        ("flags", ctypes.c_uint64),
        # The service's place in the order ingest, gyro, accel, fuser, course.
        ("service", ctypes.c_uint32),
        # What it does.
        ("state", ctypes.c_uint32),
        # Its life.
        ("incarnation", ctypes.c_uint32),
        # Its process.
        ("pid", ctypes.c_uint32),
        # The decision about its slot that it follows.
        ("epoch", ctypes.c_uint32),
        # 1 when that decision came too late for it to follow, else 0.
        ("missed", ctypes.c_uint32),
        # The first tick that it has published under that decision; u64::MAX for none.
        ("published_from", ctypes.c_uint64),
        # Outputs that were not finite.
        ("flawed", ctypes.c_uint64),
    ]

    @staticmethod
    def type_name():
        return "plumbline.Health.1"


MESSAGES = (SensorReading, ReceiverReading, ImuSample, MagSample, GnssFix, Reference, GyroStep, AccelPoint, FusedState, AttitudeOutput, Credit, Checkpoint, Difference, Control, Health)
