//! Example messages from a vehicle in motion. Most fields are non-zero, because protobuf omits
//! zeros.

use attitude::frames::{Frame, QuaternionOrder};
use bytemuck::Zeroable as _;
use messages::{AttitudeOutput, Chart, CourseReference, Flags, FusedState, Header, Health, ImuSample, State};
use wire::v1::Envelope;

fn header(tick: u64) -> Header {
    let t_end_ns = 47_000_000_000_000 + 1_000_000 * tick as i64;
    Header {
        tick: 4_000_000 + tick,
        t_start_ns: t_end_ns - 1_000_000,
        t_end_ns,
        t_born_ns: t_end_ns.unsigned_abs() + 20_000,
        t_sent_ns: t_end_ns.unsigned_abs() + 80_000,
        lost_upstream: 3,
        flags: Flags::FIELD,
        epoch: 1,
        incarnation: 4,
    }
}

/// Message type with an example value.
pub(crate) trait Example {
    fn example(tick: u64) -> Self;
}

impl Example for ImuSample {
    fn example(tick: u64) -> Self {
        Self { header: header(tick), rate_rad_s: [0.013, -0.2, 1.1], force_m_s2: [0.3, -1.7, 9.6] }
    }
}

impl Example for FusedState {
    fn example(tick: u64) -> Self {
        Self {
            header: header(tick),
            w: [0.11, -0.07],
            z_rad: 2.1,
            chart: Chart::UPRIGHT,
            rate_rad_s: [0.013, -0.2, 1.1],
            bias_rad_s: [0.001, -0.002, 0.0005],
            innovation_rad: 0.0003,
            inclination_sd_rad: 0.002,
            heading_sd_rad: 0.03,
            course_reference: CourseReference::MAGNETIC,
            reset_counter: 2,
        }
    }
}

impl Example for AttitudeOutput {
    fn example(tick: u64) -> Self {
        Self {
            header: header(tick),
            quaternion: [0.5, -0.5, 0.5, -0.5],
            yaw_rad: 2.1,
            pitch_rad: -0.1,
            roll_rad: 0.2,
            course_rad: 1.9,
            course_reference: CourseReference::TRUE,
            course_sd_rad: 0.03,
            declination_rad: 0.2,
            rate_rad_s: [0.013, -0.2, 1.1],
            inclination_sd_rad: 0.002,
            reset_counter: 2,
            jump: [1.0, 0.0, 0.0, 0.0],
        }
    }
}

impl Example for Health {
    fn example(tick: u64) -> Self {
        Self {
            ticks: 4_000_000 + tick,
            lost: 3,
            next_tick: 4_000_001 + tick,
            flags: Flags::FIELD,
            service: 3,
            state: State::RUNNING,
            incarnation: 4,
            pid: 31_415,
            epoch: 1,
            published_from: u64::MAX,
            ..Self::zeroed()
        }
    }
}

/// Returns the envelope that the gateway adds to a message.
pub(crate) fn envelope() -> Envelope {
    Envelope {
        sequence: 123_456,
        start_ns: 46_999_000_000_000,
        samples_before: 123_456,
        decimated: 2_345_678,
        dropped: 3,
        t_sent_ns: 47_000_000_100_000,
        ..Envelope::default()
    }
    .with_frame(Frame::default(), QuaternionOrder::default())
}
