//! Coverage of directions. The sphere is divided into 24 sectors, four on each face of a cube.

use attitude::Vector3;

/// Number of sectors of the sphere: four on each of the cube faces +x, −x, +y, −y, +z, −z.
///
/// The four sectors of a face are ordered ++, +−, −+, −−. These are the signs of the other two
/// components of the direction. For face ±y, these components are z and x.
pub const SECTORS: usize = 24;

/// Number of readings in each sector.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Sphere {
    counts: [u32; SECTORS],
}

/// Returns the face of a direction of any length: +x, −x, +y, −y, +z, −z.
pub(crate) fn face(direction: &Vector3<f64>) -> usize {
    sector(direction) / 4
}

/// Returns the sector, 4 · face + quadrant, of a direction vector of any length.
pub(crate) fn sector(direction: &Vector3<f64>) -> usize {
    let axis = direction.iamax();
    let is_negative = |i: usize| usize::from(direction[i % 3] < 0.0);
    4 * (2 * axis + is_negative(axis)) + 2 * is_negative(axis + 1) + is_negative(axis + 2)
}

impl Sphere {
    pub(crate) fn from_directions<'a>(directions: impl IntoIterator<Item = &'a Vector3<f64>>) -> Self {
        let mut sphere = Self::default();
        directions.into_iter().for_each(|direction| sphere.counts[sector(direction)] += 1);
        sphere
    }

    /// Returns the number of readings in the sector of `direction`.
    pub(crate) fn count(&self, direction: &Vector3<f64>) -> u32 {
        self.counts[sector(direction)]
    }

    /// Returns the number of sectors with a reading.
    pub(crate) fn covered_count(&self) -> usize {
        self.counts.iter().filter(|count| **count > 0).count()
    }

    /// Returns, for each sector, `true` if it has a reading.
    pub(crate) fn covered_sectors(&self) -> [bool; SECTORS] {
        self.counts.map(|count| count > 0)
    }

    /// Returns, for each face, `true` if it has a reading: +x, −x, +y, −y, +z, −z.
    pub(crate) fn covered_faces(&self) -> [bool; 6] {
        std::array::from_fn(|face| self.counts[4 * face..4 * face + 4].iter().any(|count| *count > 0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_map_to_faces_and_cube_corners_to_sectors() {
        for (i, axis) in [Vector3::x(), Vector3::y(), Vector3::z()].into_iter().enumerate() {
            assert_eq!([sector(&axis) / 4, sector(&-axis) / 4], [2 * i, 2 * i + 1]);
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
        assert_eq!(Sphere::from_directions(&all).covered_count(), SECTORS);
    }
}
