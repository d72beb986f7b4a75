//! Reads a reference attitude from a separate file, such as the output of a motion-capture system
//! or another estimator.
//!
//! Input: a file with one header line. Columns `t_s,qw,qx,qy,qz` (body to ENU), as `plumb up --out`
//! writes them, and optionally `mov`.
//!
//! Output: the attitude at a given time, interpolated between two rows along the shortest rotation.
//! If the intervals between the rows are long and the rotation between two rows is large, each
//! attitude is used once, at its own time.
//!
//! Time: the recording's clock. Requested times must not decrease.
//!
//! Failure: reading ends at the first malformed line, with its position.

use std::path::Path;

use crate::{
    columns::group_indices,
    error::{ParseError, Position, RecordingError},
    reader::{Reference, normalized},
    table::{Fields, Table},
};

const SCORED: &str = "mov";
const KNOWN: [&str; 6] = ["t_s", "qw", "qx", "qy", "qz", SCORED];
/// Longest interval in ns between two rows across which the attitude is always interpolated.
pub const MAX_GAP_NS: i64 = 200_000_000;
/// Longest interval in ns between two rows across which the attitude is interpolated if the
/// rotation between them is small. It allows for references at 1 Hz. Rows with such an interval are
/// called slow.
const MAX_SLOW_GAP_NS: i64 = 1_100_000_000;
/// Cosine of half the largest rotation across which slow rows are interpolated, which is 5°.
const MIN_HALF_ROTATION_COS: f64 = 0.999_048_221_581_857_8;

/// Maximum number of rows read to decide whether slow rows are interpolated.
const MAX_JUDGED_ROWS: usize = 10_000;
/// Slow rows are interpolated only if at most this share of the rotations between them is large.
///
/// If only the calm parts of a motion were interpolated, they would dominate the scored errors.
const MAX_LARGE_ROTATION_SHARE: f64 = 0.01;

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
    /// `true` if slow rows are interpolated, because the rotations between them are usually small.
    is_calm: bool,
    before: Option<ReferenceRow>,
    after: Option<ReferenceRow>,
    /// Time of the previous request, ns.
    requested_ns: Option<i64>,
}

impl References {
    /// Opens a file, judges whether its rotations are small, and reads its first row.
    ///
    /// # Errors
    ///
    /// Returns an error if the file cannot be opened, or its header or first row is malformed.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let is_calm = is_calm(open_table(path)?);
        let mut table = open_table(path)?;
        let after = table.next(parse_row).transpose()?;
        Ok(Self { table, is_calm, before: None, after, requested_ns: None })
    }

    /// Returns the attitude at `t_ns`. `rate_rad_s` is the body rate at that time.
    ///
    /// The attitude is interpolated across a gap of at most [`MAX_GAP_NS`]. Gaps of up to 1.1 s are
    /// interpolated if the rotation across the gap, and across 99 % of all such gaps, is less than
    /// 5°. Otherwise the row before the gap is returned once, for the first request after it,
    /// rotated by the rate up to that request.
    ///
    /// Returns `None` before the first row, after the last row, in other gaps, and next to a row
    /// without a quaternion. Also returns `None` if an earlier call has already moved the reader
    /// past `t_ns`.
    ///
    /// # Errors
    ///
    /// Returns an error if the first row after `t_ns`, or a row before it, is malformed.
    pub fn attitude_at(&mut self, t_ns: i64, rate_rad_s: [f64; 3]) -> Result<Option<Reference>, RecordingError> {
        while let Some(row_before) = self.after.take_if(|(row_ns, _)| *row_ns <= t_ns) {
            self.before = Some(row_before);
            self.after = self.table.next(parse_row).transpose()?;
        }
        let previous_ns = self.requested_ns.replace(t_ns);
        Ok(match (self.before, self.after) {
            (Some((before_ns, reference)), _) if before_ns == t_ns => reference,
            (Some((before_ns, Some(before))), Some((after_ns, Some(after))))
                if before_ns < t_ns && self.is_interpolated(after_ns - before_ns, &before, &after) =>
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
                let dt_s = (t_ns - before_ns) as f64 * 1e-9;
                let quaternion = rotated(before.quaternion, rate_rad_s.map(|part| part * dt_s));
                Some(Reference { quaternion, ..before })
            }
            _ => None,
        })
    }

    /// Returns the number of the last line if it has been read and has no line end.
    pub fn unended_line(&self) -> Option<u64> {
        self.table.unended_line()
    }

    fn is_interpolated(&self, gap_ns: i64, before: &Reference, after: &Reference) -> bool {
        let is_slow_but_calm = || self.is_calm && gap_ns <= MAX_SLOW_GAP_NS && !is_large_rotation(before, after);
        gap_ns <= MAX_GAP_NS || is_slow_but_calm()
    }
}

fn open_table(path: &Path) -> Result<Table<Columns>, RecordingError> {
    Table::open(path, &KNOWN, |names| {
        let [time, w, x, y, z] = group_indices(names, &["t_s", "qw", "qx", "qy", "qz"])?;
        let scored = names.iter().position(|&name| name == SCORED);
        Ok(Columns { time, quaternion: [w, x, y, z], scored })
    })
}

