//! Data path of the system, and bit patterns for comparing its outputs with those of the filter.

use launch::{Launch, Source};
use messages::{AttitudeOutput, FusedState};
use pipeline::Path;
use plumbline_ahrs::{Ahrs, Attitude, stages::FuserStage};
use readings::{conditioner::Conditioner, source::Reading};
use runtime::{Pace, ServiceConfig};

use crate::digest::words;

/// Conditioner and data path of `plumb up --in-process`.
pub(crate) struct System {
    conditioner: Conditioner,
    path: Path,
}

impl System {
    pub(crate) fn new(mut launch: Launch, rate_hz: f64) -> Self {
        launch.ingest.source = Source::Replay;
        let config = ServiceConfig::standalone(launch, rate_hz, Pace::Max);
        Self { conditioner: readings::conditioner(&config).unwrap(), path: Path::new(&config).unwrap() }
    }

    /// Returns the output for a reading, or `None` if the reading is rejected.
    pub(crate) fn step(&mut self, reading: &Reading) -> Option<(FusedState, AttitudeOutput)> {
        let sample = self.conditioner.condition(reading)?;
        let (mut fused, mut output) = (None, None);
        self.path
            .offer_observed(sample, &mut |state| fused = Some(*state), &mut |attitude| output = Some(attitude))
            .unwrap();
        Some((fused.unwrap(), output.unwrap()))
    }
}

/// Passes a reading to the filter: first its fix, if any, then its other values with `update_at`.
pub(crate) fn update<F: FuserStage>(ahrs: &mut Ahrs<F>, reading: &Reading) -> Attitude {
    if let Some(received) = reading.fix {
        ahrs.update_gnss(&plumbline_ahrs::GnssFix {
            velocity_m_s: received.fix.velocity_m_s.into(),
            velocity_sd_m_s: received.fix.sd_m_s,
            age_s: received.fix.age_s,
            latitude_rad: received.fix.latitude_rad,
        });
    }
    ahrs.update_at(reading.rate_rad_s, reading.force_m_s2, reading.field_ut, reading.t_ns)
}

/// Returns the bit patterns of all numbers in a system's output, in the order of [`words`].
pub(crate) fn system_bits((fused, output): &(FusedState, AttitudeOutput)) -> Vec<u64> {
    let numbers = [
        &[output.yaw_rad, output.pitch_rad, output.roll_rad][..],
        &[output.course_rad, output.course_sd_rad, output.declination_rad, output.inclination_sd_rad],
        &[fused.innovation_rad],
        &output.quaternion,
        &output.rate_rad_s,
        &fused.bias_rad_s,
        &output.jump,
    ];
    let words = [
        output.header.tick,
        output.header.t_end_ns.cast_unsigned(),
        output.header.flags.0,
        output.course_reference.0,
        output.reset_counter,
    ];
    words.into_iter().chain(numbers.concat().into_iter().map(f64::to_bits)).collect()
}

/// Returns the bit patterns of all numbers in an attitude, in the order of [`system_bits`].
pub(crate) fn bits(attitude: &Attitude) -> Vec<u64> {
    words(attitude).collect()
}
