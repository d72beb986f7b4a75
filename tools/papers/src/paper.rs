//! The papers that can be reproduced.

use crate::{picture::Part, progress::Progress, s1, s2, s3, s4};

/// One of the four papers that are reproduced.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Paper {
    /// S1, Matveev et al. 2025: parameters (w, z).
    S1,
    /// S2: pitch and roll by matrix and by quaternion.
    S2,
    /// S3: improved Madgwick filter.
    S3,
    /// S4: platform levelling with and without GNSS.
    S4,
}

impl Paper {
    /// All papers in order.
    pub const ALL: [Self; 4] = [Self::S1, Self::S2, Self::S3, Self::S4];

    /// Returns the name of the paper in commands and paths, `s1` to `s4`.
    pub fn name(self) -> &'static str {
        match self {
            Self::S1 => "s1",
            Self::S2 => "s2",
            Self::S3 => "s3",
            Self::S4 => "s4",
        }
    }

    /// Returns the title of the paper, preceded by its short name.
    pub fn title(self) -> &'static str {
        match self {
            Self::S1 => {
                "S1: V. V. Matveev et al., parameters (w, z) in strapdown attitude systems, Devices and Methods of Measurements 16(3), 2025, 202–211"
            }
            Self::S2 => {
                "S2: mathematical modelling of geonavigation measuring systems with three-component accelerometers (matrix and quaternion methods)"
            }
            Self::S3 => {
                "S3: improved orientation of a UAV by a MEMS inertial system on the basis of the Madgwick filter"
            }
            Self::S4 => "S4: orientation algorithm for a low-grade MEMS strapdown system, tried on a Mi-8 helicopter",
        }
    }

    /// Returns the number of simulation runs. The progress display counts them in addition to the
    /// pictures.
    pub(crate) fn run_count(self) -> u64 {
        match self {
            Self::S1 => s1::RUN_COUNT,
            Self::S2 => s2::RUN_COUNT,
            Self::S3 => s3::RUN_COUNT,
            Self::S4 => s4::RUN_COUNT,
        }
    }

    pub(crate) fn parts(self, progress: &mut Progress<'_>) -> Vec<Part> {
        match self {
            Self::S1 => s1::parts(progress),
            Self::S2 => s2::parts(progress),
            Self::S3 => s3::parts(progress),
            Self::S4 => s4::parts(progress),
        }
    }
}
