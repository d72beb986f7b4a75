//! The payloads, topic by topic.

use graph::Topic;

use crate::{
    Flags, Layout,
    binding::carry,
    layout::{laid_out, payload},
};

laid_out! {
    /// Where a message comes from: the tick, unchanged from ingest to the end, and what happened to it on the way.
    Header = "plumbline.Header.1" {
        /// The number ingest gave to the IMU sample, from 0, without a gap.
        tick: u64,
        /// Start of the sample's interval on the source's clock, ns.
        t_start_ns: i64,
        /// End of the sample's interval on the source's clock, ns; grows with every tick.
        t_end_ns: i64,
        /// When ingest took the sample, CLOCK_MONOTONIC, ns.
        t_born_ns: u64,
        /// When this message was published, CLOCK_MONOTONIC, ns.
        t_sent_ns: u64,
        /// Ticks before this one that its stream does not have.
        lost_upstream: u64,
        /// What is to be said about the sample and what was made of it.
        flags: Flags,
        /// The supervisor's decision under which the sender owns its slot.
        epoch: u32,
        /// The incarnation of the sender.
        incarnation: u32,
    }
}

impl Header {
    /// Length of the sample's interval, s.
    pub fn dt_s(&self) -> f64 {
        (self.t_end_ns - self.t_start_ns) as f64 * 1e-9
    }

    /// Names, types and places of the fields.
    pub fn layout() -> Layout {
        Self::own_layout()
    }
}

/// The chart of a point (w): numbers, so that a message has no invalid bit pattern.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(transparent)]
pub struct Chart(pub u64);

impl Chart {
    /// Projected from −ζ: w = 0 is level.
    pub const UPRIGHT: Self = Self(0);
    /// Projected from +ζ: w = 0 is upside down.
    pub const INVERTED: Self = Self(1);

    /// The word for it.
    pub fn name(self) -> &'static str {
        match self {
            Self::UPRIGHT => "upright",
            Self::INVERTED => "inverted",
            _ => "unknown",
        }
    }
}

/// From which direction a course is counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(transparent)]
pub struct CourseReference(pub u64);

impl CourseReference {
    /// From wherever the attitude began: gyro and accelerometer alone cannot know north.
    pub const ARBITRARY: Self = Self(0);
    /// From magnetic north.
    pub const MAGNETIC: Self = Self(1);
    /// From true north.
    pub const TRUE: Self = Self(2);

    /// The word for it.
    pub fn name(self) -> &'static str {
        match self {
            Self::MAGNETIC => "magnetic",
            Self::TRUE => "true",
            _ => "arbitrary",
        }
    }
}

/// What a service does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(transparent)]
pub struct State(pub u32);

impl State {
    /// All its topics are open; it waits for work.
    pub const READY: Self = Self(1);
    /// It works.
    pub const RUNNING: Self = Self(2);
    /// Its source is at its end.
    pub const FINISHED: Self = Self(3);

    /// The word for it.
    pub fn name(self) -> &'static str {
        match self {
            Self::READY => "ready",
            Self::RUNNING => "running",
            Self::FINISHED => "finished",
            _ => "starting",
        }
    }
}

payload! {
    /// A reading as it comes from a sensor, before anything was checked: any value may be NaN.
    SensorReading = "plumbline.SensorReading.1" at (|reading, _| Some(reading.t_sensor_ns)) {
        /// The sensor's own time stamp, ns.
        t_sensor_ns: i64,
        /// Body rate, rad/s.
        rate_rad_s: [f64; 3],
        /// Specific force, m/s².
        force_m_s2: [f64; 3],
        /// Magnetic field, µT; NaN where this reading brings none.
        field_ut: [f64; 3],
    }
}