/// Returns `true` if there are no slow rows, or if the rotation between two of them is rarely
/// large. Only the rows before the first malformed one are used. The malformed row is reported when
/// the reader reaches it.
fn is_calm(mut table: Table<Columns>) -> bool {
    let (mut before, mut slow, mut large) = (None::<ReferenceRow>, 0usize, 0usize);
    let rows = std::iter::from_fn(|| table.next(parse_row)?.ok());
    for row in rows.take(MAX_JUDGED_ROWS) {
        if let (Some((before_ns, Some(before))), (row_ns, Some(reference))) = (before.replace(row), row)
            && (MAX_GAP_NS + 1..=MAX_SLOW_GAP_NS).contains(&row_ns.saturating_sub(before_ns))
        {
            slow += 1;
            large += usize::from(is_large_rotation(&before, &reference));
        }
    }
    large as f64 <= MAX_LARGE_ROTATION_SHARE * slow as f64
}

fn is_large_rotation(before: &Reference, after: &Reference) -> bool {
    let cosine: f64 = before.quaternion.iter().zip(after.quaternion).map(|(a, b)| a * b).sum();
    cosine.abs() < MIN_HALF_ROTATION_COS
}

/// Rotates an attitude (w, x, y, z) by a rotation vector in rad, body axes. A rotation that is not
/// finite is ignored.
pub fn rotated([w, x, y, z]: [f64; 4], rotation_rad: [f64; 3]) -> [f64; 4] {
    let angle = rotation_rad.iter().map(|part| part * part).sum::<f64>().sqrt();
    if !angle.is_finite() || angle == 0.0 {
        return [w, x, y, z];
    }
    let (sin, c) = (angle / 2.0).sin_cos();
    let [i, j, k] = rotation_rad.map(|part| part / angle * sin);
    let product = [
        w * c - x * i - y * j - z * k,
        w * i + x * c + y * k - z * j,
        w * j - x * k + y * c + z * i,
        w * k + x * j - y * i + z * c,
    ];
    let length = product.iter().map(|part| part * part).sum::<f64>().sqrt();
    product.map(|part| part / length)
}

fn parse_row(fields: &mut Fields<'_>, columns: &Columns) -> Result<ReferenceRow, (Position, ParseError)> {
    let scored = columns.scored.map_or(Ok(true), |index| fields.flag(index))?;
    let quaternion = normalized(fields.numbers(columns.quaternion)?);
    let t_ns = fields.time_ns(columns.time)?;
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
            .map(|t_s: f64| yaw_deg(references.attitude_at((t_s * 1e9).round() as i64, [0.0; 3]).unwrap()))
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

    /// Returns a reference at 1 Hz. `yaw_deg` gives the yaw of each row.
    fn slow(yaw_deg: impl Fn(u32) -> f64) -> References {
        let rows: String = (0..200).map(|row| line(row.into(), yaw_deg(row), 1.0)).collect();
        open(&format!("t_s,qw,qx,qy,qz\n{rows}")).unwrap()
    }

    #[test]
    fn slow_reference_is_interpolated_only_if_calm() {
        let mut calm = slow(|row| 3.0 * f64::from(row % 2) + if row >= 150 { 60.0 } else { 0.0 });
        let mut yaw = |t_ms: i64| yaw_deg(calm.attitude_at(t_ms * 1_000_000, [0.0; 3]).unwrap());
        assert!(yaw(500).is_some_and(|deg| (deg - 1.5).abs() < 1e-9));
        assert!(yaw(990).is_some());
        assert!(yaw(149_000).is_some());
        assert_eq!([yaw(149_500), yaw(149_900)], [None, None], "a single large rotation");
        assert_eq!(yaw(150_000).map(f64::round), Some(60.0));
        // If many rotations are large, even the calm parts are not interpolated.
        let mut rotating = slow(|row| f64::from(row / 2 * 20) + f64::from(row % 2));
        let mut yaw = |t_ms: i64, rate_deg_s: f64| {
            let rate_rad_s = [0.0, 0.0, rate_deg_s.to_radians()];
            yaw_deg(rotating.attitude_at(t_ms * 1_000_000, rate_rad_s).unwrap())
        };
        assert_eq!([yaw(500, 0.0), yaw(990, 0.0)], [None, None]);
        let at_own_time = yaw(1010, 20.0);
        assert!(at_own_time.is_some_and(|deg| (deg - 1.2).abs() < 1e-9), "rotated for 10 ms: {at_own_time:?}");
        assert_eq!(yaw(1020, 20.0), None, "once only");
    }

    #[test]
    fn missing_quaternion_makes_neighbourhood_unknown() {
        let text = "t_s,qw,qx,qy,qz,mov\n0,1,0,0,0,1\n0.1,nan,nan,nan,nan,1\n0.2,1,0,0,0,0\n0.3,1,0,0,0,1\n";
        let mut references = open(text).unwrap();
        let scored = [0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3].map(|t_s: f64| {
            references.attitude_at((t_s * 1e9).round() as i64, [0.0; 3]).unwrap().map(|reference| reference.scored)
        });
        assert_eq!(scored, [Some(true), None, None, None, Some(false), Some(false), Some(true)]);
        assert!(open("t_s,qw,qx,qy\n").is_err());
        assert!(open("t_s,qw,qx,qy,qz\n0,1,0,0,x\n").is_err());
    }
}
