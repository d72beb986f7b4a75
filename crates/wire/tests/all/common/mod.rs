//! Random valid messages of every topic, with frequent extreme values.
#![allow(dead_code, unreachable_pub, reason = "the fuzz example uses a part")]

use messages::{
    AccelPoint, AttitudeOutput, CHECKPOINT_WORDS, Chart, Checkpoint, Control, CourseReference, Credit, Difference,
    EventKind, Flags, FusedState, GnssFix, GyroStep, Header, Health, ImuSample, MagSample, ReceiverReading, Reference,
    SensorReading, State, SystemEvent, TakenReading,
};
use rand_chacha::{
    ChaCha8Rng,
    rand_core::{Rng, SeedableRng},
};
use wire::Payload;

pub struct TestRng(ChaCha8Rng);

impl TestRng {
    pub fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    pub fn next_u64(&mut self) -> u64 {
        // Half of the numbers are close to zero or to the maximum.
        match self.below(4) {
            0 => self.below(3),
            1 => u64::MAX - self.below(3),
            _ => self.0.next_u64(),
        }
    }

    pub fn next_u32(&mut self) -> u32 {
        self.next_u64() as u32
    }

    pub fn below(&mut self, limit: u64) -> u64 {
        self.0.next_u64() % limit
    }

    pub fn finite(&mut self) -> f64 {
        match self.below(8) {
            0 => 0.0,
            1 => f64::MIN_POSITIVE / 8.0,
            2 => f64::MAX,
            _ => (self.0.next_u64() as f64 / u64::MAX as f64 - 0.5) * 1e3,
        }
    }

    /// Returns a finite number or NaN.
    pub fn finite_or_nan(&mut self) -> f64 {
        if self.below(3) == 0 { f64::NAN } else { self.finite() }
    }

    pub fn finite_array<const N: usize>(&mut self) -> [f64; N] {
        std::array::from_fn(|_| self.finite())
    }

    pub fn finite_or_nan_array(&mut self) -> [f64; 3] {
        std::array::from_fn(|_| self.finite_or_nan())
    }

    pub fn quaternion(&mut self) -> [f64; 4] {
        let parts: [f64; 4] = std::array::from_fn(|_| self.0.next_u64() as f64 / u64::MAX as f64 + 0.1);
        let norm = parts.iter().map(|x| x * x).sum::<f64>().sqrt();
        parts.map(|x| x / norm)
    }

    pub fn header(&mut self) -> Header {
        let (one, other) = (self.next_u64().cast_signed(), self.next_u64().cast_signed());
        Header {
            tick: self.next_u64(),
            t_start_ns: one.min(other),
            t_end_ns: one.max(other),
            t_born_ns: self.next_u64(),
            t_sent_ns: self.next_u64(),
            lost_upstream: self.next_u64(),
            flags: self.flags(),
            epoch: self.next_u32(),
            incarnation: self.next_u32(),
        }
    }

    pub fn flags(&mut self) -> Flags {
        Flags(self.next_u64())
    }

    pub fn chart(&mut self) -> Chart {
        Chart(self.below(2))
    }

    pub fn reference(&mut self) -> CourseReference {
        CourseReference(self.below(3))
    }

    pub fn state(&mut self) -> State {
        State(self.below(4) as u32)
    }

    pub fn service(&mut self) -> u32 {
        self.below(7) as u32
    }

    pub fn next_i64(&mut self) -> i64 {
        self.next_u64().cast_signed()
    }
}

/// Message type for which random valid messages can be generated.
pub trait RandomMessage: Payload {
    fn random(rng: &mut TestRng) -> Self;
}

macro_rules! random_messages {
    ($($name:ident { $($field:ident: $method:ident),* })*) => { $(impl RandomMessage for $name {
        fn random(rng: &mut TestRng) -> Self { Self { $($field: rng.$method()),* } }
    })* };
}

