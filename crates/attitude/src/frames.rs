//! Conversion of attitudes and vectors between Plumbline's frames and those of other systems.
//!
//! Input and output: a quaternion body → reference, angles, body vectors, w and z. *Native* values
//! are in Plumbline's frames (body right, forward, up; reference east, north, up); *external*
//! values are in another frame. Native values converted to an external frame contain no −0.
//!
//! `docs/reference/conventions.md` has the equations, and `docs/reference/conventions.json` has
//! test vectors.
//!
//! External axes are obtained from the native axes by one of three permutations, which are the same
//! for body and reference: the identity; (second, −first, third); (second, first, −third). Relative
//! to the identity, the middle one is a quarter turn about the third axis and the last one a half
//! turn about (1, 1, 0).

use core::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_2};

use crate::{angles::Angles, state::wrapped_rad};

/// Combination of reference and body axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Frame {
    /// Reference east, north, up; body right, forward, up: Plumbline's native frame.
    #[default]
    EnuRfu,
    /// Reference east, north, up; body forward, left, up: ROS, by REP 103.
    EnuFlu,
    /// Reference north, west, up; body forward, left, up.
    NwuFlu,
    /// Reference north, east, down; body forward, right, down: aircraft, PX4, ArduPilot, MAVLink.
    NedFrd,
}

/// Axes of the body.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Body {
    /// Right, forward, up. These are the native axes.
    #[default]
    Rfu,
    /// Forward, left, up.
    Flu,
    /// Forward, right, down.
    Frd,
}

/// Axes of the reference frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Earth {
    /// East, north, up. These are the native axes.
    #[default]
    Enu,
    /// North, west, up.
    Nwu,
    /// North, east, down.
    Ned,
}

/// Order of the components of a quaternion.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum QuaternionOrder {
    /// w, x, y, z. This is the native order.
    #[default]
    Wxyz,
    /// x, y, z, w.
    Xyzw,
}

impl Frame {
    /// All frames with their names.
    pub const NAMES: [(&str, Self); 4] =
        [("enu-rfu", Self::EnuRfu), ("enu-flu", Self::EnuFlu), ("nwu-flu", Self::NwuFlu), ("ned-frd", Self::NedFrd)];

    /// Returns the name of the frame.
    pub fn name(self) -> &'static str {
        name_of(&Self::NAMES, self)
    }

    /// Returns the reference axes.
    pub fn earth(self) -> Earth {
        match self {
            Self::EnuRfu | Self::EnuFlu => Earth::Enu,
            Self::NwuFlu => Earth::Nwu,
            Self::NedFrd => Earth::Ned,
        }
    }

    /// Returns the body axes.
    pub fn body(self) -> Body {
        match self {
            Self::EnuRfu => Body::Rfu,
            Self::EnuFlu | Self::NwuFlu => Body::Flu,
            Self::NedFrd => Body::Frd,
        }
    }

    /// Converts a native quaternion (body → reference, w x y z) to this frame.
    pub fn quaternion(self, native: [f64; 4]) -> [f64; 4] {
        quaternion_from_native(self.earth(), self.body(), native)
    }

    /// Converts native yaw, pitch and roll to the angles of this frame.
    ///
    /// In every frame, yaw, pitch and roll are successive rotations about the third axis, the
    /// second axis (in the native frame, the first axis) and the axis that points forward. Yaw and
    /// roll are in (−π, π].
    pub fn angles(self, native: Angles) -> Angles {
        let Angles { yaw_rad, pitch_rad, roll_rad } = native;
        let [yaw_rad, pitch_rad, roll_rad] = match self {
            Self::EnuRfu => return native,
            Self::EnuFlu => [wrapped_rad(yaw_rad + FRAC_PI_2), -pitch_rad, roll_rad],
            Self::NwuFlu => [yaw_rad, -pitch_rad, roll_rad],
            Self::NedFrd => [wrapped_rad(-yaw_rad), pitch_rad, roll_rad],
        }
        .map(without_negative_zero);
        Angles { yaw_rad, pitch_rad, roll_rad }
    }

    /// Converts external yaw, pitch and roll to native angles.
    pub fn angles_to_native(self, external: Angles) -> Angles {
        let Angles { yaw_rad, pitch_rad, roll_rad } = external;
        let [yaw_rad, pitch_rad, roll_rad] = match self {
            Self::EnuRfu => return external,
            Self::EnuFlu => [wrapped_rad(yaw_rad - FRAC_PI_2), -pitch_rad, roll_rad],
            Self::NwuFlu => [yaw_rad, -pitch_rad, roll_rad],
            Self::NedFrd => [wrapped_rad(-yaw_rad), pitch_rad, roll_rad],
        }
        .map(without_negative_zero);
        Angles { yaw_rad, pitch_rad, roll_rad }
    }

    /// Converts native u, v and z to this frame.
    ///
    /// The point w = u + j v is the projection of the reference's third axis in body axes, and z is
    /// the rotation about that axis. In the inverted chart, w and z are those of the body rotated
    /// by π about its right axis, in every frame.
    pub fn point(self, [u, v]: [f64; 2], z_rad: f64) -> ([f64; 2], f64) {
        let (w, z_rad) = match self {
            Self::EnuRfu => return ([u, v], z_rad),
            Self::EnuFlu => ([v, -u], wrapped_rad(z_rad + FRAC_PI_2)),
            Self::NwuFlu => ([v, -u], z_rad),
            Self::NedFrd => ([-v, -u], wrapped_rad(-z_rad)),
        };
        (w.map(without_negative_zero), without_negative_zero(z_rad))
    }
}

