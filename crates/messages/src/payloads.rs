//! Payload types, in the order of the data flow.

use crate::{
    Flags, Layout,
    layout::{layout_struct, payload},
};

layout_struct! {
    /// Origin of a message, with its time and flags. The tick is the same from ingest to the last
    /// service.
    Header = "plumbline.Header.1" {
        /// Number assigned to the IMU sample by ingest, from 0, without gaps.
        tick: u64,
        /// Start of the sample's interval on the source's clock, ns.
        t_start_ns: i64,
        /// End of the sample's interval on the source's clock, ns; increases with every tick.
        t_end_ns: i64,
        /// Time at which ingest received the sample, CLOCK_MONOTONIC, ns.
        t_born_ns: u64,
        /// Time at which this message was published, CLOCK_MONOTONIC, ns.
        t_sent_ns: u64,
        /// Number of ticks missing from the stream before this one.
        lost_upstream: u64,
        /// Faults and events of the sample and of its processing.
        flags: Flags,
        /// Epoch of the decision under which the publisher owns its slot.
        epoch: u32,
        /// Incarnation of the publisher.
        incarnation: u32,
    }
}

impl Header {
    /// Returns the length of the sample's interval, s.
    pub fn dt_s(&self) -> f64 {
        (self.t_end_ns - self.t_start_ns) as f64 * 1e-9
    }

    /// Returns the names, types and offsets of the fields.
    pub fn layout() -> Layout {
        Self::struct_layout()
    }
}

