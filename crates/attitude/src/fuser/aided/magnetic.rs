//! Heading from the magnetic field, if enabled.

use super::{
    covariance::{ErrorState, HEADING, Measurement},
    filter::Aided,
    variance::{correlated_variance, square},
};
use crate::{Vector3, course::CourseReference, fuser::fused::Corrections, state::wrapped_rad};

/// Smallest horizontal component of the unit magnetic field vector that defines a heading.
const MIN_HORIZONTAL_FRACTION: f64 = 0.1;
/// Indices of the error states that the magnetic field does not correct.
///
/// The magnetic field corrects the heading and, through correlation, the gyro bias, but not the
/// level.
const CONSIDERED: [usize; 9] = [0, 1, 2, 3, 4, 9, 10, 11, 12];

impl Aided {
    /// Updates the heading with a magnetic field sample.
    pub(super) fn update_magnetic_heading(&mut self, field_ut: Vector3<f64>, corrections: &mut Corrections) {
        let settings = self.settings;
        let interval_s = self.since_field_s.min(1.0);
        if settings.magnetic < 0.5 || interval_s < 0.05 {
            return;
        }
        let norm_ut = field_ut.norm();
        if !(norm_ut > 1.0 && norm_ut < 1e4) {
            return;
        }
        let field = self.attitude.matrix().transpose() * (field_ut / norm_ut);
        let field = field - self.pending_rad.cross(&field);
        if libm::hypot(field.x, field.y) < MIN_HORIZONTAL_FRACTION {
            return;
        }
        self.since_field_s = 0.0;
        let residual = wrapped_rad(libm::atan2(field.x, field.y) - settings.declination_deg.to_radians());
        if self.reference == CourseReference::Arbitrary {
            self.attitude.z_rad = wrapped_rad(self.attitude.z_rad + residual);
            self.reference =
                if settings.declination_deg == 0.0 { CourseReference::Magnetic } else { CourseReference::True };
            self.covariance.reset(HEADING, square(settings.magnetic_sd_deg.to_radians()));
            corrections.aligned = true;
            corrections.magnetic = true;
            return;
        }
        let variance =
            correlated_variance(settings.magnetic_sd_deg.to_radians(), settings.magnetic_memory_s, interval_s);
        let (mut error, row) = (ErrorState::zeros(), [(HEADING, -1.0)]);
        let measurement = Measurement { residual, row: &row, variance, considered: &CONSIDERED };
        self.covariance.update(&mut error, settings.innovation_limit, &measurement);
        self.apply_correction(&error);
        corrections.magnetic = true;
    }
}
