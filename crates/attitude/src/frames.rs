//! The attitude in the frames of others.
//!
//! Input: a quaternion body → reference, angles, body vectors, w and z in our frames (body right, forward, up; reference east, north, up), or a
//! quaternion or vector in theirs. Output: the same in the other. Time: none. Failure: none. `docs/conventions.md` has the equations and
//! `docs/conventions.json` test vectors. What is made for others has no −0.
//!
//! Theirs are ours in one of three ways, the same for body and reference: as they are; second, −first, third; second, first, −third. The first
//! two differ by a quarter of a turn about the third axis, the first and the last by half a turn about (1, 1, 0).

use core::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_2};

use crate::{angles::Angles, state::wrapped_rad};

/// Frames in which the attitude is given to others: reference and body.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Frame {
    /// East, north, up; right, forward, up: ours.
    #[default]
    EnuRfu,
    /// East, north, up; forward, left, up: ROS, by REP 103.
    EnuFlu,
    /// North, west, up; forward, left, up.
    NwuFlu,
    /// North, east, down; forward, right, down: aircraft, PX4, ArduPilot, MAVLink.
    NedFrd,
}

/// Body axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Body {
    /// Right, forward, up: ours.
    #[default]
    Rfu,
    /// Forward, left, up.
    Flu,
    /// Forward, right, down.
    Frd,
}

/// Axes of the reference.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Earth {
    /// East, north, up: ours.
    #[default]
    Enu,
    /// North, west, up.
    Nwu,
    /// North, east, down.
    Ned,
}

/// In which order the parts of a quaternion stand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum QuaternionOrder {
    /// w, x, y, z: ours.
    #[default]
    Wxyz,
    /// x, y, z, w.
    Xyzw,
}

impl Frame {
    /// Every frame with its name.
    pub const NAMES: [(&str, Self); 4] =
        [("enu-rfu", Self::EnuRfu), ("enu-flu", Self::EnuFlu), ("nwu-flu", Self::NwuFlu), ("ned-frd", Self::NedFrd)];

    /// Its name.
    pub fn name(self) -> &'static str {
        name_in(&Self::NAMES, self)
    }

    /// Its reference.
    pub fn earth(self) -> Earth {
        match self {
            Self::EnuRfu | Self::EnuFlu => Earth::Enu,
            Self::NwuFlu => Earth::Nwu,
            Self::NedFrd => Earth::Ned,
        }
    }

    /// Its body axes.
    pub fn body(self) -> Body {
        match self {
            Self::EnuRfu => Body::Rfu,
            Self::EnuFlu | Self::NwuFlu => Body::Flu,
            Self::NedFrd => Body::Frd,
        }
    }

    /// The quaternion body → reference, w x y z.
    pub fn quaternion(self, ours: [f64; 4]) -> [f64; 4] {
        quaternion(self.earth(), self.body(), ours)
    }

    /// Yaw, pitch and roll: turns about the third, then the second or, of ours, the first axis, then the one that points forward; the first and the
    /// last in (−π, π].
    pub fn angles(self, ours: Angles) -> Angles {
        let Angles { yaw_rad, pitch_rad, roll_rad } = ours;
        let [yaw_rad, pitch_rad, roll_rad] = match self {
            Self::EnuRfu => return ours,
            Self::EnuFlu => [wrapped_rad(yaw_rad + FRAC_PI_2), -pitch_rad, roll_rad],
            Self::NwuFlu => [yaw_rad, -pitch_rad, roll_rad],
            Self::NedFrd => [wrapped_rad(-yaw_rad), pitch_rad, roll_rad],
        }
        .map(without_sign);
        Angles { yaw_rad, pitch_rad, roll_rad }
    }

    /// Their yaw, pitch and roll as ours.
    pub fn ours_of_angles(self, theirs: Angles) -> Angles {
        let Angles { yaw_rad, pitch_rad, roll_rad } = theirs;
        let [yaw_rad, pitch_rad, roll_rad] = match self {
            Self::EnuRfu => return theirs,
            Self::EnuFlu => [wrapped_rad(yaw_rad - FRAC_PI_2), -pitch_rad, roll_rad],
            Self::NwuFlu => [yaw_rad, -pitch_rad, roll_rad],
            Self::NedFrd => [wrapped_rad(-yaw_rad), pitch_rad, roll_rad],
        }
        .map(without_sign);
        Angles { yaw_rad, pitch_rad, roll_rad }
    }

    /// u, v and z: w projects the reference's third axis as the body axes see it, z is the turn about that axis. Inverted, they are those of the body
    /// turned by π about its right axis, in every frame.
    pub fn point(self, [u, v]: [f64; 2], z_rad: f64) -> ([f64; 2], f64) {
        let (w, z_rad) = match self {
            Self::EnuRfu => return ([u, v], z_rad),
            Self::EnuFlu => ([v, -u], wrapped_rad(z_rad + FRAC_PI_2)),
            Self::NwuFlu => ([v, -u], z_rad),
            Self::NedFrd => ([-v, -u], wrapped_rad(-z_rad)),
        };
        (w.map(without_sign), without_sign(z_rad))
    }
}

