//! Settings of the fuser stage `wz`.

use crate::parameters::settings;

settings! {
    /// Settings of the stage.
    pub(in crate::fuser::wz) struct Settings {
        /// Standard deviation of the hard iron at the start, each axis; 0: the magnetometer is calibrated.
        hard_iron_sd_ut: 0.0 in 0.0 .. 200.0, "µT";
        /// How late the magnetometer is on the gyro; where the estimate begins.
        magnetometer_delay_s: 0.0 in -0.01 .. 0.04, "s";
        /// Standard deviation of that delay; 0: it is known and not estimated.
        magnetometer_delay_sd_s: 0.01 in 0.0 .. 0.02, "s";
    }
}
