//! Formats the lines of the attitude file.
//!
//! Input: the attitude of a tick and, if its columns are selected, the fused state.
//!
//! Output: a CSV line in the frame of the file.
//!
//! Time: the source's clock.
//!
//! Failure: the values of a missing fused state are `nan`, and its chart is empty.

use std::{fmt::Write as _, path::PathBuf};

use launch::Output;
use messages::{AttitudeOutput, FusedState};
use runtime::frames::{attitude_to_frame, fused_to_frame};

/// Attitude file requested by the user.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AttitudeFile {
    /// Path of the file.
    pub path: PathBuf,
    /// Frame of the attitudes and order of the quaternion components.
    pub output: Output,
    /// Columns after time and quaternion.
    pub columns: Vec<Column>,
}

/// Optional group of columns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Column {
    /// Chart, u, v and z of the fused state.
    Uvz,
    /// Yaw, pitch and roll, rad.
    Angles,
    /// Course, rad, and its reference.
    Course,
    /// Gyro bias on each axis, rad/s.
    Bias,
    /// Standard deviations of inclination and course, rad.
    Sd,
    /// Names of the flags, separated by spaces.
    Flags,
}

impl Column {
    /// All groups with their names, in the order in which the option `all` writes them.
    pub const NAMES: [(&str, Self); 6] = [
        ("uvz", Self::Uvz),
        ("angles", Self::Angles),
        ("course", Self::Course),
        ("bias", Self::Bias),
        ("sd", Self::Sd),
        ("flags", Self::Flags),
    ];

    fn header(self) -> &'static str {
        match self {
            Self::Uvz => "chart,u,v,z_rad",
            Self::Angles => "yaw_rad,pitch_rad,roll_rad",
            Self::Course => "course_rad,course_reference",
            Self::Bias => "bias_x_rad_s,bias_y_rad_s,bias_z_rad_s",
            Self::Sd => "inclination_sd_rad,course_sd_rad",
            Self::Flags => "flags",
        }
    }

    fn needs_fused(self) -> bool {
        matches!(self, Self::Uvz | Self::Bias)
    }
}

impl AttitudeFile {
    /// Creates a file with time and quaternion only, in the native frame.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into(), output: Output::default(), columns: Vec::new() }
    }

    /// Returns `true` if a line needs the fused state of its tick.
    pub fn needs_fused(&self) -> bool {
        self.columns.iter().any(|column| column.needs_fused())
    }

    /// Returns the header line.
    pub fn header(&self) -> String {
        let quaternion = self.output.quaternion.ordered(["qw", "qx", "qy", "qz"]).join(",");
        let extra = self.columns.iter().map(|column| format!(",{}", column.header()));
        format!("t_s,{quaternion}{}\n", extra.collect::<String>())
    }

    /// Appends the line of a tick to `text`.
    pub fn append_line(&self, output: &AttitudeOutput, fused: Option<&FusedState>, text: &mut String) {
        let Output { frame, quaternion } = self.output;
        let (output, fused) = (attitude_to_frame(frame, *output), fused.map(|state| fused_to_frame(frame, *state)));
        let t_ns = output.header.t_end_ns;
        let sign = if t_ns < 0 { "-" } else { "" };
        let (s, ns) = (t_ns.unsigned_abs() / 1_000_000_000, t_ns.unsigned_abs() % 1_000_000_000);
        let [a, b, c, d] = quaternion.ordered(output.quaternion);
        // Writing to a `String` does not fail.
        let _ = write!(text, "{sign}{s}.{ns:09},{a},{b},{c},{d}");
        for column in &self.columns {
            let _ = column.write(&output, fused.as_ref(), text);
        }
        text.push('\n');
    }
}

impl Column {
    fn write(self, output: &AttitudeOutput, fused: Option<&FusedState>, line: &mut String) -> std::fmt::Result {
        let AttitudeOutput { yaw_rad, pitch_rad, roll_rad, course_rad, course_sd_rad, inclination_sd_rad, .. } =
            *output;
        match (self, fused) {
            (Self::Uvz, Some(FusedState { w: [u, v], z_rad, chart, .. })) => {
                write!(line, ",{},{u},{v},{z_rad}", chart.name())
            }
            (Self::Uvz, None) => write!(line, ",,nan,nan,nan"),
            (Self::Bias, Some(FusedState { bias_rad_s: [x, y, z], .. })) => write!(line, ",{x},{y},{z}"),
            (Self::Bias, None) => write!(line, ",nan,nan,nan"),
            (Self::Angles, _) => write!(line, ",{yaw_rad},{pitch_rad},{roll_rad}"),
            (Self::Course, _) => write!(line, ",{course_rad},{}", output.course_reference.name()),
            (Self::Sd, _) => write!(line, ",{inclination_sd_rad},{course_sd_rad}"),
            (Self::Flags, _) => {
                let names: Vec<_> = output.header.flags.names().collect();
                write!(line, ",{}", names.join(" "))
            }
        }
    }
}
