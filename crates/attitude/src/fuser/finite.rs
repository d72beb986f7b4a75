//! Input check shared by all fusers: a sensor value with a non-finite number is treated as missing.
//!
//! Input: the input of a stage.
//!
//! Output: the same input with finite numbers only.
//!
//! Time: a motion with a negative or non-finite interval becomes an identity rotation of zero
//! duration.

use super::input::FuserInput;
use crate::{Vector3, accel::Inclination, gnss::Fix, gyro::Motion, rotation::Rotation, scalars::are_finite};

/// Implements the items that are the same in every fuser stage: the types of the slot, `step` and
/// `adopt`.
///
/// `step` removes invalid sensor values from the input and passes it to `Self::fuse`. `adopt`
/// validates the estimate and passes it to `Self::continue_from`.
macro_rules! fuser_items {
    () => {
        type Input = $crate::fuser::FuserInput;
        type Output = $crate::fuser::Fused;
        type Common = $crate::fuser::Estimate;

        // Inlined like `step` of the slot.
        #[inline(always)]
        fn step(&mut self, input: &$crate::fuser::FuserInput) -> $crate::fuser::Fused {
            self.fuse(input.sanitized(&mut None))
        }

        fn adopt(&mut self, common: &$crate::fuser::Estimate) -> Result<(), $crate::stage::RestoreError> {
            common.validate()?;
            self.continue_from(common);
            Ok(())
        }
    };
}
pub(in crate::fuser) use fuser_items;

impl FuserInput {
    /// Returns the input itself if all its numbers are finite, else a copy without the invalid
    /// values.
    ///
    /// The copy is kept in `storage`.
    #[inline(always)]
    pub fn sanitized<'a>(&'a self, storage: &'a mut Option<Self>) -> &'a Self {
        if self.is_finite() { self } else { storage.insert(self.without_non_finite()) }
    }

    /// Removes the invalid values.
    #[inline(always)]
    pub fn sanitize(&mut self) {
        if !self.is_finite() {
            *self = self.without_non_finite();
        }
    }

    #[inline(always)]
    fn is_finite(&self) -> bool {
        self.motion.as_ref().is_none_or(|motion| motion_is_finite(motion) && is_valid_interval(motion.dt_s))
            && self.inclination.as_ref().is_none_or(inclination_is_finite)
            && self.field_ut.as_ref().is_none_or(vector_is_finite)
            && self.fix.is_none_or(|fix| fix.finite() == Some(fix))
    }

    #[cold]
    fn without_non_finite(&self) -> Self {
        let with_valid_interval = |motion: Motion| {
            if is_valid_interval(motion.dt_s) {
                motion
            } else {
                Motion { rotation: Rotation::IDENTITY, dt_s: 0.0, ..motion }
            }
        };
        Self {
            motion: self.motion.filter(motion_is_finite).map(with_valid_interval),
            inclination: self.inclination.filter(inclination_is_finite),
            field_ut: self.field_ut.filter(vector_is_finite),
            fix: self.fix.and_then(Fix::finite),
            ..*self
        }
    }
}

#[inline]
fn is_valid_interval(dt_s: f64) -> bool {
    (0.0..f64::INFINITY).contains(&dt_s)
}

#[inline]
fn vector_is_finite(vector: &Vector3<f64>) -> bool {
    are_finite([vector.x, vector.y, vector.z])
}

#[inline]
fn motion_is_finite(motion: &Motion) -> bool {
    let (Rotation { p, s }, rate) = (motion.rotation, motion.rate_rad_s);
    are_finite([p.re, p.im, s.re, s.im, rate.x, rate.y, rate.z])
}

#[inline]
fn inclination_is_finite(inclination: &Inclination) -> bool {
    let (w, force) = (inclination.up.w, inclination.force_m_s2);
    are_finite([w.re, w.im, inclination.norm_m_s2, inclination.trust, force.x, force.y, force.z])
}