payload! {
    /// A fix as it comes from a satellite receiver, before anything was checked; it belongs to the next sensor reading.
    ReceiverReading = "plumbline.ReceiverReading.2" {
        /// Velocity over ground, m/s, east, north, up.
        velocity_m_s: [f64; 3],
        /// Standard deviation of each component, m/s; NaN where unknown.
        velocity_sd_m_s: f64,
        /// How old the velocity is on arrival, s; NaN where unknown.
        age_s: f64,
        /// Geodetic latitude, rad, north positive; NaN where unknown.
        latitude_rad: f64,
        /// Longitude, rad, east positive; NaN where unknown.
        longitude_rad: f64,
        /// Altitude as the receiver gives it, m; NaN where unknown.
        altitude_m: f64,
    }
}

payload! {
    /// One checked IMU sample: finite, its time grows, what is wrong with it is in the flags.
    ImuSample = "plumbline.ImuSample.1" {
        /// Tick, interval, flags.
        header: Header,
        /// Body rate, rad/s, body axes.
        rate_rad_s: [f64; 3],
        /// Specific force, m/s², body axes; up at rest.
        force_m_s2: [f64; 3],
    }
}

payload! {
    /// The magnetic field at a tick; the sample of that tick is flagged `field`.
    MagSample = "plumbline.MagSample.1" {
        /// Tick, interval, flags.
        header: Header,
        /// Magnetic field, µT, body axes.
        field_ut: [f64; 3],
    }
}

payload! {
    /// What a satellite receiver said, at the tick at which it arrived; the sample of that tick is flagged `fix`.
    GnssFix = "plumbline.GnssFix.2" {
        /// Tick, interval, flags.
        header: Header,
        /// Velocity over ground, m/s, east, north, up.
        velocity_m_s: [f64; 3],
        /// Standard deviation of each component, m/s; NaN where unknown.
        velocity_sd_m_s: f64,
        /// How old the velocity was on arrival, s; NaN where unknown.
        age_s: f64,
        /// Geodetic latitude, rad, north positive; NaN where unknown.
        latitude_rad: f64,
        /// Longitude, rad, east positive; NaN where unknown.
        longitude_rad: f64,
        /// Altitude as the receiver gives it, m; NaN where unknown.
        altitude_m: f64,
    }
}

payload! {
    /// The true attitude at a tick, as far as the source knows it.
    Reference = "plumbline.Reference.1" at (|reference, rate_hz| Some((reference.tick as f64 * 1e9 / rate_hz) as i64)) {
        /// The IMU sample's tick.
        tick: u64,
        /// 1 where an estimate is to be judged by it, else 0.
        scored: u64,
        /// Body → reference, w x y z, unit.
        quaternion: [f64; 4],
    }
}

payload! {
    /// A reading as ingest took it, in the order in which it did, before faults of the launch file, checks, calibration and mounting: from these a
    /// flight is replayed. Published while somebody asked for it.
    ///
    /// A simulation or a recording is read again by each incarnation of ingest, so that a number may come again, with the same reading. Of sensors on
    /// the bus each incarnation counts anew, and goes on at `tick` with `offset_ns`.
    TakenReading = "plumbline.TakenReading.2" at (|reading, _| Some(reading.t_sensor_ns)) {
        /// Readings that this incarnation had taken before it, those included that were refused.
        number: u64,
        /// The tick that it becomes, unless it is refused.
        tick: u64,
        /// The source's own time stamp, ns.
        t_sensor_ns: i64,
        /// Time of the samples less the source's before this reading, ns.
        offset_ns: i64,
        /// Body rate, rad/s, sensor axes.
        rate_rad_s: [f64; 3],
        /// Specific force, m/s², sensor axes.
        force_m_s2: [f64; 3],
        /// Magnetic field, µT, sensor axes; NaN where there is none.
        field_ut: [f64; 3],
        /// Velocity of the fix that belongs to it, m/s, east, north, up; NaN where there is none.
        velocity_m_s: [f64; 3],
        /// Standard deviation of each component, m/s; NaN where unknown.
        velocity_sd_m_s: f64,
        /// How old the velocity was on arrival, s; NaN where unknown.
        age_s: f64,
        /// Geodetic latitude, rad, north positive; NaN where unknown.
        latitude_rad: f64,
        /// Longitude, rad, east positive; NaN where unknown.
        longitude_rad: f64,
        /// Altitude as the receiver gives it, m; NaN where unknown.
        altitude_m: f64,
        /// The true attitude, body → reference, w x y z; NaN where the source does not know it.
        quaternion: [f64; 4],
        /// What it brings: 1 a field, 2 a fix, 4 the true attitude, 8 that an estimate is to be judged by that; their sum.
        brings: u32,
        /// The incarnation of ingest.
        incarnation: u32,
    }
}

