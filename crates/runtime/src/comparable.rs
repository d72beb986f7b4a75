//! What of two outputs can be compared, whichever slot they are of: their attitudes.

use attitude::{Quaternion, state::Attitude};
use messages::{AccelPoint, AttitudeOutput, FusedState, GyroStep};

use crate::quantities;

/// An output with an attitude in it.
pub trait Comparable {
    /// The attitude, body → reference; `None` when a number is not finite.
    fn attitude(&self) -> Option<Quaternion<f64>>;
}

impl Comparable for GyroStep {
    fn attitude(&self) -> Option<Quaternion<f64>> {
        Some(quantities::motion(self, 0.0)?.attitude.quaternion())
    }
}

impl Comparable for AccelPoint {
    fn attitude(&self) -> Option<Quaternion<f64>> {
        Some(Attitude::levelled(quantities::up(self)?).quaternion())
    }
}

impl Comparable for FusedState {
    fn attitude(&self) -> Option<Quaternion<f64>> {
        Some(quantities::attitude(self)?.quaternion())
    }
}

impl Comparable for AttitudeOutput {
    fn attitude(&self) -> Option<Quaternion<f64>> {
        let [w, x, y, z] = self.quaternion;
        let sound = [w, x, y, z, self.course_rad].iter().all(|number| number.is_finite());
        sound.then(|| Quaternion::new(w, x, y, z))
    }
}
