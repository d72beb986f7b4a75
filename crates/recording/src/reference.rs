//! The true attitude from elsewhere: a file of its own, as a motion capture or another estimator writes it.
//!
//! Input: a file with one header line; columns `t_s,qw,qx,qy,qz` (body to ENU) as `plumb up --out` writes them, and optionally `mov`.
//! Output: the attitude at any time, between two rows the shortest turn from one to the other. Time: that of the recording; a time
//! earlier than one asked for before has none. Failure: the first malformed line ends the reading, with its place.

use std::path::Path;

use crate::{
    columns::indices,
    error::{Fault, Position, RecordingError},
    reader::{Reference, flag, unit},
    table::{Fields, Table},
    time,
};

const SCORED: &str = "mov";
const KNOWN: [&str; 6] = ["t_s", "qw", "qx", "qy", "qz", SCORED];
/// Rows that are farther apart than this have nothing known between them, ns.
pub const GAP_NS: i64 = 200_000_000;

/// Where the columns are.
struct Columns {
    time: usize,
    quaternion: [usize; 4],
    scored: Option<usize>,
}

/// A row; without a quaternion where it is not told.
type Told = (i64, Option<Reference>);

/// The rows, to be asked as those of a recording go on.
pub struct References {
    table: Table<Columns>,
    before: Option<Told>,
    after: Option<Told>,
}

impl References {
    /// Opens a file and reads its first row.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let mut table = Table::open(path, &KNOWN, |names| {
            let [time, w, x, y, z] = indices(names, &["t_s", "qw", "qx", "qy", "qz"])?;
            let scored = names.iter().position(|&name| name == SCORED);
            Ok(Columns { time, quaternion: [w, x, y, z], scored })
        })?;
        let after = table.next(row).transpose()?;
        Ok(Self { table, before: None, after })
    }

    /// The attitude at a time; none before the first row, after the last, in a gap, and where a row beside it tells none.
    pub fn at(&mut self, t_ns: i64) -> Result<Option<Reference>, RecordingError> {
        while let Some(row_before) = self.after.take_if(|(row_ns, _)| *row_ns <= t_ns) {
            self.before = Some(row_before);
            self.after = self.table.next(row).transpose()?;
        }
        Ok(match (self.before, self.after) {
            (Some((before_ns, reference)), _) if before_ns == t_ns => reference,
            (Some((before_ns, Some(before))), Some((after_ns, Some(after))))
                if before_ns < t_ns && after_ns - before_ns <= GAP_NS =>
            {
                let share = (t_ns - before_ns) as f64 / (after_ns - before_ns) as f64;
                Some(Reference {
                    quaternion: between(before.quaternion, after.quaternion, share),
                    scored: before.scored && after.scored,
                })
            }
            _ => None,
        })
    }
}

fn row(fields: &Fields<'_>, columns: &Columns) -> Result<Told, (Position, Fault)> {
    let scored = columns.scored.map_or(Ok(true), |index| fields.parsed(index, "0 or 1", flag))?;
    let quaternion = unit(fields.numbers(columns.quaternion)?);
    let t_ns = fields.parsed(columns.time, time::EXPECTED, time::parse_ns)?;
    Ok((t_ns, quaternion.map(|quaternion| Reference { quaternion, scored })))
}

/// The rotation that has made `share` of the shortest turn from one to the other.
fn between(from: [f64; 4], to: [f64; 4], share: f64) -> [f64; 4] {
    let cosine: f64 = from.iter().zip(to).map(|(a, b)| a * b).sum();
    // q and −q are the same attitude; the nearer one is the end of the shortest turn.
    let to = if cosine < 0.0 { to.map(|part| -part) } else { to };
    let half = cosine.abs().min(1.0).acos();
    let [a, b] = if half < 1e-6 {
        [1.0 - share, share]
    } else {
        [((1.0 - share) * half).sin() / half.sin(), (share * half).sin() / half.sin()]
    };
    let mixed = [0, 1, 2, 3].map(|part| a * from[part] + b * to[part]);
    unit(mixed).unwrap_or(from)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn opened(text: &str) -> Result<References, RecordingError> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(&file, text).unwrap();
        References::open(file.path())
    }

    fn yaw_deg(reference: Option<Reference>) -> Option<f64> {
        reference.map(|Reference { quaternion: [w, _, _, z], .. }| (2.0 * z.atan2(w)).to_degrees())
    }

    /// A turn about z, of either sign.
    fn line(t_s: f64, yaw_deg: f64, sign: f64) -> String {
        let (sin, cos) = (yaw_deg.to_radians() / 2.0).sin_cos();
        format!("{t_s},{},0,0,{}\n", sign * cos, sign * sin)
    }

    #[test]
    fn between_two_rows_it_is_the_shortest_turn_and_beyond_them_nothing() {
        let rows = [line(1.0, 10.0, 1.0), line(1.1, 20.0, -1.0), line(1.2, 30.0, 1.0), line(2.0, 0.0, 1.0)];
        let mut references = opened(&format!("t_s,qw,qx,qy,qz\n{}", rows.concat())).unwrap();
        let told: Vec<_> = [0.9, 1.0, 1.025, 1.1, 1.15, 1.2, 1.6, 2.0, 2.1]
            .map(|t_s: f64| yaw_deg(references.at((t_s * 1e9).round() as i64).unwrap()))
            .to_vec();
        let expected = [None, Some(10.0), Some(12.5), Some(20.0), Some(25.0), Some(30.0), None, Some(0.0), None];
        for (told, expected) in told.iter().zip(expected) {
            let same = match (told, expected) {
                // Of a turn by 360° either.
                (Some(told), Some(expected)) => (told - expected).to_radians().sin().abs() < 1e-9,
                (told, expected) => told.is_none() && expected.is_none(),
            };
            assert!(same, "{told:?} instead of {expected:?}");
        }
    }

    #[test]
    fn what_a_row_does_not_tell_is_not_known_about_it() {
        let text = "t_s,qw,qx,qy,qz,mov\n0,1,0,0,0,1\n0.1,nan,nan,nan,nan,1\n0.2,1,0,0,0,0\n0.3,1,0,0,0,1\n";
        let mut references = opened(text).unwrap();
        let scored = [0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3]
            .map(|t_s: f64| references.at((t_s * 1e9).round() as i64).unwrap().map(|reference| reference.scored));
        assert_eq!(scored, [Some(true), None, None, None, Some(false), Some(false), Some(true)]);
        assert!(opened("t_s,qw,qx,qy\n").is_err());
        assert!(opened("t_s,qw,qx,qy,qz\n0,1,0,0,x\n").is_err());
    }
}
