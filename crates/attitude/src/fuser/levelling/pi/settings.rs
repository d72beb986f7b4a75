//! Settings of the fuser stage `levelling-pi`.

use crate::parameters::settings;

settings! {
    /// Settings of `levelling-pi`.
    pub struct PiSettings {
        /// Time constant of levelling with satellite velocity; the gyro's bias follows with twice that.
        time_constant_s: 20.0 in 1.0 .. 1000.0, "s";
        /// Time constant of the azimuth with a track over ground; the bias about the vertical follows with twice that.
        track_time_constant_s: 50.0 in 5.0 .. 10000.0, "s";
        /// The same once turns have told the azimuth, so that a crab angle does not take it back.
        turned_track_time_constant_s: 100.0 in 5.0 .. 10000.0, "s";
        /// Time constant of the azimuth with the direction of accelerations, in a turn.
        turn_time_constant_s: 10.0 in 1.0 .. 10000.0, "s";
        /// Ground speed below which a track says nothing about the course.
        track_speed_m_s: 3.0 in 0.5 .. 100.0, "m/s";
        /// How old a velocity is on arrival where the receiver does not tell.
        latency_s: 0.2 in 0.0 .. 0.8, "s";
        /// A fix of a larger standard deviation is none.
        velocity_sd_max_m_s: 1.0 in 0.01 .. 100.0, "m/s";
        /// Time over which a correction is fed in.
        feed_in_s: 0.3 in 0.0 .. 5.0, "s";
        /// Time after the last fix from which levelling is autonomous. A receiver slower than that aids nothing.
        gap_s: 1.5 in 0.1 .. 60.0, "s";
        /// Time constant of levelling in a gap.
        gap_time_constant_s: 100.0 in 1.0 .. 10000.0, "s";
        /// Low-pass of what is left of the specific force in a gap.
        gap_low_pass_s: 30.0 in 0.0 .. 1000.0, "s";
        /// Integral time of the gyro's bias in a gap.
        gap_integral_s: 4000.0 in 100.0 .. 1000000.0, "s";
        /// Turn rate at which the force counts for half in a gap.
        gap_turn_deg_s: 1.0 in 0.01 .. 1000.0, "°/s";
        /// Time constant of levelling while the gyro's bias is unknown and there is no satellite velocity.
        cold_time_constant_s: 60.0 in 1.0 .. 10000.0, "s";
        /// Low-pass of the specific force then.
        cold_low_pass_s: 20.0 in 0.0 .. 1000.0, "s";
    }
}