impl TakenReading {
    /// It has a magnetic field.
    pub const FIELD: u32 = 1;
    /// It has a fix.
    pub const FIX: u32 = 2;
    /// It has the true attitude.
    pub const REFERENCE: u32 = 4;
    /// An estimate is to be judged by the true attitude.
    pub const SCORED: u32 = 8;
}

payload! {
    /// The motion over one tick's interval.
    GyroStep = "plumbline.GyroStep.1" {
        /// Tick, interval, flags.
        header: Header,
        /// Open-loop point u, v at the interval's end.
        w: [f64; 2],
        /// Open-loop turn about the vertical, rad.
        z_rad: f64,
        /// The chart of `w` and `z_rad`.
        chart: Chart,
        /// The body's turn over the interval, p = d0 + j d3.
        p: [f64; 2],
        /// The body's turn over the interval, s = d1 + j d2.
        s: [f64; 2],
        /// Mean rate over the interval, rad/s, body axes.
        rate_rad_s: [f64; 3],
    }
}

payload! {
    /// Where the accelerometer sees up.
    AccelPoint = "plumbline.AccelPoint.1" {
        /// Tick, interval, flags.
        header: Header,
        /// u, v.
        w: [f64; 2],
        /// The chart of `w`.
        chart: Chart,
        /// |f|, m/s².
        norm_m_s2: f64,
        /// 1 at |f| = g, 0 where the point is not from this sample.
        trust: f64,
        /// Specific force, m/s², body axes.
        force_m_s2: [f64; 3],
    }
}

payload! {
    /// The fused attitude.
    FusedState = "plumbline.FusedState.1" {
        /// Tick, interval, flags.
        header: Header,
        /// u, v.
        w: [f64; 2],
        /// Turn about the vertical, rad.
        z_rad: f64,
        /// The chart of `w` and `z_rad`.
        chart: Chart,
        /// Body rate less the bias, rad/s, body axes.
        rate_rad_s: [f64; 3],
        /// Gyro bias, rad/s, body axes; zero where the stage does not estimate it.
        bias_rad_s: [f64; 3],
        /// Angle between the accelerometer's up and the attitude's, rad.
        innovation_rad: f64,
        /// Standard deviation of the inclination, rad.
        inclination_sd_rad: f64,
        /// Standard deviation of the heading, rad; π where nothing is known.
        heading_sd_rad: f64,
        /// What the heading is counted from.
        course_reference: CourseReference,
        /// Times the attitude was set anew.
        reset_counter: u64,
    }
}

payload! {
    /// The attitude as people and autopilots read it.
    AttitudeOutput = "plumbline.AttitudeOutput.1" {
        /// Tick, interval, flags.
        header: Header,
        /// Body → reference, w x y z, unit: v_ref = q v_body q*.
        quaternion: [f64; 4],
        /// ψ, rad, counter-clockwise from above, (−π, π].
        yaw_rad: f64,
        /// ϑ, rad, nose up, [−π/2, π/2].
        pitch_rad: f64,
        /// γ, rad, right side down, (−π, π].
        roll_rad: f64,
        /// Course, rad, clockwise from above, [0, 2π).
        course_rad: f64,
        /// What the course is counted from.
        course_reference: CourseReference,
        /// Standard deviation of the course, rad; π where nothing is known.
        course_sd_rad: f64,
        /// Magnetic declination by which a magnetic course was made true, rad, east positive; 0 where none was.
        declination_rad: f64,
        /// Body rate less the bias, rad/s, body axes.
        rate_rad_s: [f64; 3],
        /// Standard deviation of the inclination, rad.
        inclination_sd_rad: f64,
        /// Times the attitude or the course was set anew.
        reset_counter: u64,
        /// The jump of the last time: the turn from the attitude expected to the attitude set, w x y z.
        jump: [f64; 4],
    }
}

