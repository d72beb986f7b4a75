//! Reads a reference attitude from a separate file, such as the output of a motion-capture system
//! or another estimator.
//!
//! Input: a file with one header line. Columns `t_s,qw,qx,qy,qz` (body to ENU), as `plumb up --out`
//! writes them, and optionally `mov`.
//!
//! Output: the attitude at a given time, interpolated between two rows along the shortest rotation.
//! Between slow rows with a large rotation, each attitude is returned once, at its own time.
//!
//! Time: the recording's clock. Requested times must not decrease.
//!
//! Failure: reading ends at the first malformed line, with its position.

use std::path::Path;

use crate::{
    columns::group_indices,
    error::{ParseError, Position, RecordingError},
    reader::{Reference, normalized, parse_flag},
    table::{Fields, Table},
    time,
};

const SCORED: &str = "mov";
const KNOWN: [&str; 6] = ["t_s", "qw", "qx", "qy", "qz", SCORED];
/// Longest interval between two rows across which the attitude is always interpolated, ns.
pub const MAX_GAP_NS: i64 = 200_000_000;
/// Longest interval between two rows across which the attitude is interpolated if the rotation
/// between them is small, ns. It allows for references at 1 Hz.
const MAX_SLOW_GAP_NS: i64 = 1_100_000_000;
/// Cosine of half the largest rotation across which slow rows are interpolated: 5°.
const MIN_HALF_ROTATION_COS: f64 = 0.999_048_221_581_857_8;

/// Columns of a reference, as field indices from 0.
struct Columns {
    time: usize,
    quaternion: [usize; 4],
    scored: Option<usize>,
}

/// Time of a row, ns, and its reference; `None` if the row has no valid quaternion.
type ReferenceRow = (i64, Option<Reference>);

/// Reader of a reference attitude, to be advanced in step with the rows of a recording.
pub struct References {
    table: Table<Columns>,
    before: Option<ReferenceRow>,
    after: Option<ReferenceRow>,
    /// Time of the previous request, ns.
    requested_ns: Option<i64>,
}

impl References {
    /// Opens a file and reads its first row.
    ///
    /// # Errors
    ///
    /// Returns an error if the file cannot be opened, or its header or first row is malformed.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let mut table = Table::open(path, &KNOWN, |names| {
            let [time, w, x, y, z] = group_indices(names, &["t_s", "qw", "qx", "qy", "qz"])?;
            let scored = names.iter().position(|&name| name == SCORED);
            Ok(Columns { time, quaternion: [w, x, y, z], scored })
        })?;
        let after = table.next(parse_row).transpose()?;
        Ok(Self { table, before: None, after, requested_ns: None })
    }

    /// Returns the interpolated attitude at `t_ns`.
    ///
    /// Across a gap longer than [`MAX_GAP_NS`] the attitude is interpolated only up to 1.1 s and a
    /// rotation of 5°. Otherwise the row before it is returned once, for the first request after
    /// it.
    ///
    /// Returns `None` before the first row, after the last row, in other gaps, and next to a row
    /// without a quaternion. Also returns `None` if an earlier call has already moved the reader
    /// past `t_ns`.
    ///
    /// # Errors
    ///
    /// Returns an error if the first row after `t_ns`, or a row before it, is malformed.
    pub fn interpolate(&mut self, t_ns: i64) -> Result<Option<Reference>, RecordingError> {
        while let Some(row_before) = self.after.take_if(|(row_ns, _)| *row_ns <= t_ns) {
            self.before = Some(row_before);
            self.after = self.table.next(parse_row).transpose()?;
        }
        let previous_ns = self.requested_ns.replace(t_ns);
        Ok(match (self.before, self.after) {
            (Some((before_ns, reference)), _) if before_ns == t_ns => reference,
            (Some((before_ns, Some(before))), Some((after_ns, Some(after))))
                if before_ns < t_ns && is_interpolated(after_ns - before_ns, &before, &after) =>
            {
                let fraction = (t_ns - before_ns) as f64 / (after_ns - before_ns) as f64;
                Some(Reference {
                    quaternion: slerp(before.quaternion, after.quaternion, fraction),
                    scored: before.scored && after.scored,
                })
            }
            (Some((before_ns, Some(before))), Some((after_ns, _)))
                if previous_ns.is_some_and(|previous_ns| previous_ns < before_ns)
                    && before_ns < t_ns
                    && after_ns - before_ns <= MAX_SLOW_GAP_NS =>
            {
                Some(before)
            }
            _ => None,
        })
    }
}

fn is_interpolated(gap_ns: i64, before: &Reference, after: &Reference) -> bool {
    let cosine: f64 = before.quaternion.iter().zip(after.quaternion).map(|(a, b)| a * b).sum();
    gap_ns <= MAX_GAP_NS || gap_ns <= MAX_SLOW_GAP_NS && cosine.abs() >= MIN_HALF_ROTATION_COS
}

