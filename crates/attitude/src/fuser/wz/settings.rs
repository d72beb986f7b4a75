//! Settings of the fuser stage `wz`.

use crate::parameters::settings;

/// How many of the settings, at the end of the table, the stage `aided` has as well.
pub(in crate::fuser) const OF_AIDED_TOO: usize = 1;

settings! {
    /// Settings of the stage.
    pub(in crate::fuser) struct Settings {
        /// Standard deviation of the hard iron at the start, each axis; 0: the magnetometer is calibrated.
        hard_iron_sd_ut: 0.0 in 0.0 .. 200.0, "µT";
        /// How late the magnetometer is on the gyro; where the estimate begins.
        magnetometer_delay_s: 0.0 in -0.01 .. 0.04, "s";
        /// Standard deviation of that delay; 0: it is known and not estimated.
        magnetometer_delay_sd_s: 0.01 in 0.0 .. 0.02, "s";
        /// Standard deviation of the accelerometer bias that a calibration leaves, each axis; never estimated, it is added to the inclination's deviation.
        accel_bias_left_m_s2: 0.005 in 0.0 .. 1.0, "m/s²";
        /// Random walk of the level: noise and coning of the gyro.
        level_noise_deg_sqrt_s: 0.022 in 0.0001 .. 10.0, "°/√s";
        /// Random walk of the gyro bias.
        gyro_bias_walk_deg_s_sqrt_s: 0.0005 in 0.0 .. 1.0, "°/s/√s";
    }
}