payload! {
    /// Leave to publish: in live operation without end, in lockstep as far as the slowest reader allows.
    Credit = "plumbline.Credit.2" {
        /// Ingest may publish the ticks below this one.
        ticks: u64,
        /// 1 once the system is to end: nothing new is published, and the source stays for readers that are started again.
        ends: u64,
    }
}

payload! {
    /// The state of a slot between two ticks: from it the next incarnation of the service goes on, or another stage.
    Checkpoint = "plumbline.Checkpoint.3" {
        /// The tick that the slot takes next.
        next_tick: u64,
        /// [`Checkpoint::sum`].
        checksum: u64,
        /// The service's place in the order ingest, gyro, accel, fuser, course, gateway, drivers.
        service: u32,
        /// The incarnation of the sender.
        incarnation: u32,
        /// The stage's name, filled up with zeros.
        stage: [u8; 32],
        /// How many words are the slot's own.
        slot_words: u32,
        /// How many words after them are numbers that every stage of the slot can go on with.
        common_words: u32,
        /// How many words after those are the numbers of this stage.
        stage_words: u32,
        /// 1 while the first output of a stage that fills the slot in the place of another, which says so, is to come.
        swapped: u32,
        /// Numbers, each as its bits.
        words: [u64; CHECKPOINT_WORDS],
    }
}

/// Words of a checkpoint at most: the state of the largest stage and what a slot keeps beside it.
pub const CHECKPOINT_WORDS: usize = 1600;

impl Checkpoint {
    /// A number of all but the checksum itself, by words of eight bytes: a checkpoint is long, and is summed often.
    pub fn sum(&self) -> u64 {
        let Self { checksum, .. } = self;
        let words: &[u64] = bytemuck::cast_slice(std::slice::from_ref(self));
        let own = std::mem::offset_of!(Self, checksum) / size_of_val(checksum);
        let (before, after) = (&words[..own], &words[own + 1..]);
        before.iter().chain(after).fold(crate::HASH_START, |sum, word| {
            let sum = (sum ^ word).wrapping_mul(crate::HASH_PRIME);
            // Without this the highest bits of two words could cancel each other.
            sum ^ (sum >> 32)
        })
    }

    /// The stage's name; empty when it is none.
    pub fn stage(&self) -> &str {
        text(&self.stage)
    }
}

payload! {
    /// How far a candidate is from the stage that owns its slot: angle, inclination, heading.
    Difference = "plumbline.Difference.2" {
        /// The newest tick compared.
        tick: u64,
        /// Ticks compared.
        ticks: u64,
        /// At that tick, rad.
        now_rad: [f64; 3],
        /// Mean, rad.
        mean_rad: [f64; 3],
        /// Root of the mean square, rad.
        rms_rad: [f64; 3],
        /// Largest, rad.
        max_rad: [f64; 3],
        /// At that tick: the turn from the owner's attitude to the candidate's, w x y z, body axes; NaN where unknown.
        turn: [f64; 4],
        /// The slot's place in the order ingest, gyro, accel, fuser, course, gateway.
        service: u32,
        /// The candidate's incarnation.
        incarnation: u32,
    }
}

