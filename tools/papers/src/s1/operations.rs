//! Operation counts per step for (u, v, z) and for the quaternion, with integrators of equal order.
//!
//! Output: multiplications, additions, divisions and square roots of one step, counted by a number
//! type.
//!
//! S1 claims that three equations instead of four need up to 30 % less computation. The counts
//! check this claim.

use std::{
    cell::Cell,
    ops::{Add, Div, Mul, Sub},
};

thread_local! {
    static COUNTS: Cell<Operations> = const { Cell::new(Operations { products: 0, sums: 0, others: 0 }) };
}

/// Numbers of operations in a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Operations {
    /// Multiplications.
    pub products: u32,
    /// Additions and subtractions.
    pub sums: u32,
    /// Divisions and square roots.
    pub others: u32,
}

impl Operations {
    /// Returns the total number of operations.
    pub fn total(self) -> u32 {
        self.products + self.sums + self.others
    }
}

/// Number that counts the operations applied to it.
#[derive(Debug, Clone, Copy)]
struct Counted(f64);

/// Increments the count of one kind of operation.
fn increment(kind: fn(&mut Operations) -> &mut u32) {
    COUNTS.with(|counts| {
        let mut operations = counts.get();
        *kind(&mut operations) += 1;
        counts.set(operations);
    });
}

macro_rules! impl_counted_ops {
    ($($Trait:ident, $method:ident, $op:tt, $field:ident;)*) => {$(
        impl $Trait for Counted {
            type Output = Self;

            fn $method(self, other: Self) -> Self {
                increment(|operations| &mut operations.$field);
                Self(self.0 $op other.0)
            }
        }
    )*};
}

impl_counted_ops! {
    Add, add, +, sums;
    Sub, sub, -, sums;
    Mul, mul, *, products;
    Div, div, /, others;
}

impl Counted {
    fn sqrt(self) -> Self {
        increment(|operations| &mut operations.others);
        Self(self.0.sqrt())
    }
}

/// Returns the derivatives of u, v and z — Matveev 2025, (18)–(20).
fn point([u, v, _]: [Counted; 3], [x, y, z]: [Counted; 3]) -> [Counted; 3] {
    let (one, half) = (Counted(1.0), Counted(0.5));
    let (product, difference) = (u * v, u * u - v * v);
    [
        v * z + product * x - half * y * (one + difference),
        half * x * (one - difference) - u * z - product * y,
        z + u * x + v * y,
    ]
}

/// Returns the derivative of the quaternion, q' = ½ q ⊗ (0, ω).
fn quaternion([a, b, c, d]: [Counted; 4], [x, y, z]: [Counted; 3]) -> [Counted; 4] {
    let half = Counted(0.5);
    let (x, y, z) = (half * x, half * y, half * z);
    [Counted(0.0 - b.0) * x - c * y - d * z, a * x + c * z - d * y, a * y + d * x - b * z, a * z + b * y - c * x]
}

fn advanced<const N: usize>(state: [Counted; N], slope: [Counted; N], dt: Counted) -> [Counted; N] {
    std::array::from_fn(|i| state[i] + slope[i] * dt)
}

/// Performs one step of the classical Runge–Kutta method.
///
/// `rates` are the rates at the start, the midpoint and the end of the step.
fn fourth_order<const N: usize>(
    state: [Counted; N],
    slope: fn([Counted; N], [Counted; 3]) -> [Counted; N],
    rates: [[Counted; 3]; 3],
) -> [Counted; N] {
    let (dt, half, sixth) = (Counted(0.01), Counted(0.005), Counted(0.01 / 6.0));
    let first = slope(state, rates[0]);
    let second = slope(advanced(state, first, half), rates[1]);
    let third = slope(advanced(state, second, half), rates[1]);
    let fourth = slope(advanced(state, third, dt), rates[2]);
    let two = Counted(2.0);
    let sum = std::array::from_fn(|i| first[i] + (second[i] + third[i]) * two + fourth[i]);
    advanced(state, sum, sixth)
}

