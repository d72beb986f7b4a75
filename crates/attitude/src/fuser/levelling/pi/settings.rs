//! Settings of the fuser stage `levelling-pi`.

use crate::parameters::settings;

settings! {
    /// Settings of `levelling-pi`.
    pub struct PiSettings {
        /// Time constant of levelling with satellite velocity. The time constant of the gyro bias
        /// is twice as long.
        time_constant_s: 20.0 in 1.0 .. 1000.0, "s";
        /// Time constant with which the track over ground corrects the azimuth. The time constant
        /// of the bias about the vertical is twice as long.
        track_time_constant_s: 50.0 in 5.0 .. 10000.0, "s";
        /// Time constant of the correction by the track once turns have determined the azimuth. A
        /// long time constant keeps a crab angle from undoing what the turns have corrected.
        turned_track_time_constant_s: 100.0 in 5.0 .. 10000.0, "s";
        /// Time constant with which the direction of accelerations corrects the azimuth in a turn.
        turn_time_constant_s: 10.0 in 1.0 .. 10000.0, "s";
        /// Minimum ground speed at which the track is used.
        track_speed_m_s: 3.0 in 0.5 .. 100.0, "m/s";
        /// Assumed age of a velocity on arrival if the receiver does not report the age.
        latency_s: 0.2 in 0.0 .. 0.8, "s";
        /// Maximum velocity standard deviation of a fix. Fixes with a larger one are ignored.
        velocity_sd_max_m_s: 1.0 in 0.01 .. 100.0, "m/s";
        /// Time over which a tilt correction is applied.
        feed_in_s: 0.3 in 0.0 .. 5.0, "s";
        /// Time after the last fix at which levelling becomes autonomous. A receiver with longer
        /// intervals between its fixes is not used.
        gap_s: 1.5 in 0.1 .. 60.0, "s";
        /// Time constant of levelling without fixes.
        gap_time_constant_s: 100.0 in 1.0 .. 10000.0, "s";
        /// Low-pass time constant of the specific force without fixes. The acceleration
        /// of a turn is subtracted from the force first.
        gap_low_pass_s: 30.0 in 0.0 .. 1000.0, "s";
        /// Integral time of the gyro bias estimate without fixes.
        gap_integral_s: 4000.0 in 100.0 .. 1000000.0, "s";
        /// Turn rate at which the weight of the force is halved without fixes.
        gap_turn_deg_s: 1.0 in 0.01 .. 1000.0, "°/s";
        /// Time constant of levelling without satellite velocity while the gyro bias is unknown.
        cold_time_constant_s: 60.0 in 1.0 .. 10000.0, "s";
        /// Low-pass time constant of the specific force without satellite velocity while the gyro
        /// bias is unknown.
        cold_low_pass_s: 20.0 in 0.0 .. 1000.0, "s";
    }
}
