//! Settings of the fuser stage `aided`.

use super::consistency::NoiseSettings;
use crate::{Vector3, parameters::settings};

/// Number of settings at the end of the table that belong to the magnetometer.
pub(in crate::fuser) const MAGNETOMETER_COUNT: usize = 4;

settings! {
    /// Settings of the fuser stage `aided`.
    pub struct Settings {
        /// White noise of the gyro (angle random walk), including scale errors under vibration.
        gyro_noise_deg_sqrt_s: 0.01 in 0.0001 .. 10.0, "°/√s";
        /// White noise of the accelerometer (velocity random walk), added to the measured noise.
        accel_noise_m_s_sqrt_s: 0.03 in 0.0001 .. 10.0, "m/s/√s";
        /// Random walk of the gyro bias.
        gyro_bias_walk_deg_s_sqrt_s: 0.0005 in 0.0 .. 1.0, "°/s/√s";
        /// Random walk of the accelerometer bias.
        accel_bias_walk_m_s2_sqrt_s: 0.0001 in 0.0 .. 1.0, "m/s²/√s";
        /// Scale error of gyro and accelerometer, modelled as noise proportional to the motion.
        scale_noise: 0.001 in 0.0 .. 0.1, "";
        /// Initial standard deviation of the gyro bias.
        gyro_bias_sd_deg_s: 0.2 in 0.0001 .. 10.0, "°/s";
        /// Initial standard deviation of the accelerometer bias.
        accel_bias_sd_m_s2: 0.05 in 0.0001 .. 10.0, "m/s²";
        /// Standard deviation of the initial tilt about each horizontal axis.
        level_sd_deg: 2.0 in 0.01 .. 60.0, "°";
        /// Standard deviation of the initial course, which is set from the track, in still air.
        course_sd_deg: 10.0 in 0.1 .. 90.0, "°";
        /// Standard deviation of a satellite velocity on each axis, used if the receiver reports
        /// none.
        velocity_sd_m_s: 0.2 in 0.01 .. 100.0, "m/s";
        /// Initial estimate of the receiver's latency, used if the age is not reported.
        latency_s: 0.2 in 0.0 .. 0.6, "s";
        /// Initial standard deviation of the receiver's latency.
        latency_sd_s: 0.1 in 0.0 .. 0.5, "s";
        /// Position of the receiver's antenna relative to the sensors, positive to the right.
        antenna_right_m: 0.0 in -100.0 .. 100.0, "m";
        /// Position of the receiver's antenna relative to the sensors, positive forward.
        antenna_forward_m: 0.0 in -100.0 .. 100.0, "m";
        /// Position of the receiver's antenna relative to the sensors, positive upward.
        antenna_up_m: 0.0 in -100.0 .. 100.0, "m";
        /// Speed above which the track sets the course. Lower it for slow vehicles and light wind.
        track_speed_m_s: 3.0 in 0.2 .. 100.0, "m/s";
        /// Expected wind, which makes the course differ from the track over ground.
        wind_m_s: 6.0 in 0.1 .. 100.0, "m/s";
        /// Correlation time of the difference between course and track.
        wind_memory_s: 100.0 in 1.0 .. 10000.0, "s";
        /// Time over which a correction is applied to the attitude.
        smoothing_s: 0.4 in 0.01 .. 10.0, "s";
        /// Normalised innovation above which a measurement has no greater effect.
        innovation_limit: 4.0 in 1.0 .. 1000.0, "";
        /// Time without a velocity after which the receiver counts as lost.
        fix_timeout_s: 1.5 in 0.2 .. 60.0, "s";
        /// Standard deviation of the remembered speed along the course without fixes.
        along_sd_m_s: 20.0 in 0.1 .. 1000.0, "m/s";
        /// Correlation time of the error in the remembered speed.
        along_memory_s: 100.0 in 1.0 .. 10000.0, "s";
        /// Standard deviation of the velocity across the course without fixes.
        across_sd_m_s: 4.0 in 0.1 .. 1000.0, "m/s";
        /// Correlation time of the velocity across the course without fixes.
        across_memory_s: 20.0 in 1.0 .. 10000.0, "s";
        /// Standard deviation of the vertical velocity without fixes.
        vertical_sd_m_s: 1.0 in 0.1 .. 1000.0, "m/s";
        /// Correlation time of the vertical velocity without fixes.
        vertical_memory_s: 5.0 in 1.0 .. 10000.0, "s";
        /// Standard deviation of the speed before the first satellite velocity.
        speed_sd_m_s: 50.0 in 0.1 .. 1000.0, "m/s";
        /// Turn rate at which the weight of an assumed velocity is halved.
        half_weight_turn_rate_deg_s: 2.0 in 0.01 .. 100.0, "°/s";
        /// Standard deviation of a gyro bias measurement at standstill.
        standstill_sd_deg_s: 0.05 in 0.001 .. 10.0, "°/s";
        /// 1: correct the heading with a calibrated magnetometer. 0: ignore the magnetic field.
        magnetic: 0.0 in 0.0 .. 1.0, "";
        /// Magnetic declination, east positive.
        declination_deg: 0.0 in -180.0 .. 180.0, "°";
        /// Standard deviation of the magnetic heading.
        magnetic_sd_deg: 5.0 in 0.1 .. 90.0, "°";
        /// Correlation time of the error in the magnetic heading.
        magnetic_memory_s: 20.0 in 0.1 .. 10000.0, "s";
    }
}

impl Settings {
    /// Returns [`NoiseSettings::Default`] if all noise settings have their default values.
    pub(super) fn noise_settings(&self) -> NoiseSettings {
        let noises = |settings: &Self| {
            [
                settings.gyro_noise_deg_sqrt_s,
                settings.accel_noise_m_s_sqrt_s,
                settings.gyro_bias_walk_deg_s_sqrt_s,
                settings.accel_bias_walk_m_s2_sqrt_s,
                settings.scale_noise,
                settings.velocity_sd_m_s,
            ]
        };
        if noises(self) == noises(&Self::default()) { NoiseSettings::Default } else { NoiseSettings::Custom }
    }

    /// Returns the vector from the sensors to the receiver's antenna in body axes, m.
    pub(super) fn antenna_m(&self) -> Vector3<f64> {
        Vector3::new(self.antenna_right_m, self.antenna_forward_m, self.antenna_up_m)
    }
}
