//! In which directions there was a reading: the sphere in 24 cells, four on each face of a cube.

use attitude::Vector3;

/// Parts of the sphere: four on each face of a cube, +x, −x, +y, −y, +z, −z, by the signs of the two axes that follow in turn: ++, +−, −+, −−.
pub const PARTS: usize = 24;

/// Directions that occurred.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Sphere {
    counts: [u32; PARTS],
}

/// The face of a direction of any length: +x, −x, +y, −y, +z, −z.
pub(crate) fn face(direction: &Vector3<f64>) -> usize {
    cell(direction) / 4
}

/// The cell of a direction of any length: 4 · face + quadrant; the faces are +x, −x, +y, −y, +z, −z.
pub(crate) fn cell(direction: &Vector3<f64>) -> usize {
    let axis = direction.iamax();
    let is_negative = |i: usize| usize::from(direction[i % 3] < 0.0);
    4 * (2 * axis + is_negative(axis)) + 2 * is_negative(axis + 1) + is_negative(axis + 2)
}

impl Sphere {
    pub(crate) fn of<'a>(directions: impl IntoIterator<Item = &'a Vector3<f64>>) -> Self {
        let mut sphere = Self::default();
        directions.into_iter().for_each(|direction| sphere.counts[cell(direction)] += 1);
        sphere
    }

    /// Readings in a direction's cell.
    pub(crate) fn count(&self, direction: &Vector3<f64>) -> u32 {
        self.counts[cell(direction)]
    }

    /// Cells with a reading.
    pub(crate) fn cells(&self) -> usize {
        self.counts.iter().filter(|count| **count > 0).count()
    }

    /// Whether each cell has a reading.
    pub(crate) fn parts(&self) -> [bool; PARTS] {
        self.counts.map(|count| count > 0)
    }

    /// Whether each face has a reading: +x, −x, +y, −y, +z, −z.
    pub(crate) fn faces(&self) -> [bool; 6] {
        std::array::from_fn(|face| self.counts[4 * face..4 * face + 4].iter().any(|count| *count > 0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_axis_has_its_face_and_the_corners_of_a_cube_their_cells() {
        for (i, axis) in [Vector3::x(), Vector3::y(), Vector3::z()].into_iter().enumerate() {
            assert_eq!([cell(&axis) / 4, cell(&-axis) / 4], [2 * i, 2 * i + 1]);
        }
        let signs = [-1.0, 1.0];
        let mut all = Vec::new();
        for (a, b) in signs.into_iter().flat_map(|a| signs.map(|b| (a, b))) {
            for (sign, i) in signs.into_iter().flat_map(|sign| [0, 1, 2].map(|i| (sign, i))) {
                let mut direction = Vector3::repeat(0.0);
                (direction[i], direction[(i + 1) % 3], direction[(i + 2) % 3]) = (sign, 0.5 * a, 0.5 * b);
                all.push(direction);
            }
        }
        assert_eq!(Sphere::of(&all).cells(), PARTS);
    }
}
