//! Table with one line per tick, containing the estimates of a chain and the reference.
//!
//! Input: sample, attitude, fused state and reference of a tick.
//!
//! Output: a CSV file whose column names include the units.
//!
//! Time: sample timestamps.
//!
//! Failure: an error if the file cannot be written. Unknown values are written as `nan`; for an
//! unknown chart, the CSV field is empty.
//!
//! The columns of the estimate are those of `plumb up --out FILE --columns
//! uvz,angles,course,bias,sd`. The prefix `true_` marks the reference; `gyro_` and `accel_` mark
//! the estimates from a single sensor. Each estimate has its own chart column, because two
//! estimates can use different charts at the same tick.

use std::{
    fmt::{Arguments, Write as _},
    fs::File,
    io::{self, BufWriter, Write as _},
    path::{Path, PathBuf},
};

use attitude::{Quaternion, point::Point, state::Attitude};
use messages::{AttitudeOutput, FusedState, ImuSample};
use pipeline::{AttitudeFile, Column};
use runtime::{ServiceConfig, convert};

use crate::{ScoreError, error_stats::Truth, sensors::SensorSlots};

const COLUMNS: [Column; 5] = [Column::Uvz, Column::Angles, Column::Course, Column::Bias, Column::Sd];
/// Columns for the fuser's heading. The course columns contain the output of the course stage.
const HEADING_COLUMNS: &str = "heading_reference,heading_sd_rad";
const SENSOR_COLUMNS: &str = "gyro_chart,gyro_u,gyro_v,gyro_z_rad,accel_chart,accel_u,accel_v";
const TRUTH_COLUMNS: &str = "true_qw,true_qx,true_qy,true_qz,true_chart,true_u,true_v,true_z_rad,true_yaw_rad,true_pitch_rad,true_roll_rad,\
                     true_course_rad,true_bias_x_rad_s,true_bias_y_rad_s,true_bias_z_rad_s,scored";

/// Open CSV file for one chain and trial.
pub(crate) struct TickTable {
    path: PathBuf,
    file: BufWriter<File>,
    columns: AttitudeFile,
    sensors: SensorSlots,
    line: String,
}

impl TickTable {
    pub(crate) fn create(path: PathBuf, config: &ServiceConfig) -> Result<Self, ScoreError> {
        let columns = AttitudeFile { columns: COLUMNS.into(), ..AttitudeFile::new(&path) };
        let file = File::create(&path).map_err(|cause| write_error(&path, cause))?;
        let (file, line, sensors) = (BufWriter::new(file), columns.header(), SensorSlots::new(config)?);
        let mut table = Self { path, file, columns, sensors, line };
        table.end_line(format_args!(",{HEADING_COLUMNS},{SENSOR_COLUMNS},{TRUTH_COLUMNS}"))?;
        Ok(table)
    }

    /// Writes the line of a tick.
    pub(crate) fn write(
        &mut self,
        sample: &ImuSample,
        output: &AttitudeOutput,
        fused: &FusedState,
        truth: Option<&Truth>,
    ) -> Result<(), ScoreError> {
        self.line.clear();
        self.columns.append_line(output, Some(fused), &mut self.line);
        let (gyro, accel) = self.sensors.update(sample);
        let z_rad = gyro.map_or(f64::NAN, |attitude| attitude.z_rad);
        self.append(format_args!(",{},{}", fused.course_reference.name(), fused.heading_sd_rad));
        self.append(format_args!(
            ",{},{z_rad},{}",
            point_columns(gyro.map(|attitude| attitude.up)),
            point_columns(accel)
        ));
        let Some(Truth { quaternion: [w, x, y, z], scored, gyro_bias_rad_s }) = truth else {
            return self.end_line(format_args!(",nan,nan,nan,nan,,nan,nan,nan,nan,nan,nan,nan,nan,nan,nan,0"));
        };
        let attitude = Attitude::from_quaternion(Quaternion::new(*w, *x, *y, *z));
        let angles = attitude.angles();
        let course_rad = (-angles.yaw_rad).rem_euclid(std::f64::consts::TAU);
        let [bias_x, bias_y, bias_z] = gyro_bias_rad_s.unwrap_or([f64::NAN; 3]);
        let (yaw, pitch, roll, z_rad) = (angles.yaw_rad, angles.pitch_rad, angles.roll_rad, attitude.z_rad);
        self.end_line(format_args!(
            ",{w},{x},{y},{z},{},{z_rad},{yaw},{pitch},{roll},{course_rad},{bias_x},{bias_y},{bias_z},{}",
            point_columns(Some(attitude.up)),
            u8::from(*scored)
        ))
    }

    /// Flushes the file.
    pub(crate) fn finish(mut self) -> Result<(), ScoreError> {
        self.file.flush().map_err(|cause| write_error(&self.path, cause))
    }

    /// Appends to the current line after removing its line end, if any.
    fn append(&mut self, text: Arguments<'_>) {
        self.line.truncate(self.line.trim_end().len());
        // Writing to a `String` cannot fail.
        let _ = write!(self.line, "{text}");
    }

    fn end_line(&mut self, text: Arguments<'_>) -> Result<(), ScoreError> {
        self.append(text);
        self.line.push('\n');
        self.file.write_all(self.line.as_bytes()).map_err(|cause| write_error(&self.path, cause))
    }
}

/// Returns chart, u and v as three CSV fields.
fn point_columns(point: Option<Point>) -> String {
    let Some(Point { chart, w }) = point else { return ",nan,nan".into() };
    let [u, v] = convert::complex_to_payload(w);
    format!("{},{u},{v}", convert::chart_to_payload(chart).name())
}

fn write_error(path: &Path, cause: io::Error) -> ScoreError {
    ScoreError::Write { path: path.into(), cause }
}