impl Body {
    /// Every one with its name.
    pub const NAMES: [(&str, Self); 3] = [("rfu", Self::Rfu), ("flu", Self::Flu), ("frd", Self::Frd)];

    /// Our vector in these axes.
    pub fn vector(self, ours: [f64; 3]) -> [f64; 3] {
        let [right, forward, up] = ours;
        match self {
            Self::Rfu => ours,
            Self::Flu => [forward, -right, up].map(without_sign),
            Self::Frd => [forward, right, -up].map(without_sign),
        }
    }

    /// A vector of these axes in ours. Only signs and places change, so every value stays exact.
    pub fn ours(self, [first, second, third]: [f64; 3]) -> [f64; 3] {
        match self {
            Self::Rfu => [first, second, third],
            Self::Flu => [-second, first, third],
            Self::Frd => [second, first, -third],
        }
    }

    /// A turn of the body, w x y z, in these axes.
    pub fn turn(self, ours: [f64; 4]) -> [f64; 4] {
        let [w, x, y, z] = ours;
        let [x, y, z] = self.vector([x, y, z]);
        [if self == Self::Rfu { w } else { without_sign(w) }, x, y, z]
    }

    fn of_earth(self) -> Earth {
        match self {
            Self::Rfu => Earth::Enu,
            Self::Flu => Earth::Nwu,
            Self::Frd => Earth::Ned,
        }
    }
}

impl Earth {
    /// Every one with its name.
    pub const NAMES: [(&str, Self); 3] = [("enu", Self::Enu), ("nwu", Self::Nwu), ("ned", Self::Ned)];

    /// Our vector in these axes.
    pub fn vector(self, ours: [f64; 3]) -> [f64; 3] {
        self.as_body().vector(ours)
    }

    /// A vector of these axes in ours.
    pub fn ours(self, theirs: [f64; 3]) -> [f64; 3] {
        self.as_body().ours(theirs)
    }

    fn as_body(self) -> Body {
        match self {
            Self::Enu => Body::Rfu,
            Self::Nwu => Body::Flu,
            Self::Ned => Body::Frd,
        }
    }
}

impl QuaternionOrder {
    /// Every order with its name.
    pub const NAMES: [(&str, Self); 2] = [("wxyz", Self::Wxyz), ("xyzw", Self::Xyzw)];

    /// Its name.
    pub fn name(self) -> &'static str {
        name_in(&Self::NAMES, self)
    }

    /// Of w, x, y, z, or of anything that stands for them.
    pub fn ordered<T>(self, [w, x, y, z]: [T; 4]) -> [T; 4] {
        match self {
            Self::Wxyz => [w, x, y, z],
            Self::Xyzw => [x, y, z, w],
        }
    }
}

/// The body axes of a name as `frd`, or those of the reference and the body of one as `ned-frd`, in letters of either size; `None` of what is
/// neither.
pub fn named(name: &str) -> Option<(Option<Earth>, Body)> {
    let (earth, body) = name.trim().split_once('-').map_or((None, name.trim()), |(earth, body)| (Some(earth), body));
    let earth = match earth {
        Some(earth) => Some(of_name(&Earth::NAMES, earth)?),
        None => None,
    };
    Some((earth, of_name(&Body::NAMES, body)?))
}

/// −0 as 0.
fn without_sign(number: f64) -> f64 {
    number + 0.0
}

fn of_name<T: Copy>(names: &[(&str, T)], name: &str) -> Option<T> {
    names.iter().find(|(other, _)| other.eq_ignore_ascii_case(name)).map(|(_, found)| *found)
}

