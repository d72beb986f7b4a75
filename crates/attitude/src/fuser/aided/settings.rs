//! Settings of the fuser stage `aided`.

use super::consistency::Noises;
use crate::{Vector3, parameters::settings};

/// How many of the settings, at the end of the table, are those of the magnetometer.
pub(in crate::fuser) const OF_THE_MAGNETOMETER: usize = 4;

settings! {
    /// Settings of the fuser stage `aided`.
    pub struct Settings {
        /// White noise of the gyro, angle random walk; also what its scale factor does in vibration.
        gyro_noise_deg_sqrt_s: 0.01 in 0.0001 .. 10.0, "°/√s";
        /// White noise of the accelerometer, velocity random walk, besides what differs from sample to sample.
        accel_noise_m_s_sqrt_s: 0.03 in 0.0001 .. 10.0, "m/s/√s";
        /// Random walk of the gyro bias.
        gyro_bias_walk_deg_s_sqrt_s: 0.0005 in 0.0 .. 1.0, "°/s/√s";
        /// Random walk of the accelerometer bias.
        accel_bias_walk_m_s2_sqrt_s: 0.0001 in 0.0 .. 1.0, "m/s²/√s";
        /// Scale error of gyro and accelerometer, taken for noise that grows with the motion.
        scale_noise: 0.001 in 0.0 .. 0.1, "";
        /// Standard deviation of the gyro bias at the start.
        gyro_bias_sd_deg_s: 0.2 in 0.0001 .. 10.0, "°/s";
        /// Standard deviation of the accelerometer bias at the start.
        accel_bias_sd_m_s2: 0.05 in 0.0001 .. 10.0, "m/s²";
        /// Standard deviation of the first level, about each horizontal axis.
        level_sd_deg: 2.0 in 0.01 .. 60.0, "°";
        /// Standard deviation of the first course against the track over ground, without wind.
        course_sd_deg: 10.0 in 0.1 .. 90.0, "°";
        /// Standard deviation of a satellite velocity on each axis where the receiver does not tell it.
        velocity_sd_m_s: 0.2 in 0.01 .. 100.0, "m/s";
        /// How late a satellite velocity arrives where the receiver does not tell it; refined in flight.
        latency_s: 0.2 in 0.0 .. 0.6, "s";
        /// Standard deviation of that.
        latency_sd_s: 0.1 in 0.0 .. 0.5, "s";
        /// Place of the receiver's antenna from the sensors, to the right.
        antenna_right_m: 0.0 in -100.0 .. 100.0, "m";
        /// The same, forward.
        antenna_forward_m: 0.0 in -100.0 .. 100.0, "m";
        /// The same, up.
        antenna_up_m: 0.0 in -100.0 .. 100.0, "m";
        /// Speed from which the track tells the course; a slow vehicle wants it lower, and less wind.
        track_speed_m_s: 3.0 in 0.2 .. 100.0, "m/s";
        /// Wind to be expected, by which course and track over ground differ.
        wind_m_s: 6.0 in 0.1 .. 100.0, "m/s";
        /// Time over which the difference between course and track stays alike.
        wind_memory_s: 100.0 in 1.0 .. 10000.0, "s";
        /// Time over which a correction is fed into the attitude.
        smoothing_s: 0.4 in 0.01 .. 10.0, "s";
        /// Innovation in standard deviations from which a measurement pulls no harder.
        innovation_limit: 4.0 in 1.0 .. 1000.0, "";
        /// Time without a velocity after which it counts as lost.
        gap_after_s: 1.5 in 0.2 .. 60.0, "s";
        /// Standard deviation of the remembered speed, along the course, in a gap.
        along_sd_m_s: 20.0 in 0.1 .. 1000.0, "m/s";
        /// Time over which its error stays alike.
        along_memory_s: 100.0 in 1.0 .. 10000.0, "s";
        /// Standard deviation of the velocity across the course in a gap.
        across_sd_m_s: 4.0 in 0.1 .. 1000.0, "m/s";
        /// Time over which its error stays alike.
        across_memory_s: 20.0 in 1.0 .. 10000.0, "s";
        /// Standard deviation of the vertical velocity in a gap.
        vertical_sd_m_s: 1.0 in 0.1 .. 1000.0, "m/s";
        /// Time over which its error stays alike.
        vertical_memory_s: 5.0 in 1.0 .. 10000.0, "s";
        /// Standard deviation of the speed as long as no velocity was ever told.
        speed_sd_m_s: 50.0 in 0.1 .. 1000.0, "m/s";
        /// Rate of turn at which an assumed velocity has lost half its weight.
        turn_rate_deg_s: 2.0 in 0.01 .. 100.0, "°/s";
        /// Standard deviation of the gyro bias seen at one standstill.
        standstill_sd_deg_s: 0.05 in 0.001 .. 10.0, "°/s";
        /// 1: the magnetic field corrects the heading; for a calibrated magnetometer with the declination set. 0: it does not.
        magnetic: 0.0 in 0.0 .. 1.0, "";
        /// Magnetic declination, east positive.
        declination_deg: 0.0 in -180.0 .. 180.0, "°";
        /// Standard deviation of the magnetic heading.
        magnetic_sd_deg: 5.0 in 0.1 .. 90.0, "°";
        /// Time over which its error stays alike.
        magnetic_memory_s: 20.0 in 0.1 .. 10000.0, "s";
    }
}

impl Settings {
    /// Whether a noise was set.
    pub(super) fn noises(&self) -> Noises {
        let of = |settings: &Self| {
            [
                settings.gyro_noise_deg_sqrt_s,
                settings.accel_noise_m_s_sqrt_s,
                settings.gyro_bias_walk_deg_s_sqrt_s,
                settings.accel_bias_walk_m_s2_sqrt_s,
                settings.scale_noise,
                settings.velocity_sd_m_s,
            ]
        };
        if of(self) == of(&Self::default()) { Noises::Usual } else { Noises::Set }
    }

    /// From the sensors to the receiver's antenna, m, body axes.
    pub(super) fn antenna_m(&self) -> Vector3<f64> {
        Vector3::new(self.antenna_right_m, self.antenna_forward_m, self.antenna_up_m)
    }
}
