//! Settings of the fuser stage `wz`.

use crate::parameters::settings;

/// Number of settings at the end of the table that the stage `aided` also has.
pub(in crate::fuser) const SHARED_WITH_AIDED: usize = 1;

settings! {
    /// Settings of the fuser stage `wz`.
    pub(in crate::fuser) struct Settings {
        /// Initial standard deviation of the hard iron per axis; 0 for a calibrated magnetometer.
        hard_iron_sd_ut: 0.0 in 0.0 .. 200.0, "µT";
        /// Initial estimate of the magnetometer's delay relative to the gyro.
        magnetometer_delay_s: 0.0 in -0.01 .. 0.04, "s";
        /// Initial standard deviation of the magnetometer's delay; 0 keeps the delay fixed.
        magnetometer_delay_sd_s: 0.01 in 0.0 .. 0.02, "s";
        /// Residual accelerometer bias per axis. It is not estimated; it only raises the reported
        /// standard deviation of the inclination.
        residual_accel_bias_sd_m_s2: 0.005 in 0.0 .. 1.0, "m/s²";
        /// Random walk of the level, due to gyro noise and coning.
        level_noise_deg_sqrt_s: 0.022 in 0.0001 .. 10.0, "°/√s";
        /// Random walk of the gyro bias.
        gyro_bias_walk_deg_s_sqrt_s: 0.0005 in 0.0 .. 1.0, "°/s/√s";
    }
}
