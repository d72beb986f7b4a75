//! A recording, made of rows.

use std::{fmt::Write as _, path::Path};

use crate::{
    RecordingError, Row,
    output::{Output, number},
    time,
};

/// The columns of a recording beside `t_s,gx,gy,gz,ax,ay,az`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Layout {
    /// `mx,my,mz`.
    pub field: bool,
    /// `qw,qx,qy,qz,mov`.
    pub reference: bool,
}

/// Writes a recording that a [`Reader`](crate::Reader) gives back row for row: gzip where its name ends in `.gz`, for this user's
/// eyes only, in place once it is whole. Without [`Writer::finish`] there is no file.
pub struct Writer {
    output: Output,
    layout: Layout,
    rows: u64,
    line: String,
}

impl Writer {
    /// Begins a file in place of the one that may be there.
    pub fn create(path: &Path, layout: Layout) -> Result<Self, RecordingError> {
        let mut output = Output::create(path)?;
        output.write("t_s,gx,gy,gz,ax,ay,az")?;
        if layout.field {
            output.write(",mx,my,mz")?;
        }
        if layout.reference {
            output.write(",qw,qx,qy,qz,mov")?;
        }
        output.write("\n")?;
        Ok(Self { output, layout, rows: 0, line: String::new() })
    }

    /// Writes the next row. Refuses a field or a reference for which the layout has no columns, and a time that no reader takes.
    pub fn write(&mut self, row: &Row) -> Result<(), RecordingError> {
        self.rows += 1;
        self.check(row)?;
        let Self { layout, line, .. } = self;
        line.clear();
        // A text in memory takes whatever is written to it.
        let _ = write!(line, "{}", time::Seconds(row.t_ns));
        let field = layout.field.then(|| row.field_ut.unwrap_or([f64::NAN; 3]));
        for value in [row.rate_rad_s, row.force_m_s2].into_iter().chain(field).flatten() {
            let _ = write!(line, ",{}", number(value));
        }
        if layout.reference {
            let quaternion = row.reference.map_or([f64::NAN; 4], |reference| reference.quaternion);
            for part in quaternion {
                let _ = write!(line, ",{}", number(part));
            }
            let scored = row.reference.is_some_and(|reference| reference.scored);
            line.push_str(if scored { ",1" } else { ",0" });
        }
        line.push('\n');
        self.output.write(line)
    }

    /// Puts the file in its place.
    pub fn finish(self) -> Result<(), RecordingError> {
        self.output.finish()
    }

    fn check(&self, row: &Row) -> Result<(), RecordingError> {
        let refused = |found: String, expected| {
            Err(RecordingError::Unwritable { path: self.output.path().to_owned(), row: self.rows, found, expected })
        };
        if !time::is_readable(row.t_ns) {
            return refused(format!("the time {} ns", row.t_ns), time::EXPECTED);
        }
        if row.field_ut.is_some() && !self.layout.field {
            return refused("a magnetic field".into(), "none, as the layout says");
        }
        if row.reference.is_some() && !self.layout.reference {
            return refused("a reference".into(), "none, as the layout says");
        }
        Ok(())
    }
}