fn parse_row(fields: &Fields<'_>, columns: &Columns) -> Result<ReferenceRow, (Position, ParseError)> {
    let scored = columns.scored.map_or(Ok(true), |index| fields.parse(index, "0 or 1", parse_flag))?;
    let quaternion = normalized(fields.numbers(columns.quaternion)?);
    let t_ns = fields.parse(columns.time, time::EXPECTED, time::parse_ns)?;
    Ok((t_ns, quaternion.map(|quaternion| Reference { quaternion, scored })))
}

/// Interpolates along the shortest rotation. `fraction` is 0 at `from` and 1 at `to`.
fn slerp(from: [f64; 4], to: [f64; 4], fraction: f64) -> [f64; 4] {
    let cosine: f64 = from.iter().zip(to).map(|(a, b)| a * b).sum();
    // q and −q are the same attitude; the one nearer to `from` gives the shortest rotation.
    let to = if cosine < 0.0 { to.map(|part| -part) } else { to };
    let half_rad = cosine.abs().min(1.0).acos();
    let [a, b] = if half_rad < 1e-6 {
        [1.0 - fraction, fraction]
    } else {
        [((1.0 - fraction) * half_rad).sin() / half_rad.sin(), (fraction * half_rad).sin() / half_rad.sin()]
    };
    let mixed = [0, 1, 2, 3].map(|part| a * from[part] + b * to[part]);
    normalized(mixed).unwrap_or(from)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn open(text: &str) -> Result<References, RecordingError> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(&file, text).unwrap();
        References::open(file.path())
    }

    fn yaw_deg(reference: Option<Reference>) -> Option<f64> {
        reference.map(|Reference { quaternion: [w, _, _, z], .. }| (2.0 * z.atan2(w)).to_degrees())
    }

    /// Formats a row with a rotation about z; `sign` is the sign of the quaternion.
    fn line(t_s: f64, yaw_deg: f64, sign: f64) -> String {
        let (sin, cos) = (yaw_deg.to_radians() / 2.0).sin_cos();
        format!("{t_s},{},0,0,{}\n", sign * cos, sign * sin)
    }

    #[test]
    fn interpolates_shortest_rotation_within_range_only() {
        let rows = [line(1.0, 10.0, 1.0), line(1.1, 20.0, -1.0), line(1.2, 30.0, 1.0), line(2.0, 0.0, 1.0)];
        let mut references = open(&format!("t_s,qw,qx,qy,qz\n{}", rows.concat())).unwrap();
        let found: Vec<_> = [0.9, 1.0, 1.025, 1.1, 1.15, 1.2, 1.6, 2.0, 2.1]
            .map(|t_s: f64| yaw_deg(references.interpolate((t_s * 1e9).round() as i64).unwrap()))
            .to_vec();
        let expected = [None, Some(10.0), Some(12.5), Some(20.0), Some(25.0), Some(30.0), None, Some(0.0), None];
        for (found, expected) in found.iter().zip(expected) {
            let same = match (found, expected) {
                // Angles may differ by a multiple of 360°.
                (Some(found), Some(expected)) => (found - expected).to_radians().sin().abs() < 1e-9,
                (found, expected) => found.is_none() && expected.is_none(),
            };
            assert!(same, "{found:?} instead of {expected:?}");
        }
    }

    #[test]
    fn slow_reference_is_interpolated_only_if_calm() {
        let rows = [line(1.0, 0.0, 1.0), line(2.0, 3.0, 1.0), line(3.0, 60.0, 1.0)];
        let mut references = open(&format!("t_s,qw,qx,qy,qz\n{}", rows.concat())).unwrap();
        let mut yaw = |t_ms: i64| yaw_deg(references.interpolate(t_ms * 1_000_000).unwrap());
        assert!(yaw(1500).is_some_and(|deg| (deg - 1.5).abs() < 1e-9));
        assert!(yaw(1990).is_some());
        assert!(yaw(2010).is_some_and(|deg| (deg - 3.0).abs() < 1e-9), "its own time has just passed");
        assert_eq!([yaw(2030), yaw(2990)], [None, None], "the rotation is large");
        assert_eq!(yaw(3000).map(f64::round), Some(60.0));
    }

    #[test]
    fn missing_quaternion_makes_neighbourhood_unknown() {
        let text = "t_s,qw,qx,qy,qz,mov\n0,1,0,0,0,1\n0.1,nan,nan,nan,nan,1\n0.2,1,0,0,0,0\n0.3,1,0,0,0,1\n";
        let mut references = open(text).unwrap();
        let scored = [0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3].map(|t_s: f64| {
            references.interpolate((t_s * 1e9).round() as i64).unwrap().map(|reference| reference.scored)
        });
        assert_eq!(scored, [Some(true), None, None, None, Some(false), Some(false), Some(true)]);
        assert!(open("t_s,qw,qx,qy\n").is_err());
        assert!(open("t_s,qw,qx,qy,qz\n0,1,0,0,x\n").is_err());
    }
}
