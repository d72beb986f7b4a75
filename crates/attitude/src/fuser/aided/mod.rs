//! Fuser stage `aided`: an error-state filter with the velocity of a satellite receiver.
//!
//! The levelled specific force less gravity is integrated to a velocity. The difference from the
//! receiver's velocity reveals errors in tilt and heading and the biases of gyro and accelerometer.
//! The heading needs no magnetometer once the body accelerates or turns, because the acceleration
//! is then known both in body axes and relative to north. After some time without a fix, an assumed
//! velocity with a large variance is used instead: the remembered speed along the course, and zero
//! across it and vertically. There is no mode switch, because the covariance weights all
//! measurements.
//!
//! The state consists of (w, z), the velocity v, the gyro bias b, the accelerometer bias s, the
//! receiver's latency L, and the covariance of their errors. Attitude corrections are applied over
//! [`smoothing_s`](Settings::smoothing_s), as a rotation rate, like the rate ω_c that levels a
//! platform (see `levelling`).
//!
//! The heading refers to true north once the body has moved over ground faster than
//! `track_speed_m_s`. The initial heading is that of the track, so it is wrong for a body that
//! starts moving sideways or backwards. Before the first velocity, only gravity corrects the level.
//! In that phase the filter can infer the speed from a sustained turn, but not from sustained
//! straight acceleration. The earth's curvature and the Coriolis acceleration, which amount to
//! 0.04° at 50 m/s, are neglected.
//!
//! | file | content |
//! | --- | --- |
//! | `filter` | state, initialisation, corrections and standard deviations |
//! | `stage` | implementation of the stage contract: step, snapshot and hand-over |
//! | `strapdown` | propagation of attitude, velocity and covariance over an interval |
//! | `sums` | sums since the last propagation of the covariance |
//! | `fixes` | satellite velocity and the initial course |
//! | `aiding` | state of the receiver |
//! | `assumed_velocity` | assumed velocity without fixes, and updates at standstill |
//! | `consistency` | consistency of the filter's standard deviations |
//! | `standstill` | standstill detector, which also measures the gyro bias |
//! | `magnetic` | heading from the magnetic field |
//! | `velocity_history` | velocities of the last second |
//! | `covariance` | covariance and its update by a measurement |
//! | `variance` | variances from standard deviations |

mod aiding;
mod assumed_velocity;
mod consistency;
mod covariance;
mod filter;
mod fixes;
mod magnetic;
mod settings;
mod stage;
mod standstill;
mod strapdown;
mod sums;
mod variance;
mod velocity_history;

pub(super) use settings::MAGNETOMETER_COUNT;
pub use {filter::Aided, settings::Settings};