payload! {
    /// Who owns a slot from a tick on: the supervisor's decision.
    Control = "plumbline.Control.1" {
        /// The first tick of the decision.
        from_tick: u64,
        /// The decision's number; it grows with every decision about the slot.
        epoch: u32,
        /// The slot's place in the order ingest, gyro, accel, fuser, course, gateway.
        service: u32,
        /// The incarnation that owns it.
        owner: u32,
        /// Zero.
        reserved: u32,
    }
}

payload! {
    /// What a service says of itself.
    Health = "plumbline.Health.2" {
        /// Ticks published since the start.
        ticks: u64,
        /// Ticks that never came.
        lost: u64,
        /// Messages that came twice or too late, and were left out.
        duplicated: u64,
        /// Messages that a restarted service sent again, and that were left out.
        repeated: u64,
        /// The tick that the service takes next.
        next_tick: u64,
        /// Readings refused at the source.
        refused: u64,
        /// Waits that ended by their limit although there was work: lost wake-ups.
        late_wakes: u64,
        /// Every flag seen since the start.
        flags: Flags,
        /// The service's place in the order ingest, gyro, accel, fuser, course, gateway, drivers.
        service: u32,
        /// What it does.
        state: State,
        /// Its incarnation.
        incarnation: u32,
        /// Its process.
        pid: u32,
        /// The decision about its slot that it follows.
        epoch: u32,
        /// 1 when that decision came too late for it to follow, else 0.
        missed: u32,
        /// The first tick that it has published under that decision; u64::MAX for none.
        published_from: u64,
        /// Outputs that were not finite.
        flawed: u64,
        /// Of the drivers, where they fit the device's clock: CLOCK_MONOTONIC less the device's, ns.
        clock_offset_ns: i64,
        /// Likewise: standard deviation of the times of arrival about the fit, ns.
        clock_jitter_ns: u64,
        /// Likewise: times the device's clock began again, was set, or did not go forward.
        clock_steps: u64,
    }
}

/// What an event of the system is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(transparent)]
pub struct EventKind(pub u32);

