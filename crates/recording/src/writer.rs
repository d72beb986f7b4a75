//! Writes a recording row by row.

use std::{fmt::Write as _, path::Path};

use crate::{
    RecordingError, Row,
    atomic_file::{AtomicFile, OWNER_ONLY, decimal},
    time,
};

/// Optional columns of a recording, in addition to `t_s,gx,gy,gz,ax,ay,az`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Layout {
    /// Magnetic field: `mx,my,mz`.
    pub field: bool,
    /// Reference attitude `qw,qx,qy,qz`, and `mov`, which is 1 if errors are scored at the row.
    pub reference: bool,
}

/// Writer of a recording that [`Reader`](crate::Reader) reads back row for row.
///
/// The file is compressed with gzip if its name ends in `.gz`. Only the owner may read it. The file
/// appears at its path when [`Writer::finish`] succeeds.
pub struct Writer {
    output: AtomicFile,
    layout: Layout,
    rows: u64,
    line: String,
}

impl Writer {
    /// Starts a file, which replaces an existing one when it is finished.
    ///
    /// # Errors
    ///
    /// Returns [`RecordingError::Write`] if the temporary file cannot be created or written.
    pub fn create(path: &Path, layout: Layout) -> Result<Self, RecordingError> {
        let mut output = AtomicFile::create(path, OWNER_ONLY)?;
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

    /// Writes the next row.
    ///
    /// # Errors
    ///
    /// Returns [`RecordingError::InvalidRow`] if the time of the row is out of range, or if the row
    /// has a magnetic field or a reference for which the layout has no columns. Returns
    /// [`RecordingError::Write`] if the file cannot be written.
    pub fn write(&mut self, row: &Row) -> Result<(), RecordingError> {
        self.rows += 1;
        self.validate(row)?;
        let Self { layout, line, .. } = self;
        line.clear();
        // Writing to a `String` does not fail.
        let _ = write!(line, "{}", time::Seconds(row.t_ns));
        let field = layout.field.then(|| row.field_ut.unwrap_or([f64::NAN; 3]));
        for value in [row.rate_rad_s, row.force_m_s2].into_iter().chain(field).flatten() {
            let _ = write!(line, ",{}", decimal(value));
        }
        if layout.reference {
            let quaternion = row.reference.map_or([f64::NAN; 4], |reference| reference.quaternion);
            for part in quaternion {
                let _ = write!(line, ",{}", decimal(part));
            }
            let scored = row.reference.is_some_and(|reference| reference.scored);
            line.push_str(if scored { ",1" } else { ",0" });
        }
        line.push('\n');
        self.output.write(line)
    }

    /// Flushes the file and renames it to its final path.
    ///
    /// # Errors
    ///
    /// Returns [`RecordingError::Write`] if the file cannot be flushed or renamed.
    pub fn finish(self) -> Result<(), RecordingError> {
        self.output.finish()
    }

    fn validate(&self, row: &Row) -> Result<(), RecordingError> {
        let invalid = |found: String, expected| {
            Err(RecordingError::InvalidRow { path: self.output.path().to_owned(), row: self.rows, found, expected })
        };
        if !time::is_in_range(row.t_ns) {
            return invalid(format!("the time {} ns", row.t_ns), time::EXPECTED);
        }
        if row.field_ut.is_some() && !self.layout.field {
            return invalid("a magnetic field".into(), "none: the layout has no columns for it");
        }
        if row.reference.is_some() && !self.layout.reference {
            return invalid("a reference".into(), "none: the layout has no columns for it");
        }
        Ok(())
    }
}