/// Declares a number with names for some of its values. Every bit pattern is valid; `otherwise` is
/// the name of all other values.
macro_rules! named_values {
    (
        $(#[doc = $doc:literal])+
        $Type:ident($Number:ty) otherwise $otherwise:literal {
            $($(#[doc = $description:literal])+ $name:ident = $number:literal $word:literal,)*
        }
    ) => {
        $(#[doc = $doc])+
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Default, bytemuck::Pod, bytemuck::Zeroable)]
        #[repr(transparent)]
        pub struct $Type(pub $Number);

        impl $Type {
            $($(#[doc = $description])+ pub const $name: Self = Self($number);)*

            /// Returns the name of the value.
            pub fn name(self) -> &'static str {
                match self {
                    $(Self::$name => $word,)*
                    _ => $otherwise,
                }
            }
        }
    };
}

named_values! {
    /// Chart of a point w.
    Chart(u64) otherwise "unknown" {
        /// Projection from −ζ: w = 0 is level.
        UPRIGHT = 0 "upright",
        /// Projection from +ζ: w = 0 is upside down.
        INVERTED = 1 "inverted",
    }
}

named_values! {
    /// Zero direction of a course or heading.
    CourseReference(u64) otherwise "arbitrary" {
        /// Direction of the initial heading, because gyro and accelerometer alone cannot observe
        /// north.
        ARBITRARY = 0 "arbitrary",
        /// Magnetic north.
        MAGNETIC = 1 "magnetic",
        /// True north.
        TRUE = 2 "true",
    }
}

named_values! {
    /// Operating state of a service. Other values mean that it is starting.
    State(u32) otherwise "starting" {
        /// All topics are open and the service waits for input.
        READY = 1 "ready",
        /// The service processes input.
        RUNNING = 2 "running",
        /// The source is exhausted.
        FINISHED = 3 "finished",
    }
}

payload! {
    /// Unchecked reading of the sensors. Any value may be NaN.
    SensorReading = "plumbline.SensorReading.1" at (|reading| Some(reading.t_sensor_ns)) {
        /// Sensor timestamp, ns.
        t_sensor_ns: i64,
        /// Body rate, rad/s.
        rate_rad_s: [f64; 3],
        /// Specific force, m/s².
        force_m_s2: [f64; 3],
        /// Magnetic field, µT; NaN if the reading has none.
        field_ut: [f64; 3],
    }
}

payload! {
    /// Unchecked fix of a satellite receiver. It belongs to the next sensor reading.
    ReceiverReading = "plumbline.ReceiverReading.2" {
        /// Velocity over ground, m/s, east, north, up.
        velocity_m_s: [f64; 3],
        /// Standard deviation of each component, m/s; NaN if unknown.
        velocity_sd_m_s: f64,
        /// Age of the velocity when it arrives, s; NaN if unknown.
        age_s: f64,
        /// Geodetic latitude, rad, north positive; NaN if unknown.
        latitude_rad: f64,
        /// Longitude, rad, east positive; NaN if unknown.
        longitude_rad: f64,
        /// Altitude as given by the receiver, m; NaN if unknown.
        altitude_m: f64,
    }
}

payload! {
    /// Checked IMU sample. Values are finite, time increases, and faults are recorded in the flags.
    ImuSample = "plumbline.ImuSample.1" {
        /// Tick, interval, flags.
        header: Header,
        /// Body rate, rad/s, body axes.
        rate_rad_s: [f64; 3],
        /// Specific force, m/s², body axes; points up at rest.
        force_m_s2: [f64; 3],
    }
}

payload! {
    /// Magnetic field sample of a tick that has the flag `field`.
    MagSample = "plumbline.MagSample.1" {
        /// Tick, interval, flags.
        header: Header,
        /// Magnetic field, µT, body axes.
        field_ut: [f64; 3],
    }
}

payload! {
    /// Fix of a satellite receiver, assigned to the tick at which it arrived. That tick has the
    /// flag `fix`.
    GnssFix = "plumbline.GnssFix.2" {
        /// Tick, interval, flags.
        header: Header,
        /// Velocity over ground, m/s, east, north, up.
        velocity_m_s: [f64; 3],
        /// Standard deviation of each component, m/s; NaN if unknown.
        velocity_sd_m_s: f64,
        /// Age of the velocity when it arrives, s; NaN if unknown.
        age_s: f64,
        /// Geodetic latitude, rad, north positive; NaN if unknown.
        latitude_rad: f64,
        /// Longitude, rad, east positive; NaN if unknown.
        longitude_rad: f64,
        /// Altitude as given by the receiver, m; NaN if unknown.
        altitude_m: f64,
    }
}

payload! {
    /// True attitude at a tick, if the source provides it.
    Reference = "plumbline.Reference.2" at (|reference| Some(reference.t_end_ns)) {
        /// Tick of the IMU sample.
        tick: u64,
        /// End of the sample's interval on the source's clock, ns.
        t_end_ns: i64,
        /// 1 if estimates are scored against this attitude, else 0.
        scored: u64,
        /// Rotation from body to reference, w x y z, unit quaternion.
        quaternion: [f64; 4],
    }
}

payload! {
    /// Reading as received by ingest. A flight is replayed from these messages.
    ///
    /// Readings are published in order of arrival while a subscriber requests them. Injected
    /// faults, checks, calibration and mounting are applied later.
    ///
    /// Each incarnation of ingest reads a simulation or recording from the start. The same reading,
    /// with the same number, may therefore occur more than once. With sensors on the bus, `number`
    /// starts at 0 in each incarnation, while ticks and times continue from `tick` and `offset_ns`.
    TakenReading = "plumbline.TakenReading.2" at (|reading| Some(reading.t_sensor_ns)) {
        /// Number of readings that this incarnation received before this one, including rejected
        /// ones.
        number: u64,
        /// Tick that is assigned to the reading unless it is rejected.
        tick: u64,
        /// Source timestamp, ns.
        t_sensor_ns: i64,
        /// Sample time minus source time in ns, as determined from the readings before this one.
        offset_ns: i64,
        /// Body rate, rad/s, sensor axes.
        rate_rad_s: [f64; 3],
        /// Specific force, m/s², sensor axes.
        force_m_s2: [f64; 3],
        /// Magnetic field, µT, sensor axes; NaN if absent.
        field_ut: [f64; 3],
        /// Velocity of the reading's fix, m/s, east, north, up; NaN if absent.
        velocity_m_s: [f64; 3],
        /// Standard deviation of each component, m/s; NaN if unknown.
        velocity_sd_m_s: f64,
        /// Age of the velocity when it arrives, s; NaN if unknown.
        age_s: f64,
        /// Geodetic latitude, rad, north positive; NaN if unknown.
        latitude_rad: f64,
        /// Longitude, rad, east positive; NaN if unknown.
        longitude_rad: f64,
        /// Altitude as given by the receiver, m; NaN if unknown.
        altitude_m: f64,
        /// True attitude, body to reference, w x y z; NaN if unknown.
        quaternion: [f64; 4],
        /// Contents: a sum of 1 (magnetic field), 2 (fix), 4 (true attitude) and 8 (estimates are
        /// scored against the true attitude).
        present: u32,
        /// Incarnation of ingest.
        incarnation: u32,
    }
}

impl TakenReading {
    /// Bit of `present`: the reading has a magnetic field.
    pub const FIELD: u32 = 1;
    /// Bit of `present`: the reading has a fix.
    pub const FIX: u32 = 2;
    /// Bit of `present`: the reading has the true attitude.
    pub const REFERENCE: u32 = 4;
    /// Bit of `present`: estimates are scored against the true attitude.
    pub const SCORED: u32 = 8;
}

payload! {
    /// Motion of the body over the interval of one tick.
    GyroStep = "plumbline.GyroStep.1" {
        /// Tick, interval, flags.
        header: Header,
        /// Open-loop point (u, v) at the end of the interval.
        w: [f64; 2],
        /// Open-loop rotation about the vertical, rad.
        z_rad: f64,
        /// Chart of `w` and `z_rad`.
        chart: Chart,
        /// Rotation of the body over the interval, the unit quaternion d: p = d0 + j d3.
        p: [f64; 2],
        /// Rotation of the body over the interval, the unit quaternion d: s = d1 + j d2.
        s: [f64; 2],
        /// Mean rate over the interval, rad/s, body axes.
        rate_rad_s: [f64; 3],
    }
}

payload! {
    /// Up direction derived from the specific force.
    AccelPoint = "plumbline.AccelPoint.1" {
        /// Tick, interval, flags.
        header: Header,
        /// Point (u, v) of the up direction.
        w: [f64; 2],
        /// Chart of `w`.
        chart: Chart,
        /// Magnitude |f| of the specific force, m/s².
        norm_m_s2: f64,
        /// Confidence: 1 at |f| = g, 0 if the point is not from this sample.
        trust: f64,
        /// Specific force, m/s², body axes.
        force_m_s2: [f64; 3],
    }
}

payload! {
    /// Fused attitude.
    FusedState = "plumbline.FusedState.1" {
        /// Tick, interval, flags.
        header: Header,
        /// Point (u, v) of the attitude.
        w: [f64; 2],
        /// Rotation about the vertical, rad.
        z_rad: f64,
        /// Chart of `w` and `z_rad`.
        chart: Chart,
        /// Body rate minus bias, rad/s, body axes.
        rate_rad_s: [f64; 3],
        /// Gyro bias, rad/s, body axes; zero if the stage does not estimate it.
        bias_rad_s: [f64; 3],
        /// Angle between the up directions of accelerometer and attitude, rad.
        innovation_rad: f64,
        /// Standard deviation of the inclination, rad.
        inclination_sd_rad: f64,
        /// Standard deviation of the heading, rad; π if unknown.
        heading_sd_rad: f64,
        /// Direction in which the heading is zero.
        course_reference: CourseReference,
        /// Number of times the attitude was re-initialised.
        reset_counter: u64,
    }
}

payload! {
    /// Attitude as angles and quaternion, for display and autopilots.
    AttitudeOutput = "plumbline.AttitudeOutput.1" {
        /// Tick, interval, flags.
        header: Header,
        /// Rotation from body to reference, w x y z, unit: v_ref = q v_body q*.
        quaternion: [f64; 4],
        /// ψ, rad, counter-clockwise from above, (−π, π].
        yaw_rad: f64,
        /// ϑ, rad, nose up, [−π/2, π/2].
        pitch_rad: f64,
        /// γ, rad, right side down, (−π, π].
        roll_rad: f64,
        /// Course, rad, clockwise from above, [0, 2π).
        course_rad: f64,
        /// Zero direction of the course.
        course_reference: CourseReference,
        /// Standard deviation of the course, rad; π if unknown.
        course_sd_rad: f64,
        /// Magnetic declination added to a magnetic course, rad, east positive; 0 if none was
        /// added.
        declination_rad: f64,
        /// Body rate minus bias, rad/s, body axes.
        rate_rad_s: [f64; 3],
        /// Standard deviation of the inclination, rad.
        inclination_sd_rad: f64,
        /// Number of times the attitude or the course was re-initialised.
        reset_counter: u64,
        /// Rotation of the last re-initialisation, from the expected to the new attitude, w x y z.
        jump: [f64; 4],
    }
}

payload! {
    /// Permission to publish: unlimited in live operation, limited by the slowest subscriber in
    /// lockstep.
    Credit = "plumbline.Credit.2" {
        /// Ingest may publish ticks below this one.
        ticks: u64,
        /// 1 when the system shuts down: no new ticks are published, but the source stays available
        /// to restarted subscribers.
        ends: u64,
    }
}

payload! {
    /// State of a slot between two ticks, from which another incarnation or stage resumes.
    Checkpoint = "plumbline.Checkpoint.3" {
        /// Next tick that the slot processes.
        next_tick: u64,
        /// Value of [`Checkpoint::compute_checksum`].
        checksum: u64,
        /// Index of the service in the service table.
        service: u32,
        /// Incarnation of the publisher.
        incarnation: u32,
        /// Name of the stage, padded with zeros.
        stage: [u8; 32],
        /// Number of words that contain the state of the slot itself.
        slot_words: u32,
        /// Number of following words that every stage of the slot can adopt.
        common_words: u32,
        /// Number of following words that belong to this stage only.
        stage_words: u32,
        /// 1 from the replacement of a stage until the new stage publishes its first output, which
        /// is flagged `swapped`; else 0.
        swapped: u32,
        /// State words; each contains the bits of one number.
        words: [u64; CHECKPOINT_WORDS],
    }
}

/// Maximum number of words in a checkpoint, enough for the largest stage and its slot.
pub const CHECKPOINT_WORDS: usize = 1600;

impl Checkpoint {
    /// Number of words before the state words.
    pub const HEAD_WORDS: usize = std::mem::offset_of!(Self, words) / size_of::<u64>();

    /// Returns the words of the message without the unused state words, which are zero.
    ///
    /// Most checkpoints use a small part of their state words.
    pub fn used_words(&self) -> &[u64] {
        let Self { slot_words, common_words, stage_words, .. } = self;
        let words: &[u64] = bytemuck::cast_slice(std::slice::from_ref(self));
        // The counts of a damaged checkpoint can have any value.
        let used = [slot_words, common_words, stage_words].map(|count| (*count as usize).min(CHECKPOINT_WORDS));
        &words[..(Self::HEAD_WORDS + used.iter().sum::<usize>()).min(words.len())]
    }

    /// Replaces this checkpoint. The unused words of both must be zero; those that neither uses are
    /// not accessed.
    pub fn replace_with(&mut self, new: &Self) {
        let (new, old_end) = (new.used_words(), self.used_words().len());
        let words: &mut [u64] = bytemuck::cast_slice_mut(std::slice::from_mut(self));
        words[..new.len()].copy_from_slice(new);
        if let Some(unused) = words.get_mut(new.len()..old_end) {
            unused.fill(0);
        }
    }

    /// Returns the checksum of everything but the checksum itself and the unused words.
    pub fn compute_checksum(&self) -> u64 {
        let words = self.used_words();
        let checksum_index = std::mem::offset_of!(Self, checksum) / size_of::<u64>();
        let (before, after) = (&words[..checksum_index], &words[checksum_index + 1..]);
        crate::hash_words(crate::hash_words(crate::HASH_START, before), after)
    }

    /// Returns the name of the stage; empty if it is missing or not valid UTF-8.
    pub fn stage(&self) -> &str {
        padded_text(&self.stage)
    }
}

payload! {
    /// Difference between a candidate and the owner of its slot: angle, inclination, heading.
    Difference = "plumbline.Difference.2" {
        /// Newest tick compared.
        tick: u64,
        /// Number of ticks compared.
        ticks: u64,
        /// Difference at `tick`, rad.
        now_rad: [f64; 3],
        /// Mean difference, rad.
        mean_rad: [f64; 3],
        /// Root mean square difference, rad.
        rms_rad: [f64; 3],
        /// Largest difference, rad.
        max_rad: [f64; 3],
        /// Rotation from the owner's to the candidate's attitude at `tick`, w x y z, body axes; NaN
        /// if unknown.
        rotation: [f64; 4],
        /// Index of the slot's service in the service table.
        service: u32,
        /// Incarnation of the candidate.
        incarnation: u32,
    }
}

payload! {
    /// Decision of the supervisor on which process owns a slot from a given tick onwards.
    Control = "plumbline.Control.1" {
        /// First tick of the decision.
        from_tick: u64,
        /// Number of the decision, which increases with every decision about the slot.
        epoch: u32,
        /// Index of the slot's service in the service table.
        service: u32,
        /// Incarnation of the owner.
        owner: u32,
        /// Always zero.
        reserved: u32,
    }
}

payload! {
    /// Status report of a service.
    Health = "plumbline.Health.2" {
        /// Number of ticks published since the start.
        ticks: u64,
        /// Number of ticks that never arrived.
        lost: u64,
        /// Number of messages discarded because they were duplicates or too late.
        duplicated: u64,
        /// Number of messages discarded because a restarted service published them again.
        repeated: u64,
        /// Next tick that the service processes.
        next_tick: u64,
        /// Number of readings rejected at the source.
        refused: u64,
        /// Number of waits that the publisher did not end although there was work.
        late_wakes: u64,
        /// Union of all flags since the start.
        flags: Flags,
        /// Index of the service in the service table.
        service: u32,
        /// Operating state.
        state: State,
        /// Incarnation of the service.
        incarnation: u32,
        /// Process identifier.
        pid: u32,
        /// Epoch of the decision that the service follows.
        epoch: u32,
        /// 1 if the decision with this `epoch` arrived too late to be followed, else 0.
        missed: u32,
        /// First tick published under the decision with this `epoch`; u64::MAX if none.
        published_from: u64,
        /// Number of outputs that were not finite.
        invalid_outputs: u64,
        /// CLOCK_MONOTONIC minus the device's clock, ns, if the drivers estimate it.
        clock_offset_ns: i64,
        /// Standard deviation of arrival times from the clock estimate, ns.
        clock_jitter_ns: u64,
        /// Number of times the device's clock restarted, was set or did not advance.
        clock_steps: u64,
    }
}

named_values! {
    /// Kind of a system event.
    EventKind(u32) otherwise "unknown" {
        /// The first process of a service has started; `settings` are those of its stage. If no
        /// service is given, the run has started; `settings` are its rate and its source (0
        /// simulation, 1 recording, 2 sensors on the bus).
        STARTED = 1 "started",
        /// The run started with the sensor errors in `settings`, which an earlier run estimated.
        WARM = 2 "warm",
        /// Every service is running.
        READY = 3 "ready",
        /// A process has ended; `reason` is the reason.
        ENDED = 4 "ended",
        /// A service was restarted and resumes at `adopted_tick`.
        RESTARTED = 5 "restarted",
        /// A service will not be restarted.
        GIVEN_UP = 6 "given-up",
        /// A client or a promotion rule (`[[watch]]`) requests a stage for a slot.
        SWAP_REQUESTED = 7 "swap-requested",
        /// A client or a promotion rule (`[[watch]]`) requests a shadow stage in parallel with the
        /// owner of a slot.
        SHADOW_REQUESTED = 8 "shadow-requested",
        /// A stage that is to take over has started. Its initial state is that of the slot before
        /// `adopted_tick`.
        CANDIDATE = 9 "candidate",
        /// The supervisor decided that `instance` owns the slot from `tick` on; 4294967295 means no
        /// owner.
        OWNER = 10 "owner",
        /// A request succeeded: the stage owns the slot from `tick` on.
        SWAPPED = 11 "swapped",
        /// A request was rejected without any change; `reason` is the reason.
        REFUSED = 12 "refused",
        /// A request failed and the slot is unchanged; `reason` is the reason.
        ABORTED = 13 "aborted",
        /// The attitudes of the `ticks` ticks that precede `tick` are missing.
        LOST = 14 "lost",
        /// The supervisor missed the `ticks` attitudes before `tick`, because the topic overwrote
        /// them.
        NOT_RECORDED = 15 "not-recorded",
        /// The files of the bus were removed, and a new bus has replaced the old one.
        BUS_RENEWED = 16 "bus-renewed",
        /// The system is shutting down and the source publishes no new ticks.
        ENDING = 17 "ending",
        /// The system has ended; `reason` is the reason for an early end.
        FINISHED = 18 "finished",
    }
}

payload! {
    /// Action or observation of the supervisor. A number that does not apply is 2⁶⁴ − 1 or 2³² − 1.
    SystemEvent = "plumbline.SystemEvent.1" {
        /// Number of earlier events of the run.
        number: u64,
        /// Time of the event, CLOCK_MONOTONIC, ns.
        t_event_ns: u64,
        /// Tick of the event.
        tick: u64,
        /// Number of ticks.
        ticks: u64,
        /// Tick immediately after the adopted state.
        adopted_tick: u64,
        /// Kind of the event.
        kind: EventKind,
        /// Index of the service in the service table.
        service: u32,
        /// Incarnation of the process.
        incarnation: u32,
        /// Epoch of the decision.
        epoch: u32,
        /// Sequence number of the stage instance in its slot. The instance from the launch file is
        /// 0; each candidate gets the next number, and a restart keeps it.
        instance: u32,
        /// Number of the stage instance that the adopted state comes from.
        adopted_instance: u32,
        /// 1 if the process replaces one that had ended, else 0.
        replaces_ended: u32,
        /// 1 if a text was truncated, else 0.
        truncated: u32,
        /// Name of the stage, padded with zeros.
        stage: [u8; 32],
        /// Settings, `name=1.5 other=2`, padded with zeros.
        settings: [u8; 512],
        /// Reason, for display, padded with zeros.
        reason: [u8; 256],
    }
}

impl SystemEvent {
    /// Placeholder for a 64-bit number that does not apply.
    pub const NONE: u64 = u64::MAX;
    /// Placeholder for a 32-bit number that does not apply.
    pub const NONE_U32: u32 = u32::MAX;

    /// Creates an event of `kind` without further information.
    pub fn new(kind: EventKind) -> Self {
        Self {
            kind,
            tick: Self::NONE,
            adopted_tick: Self::NONE,
            service: Self::NONE_U32,
            instance: Self::NONE_U32,
            adopted_instance: Self::NONE_U32,
            ..bytemuck::Zeroable::zeroed()
        }
    }

    /// Sets the number of the stage instance and the origin of its state.
    ///
    /// `adopted_tick` and `adopted_instance` identify the checkpoint; `adopted_tick` is `None` for
    /// a fresh start. Pass `true` for `replaces_ended` if the instance replaces one that had ended.
    pub fn with_instance(
        self,
        instance: u32,
        adopted_tick: Option<u64>,
        adopted_instance: u32,
        replaces_ended: bool,
    ) -> Self {
        let adopted_tick = adopted_tick.unwrap_or(Self::NONE);
        Self { instance, adopted_tick, adopted_instance, replaces_ended: replaces_ended.into(), ..self }
    }

    /// Sets the name and the settings of a stage. Truncation is recorded in `truncated`.
    pub fn with_stage<'a>(mut self, stage: &str, settings: impl IntoIterator<Item = (&'a str, f64)>) -> Self {
        self.truncated |= u32::from(!write_text(&mut self.stage, stage));
        // `{:?}` prints the fewest digits that parse to the same number.
        let settings = settings.into_iter().map(|(name, value)| format!("{name}={value:?}"));
        self.truncated |= u32::from(!write_text(&mut self.settings, &settings.collect::<Vec<_>>().join(" ")));
        self
    }

    /// Sets the reason. Truncation is recorded in `truncated`.
    pub fn with_reason(mut self, reason: &str) -> Self {
        self.truncated |= u32::from(!write_text(&mut self.reason, reason));
        self
    }

    /// Returns the name of the stage, which may be empty.
    pub fn stage(&self) -> &str {
        padded_text(&self.stage)
    }

    /// Returns the settings as text.
    pub fn settings_text(&self) -> &str {
        padded_text(&self.settings)
    }

    /// Returns the settings, or `None` if the text is malformed or truncated.
    pub fn settings(&self) -> Option<Vec<(&str, f64)>> {
        let parts = self.settings_text().split_whitespace();
        let pairs = parts.map(|part| part.split_once('=').and_then(|(name, value)| Some((name, value.parse().ok()?))));
        pairs.collect::<Option<_>>().filter(|_| self.truncated == 0)
    }

    /// Returns the reason.
    pub fn reason(&self) -> &str {
        padded_text(&self.reason)
    }
}

/// Writes a text, padded with zeros. Returns `true` if it fits completely.
fn write_text(target: &mut [u8], text: &str) -> bool {
    let len = text.floor_char_boundary(target.len());
    target.fill(0);
    target.iter_mut().zip(text[..len].bytes()).for_each(|(place, byte)| *place = byte);
    len == text.len()
}

/// Returns a text without its zero padding; empty if it is not valid UTF-8.
fn padded_text(bytes: &[u8]) -> &str {
    let len = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
    std::str::from_utf8(&bytes[..len]).unwrap_or_default()
}

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
    fn replaced_checkpoint_equals_new_one() {
        let checkpoint = |used_words: usize| {
            let mut checkpoint = Checkpoint { slot_words: used_words as u32, ..bytemuck::Zeroable::zeroed() };
            checkpoint.words[..used_words].fill(used_words as u64);
            checkpoint
        };
        for (old, new) in [(0, 5), (5, 3), (3, 3), (CHECKPOINT_WORDS, 0), (0, CHECKPOINT_WORDS)] {
            let mut replaced = checkpoint(old);
            replaced.replace_with(&checkpoint(new));
            assert_eq!(bytemuck::bytes_of(&replaced), bytemuck::bytes_of(&checkpoint(new)), "{old} {new}");
        }
    }

    #[test]
    fn layouts_match_the_golden_file() {
        let now: String = layouts().iter().map(|l| format!("{:016x} {l}\n", l.fingerprint())).collect();
        let golden = include_str!("../golden/layouts.txt");
        assert_eq!(
            now, golden,
            "a layout changed: raise the version in its name, then copy the left side to the golden file"
        );
    }

    #[test]
    fn field_names_end_in_a_unit() {
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
            "rotation",
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
            "invalid_outputs",
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
            "present",
            "adopted_tick",
            "kind",
            "instance",
            "adopted_instance",
            "replaces_ended",
            "truncated",
            "settings",
            "reason",
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
    fn moved_field_changes_the_fingerprint() {
        let mut layout = ImuSample::layout();
        let before = layout.fingerprint();
        let last = layout.fields.len() - 1;
        layout.fields.swap(last, last - 1);
        assert_ne!(layout.fingerprint(), before);
    }

    #[test]
    fn canonical_form_ignores_run_specific_fields() {
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