impl Body {
    /// All body axes with their names.
    pub const NAMES: [(&str, Self); 3] = [("rfu", Self::Rfu), ("flu", Self::Flu), ("frd", Self::Frd)];

    /// Converts a native vector to these axes.
    pub fn vector(self, native: [f64; 3]) -> [f64; 3] {
        let [right, forward, up] = native;
        match self {
            Self::Rfu => native,
            Self::Flu => [forward, -right, up].map(without_negative_zero),
            Self::Frd => [forward, right, -up].map(without_negative_zero),
        }
    }

    /// Converts a vector in these axes to native axes, exactly, because only signs and order
    /// change.
    pub fn to_native(self, [first, second, third]: [f64; 3]) -> [f64; 3] {
        match self {
            Self::Rfu => [first, second, third],
            Self::Flu => [-second, first, third],
            Self::Frd => [second, first, -third],
        }
    }

    /// Converts a native body rotation, given as a quaternion w x y z, to these axes.
    pub fn rotation(self, native: [f64; 4]) -> [f64; 4] {
        let [w, x, y, z] = native;
        let [x, y, z] = self.vector([x, y, z]);
        [if self == Self::Rfu { w } else { without_negative_zero(w) }, x, y, z]
    }

    fn matching_earth(self) -> Earth {
        match self {
            Self::Rfu => Earth::Enu,
            Self::Flu => Earth::Nwu,
            Self::Frd => Earth::Ned,
        }
    }
}

impl Earth {
    /// All reference axes with their names.
    pub const NAMES: [(&str, Self); 3] = [("enu", Self::Enu), ("nwu", Self::Nwu), ("ned", Self::Ned)];

    /// Converts a native vector to these axes.
    pub fn vector(self, native: [f64; 3]) -> [f64; 3] {
        self.matching_body().vector(native)
    }

    /// Converts a vector in these axes to native axes.
    pub fn to_native(self, external: [f64; 3]) -> [f64; 3] {
        self.matching_body().to_native(external)
    }

    fn matching_body(self) -> Body {
        match self {
            Self::Enu => Body::Rfu,
            Self::Nwu => Body::Flu,
            Self::Ned => Body::Frd,
        }
    }
}

impl QuaternionOrder {
    /// All orders with their names.
    pub const NAMES: [(&str, Self); 2] = [("wxyz", Self::Wxyz), ("xyzw", Self::Xyzw)];

    /// Returns the name of the order.
    pub fn name(self) -> &'static str {
        name_of(&Self::NAMES, self)
    }

    /// Returns the components `[w, x, y, z]`, rearranged in the order `self`.
    pub fn ordered<T>(self, [w, x, y, z]: [T; 4]) -> [T; 4] {
        match self {
            Self::Wxyz => [w, x, y, z],
            Self::Xyzw => [x, y, z, w],
        }
    }
}

/// Parses the name of body axes such as `frd`, or of reference and body axes such as `ned-frd`.
///
/// Case is ignored. Returns `None` for any other text.
pub fn parse(name: &str) -> Option<(Option<Earth>, Body)> {
    let (earth, body) = name.trim().split_once('-').map_or((None, name.trim()), |(earth, body)| (Some(earth), body));
    let earth = match earth {
        Some(earth) => Some(find_by_name(&Earth::NAMES, earth)?),
        None => None,
    };
    Some((earth, find_by_name(&Body::NAMES, body)?))
}

/// Replaces −0 by 0.
fn without_negative_zero(number: f64) -> f64 {
    number + 0.0
}

