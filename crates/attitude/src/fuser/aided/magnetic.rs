//! The heading of the magnetic field, where it is asked for.

use super::{
    covariance::{Error, HEADING, Measurement},
    filter::Aided,
    variance::{shared, square},
};
use crate::{Vector3, course::Reference, fuser::fused::Corrections, state::wrapped_rad};

/// Least horizontal share of the field that tells a direction.
const HORIZONTAL_MIN: f64 = 0.1;
/// What the field corrects is the heading and, through it, the gyro bias; nothing of the level.
const CONSIDERED: [usize; 9] = [0, 1, 2, 3, 4, 9, 10, 11, 12];

impl Aided {
    /// One sample of the field.
    pub(super) fn see_field(&mut self, field_ut: Vector3<f64>, corrections: &mut Corrections) {
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
        if libm::hypot(field.x, field.y) < HORIZONTAL_MIN {
            return;
        }
        self.since_field_s = 0.0;
        let residual = wrapped_rad(libm::atan2(field.x, field.y) - settings.declination_deg.to_radians());
        if self.reference == Reference::Arbitrary {
            self.attitude.z_rad = wrapped_rad(self.attitude.z_rad + residual);
            self.reference = if settings.declination_deg == 0.0 { Reference::Magnetic } else { Reference::True };
            self.covariance.begin(HEADING, square(settings.magnetic_sd_deg.to_radians()));
            corrections.aligned = true;
            corrections.magnetic = true;
            return;
        }
        let variance = shared(settings.magnetic_sd_deg.to_radians(), settings.magnetic_memory_s, interval_s);
        let (mut error, row) = (Error::zeros(), [(HEADING, -1.0)]);
        let measurement = Measurement { residual, row: &row, variance, considered: &CONSIDERED };
        self.covariance.update(&mut error, settings.innovation_limit, &measurement);
        self.correct(&error);
        corrections.magnetic = true;
    }
}
