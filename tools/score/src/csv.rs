//! A line for each tick: what a chain of stages says, and the truth beside it.
//!
//! Input: sample, attitude, fused state and truth of a tick. Output: a CSV file whose columns have their units in their names. Time: the samples' own.
//! Failure: a file that cannot be written; what is not known is `nan`, and its chart or reference empty.
//!
//! The columns of the estimate are those of `plumb up --out FILE --columns uvz,angles,course,bias,sd`; those of the truth have the same names after
//! `true_`, those of gyro and accelerometer alone after `gyro_` and `accel_`. Each has a chart of its own, as it may be on the other side of the sphere.

use std::{
    fmt::{Arguments, Write as _},
    fs::File,
    io::{self, BufWriter, Write as _},
    path::{Path, PathBuf},
};

use attitude::{Quaternion, point::Point, state::Attitude};
use messages::{AttitudeOutput, FusedState, ImuSample};
use pipeline::{Column, OutFile};
use runtime::{ServiceConfig, convert};

use crate::{ScoreError, sensors::Sensors, tally::Truth};

const COLUMNS: [Column; 5] = [Column::Uvz, Column::Angles, Column::Course, Column::Bias, Column::Sd];
/// Of the fuser; the course above it is the course stage's.
const HEADING: &str = "heading_reference,heading_sd_rad";
const SENSORS: &str = "gyro_chart,gyro_u,gyro_v,gyro_z_rad,accel_chart,accel_u,accel_v";
const TRUTH: &str = "true_qw,true_qx,true_qy,true_qz,true_chart,true_u,true_v,true_z_rad,true_yaw_rad,true_pitch_rad,true_roll_rad,\
                     true_course_rad,true_bias_x_rad_s,true_bias_y_rad_s,true_bias_z_rad_s,scored";

/// The file.
pub(crate) struct Csv {
    path: PathBuf,
    file: BufWriter<File>,
    columns: OutFile,
    sensors: Sensors,
    line: String,
}

impl Csv {
    pub(crate) fn create(path: PathBuf, config: &ServiceConfig) -> Result<Self, ScoreError> {
        let columns = OutFile { columns: COLUMNS.into(), ..OutFile::new(&path) };
        let file = File::create(&path).map_err(|cause| failed(&path, cause))?;
        let (file, line, sensors) = (BufWriter::new(file), columns.head(), Sensors::new(config)?);
        let mut csv = Self { path, file, columns, sensors, line };
        csv.end_line(format_args!(",{HEADING},{SENSORS},{TRUTH}"))?;
        Ok(csv)
    }

    /// Takes a tick.
    pub(crate) fn take(
        &mut self,
        sample: &ImuSample,
        output: &AttitudeOutput,
        fused: &FusedState,
        truth: Option<&Truth>,
    ) -> Result<(), ScoreError> {
        self.line.clear();
        self.columns.line(output, Some(fused), &mut self.line);
        let (gyro, accel) = self.sensors.take(sample);
        let z_rad = gyro.map_or(f64::NAN, |attitude| attitude.z_rad);
        self.more(format_args!(",{},{}", fused.course_reference.name(), fused.heading_sd_rad));
        self.more(format_args!(",{},{z_rad},{}", place(gyro.map(|attitude| attitude.up)), place(accel)));
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
            place(Some(attitude.up)),
            u8::from(*scored)
        ))
    }

    /// Everything is written.
    pub(crate) fn finish(mut self) -> Result<(), ScoreError> {
        self.file.flush().map_err(|cause| failed(&self.path, cause))
    }

    /// The line so far may have an end already, before which there is more.
    fn more(&mut self, more: Arguments<'_>) {
        self.line.truncate(self.line.trim_end().len());
        // A text in memory takes whatever is written to it.
        let _ = write!(self.line, "{more}");
    }

    fn end_line(&mut self, more: Arguments<'_>) -> Result<(), ScoreError> {
        self.more(more);
        self.line.push('\n');
        self.file.write_all(self.line.as_bytes()).map_err(|cause| failed(&self.path, cause))
    }
}

/// Chart, u and v.
fn place(of: Option<Point>) -> String {
    let Some(Point { chart, w }) = of else { return ",nan,nan".into() };
    let [u, v] = convert::complex_to_payload(w);
    format!("{},{u},{v}", convert::chart_to_payload(chart).name())
}

fn failed(path: &Path, cause: io::Error) -> ScoreError {
    ScoreError::Write { path: path.into(), cause }
}