macro_rules! event_kinds {
    ($($(#[doc = $about:literal])+ $name:ident = $number:literal $word:literal,)*) => {
        impl EventKind {
            $($(#[doc = $about])+ pub const $name: Self = Self($number);)*

            /// The word for it.
            pub fn name(self) -> &'static str {
                match self {
                    $(Self::$name => $word,)*
                    _ => "unknown",
                }
            }
        }
    };
}

event_kinds! {
    /// A process of a service has started for the first time; `settings` are those of its stage. Of no service: the run has begun; `settings` are its
    /// rate and its source (0 simulation, 1 recording, 2 sensors on the bus).
    STARTED = 1 "started",
    /// The run began with what an earlier one had found of the sensors: `settings`.
    WARM = 2 "warm",
    /// Every service runs.
    READY = 3 "ready",
    /// A process has ended; `why` tells how.
    ENDED = 4 "ended",
    /// A service was started again; it goes on at `adopted_tick`.
    RESTARTED = 5 "restarted",
    /// A service is not started again.
    GIVEN_UP = 6 "given-up",
    /// Somebody asks for a stage in a slot, or a watch does.
    SWAP_ASKED = 7 "swap-asked",
    /// Somebody asks for a stage beside the owner of a slot, or a watch does.
    SHADOW_ASKED = 8 "shadow-asked",
    /// A stage that is to take over has started, from the slot's state before `adopted_tick`.
    CANDIDATE = 9 "candidate",
    /// A decision: from `tick` on the slot is that of `filling`; `filling` 4294967295 is nobody.
    OWNER = 10 "owner",
    /// A request has been met: the stage has the slot from `tick` on.
    SWAPPED = 11 "swapped",
    /// A request was refused, and nothing was begun; `why` tells the reason.
    REFUSED = 12 "refused",
    /// A request has failed, and the slot is as it was; `why` tells the reason.
    ABORTED = 13 "aborted",
    /// So many `ticks` before `tick` have no attitude.
    LOST = 14 "lost",
    /// The supervisor did not take so many attitudes before `tick` while the topic held them.
    NOT_TAKEN = 15 "not-taken",
    /// A new bus in the place of one whose files were removed.
    BUS_RENEWED = 16 "bus-renewed",
    /// The end has begun: the source publishes nothing new.
    ENDING = 17 "ending",
    /// The system is at its end; `why` tells what ended it before its time.
    FINISHED = 18 "finished",
}

payload! {
    /// What the supervisor did or saw. A number that tells nothing is 2⁶⁴ − 1, or 2³² − 1.
    SystemEvent = "plumbline.SystemEvent.1" {
        /// Events of the run before it.
        number: u64,
        /// When, CLOCK_MONOTONIC, ns.
        t_told_ns: u64,
        /// The tick that it is about.
        tick: u64,
        /// How many.
        ticks: u64,
        /// The tick before which the state was that the process goes on from.
        adopted_tick: u64,
        /// What has happened.
        kind: EventKind,
        /// The service's place in the order ingest, gyro, accel, fuser, course, gateway, drivers.
        service: u32,
        /// The process's incarnation.
        incarnation: u32,
        /// The decision's number.
        epoch: u32,
        /// Which stage of those that a slot has had: 0 is the launch file's, each candidate counts one on, and a restart changes nothing.
        filling: u32,
        /// Of which one the state was that it goes on from.
        adopted_filling: u32,
        /// 1 where it began in the place of one that had ended, else 0.
        alone: u32,
        /// 1 where a text did not fit and was cut, else 0.
        cut: u32,
        /// The stage's name, filled up with zeros.
        stage: [u8; 32],
        /// Names and numbers, `name=1.5 other=2`, filled up with zeros.
        settings: [u8; 512],
        /// The reason, for people, filled up with zeros.
        why: [u8; 256],
    }
}

impl SystemEvent {
    /// What a number says that tells nothing.
    pub const NONE: u64 = u64::MAX;
    /// The same of a short one.
    pub const NOBODY: u32 = u32::MAX;

    /// An event that tells nothing but what it is.
    pub fn new(kind: EventKind) -> Self {
        Self {
            kind,
            tick: Self::NONE,
            adopted_tick: Self::NONE,
            service: Self::NOBODY,
            filling: Self::NOBODY,
            adopted_filling: Self::NOBODY,
            ..bytemuck::Zeroable::zeroed()
        }
    }

    /// Of the stage with this number, which began with the state of another before a tick, or anew; `alone` where that had ended.
    pub fn begun(self, filling: u32, adopted_tick: Option<u64>, adopted_filling: u32, alone: bool) -> Self {
        let adopted_tick = adopted_tick.unwrap_or(Self::NONE);
        Self { filling, adopted_tick, adopted_filling, alone: alone.into(), ..self }
    }

    /// With the name and the settings of a stage.
    pub fn with_stage<'a>(mut self, stage: &str, settings: impl IntoIterator<Item = (&'a str, f64)>) -> Self {
        self.cut |= u32::from(!put_text(&mut self.stage, stage));
        // The shortest digits that are read as the same number.
        let settings = settings.into_iter().map(|(name, value)| format!("{name}={value:?}"));
        self.cut |= u32::from(!put_text(&mut self.settings, &settings.collect::<Vec<_>>().join(" ")));
        self
    }

    /// With a reason.
    pub fn with_why(mut self, why: &str) -> Self {
        self.cut |= u32::from(!put_text(&mut self.why, why));
        self
    }

    /// The stage's name; empty when it is none.
    pub fn stage(&self) -> &str {
        text(&self.stage)
    }

    /// Names and numbers as they are written.
    pub fn settings_text(&self) -> &str {
        text(&self.settings)
    }

    /// Names and numbers; `None` where they are none, or not all of them.
    pub fn settings(&self) -> Option<Vec<(&str, f64)>> {
        let parts = self.settings_text().split_whitespace();
        let pairs = parts.map(|part| part.split_once('=').and_then(|(name, value)| Some((name, value.parse().ok()?))));
        pairs.collect::<Option<_>>().filter(|_| self.cut == 0)
    }

    /// The reason.
    pub fn why(&self) -> &str {
        text(&self.why)
    }
}

/// Puts a text where it is filled up with zeros; what does not fit is left out. Whether all of it fits.
fn put_text(place: &mut [u8], text: &str) -> bool {
    let len = text.floor_char_boundary(place.len());
    place.fill(0);
    place.iter_mut().zip(text[..len].bytes()).for_each(|(place, byte)| *place = byte);
    len == text.len()
}

/// A text that is filled up with zeros; empty when it is none.
fn text(bytes: &[u8]) -> &str {
    let len = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
    std::str::from_utf8(&bytes[..len]).unwrap_or_default()
}

graph::topics!(carry { Topic });

const _: () = {
    assert!(size_of::<Header>() == 64);
    assert!(size_of::<ImuSample>() == 112);
    assert!(size_of::<GyroStep>() == 152);
    assert!(size_of::<AccelPoint>() == 128);
    assert!(size_of::<FusedState>() == 184);
    assert!(size_of::<AttitudeOutput>() == 224);
    assert!(size_of::<Health>() == 128);
};

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{HASH_START, Message, Ticked, hash, layouts};

    #[test]
    fn layouts_are_those_of_the_golden_file() {
        let now: String = layouts().iter().map(|l| format!("{:016x} {l}\n", l.fingerprint())).collect();
        let golden = include_str!("../golden/layouts.txt");
        assert_eq!(now, golden, "a layout changed: raise the version in its name, then copy the left side to the file");
    }

    #[test]
    fn every_quantity_says_its_unit() {
        let plain = [
            "tick",
            "ticks",
            "lost",
            "duplicated",
            "refused",
            "late_wakes",
            "clock_steps",
            "flags",
            "service",
            "state",
            "incarnation",
            "pid",
            "epoch",
            "lost_upstream",
            "quaternion",
            "jump",
            "turn",
            "w",
            "p",
            "s",
            "chart",
            "trust",
            "scored",
            "reset_counter",
            "course_reference",
            "repeated",
            "next_tick",
            "from_tick",
            "missed",
            "published_from",
            "flawed",
            "owner",
            "checksum",
            "stage",
            "slot_words",
            "common_words",
            "stage_words",
            "swapped",
            "ends",
            "reserved",
            "words",
            "number",
            "brings",
            "adopted_tick",
            "kind",
            "filling",
            "adopted_filling",
            "alone",
            "cut",
            "settings",
            "why",
        ];
        for layout in layouts() {
            for field in layout.fields {
                assert!(
                    field.unit().is_some() || plain.contains(&field.name),
                    "{}: {} has no unit",
                    layout.name,
                    field.name
                );
            }
        }
    }

    #[test]
    fn a_moved_field_changes_the_fingerprint() {
        let mut layout = ImuSample::layout();
        let before = layout.fingerprint();
        let last = layout.fields.len() - 1;
        layout.fields.swap(last, last - 1);
        assert_ne!(layout.fingerprint(), before);
    }

    #[test]
    fn stamps_of_the_run_are_not_canonical() {
        let mut sample: ImuSample = bytemuck::Zeroable::zeroed();
        sample.header.tick = 7;
        let mut later = sample;
        (later.header.t_born_ns, later.header.t_sent_ns) = (1, 2);
        (later.header.epoch, later.header.incarnation) = (3, 4);
        let digest = |sample: ImuSample| hash(HASH_START, bytemuck::bytes_of(&sample.canonical()));
        assert_eq!(digest(sample), digest(later));
        later.header.tick = 8;
        assert_ne!(digest(sample), digest(later));
    }
}
