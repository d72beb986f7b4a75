//! What a line of the file of attitudes has.
//!
//! Input: the attitude of a tick and, where its columns are wanted, the fused state. Output: the line, in the frame of the file. Time: the source's.
//! Failure: none; what a fused state that did not come would have told is `nan`, and its chart empty.

use std::{fmt::Write as _, path::PathBuf};

use launch::Output;
use messages::{AttitudeOutput, FusedState};
use runtime::frames::{attitude_to_frame, fused_to_frame};

/// The file of attitudes that is asked for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OutFile {
    /// The file.
    pub path: PathBuf,
    /// Its frame, and the order of its quaternions.
    pub output: Output,
    /// What a line has after time and quaternion.
    pub columns: Vec<Column>,
}

/// Columns beside time and quaternion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Column {
    /// Chart, u, v, z of the fused state.
    Uvz,
    /// Yaw, pitch, roll.
    Angles,
    /// The course, and from what it is counted.
    Course,
    /// The gyro's bias on each axis.
    Bias,
    /// Standard deviations of inclination and course.
    Sd,
    /// The flags by their names, with spaces between them.
    Flags,
}

impl Column {
    /// Every one with its name, in the order of `all`.
    pub const NAMES: [(&str, Self); 6] = [
        ("uvz", Self::Uvz),
        ("angles", Self::Angles),
        ("course", Self::Course),
        ("bias", Self::Bias),
        ("sd", Self::Sd),
        ("flags", Self::Flags),
    ];

    fn head(self) -> &'static str {
        match self {
            Self::Uvz => "chart,u,v,z_rad",
            Self::Angles => "yaw_rad,pitch_rad,roll_rad",
            Self::Course => "course_rad,course_reference",
            Self::Bias => "bias_x_rad_s,bias_y_rad_s,bias_z_rad_s",
            Self::Sd => "inclination_sd_rad,course_sd_rad",
            Self::Flags => "flags",
        }
    }

    fn is_of_fused(self) -> bool {
        matches!(self, Self::Uvz | Self::Bias)
    }
}

impl OutFile {
    /// A file of time and quaternion, in our frame.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into(), output: Output::default(), columns: Vec::new() }
    }

    /// A line needs the fused state of its tick.
    pub fn needs_fused(&self) -> bool {
        self.columns.iter().any(|column| column.is_of_fused())
    }

    /// The names of the columns, as a line.
    pub fn head(&self) -> String {
        let quaternion = self.output.quaternion.ordered(["qw", "qx", "qy", "qz"]).join(",");
        let more = self.columns.iter().map(|column| format!(",{}", column.head()));
        format!("t_s,{quaternion}{}\n", more.collect::<String>())
    }

    /// Adds the line of a tick.
    pub fn line(&self, output: &AttitudeOutput, fused: Option<&FusedState>, lines: &mut String) {
        let Output { frame, quaternion } = self.output;
        let (output, fused) = (attitude_to_frame(frame, *output), fused.map(|state| fused_to_frame(frame, *state)));
        let t_ns = output.header.t_end_ns;
        let sign = if t_ns < 0 { "-" } else { "" };
        let (s, ns) = (t_ns.unsigned_abs() / 1_000_000_000, t_ns.unsigned_abs() % 1_000_000_000);
        let [a, b, c, d] = quaternion.ordered(output.quaternion);
        // A text in memory takes whatever is written to it.
        let _ = write!(lines, "{sign}{s}.{ns:09},{a},{b},{c},{d}");
        for column in &self.columns {
            let _ = column.write(&output, fused.as_ref(), lines);
        }
        lines.push('\n');
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
