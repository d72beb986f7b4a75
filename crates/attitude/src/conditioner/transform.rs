//! Conversion of the values of one sensor to body axes.
//!
//! Input: values in the axes and units of the sensor, without −0.
//!
//! Output: values in body axes and SI units (µT for a magnetometer).
//!
//! The matrices of a calibrated sensor in body axes are identities, which leave every value
//! unchanged. They are therefore not multiplied.

use crate::calibration::{Calibration, Mounting};

/// Range of the factors for which a calibration is assumed not to change the unit of the reading.
const SAME_UNIT_FACTORS: core::ops::RangeInclusive<f64> = 0.5..=2.0;

/// Calibration and mounting of one sensor.
#[derive(Debug, Clone, Copy)]
pub(super) struct SensorTransform {
    calibration: Calibration,
    mounting: Mounting,
    is_identity: bool,
    /// Set if the calibration does not change the unit of the sensor.
    is_same_unit: bool,
}

impl SensorTransform {
    pub(super) fn new(calibration: Calibration, mounting: Mounting) -> Self {
        let is_identity = calibration == Calibration::default() && mounting == Mounting::default();
        let is_same_unit = calibration.row_lengths().iter().all(|factor| SAME_UNIT_FACTORS.contains(factor));
        Self { calibration, mounting, is_identity, is_same_unit }
    }

    /// Returns a value in the units of the sensor's range.
    ///
    /// If the calibration converts the unit, for example from raw counts, the range applies to the
    /// calibrated value. Otherwise the range applies to the value itself, since a sensor clips
    /// before its calibration.
    #[inline]
    pub(super) fn in_range_units(&self, value: [f64; 3]) -> [f64; 3] {
        if self.is_same_unit { value } else { self.calibration.apply(value.into()).into() }
    }

    /// Returns a value in body axes.
    #[inline]
    pub(super) fn in_body_axes(&self, value: [f64; 3]) -> [f64; 3] {
        if self.is_identity {
            // Like the product with the matrices, the sum with 0 is never −0.
            return value.map(|component| component + 0.0);
        }
        self.mounting.apply(self.calibration.apply(value.into())).into()
    }
}