fn name_in<T: PartialEq>(names: &[(&'static str, T)], one: T) -> &'static str {
    names.iter().find(|(_, other)| *other == one).map_or("", |(name, _)| name)
}

/// A quarter of a turn about the third axis, and half a turn about (1, 1, 0): v_theirs = b v_ours b*.
const QUARTER_TURN: [f64; 4] = [FRAC_1_SQRT_2, 0.0, 0.0, -FRAC_1_SQRT_2];
const HALF_TURN: [f64; 4] = [0.0, FRAC_1_SQRT_2, FRAC_1_SQRT_2, 0.0];
const NO_TURN: [f64; 4] = [1.0, 0.0, 0.0, 0.0];

impl Body {
    fn quaternion(self) -> [f64; 4] {
        match self {
            Self::Rfu => NO_TURN,
            Self::Flu => QUARTER_TURN,
            Self::Frd => HALF_TURN,
        }
    }
}

/// Our quaternion, w x y z, as one from the axes `body` to the axes `earth`: e q b*. Where both differ from ours in one way, only signs and places
/// change.
pub fn quaternion(earth: Earth, body: Body, ours: [f64; 4]) -> [f64; 4] {
    if body.of_earth() == earth {
        return body.turn(ours);
    }
    product(product(earth.as_body().quaternion(), ours), conjugate(body.quaternion())).map(without_sign)
}

/// The quaternion, w x y z, from the axes `body` to the axes `earth` as ours: e* q b.
pub fn ours(earth: Earth, body: Body, theirs: [f64; 4]) -> [f64; 4] {
    let [w, x, y, z] = theirs;
    match (earth, body) {
        (Earth::Enu, Body::Flu) => [w + z, x - y, x + y, z - w].map(|part| part * FRAC_1_SQRT_2),
        _ if body.of_earth() == earth => {
            let [x, y, z] = body.ours([x, y, z]);
            [w, x, y, z]
        }
        _ => product(product(conjugate(earth.as_body().quaternion()), theirs), body.quaternion()),
    }
}

fn conjugate([w, x, y, z]: [f64; 4]) -> [f64; 4] {
    [w, -x, -y, -z]
}

fn product([w, x, y, z]: [f64; 4], [a, b, c, d]: [f64; 4]) -> [f64; 4] {
    [
        w * a - x * b - y * c - z * d,
        w * b + x * a + y * d - z * c,
        w * c - x * d + y * a + z * b,
        w * d + x * c - y * b + z * a,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rotated(q: [f64; 4], [x, y, z]: [f64; 3]) -> [f64; 3] {
        let [_, x, y, z] = product(product(q, [0.0, x, y, z]), conjugate(q));
        [x, y, z]
    }

    fn apart(a: [f64; 3], b: [f64; 3]) -> f64 {
        a.into_iter().zip(b).map(|(a, b)| libm::fabs(a - b)).fold(0.0, f64::max)
    }

    const Q: [f64; 4] = [0.1, -0.5, 0.7, 0.5];
    const V: [f64; 3] = [0.2, -1.3, 0.8];

    #[test]
    fn a_vector_comes_to_the_same_place_in_every_frame_and_back() {
        for (_, earth) in Earth::NAMES {
            for (_, body) in Body::NAMES {
                let theirs = quaternion(earth, body, Q);
                assert!(
                    apart(rotated(theirs, body.vector(V)), earth.vector(rotated(Q, V))) < 1e-15,
                    "{earth:?} {body:?}"
                );
                let back = ours(earth, body, theirs);
                assert!(apart(rotated(back, V), rotated(Q, V)) < 1e-15, "{earth:?} {body:?}");
                assert_eq!((body.ours(body.vector(V)), earth.ours(earth.vector(V))), (V, V));
            }
        }
    }

    #[test]
    fn each_axis_goes_where_its_name_says() {
        let ours = [1.0, 2.0, 3.0];
        assert_eq!(Body::NAMES.map(|(_, body)| body.vector(ours)), [ours, [2.0, -1.0, 3.0], [2.0, 1.0, -3.0]]);
    }

    #[test]
    fn a_name_is_that_of_body_axes_or_of_both() {
        assert_eq!(named("frd"), Some((None, Body::Frd)));
        assert_eq!(named(" NED-frd "), Some((Some(Earth::Ned), Body::Frd)));
        assert_eq!([named("ned"), named("ned-"), named("frd-ned"), named("enu-flu-x"), named("")], [None; 5]);
        for (name, frame) in Frame::NAMES {
            assert_eq!((named(name), frame.name()), (Some((Some(frame.earth()), frame.body())), name));
        }
    }

    #[test]
    fn nothing_is_minus_zero() {
        for (name, frame) in Frame::NAMES.into_iter().skip(1) {
            for zero in [0.0, -0.0] {
                let angles = frame.angles(Angles { yaw_rad: zero, pitch_rad: zero, roll_rad: zero });
                let (w, z_rad) = frame.point([zero; 2], zero);
                let level = [[1.0, zero, zero, zero], [zero, zero, zero, 1.0]].map(|q| frame.quaternion(q));
                let vector = frame.body().vector([zero; 3]);
                let numbers = [angles.yaw_rad, angles.pitch_rad, angles.roll_rad, z_rad];
                let mut all = level.as_flattened().iter().chain(&vector).chain(&w).chain(&numbers);
                assert!(all.all(|x| *x != 0.0 || x.is_sign_positive()), "{name}");
            }
        }
    }
}
