//! Messages of every topic, drawn from a seed: what may be on the bus, with awkward numbers among them.
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

pub struct Dice(ChaCha8Rng);

impl Dice {
    pub fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    pub fn word(&mut self) -> u64 {
        // Small and extreme values as often as any other.
        match self.below(4) {
            0 => self.below(3),
            1 => u64::MAX - self.below(3),
            _ => self.0.next_u64(),
        }
    }

    pub fn half(&mut self) -> u32 {
        self.word() as u32
    }

    pub fn below(&mut self, limit: u64) -> u64 {
        self.0.next_u64() % limit
    }

    pub fn number(&mut self) -> f64 {
        match self.below(8) {
            0 => 0.0,
            1 => f64::MIN_POSITIVE / 8.0,
            2 => f64::MAX,
            _ => (self.0.next_u64() as f64 / u64::MAX as f64 - 0.5) * 1e3,
        }
    }

    /// A number that may be unknown.
    pub fn unsure(&mut self) -> f64 {
        if self.below(3) == 0 { f64::NAN } else { self.number() }
    }

    pub fn numbers<const N: usize>(&mut self) -> [f64; N] {
        std::array::from_fn(|_| self.number())
    }

    pub fn unsure_numbers(&mut self) -> [f64; 3] {
        std::array::from_fn(|_| self.unsure())
    }

    pub fn quaternion(&mut self) -> [f64; 4] {
        let parts: [f64; 4] = std::array::from_fn(|_| self.0.next_u64() as f64 / u64::MAX as f64 + 0.1);
        let norm = parts.iter().map(|x| x * x).sum::<f64>().sqrt();
        parts.map(|x| x / norm)
    }

    pub fn header(&mut self) -> Header {
        let (one, other) = (self.word().cast_signed(), self.word().cast_signed());
        Header {
            tick: self.word(),
            t_start_ns: one.min(other),
            t_end_ns: one.max(other),
            t_born_ns: self.word(),
            t_sent_ns: self.word(),
            lost_upstream: self.word(),
            flags: self.flags(),
            epoch: self.half(),
            incarnation: self.half(),
        }
    }

    pub fn flags(&mut self) -> Flags {
        Flags(self.word())
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

    pub fn signed(&mut self) -> i64 {
        self.word().cast_signed()
    }
}

/// A message of the bus drawn by dice.
pub trait Drawn: Payload {
    fn drawn(dice: &mut Dice) -> Self;
}

macro_rules! drawn {
    ($($name:ident { $($field:ident: $how:ident),* })*) => { $(impl Drawn for $name {
        fn drawn(dice: &mut Dice) -> Self { Self { $($field: dice.$how()),* } }
    })* };
}

drawn! {
    SensorReading { t_sensor_ns: signed, rate_rad_s: unsure_numbers, force_m_s2: unsure_numbers, field_ut: unsure_numbers }
    ReceiverReading { velocity_m_s: unsure_numbers, velocity_sd_m_s: unsure, age_s: unsure, latitude_rad: unsure, longitude_rad: unsure, altitude_m: unsure }
    ImuSample { header: header, rate_rad_s: numbers, force_m_s2: numbers }
    MagSample { header: header, field_ut: numbers }
    GnssFix { header: header, velocity_m_s: numbers, velocity_sd_m_s: unsure, age_s: unsure, latitude_rad: unsure, longitude_rad: unsure, altitude_m: unsure }
    Reference { tick: word, scored: word, quaternion: quaternion }
    TakenReading {
        number: word, tick: word, t_sensor_ns: signed, offset_ns: signed, rate_rad_s: unsure_numbers, force_m_s2: unsure_numbers,
        field_ut: unsure_numbers, velocity_m_s: unsure_numbers, velocity_sd_m_s: unsure, age_s: unsure, latitude_rad: unsure, longitude_rad: unsure, altitude_m: unsure,
        quaternion: numbers, brings: half, incarnation: half
    }
    GyroStep { header: header, w: numbers, z_rad: number, chart: chart, p: numbers, s: numbers, rate_rad_s: numbers }
    AccelPoint { header: header, w: numbers, chart: chart, norm_m_s2: number, trust: number, force_m_s2: numbers }
    FusedState {
        header: header, w: numbers, z_rad: number, chart: chart, rate_rad_s: numbers, bias_rad_s: numbers,
        innovation_rad: number, inclination_sd_rad: number, heading_sd_rad: number, course_reference: reference,
        reset_counter: word
    }
    AttitudeOutput {
        header: header, quaternion: quaternion, yaw_rad: number, pitch_rad: number, roll_rad: number, course_rad: number,
        course_reference: reference, course_sd_rad: number, declination_rad: number, rate_rad_s: numbers,
        inclination_sd_rad: number, reset_counter: word, jump: quaternion
    }
    Credit { ticks: word, ends: word }
    Difference {
        tick: word, ticks: word, now_rad: numbers, mean_rad: numbers, rms_rad: numbers, max_rad: numbers, service: service,
        incarnation: half, turn: quaternion
    }
    Health {
        ticks: word, lost: word, duplicated: word, repeated: word, next_tick: word, refused: word, late_wakes: word,
        flags: flags, service: service, state: state, incarnation: half, pid: half, epoch: half, missed: half,
        published_from: word, flawed: word, clock_offset_ns: signed, clock_jitter_ns: word, clock_steps: word
    }
}

impl Drawn for Control {
    fn drawn(dice: &mut Dice) -> Self {
        let (from_tick, epoch, service, owner) = (dice.word(), dice.half(), dice.service(), dice.half());
        Self { from_tick, epoch, service, owner, reserved: 0 }
    }
}

impl Drawn for Checkpoint {
    fn drawn(dice: &mut Dice) -> Self {
        let mut checkpoint = Self { next_tick: dice.word(), service: dice.service(), ..bytemuck::Zeroable::zeroed() };
        checkpoint.stage[..7].copy_from_slice(b"madgwick".first_chunk::<7>().unwrap());
        // Eight of the largest do not fit one batch.
        let words = dice.below(CHECKPOINT_WORDS as u64 / 2 + 1) as usize;
        checkpoint.words[..words].iter_mut().for_each(|word| *word = dice.word());
        (checkpoint.slot_words, checkpoint.common_words) = (dice.half(), dice.half());
        (checkpoint.stage_words, checkpoint.incarnation) = (dice.half(), dice.half());
        checkpoint.swapped = dice.half();
        checkpoint.checksum = checkpoint.sum();
        checkpoint
    }
}

impl Drawn for SystemEvent {
    fn drawn(dice: &mut Dice) -> Self {
        let settings = [("gain", dice.number()), ("fade_s", dice.number())];
        let event = Self::new(EventKind(1 + dice.below(18) as u32)).with_stage("madgwick", settings);
        Self {
            number: dice.word(),
            t_told_ns: dice.word(),
            tick: dice.word(),
            ticks: dice.word(),
            adopted_tick: dice.word(),
            service: if dice.below(3) == 0 { Self::NOBODY } else { dice.service() },
            incarnation: dice.half(),
            epoch: dice.half(),
            filling: dice.half(),
            adopted_filling: dice.half(),
            alone: dice.half(),
            cut: dice.half(),
            ..event.with_why(&"é".repeat(dice.below(200) as usize))
        }
    }
}

/// Calls a generic function for every topic's message, in the order of the table.
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