random_messages! {
    SensorReading { t_sensor_ns: next_i64, rate_rad_s: finite_or_nan_array, force_m_s2: finite_or_nan_array, field_ut: finite_or_nan_array }
    ReceiverReading { velocity_m_s: finite_or_nan_array, velocity_sd_m_s: finite_or_nan, age_s: finite_or_nan, latitude_rad: finite_or_nan, longitude_rad: finite_or_nan, altitude_m: finite_or_nan }
    ImuSample { header: header, rate_rad_s: finite_array, force_m_s2: finite_array }
    MagSample { header: header, field_ut: finite_array }
    GnssFix { header: header, velocity_m_s: finite_array, velocity_sd_m_s: finite_or_nan, age_s: finite_or_nan, latitude_rad: finite_or_nan, longitude_rad: finite_or_nan, altitude_m: finite_or_nan }
    Reference { tick: next_u64, t_end_ns: next_i64, scored: next_u64, quaternion: quaternion }
    TakenReading {
        number: next_u64, tick: next_u64, t_sensor_ns: next_i64, offset_ns: next_i64, rate_rad_s: finite_or_nan_array, force_m_s2: finite_or_nan_array,
        field_ut: finite_or_nan_array, velocity_m_s: finite_or_nan_array, velocity_sd_m_s: finite_or_nan, age_s: finite_or_nan, latitude_rad: finite_or_nan, longitude_rad: finite_or_nan, altitude_m: finite_or_nan,
        quaternion: finite_array, present: next_u32, incarnation: next_u32
    }
    GyroStep { header: header, w: finite_array, z_rad: finite, chart: chart, p: finite_array, s: finite_array, rate_rad_s: finite_array }
    AccelPoint { header: header, w: finite_array, chart: chart, norm_m_s2: finite, trust: finite, force_m_s2: finite_array }
    FusedState {
        header: header, w: finite_array, z_rad: finite, chart: chart, rate_rad_s: finite_array, bias_rad_s: finite_array,
        innovation_rad: finite, inclination_sd_rad: finite, heading_sd_rad: finite, course_reference: reference,
        reset_counter: next_u64
    }
    AttitudeOutput {
        header: header, quaternion: quaternion, yaw_rad: finite, pitch_rad: finite, roll_rad: finite, course_rad: finite,
        course_reference: reference, course_sd_rad: finite, declination_rad: finite, rate_rad_s: finite_array,
        inclination_sd_rad: finite, reset_counter: next_u64, jump: quaternion
    }
    Credit { ticks: next_u64, ends: next_u64 }
    Difference {
        tick: next_u64, ticks: next_u64, now_rad: finite_array, mean_rad: finite_array, rms_rad: finite_array, max_rad: finite_array, service: service,
        incarnation: next_u32, rotation: quaternion
    }
    Health {
        ticks: next_u64, lost: next_u64, duplicated: next_u64, repeated: next_u64, next_tick: next_u64, refused: next_u64, late_wakes: next_u64,
        flags: flags, service: service, state: state, incarnation: next_u32, pid: next_u32, epoch: next_u32, missed: next_u32,
        published_from: next_u64, invalid_outputs: next_u64, clock_offset_ns: next_i64, clock_jitter_ns: next_u64, clock_steps: next_u64
    }
}

impl RandomMessage for Control {
    fn random(rng: &mut TestRng) -> Self {
        let (from_tick, epoch, service, owner) = (rng.next_u64(), rng.next_u32(), rng.service(), rng.next_u32());
        Self { from_tick, epoch, service, owner, reserved: 0 }
    }
}

impl RandomMessage for Checkpoint {
    fn random(rng: &mut TestRng) -> Self {
        let mut checkpoint = Self { next_tick: rng.next_u64(), service: rng.service(), ..bytemuck::Zeroable::zeroed() };
        checkpoint.stage[..7].copy_from_slice(b"madgwick".first_chunk::<7>().unwrap());
        // At most half of the words are set, because a batch cannot hold eight messages of the
        // maximum size.
        let words = rng.below(CHECKPOINT_WORDS as u64 / 2 + 1) as usize;
        checkpoint.words[..words].iter_mut().for_each(|word| *word = rng.next_u64());
        (checkpoint.slot_words, checkpoint.common_words) = (rng.next_u32(), rng.next_u32());
        (checkpoint.stage_words, checkpoint.incarnation) = (rng.next_u32(), rng.next_u32());
        checkpoint.swapped = rng.next_u32();
        checkpoint.checksum = checkpoint.compute_checksum();
        checkpoint
    }
}

impl RandomMessage for SystemEvent {
    fn random(rng: &mut TestRng) -> Self {
        let settings = [("gain", rng.finite()), ("fade_s", rng.finite())];
        let event = Self::new(EventKind(1 + rng.below(18) as u32)).with_stage("madgwick", settings);
        Self {
            number: rng.next_u64(),
            t_event_ns: rng.next_u64(),
            tick: rng.next_u64(),
            ticks: rng.next_u64(),
            adopted_tick: rng.next_u64(),
            service: if rng.below(3) == 0 { Self::NONE_U32 } else { rng.service() },
            incarnation: rng.next_u32(),
            epoch: rng.next_u32(),
            instance: rng.next_u32(),
            adopted_instance: rng.next_u32(),
            replaces_ended: rng.next_u32(),
            truncated: rng.next_u32(),
            ..event.with_reason(&"é".repeat(rng.below(200) as usize))
        }
    }
}

/// Calls a generic function for the message type of every topic, in the order of the topic table.
macro_rules! for_every_message {
    ($call:ident $arguments:tt) => {{
        let mut all = Vec::new();
        for topic in graph::Topic::ALL {
            all.push(messages::dispatch!(*topic, M => $call::<M> $arguments));
        }
        all
    }};
}
pub(crate) use for_every_message;
