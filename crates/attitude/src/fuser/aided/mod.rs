//! The fuser `aided`: an error-state filter with the velocity of a satellite receiver.
//!
//! The levelled specific force, less gravity, is integrated to a velocity; what it misses of the receiver's velocity tells tilt,
//! heading and the biases of gyro and accelerometer. Heading needs no magnetometer as soon as the body speeds up, slows down or
//! turns: the acceleration is told twice, in body axes and against north. Without a fix for a while an assumed velocity with a large
//! variance takes its place: the remembered speed along the course, nothing across it, nothing upwards. Nothing is switched over,
//! the covariance carries on how much each is to be trusted.
//!
//! The state is (w, z), the velocity v, the biases b and s, the receiver's latency L and the covariance of their errors. Corrections
//! of the attitude are fed in over [`smoothing_s`](Settings::smoothing_s), as the rate w_c of a platform that is levelled.
//!
//! Heading counts from true north once the body was seen to move over ground faster than `track_speed_m_s`. The first heading is that
//! of the track: a body that begins to move sideways or backwards gets a wrong one. Until a velocity is told only gravity levels: a lasting turn then
//! reveals the speed, lasting straight acceleration does not. Curvature of the earth and Coriolis acceleration, 0.04° at 50 m/s, are
//! left out.
//!
//! | file | what it does |
//! | --- | --- |
//! | `filter` | the state: its beginning, its correction, its standard deviations |
//! | `stage` | the order of a step, and what is in the snapshot |
//! | `strapdown` | attitude, velocity and covariance over one interval |
//! | `sums` | what happened since the last step of the covariance |
//! | `fixes` | a velocity that was told; the first course |
//! | `aiding` | what is known of the receiver |
//! | `assumed` | a velocity that is assumed |
//! | `consistency` | whether the filter's own standard deviations are true |
//! | `standstill` | the gyro bias at rest |
//! | `magnetic` | the heading of the magnetic field |
//! | `past` | velocities of the last second |
//! | `covariance` | the covariance and the gain of a measurement |
//! | `variance` | variances from standard deviations |

mod aiding;
mod assumed;
mod consistency;
mod covariance;
mod filter;
mod fixes;
mod magnetic;
mod past;
mod settings;
mod stage;
mod standstill;
mod strapdown;
mod sums;
mod variance;

pub(super) use settings::OF_THE_MAGNETOMETER;
pub use {filter::Aided, settings::Settings};
