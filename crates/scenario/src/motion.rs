//! Motions of a body and the true state at a given time.

use attitude::{GRAVITY_M_S2, Vector3, rotation::Rotation};

use crate::{
    coning::Coning,
    cruise::{Flight, FlightPlan},
    s1::{self, Swing},
    s3,
    truth::Truth,
    tumble,
};

/// Motion of a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Motion {
    /// Yaw at 1 °/s, with pitch and roll oscillating at 0.05 Hz.
    Swing(Swing),
    /// Constant rate about a body-fixed axis, rad/s, starting from level.
    Tumble(Vector3<f64>),
    /// One full turn about each axis in sequence.
    S3,
    /// Classical coning.
    Coning(Coning),
    /// Aircraft in cruise.
    Cruise(Flight),
}

impl Motion {
    /// Reference scenario of Matveev 2025: yaw 1 °/s, pitch 25° and roll 30° at 0.05 Hz.
    pub const S1: Self = Self::Swing(Swing::S1);

    /// Names that [`Motion::from_name`] accepts.
    pub const NAMES: [&'static str; 6] = ["s1", "tumble", "s3", "coning", "cruise", "cruise-hard"];

    /// Returns the motion with the given name, or `None` for an unknown name.
    ///
    /// `tumble` has a rate of 500 °/s about an axis oblique to all body axes. The flights have seed
    /// 1.
    pub fn from_name(name: &str) -> Option<Self> {
        match name {
            "s1" => Some(Self::S1),
            "tumble" => Some(Self::Tumble(tumble::rate_rad_s())),
            "s3" => Some(Self::S3),
            "coning" => Some(Self::Coning(Coning::default())),
            "cruise" => Some(Self::Cruise(Flight { seed: 1, hard: false })),
            "cruise-hard" => Some(Self::Cruise(Flight { seed: 1, hard: true })),
            _ => None,
        }
    }

    /// Returns the true state at `t_s`.
    pub fn at(self, t_s: f64) -> Truth {
        Body::new(self).at(t_s)
    }

    /// Returns the exact rotation of the body from one time to another.
    pub fn rotation_between(self, from_s: f64, to_s: f64) -> Rotation {
        let mut body = Body::new(self);
        Rotation::between(body.at(from_s).attitude, body.at(to_s).attitude)
    }

    /// Returns the mean body rate in rad/s from one time to another, as read by an integrating
    /// gyro.
    ///
    /// If the axis of rotation changes within the interval, the mean rate differs from the constant
    /// rate that would cause the rotation returned by [`rotation_between`](Self::rotation_between).
    pub fn mean_rate_rad_s(self, from_s: f64, to_s: f64) -> Vector3<f64> {
        Body::new(self).mean_rate_rad_s(from_s, to_s)
    }
}

/// Motion and, for a flight, the part of its plan generated so far.
#[derive(Debug, Clone)]
pub(crate) struct Body {
    motion: Motion,
    plan: Option<FlightPlan>,
}

impl Body {
    pub(crate) fn new(motion: Motion) -> Self {
        let plan = if let Motion::Cruise(flight) = motion { Some(FlightPlan::new(flight)) } else { None };
        Self { motion, plan }
    }

    pub(crate) fn at(&mut self, t_s: f64) -> Truth {
        let (attitude, rate_rad_s) = match self.motion {
            Motion::Swing(swing) => s1::at(swing, t_s),
            Motion::Tumble(rate_rad_s) => (tumble::at(rate_rad_s, t_s), rate_rad_s),
            Motion::S3 => s3::at(t_s),
            Motion::Coning(coning) => coning.at(t_s),
            Motion::Cruise(flight) => return self.plan.get_or_insert_with(|| FlightPlan::new(flight)).at(t_s),
        };
        Truth { attitude, rate_rad_s, force_m_s2: attitude.up.direction() * GRAVITY_M_S2 }
    }

    /// Returns the velocity over ground, m/s, east, north, up.
    pub(crate) fn velocity_m_s(&mut self, t_s: f64) -> Vector3<f64> {
        self.plan.as_mut().map_or(Vector3::zeros(), |plan| plan.velocity_m_s(t_s))
    }

    pub(crate) fn mean_rate_rad_s(&mut self, from_s: f64, to_s: f64) -> Vector3<f64> {
        let interval_s = to_s - from_s;
        if interval_s == 0.0 {
            return self.at(to_s).rate_rad_s;
        }
        match self.motion {
            Motion::Tumble(rate_rad_s) => rate_rad_s,
            Motion::S3 => (s3::rotation_rad(to_s) - s3::rotation_rad(from_s)) / interval_s,
            Motion::Coning(coning) => (coning.rotation_rad(to_s) - coning.rotation_rad(from_s)) / interval_s,
            // Gauss-Legendre quadrature with three points, which is exact for polynomials up to
            // degree 5 and accurate enough for motions as slow as these.
            Motion::Swing(_) | Motion::Cruise(_) => {
                let middle_s = 0.5 * (from_s + to_s);
                let offset_s = 0.5 * interval_s * libm::sqrt(0.6);
                let mut rate = |t_s: f64| self.at(t_s).rate_rad_s;
                (rate(middle_s - offset_s) * 5.0 + rate(middle_s) * 8.0 + rate(middle_s + offset_s) * 5.0) / 18.0
            }
        }
    }
}