fn find_by_name<T: Copy>(names: &[(&str, T)], name: &str) -> Option<T> {
    names.iter().find(|(other, _)| other.eq_ignore_ascii_case(name)).map(|(_, found)| *found)
}

fn name_of<T: PartialEq>(names: &[(&'static str, T)], one: T) -> &'static str {
    names.iter().find(|(_, other)| *other == one).map_or("", |(name, _)| name)
}

/// Quaternion b with v_external = b v_native b* for the axes forward, left, up.
///
/// This rotation is a quarter turn about the third axis.
const FLU_ROTATION: [f64; 4] = [FRAC_1_SQRT_2, 0.0, 0.0, -FRAC_1_SQRT_2];
/// Quaternion b such that v_external = b v_native b*, for axes forward, right, down.
///
/// This rotation is a half turn about (1, 1, 0).
const FRD_ROTATION: [f64; 4] = [0.0, FRAC_1_SQRT_2, FRAC_1_SQRT_2, 0.0];
const IDENTITY: [f64; 4] = [1.0, 0.0, 0.0, 0.0];

impl Body {
    fn quaternion(self) -> [f64; 4] {
        match self {
            Self::Rfu => IDENTITY,
            Self::Flu => FLU_ROTATION,
            Self::Frd => FRD_ROTATION,
        }
    }
}

/// Converts a native quaternion (w x y z) to the quaternion `body` → `earth`.
///
/// The result is e q b*, where q is the native quaternion, b converts native body axes to `body`,
/// and e converts native reference axes to `earth`. If b and e are the same permutation of axes,
/// only signs and order change.
pub fn quaternion_from_native(earth: Earth, body: Body, native: [f64; 4]) -> [f64; 4] {
    if body.matching_earth() == earth {
        return body.rotation(native);
    }
    product(product(earth.matching_body().quaternion(), native), conjugate(body.quaternion()))
        .map(without_negative_zero)
}

/// Converts a quaternion `body` → `earth` (w x y z) to the native quaternion.
///
/// The result is e* q b, where q is the given quaternion, and b and e are those of
/// [`quaternion_from_native`].
pub fn quaternion_to_native(earth: Earth, body: Body, external: [f64; 4]) -> [f64; 4] {
    let [w, x, y, z] = external;
    match (earth, body) {
        (Earth::Enu, Body::Flu) => [w + z, x - y, x + y, z - w].map(|part| part * FRAC_1_SQRT_2),
        _ if body.matching_earth() == earth => {
            let [x, y, z] = body.to_native([x, y, z]);
            [w, x, y, z]
        }
        _ => product(product(conjugate(earth.matching_body().quaternion()), external), body.quaternion()),
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

    fn max_difference(a: [f64; 3], b: [f64; 3]) -> f64 {
        a.into_iter().zip(b).map(|(a, b)| libm::fabs(a - b)).fold(0.0, f64::max)
    }

    const Q: [f64; 4] = [0.1, -0.5, 0.7, 0.5];
    const V: [f64; 3] = [0.2, -1.3, 0.8];

    #[test]
    fn vectors_round_trip_through_every_frame() {
        for (_, earth) in Earth::NAMES {
            for (_, body) in Body::NAMES {
                let external = quaternion_from_native(earth, body, Q);
                assert!(
                    max_difference(rotated(external, body.vector(V)), earth.vector(rotated(Q, V))) < 1e-15,
                    "{earth:?} {body:?}"
                );
                let back = quaternion_to_native(earth, body, external);
                assert!(max_difference(rotated(back, V), rotated(Q, V)) < 1e-15, "{earth:?} {body:?}");
                assert_eq!((body.to_native(body.vector(V)), earth.to_native(earth.vector(V))), (V, V));
            }
        }
    }

    #[test]
    fn body_axes_match_their_names() {
        let native = [1.0, 2.0, 3.0];
        assert_eq!(Body::NAMES.map(|(_, body)| body.vector(native)), [native, [2.0, -1.0, 3.0], [2.0, 1.0, -3.0]]);
    }

    #[test]
    fn parse_accepts_body_or_reference_and_body() {
        assert_eq!(parse("frd"), Some((None, Body::Frd)));
        assert_eq!(parse(" NED-frd "), Some((Some(Earth::Ned), Body::Frd)));
        assert_eq!([parse("ned"), parse("ned-"), parse("frd-ned"), parse("enu-flu-x"), parse("")], [None; 5]);
        for (name, frame) in Frame::NAMES {
            assert_eq!((parse(name), frame.name()), (Some((Some(frame.earth()), frame.body())), name));
        }
    }

    #[test]
    fn conversions_yield_no_negative_zero() {
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