fn normalized(q: [Counted; 4]) -> [Counted; 4] {
    let [a, b, c, d] = q;
    let inverse = Counted(1.0) / (a * a + b * b + c * c + d * d).sqrt();
    q.map(|x| x * inverse)
}

/// Operation counts of one integration step with (u, v, z) and with the normalised quaternion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OperationComparison {
    /// Integration method.
    pub method: &'static str,
    /// Operations with (u, v, z), by (18)–(20).
    pub point: Operations,
    /// Operations with the quaternion, by q' = ½ q ⊗ (0, ω), including the normalisation.
    pub quaternion: Operations,
}

impl OperationComparison {
    /// Returns the fraction of operations that (u, v, z) saves compared with the quaternion.
    pub fn reduction(&self) -> f64 {
        1.0 - f64::from(self.point.total()) / f64::from(self.quaternion.total())
    }
}

/// Returns the comparison for Euler's method and for the classical Runge–Kutta method.
pub(crate) fn comparisons() -> [OperationComparison; 2] {
    let rate = [0.3, -0.2, 0.5].map(Counted);
    let (w, q, dt) = ([0.1, 0.2, 0.3].map(Counted), [0.5; 4].map(Counted), Counted(0.01));
    [
        OperationComparison {
            method: "Euler, first order",
            point: count_operations(|| advanced(w, point(w, rate), dt)),
            quaternion: count_operations(|| normalized(advanced(q, quaternion(q, rate), dt))),
        },
        OperationComparison {
            method: "Runge–Kutta, fourth order",
            point: count_operations(|| fourth_order(w, point, [rate; 3])),
            quaternion: count_operations(|| normalized(fourth_order(q, quaternion, [rate; 3]))),
        },
    ]
}

/// Runs `step` and returns the number of its operations.
fn count_operations<T>(step: impl FnOnce() -> T) -> Operations {
    COUNTS.with(Cell::take);
    step();
    COUNTS.with(Cell::take)
}

#[cfg(test)]
mod tests {
    use attitude::{
        Complex, Quaternion, Vector3, kinematics,
        point::{Chart, Point},
        state::Attitude,
    };

    use super::*;

    #[test]
    fn counted_step_matches_stage_kinematics() {
        let rate = [0.3, -0.2, 0.5];
        let up = Point { w: Complex::new(0.1, 0.2), chart: Chart::Upright };
        let [u, v, z] = fourth_order([0.1, 0.2, 0.3].map(Counted), point, [rate.map(Counted); 3]).map(|x| x.0);
        let runs = kinematics::rk4(Attitude { up, z_rad: 0.3 }, |_| Vector3::from(rate), 0.01);
        for (got, want) in [(u, runs.up.w.re), (v, runs.up.w.im), (z, runs.z_rad)] {
            assert!((got - want).abs() < 1e-15, "{got}, {want}");
        }
        let start = Quaternion::new(0.5, 0.5, -0.5, 0.5);
        let q = normalized(fourth_order([0.5, 0.5, -0.5, 0.5].map(Counted), quaternion, [rate.map(Counted); 3]));
        let exact = start * Quaternion::new(0.0, rate[0] * 0.005, rate[1] * 0.005, rate[2] * 0.005).exp();
        for (got, want) in q.map(|x| x.0).into_iter().zip([exact.w, exact.i, exact.j, exact.k]) {
            assert!((got - want).abs() < 1e-12, "{got}, {want}");
        }
    }

    #[test]
    fn point_step_needs_fewer_operations_than_quaternion() {
        for comparison in comparisons() {
            println!("{comparison:?}: {:.1} % less", 100.0 * comparison.reduction());
            assert!((0.1..0.4).contains(&comparison.reduction()), "{comparison:?}: {}", comparison.reduction());
        }
    }
}
