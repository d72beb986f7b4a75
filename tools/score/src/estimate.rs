//! Attitudes that another program has estimated, scored like the outputs of a chain of stages.
//!
//! Input: a file of attitudes, as [`recording::References`] reads it.
//!
//! Output: attitude and fused state at a tick. The gyro bias and all standard deviations are NaN,
//! because the file does not have them.
//!
//! Time: the clock of the recording. The attitude is interpolated at the ticks.
//!
//! Failure: a malformed line is an error. Ticks that the file does not cover have no attitude.

use std::path::PathBuf;

use attitude::{Quaternion, state::Attitude};
use messages::{AttitudeOutput, CourseReference, FusedState, ImuSample};
use recording::{RecordingError, References};
use runtime::convert;

/// File of attitudes that another program has estimated.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Estimate {
    /// Name in tables, figures and folders.
    pub name: String,
    /// File with the columns `t_s,qw,qx,qy,qz`, body to east-north-up.
    pub file: PathBuf,
    /// `true` if the heading is referenced to north, `false` if its zero direction is arbitrary.
    pub heading_is_known: bool,
}

/// Reader of an estimate, to be advanced in step with the ticks.
pub(crate) struct EstimateReader {
    attitudes: References,
    course_reference: CourseReference,
}

impl EstimateReader {
    pub(crate) fn open(estimate: &Estimate) -> Result<Self, RecordingError> {
        let course_reference =
            if estimate.heading_is_known { CourseReference::TRUE } else { CourseReference::ARBITRARY };
        Ok(Self { attitudes: References::open(&estimate.file)?, course_reference })
    }

    /// Returns the estimate at the tick of a sample, or `None` if the file does not cover the tick.
    pub(crate) fn at(&mut self, sample: &ImuSample) -> Result<Option<(AttitudeOutput, FusedState)>, RecordingError> {
        let header = sample.header;
        let Some(found) = self.attitudes.attitude_at(header.t_end_ns, sample.rate_rad_s)? else { return Ok(None) };
        let [w, x, y, z] = found.quaternion;
        let attitude = Attitude::from_quaternion(Quaternion::new(w, x, y, z));
        let angles = attitude.angles();
        let (course_reference, rate_rad_s) = (self.course_reference, sample.rate_rad_s);
        let fused = FusedState {
            header,
            w: convert::complex_to_payload(attitude.up.w),
            z_rad: attitude.z_rad,
            chart: convert::chart_to_payload(attitude.up.chart),
            rate_rad_s,
            bias_rad_s: [f64::NAN; 3],
            innovation_rad: f64::NAN,
            inclination_sd_rad: f64::NAN,
            heading_sd_rad: f64::NAN,
            course_reference,
            reset_counter: 0,
        };
        let output = AttitudeOutput {
            header,
            quaternion: found.quaternion,
            yaw_rad: angles.yaw_rad,
            pitch_rad: angles.pitch_rad,
            roll_rad: angles.roll_rad,
            course_rad: (-angles.yaw_rad).rem_euclid(std::f64::consts::TAU),
            course_reference,
            course_sd_rad: f64::NAN,
            declination_rad: 0.0,
            rate_rad_s,
            inclination_sd_rad: f64::NAN,
            reset_counter: 0,
            jump: [1.0, 0.0, 0.0, 0.0],
        };
        Ok(Some((output, fused)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn estimate_is_interpolated_at_ticks_and_has_no_deviations() {
        let file = tempfile::NamedTempFile::new().unwrap();
        // Yaw of 0° and 20°.
        std::fs::write(file.path(), "t_s,qw,qx,qy,qz\n1,1,0,0,0\n1.1,0.984807753,0,0,0.173648178\n").unwrap();
        let estimate = Estimate { name: "mine".into(), file: file.path().into(), heading_is_known: false };
        let mut reader = EstimateReader::open(&estimate).unwrap();
        let mut sample: ImuSample = bytemuck::Zeroable::zeroed();
        let mut at = |t_ns: i64| {
            sample.header.t_end_ns = t_ns;
            reader.at(&sample).unwrap()
        };
        assert!(at(900_000_000).is_none(), "before the first row");
        let (output, fused) = at(1_050_000_000).unwrap();
        assert!((output.yaw_rad.to_degrees() - 10.0).abs() < 1e-6, "{}", output.yaw_rad);
        assert!((output.course_rad.to_degrees() - 350.0).abs() < 1e-6, "{}", output.course_rad);
        assert_eq!(output.course_reference, CourseReference::ARBITRARY);
        assert!(fused.heading_sd_rad.is_nan() && fused.bias_rad_s.iter().all(|bias| bias.is_nan()));
        let attitude = convert::attitude(&fused).unwrap();
        assert!((attitude.angles().yaw_rad - output.yaw_rad).abs() < 1e-12);
        assert!(at(1_200_000_000).is_none(), "after the last row");
    }
}
