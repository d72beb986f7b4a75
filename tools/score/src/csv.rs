//! A line for each tick: what a chain of stages says, and the truth beside it.
//!
//! Input: attitude, fused state and truth of a tick. Output: a CSV file whose columns have their units in their names. Time: the samples' own. Failure: a
//! file that cannot be written; what is not known is `nan`, and its chart or reference empty.
//!
//! The columns of the estimate are those of `plumb up --out FILE --columns uvz,angles,course,bias,sd`; those of the truth have the same names after
//! `true_`. The truth is in a chart of its own, as it may be on the other side of the sphere.

use std::{
    fmt::Write as _,
    fs::File,
    io::{self, BufWriter, Write as _},
    path::{Path, PathBuf},
};

use attitude::{Quaternion, state::Attitude};
use messages::{AttitudeOutput, FusedState};
use pipeline::{Column, OutFile};
use runtime::quantities;

use crate::{ScoreError, tally::Truth};

const COLUMNS: [Column; 5] = [Column::Uvz, Column::Angles, Column::Course, Column::Bias, Column::Sd];
const TRUTH: &str = "true_qw,true_qx,true_qy,true_qz,true_chart,true_u,true_v,true_z_rad,true_yaw_rad,true_pitch_rad,true_roll_rad,\
                     true_course_rad,true_bias_x_rad_s,true_bias_y_rad_s,true_bias_z_rad_s,scored";

/// The file.
pub(crate) struct Csv {
    path: PathBuf,
    file: BufWriter<File>,
    columns: OutFile,
    line: String,
}

impl Csv {
    pub(crate) fn create(path: PathBuf) -> Result<Self, ScoreError> {
        let columns = OutFile { columns: COLUMNS.into(), ..OutFile::new(&path) };
        let file = File::create(&path).map_err(|cause| failed(&path, cause))?;
        let mut csv = Self { file: BufWriter::new(file), line: columns.head(), columns, path };
        csv.end_line(format_args!(",{TRUTH}"))?;
        Ok(csv)
    }

    /// Takes a tick.
    pub(crate) fn take(
        &mut self,
        output: &AttitudeOutput,
        fused: &FusedState,
        truth: Option<&Truth>,
    ) -> Result<(), ScoreError> {
        self.line.clear();
        self.columns.line(output, Some(fused), &mut self.line);
        let Some(Truth { quaternion: [w, x, y, z], scored, gyro_bias_rad_s }) = truth else {
            return self.end_line(format_args!(",nan,nan,nan,nan,,nan,nan,nan,nan,nan,nan,nan,nan,nan,nan,0"));
        };
        let attitude = Attitude::of_quaternion(Quaternion::new(*w, *x, *y, *z));
        let angles = attitude.angles();
        let ([u, v], chart) = (quantities::pair(attitude.up.w), quantities::chart_of(attitude.up.chart).name());
        let course_rad = (-angles.yaw_rad).rem_euclid(std::f64::consts::TAU);
        let [bias_x, bias_y, bias_z] = gyro_bias_rad_s.unwrap_or([f64::NAN; 3]);
        let (yaw, pitch, roll, z_rad) = (angles.yaw_rad, angles.pitch_rad, angles.roll_rad, attitude.z_rad);
        self.end_line(format_args!(
            ",{w},{x},{y},{z},{chart},{u},{v},{z_rad},{yaw},{pitch},{roll},{course_rad},{bias_x},{bias_y},{bias_z},{}",
            u8::from(*scored)
        ))
    }

    /// Everything is written.
    pub(crate) fn finish(mut self) -> Result<(), ScoreError> {
        self.file.flush().map_err(|cause| failed(&self.path, cause))
    }

    /// The line so far has an end already, before which there is more.
    fn end_line(&mut self, more: std::fmt::Arguments<'_>) -> Result<(), ScoreError> {
        let end = self.line.trim_end().len();
        self.line.truncate(end);
        // A text in memory takes whatever is written to it.
        let _ = writeln!(self.line, "{more}");
        self.file.write_all(self.line.as_bytes()).map_err(|cause| failed(&self.path, cause))
    }
}

fn failed(path: &Path, cause: io::Error) -> ScoreError {
    ScoreError::Write { path: path.into(), cause }
}
