//! Kind of rate sample, calibration and mounting of the sensors: `[ingest.calibration.*]` and
//! `[ingest.mounting]`.

use attitude::{
    Matrix3, Quaternion, Vector3,
    angles::Angles,
    calibration::{self, CalibrationError, Mounting},
    gyro::RateKind,
};
use mapping::names::nearest;
use serde::{Deserialize, Serialize};

use crate::{
    keys::{choices, keys},
    kind::{Matrix, Optional, Table, Vector, text},
    problem::Problem,
    toml_reader::Section,
};

/// Identity matrix.
pub(crate) const IDENTITY: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

choices! {
    /// Kind of rate sample, in relation to its sampling interval.
    #[derive(Eq)]
    #[serde(rename_all = "lowercase")]
    pub enum GyroSamples {
        /// Mean over the interval.
        Means = "means",
        /// Value at the end of the interval.
        Instants = "instants",
    }
}

impl GyroSamples {
    /// Returns the corresponding [`RateKind`] for the stages.
    pub fn rate_kind(self) -> RateKind {
        match self {
            Self::Means => RateKind::Mean,
            Self::Instants => RateKind::Instant,
        }
    }
}

keys! {
    /// Calibrations of the sensors.
    #[derive(Copy)]
    pub struct Calibrations {
        /// Calibration from raw units to rad/s. Readings are calibrated in sensor axes,
        /// out = matrix (raw − bias), then rotated into body axes.
        gyro: Calibration = Calibration::default(), Table(calibration);
        /// Calibration from raw units to m/s².
        accel: Calibration = Calibration::default(), Table(calibration);
        /// Calibration from raw units to µT.
        mag: Calibration = Calibration::default(), Table(calibration);
    }
}

/// Calibration of a sensor with three axes: out = M (raw − bias).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// Bias in raw units.
    pub bias: [f64; 3],
    /// Matrix in SI units (µT for magnetic fields) per raw unit, row by row.
    pub matrix: [[f64; 3]; 3],
}

impl Default for Calibration {
    fn default() -> Self {
        Self { bias: [0.0; 3], matrix: IDENTITY }
    }
}

impl Calibration {
    /// Converts these values to a calibration that can be applied to readings.
    ///
    /// # Errors
    ///
    /// Returns an error if the values are not a valid calibration.
    pub fn to_calibration(&self) -> Result<calibration::Calibration, CalibrationError> {
        calibration::Calibration::new(self.bias.into(), matrix_from_rows(self.matrix))
    }
}

keys! {
    /// Keys of a calibration.
    struct CalibrationKeys {
        /// Bias in raw units.
        bias: Option<[f64; 3]> = None, Optional(Vector), example "[0.02, 0.0, -0.05]";
        /// Scale of each axis, in SI units (µT for magnetic fields) per raw unit.
        scale: Option<[f64; 3]> = None, Optional(Vector), example "[1.001, 1.0, 0.998]";
        /// Matrix that is multiplied with the scale.
        misalignment: Option<[[f64; 3]; 3]> = None, Optional(Matrix);
        /// Product of misalignment and scale, given instead of these two matrices.
        matrix: Option<[[f64; 3]; 3]> = None, Optional(Matrix);
    }
}

/// Reads `bias`, and either `matrix` or its factors `scale` and `misalignment`.
fn calibration(out: &mut Calibration, section: &mut Section<'_, '_>) {
    let mut keys = CalibrationKeys::default();
    let before = section.problem_count();
    keys.read_keys(section);
    let CalibrationKeys { bias, scale, misalignment, matrix } = keys;
    let has_factors = section.has("scale") || section.has("misalignment");
    if section.has("matrix") && has_factors {
        let note = Some("the matrix is the misalignment times the scale".into());
        let title = "matrix: set together with scale or misalignment";
        return reject(section, "matrix", title, "keep either this or scale and misalignment", note);
    }
    if section.problem_count() > before {
        return;
    }
    let scale = Matrix3::from_diagonal(&Vector3::from(scale.unwrap_or([1.0; 3])));
    let factors = to_rows(&(matrix_from_rows(misalignment.unwrap_or(IDENTITY)) * scale));
    *out = Calibration { bias: bias.unwrap_or(out.bias), matrix: matrix.unwrap_or(factors) };
    if let Err(error) = out.to_calibration() {
        let key = if section.has("matrix") { "matrix" } else { "misalignment" };
        let title = format!("{}: {error}", section.path());
        reject(section, key, &title, "invalid calibration", None);
    }
}

keys! {
    /// Keys of the mounting. Only the three angles can be set together.
    struct MountingKeys {
        /// Body directions of the sensors' x and y axes, as x-DIRECTION-y-DIRECTION. The directions
        /// are two of right, left, forward, back, up and down, at right angles to each other.
        /// "rfu", "flu" and "frd" are short forms.
        axes: String = String::new(), text("x-DIRECTION-y-DIRECTION", |name| Some(name.into())),
            example r#""x-right-y-forward""#;
        /// Quaternion w, x, y, z.
        quaternion: Option<[f64; 4]> = None, Optional(Vector);
        /// Rotation matrix.
        matrix: Option<[[f64; 3]; 3]> = None, Optional(Matrix);
        /// Yaw of the sensors in the body.
        yaw_deg: Option<f64> = None, Optional(-360.0..=360.0), unit "°";
        /// Pitch of the sensors in the body.
        pitch_deg: Option<f64> = None, Optional(-360.0..=360.0), unit "°";
        /// Roll of the sensors in the body.
        roll_deg: Option<f64> = None, Optional(-360.0..=360.0), unit "°";
    }
}

/// Reads one of `axes`, `quaternion`, `matrix` or the angles.
pub(crate) fn mounting(out: &mut [[f64; 3]; 3], section: &mut Section<'_, '_>) {
    let mut keys = MountingKeys::default();
    let before = section.problem_count();
    keys.read_keys(section);
    let MountingKeys { axes, quaternion, matrix, yaw_deg, pitch_deg, roll_deg } = keys;
    let set: Vec<_> =
        ["axes", "quaternion", "matrix"].into_iter().chain(ANGLES).filter(|key| section.has(key)).collect();
    let Some(first) = set.first().copied().filter(|_| section.problem_count() == before) else { return };
    if let Some(second) = set.iter().find(|key| **key != first && !(ANGLES.contains(&first) && ANGLES.contains(key))) {
        let title = format!("ingest.mounting: both {first} and {second} are set");
        return reject(section, second, &title, "keep one of the two", None);
    }
    let mounting = match (quaternion, matrix) {
        (Some([w, x, y, z]), _) => Mounting::from_quaternion(Quaternion::new(w, x, y, z)),
        (_, Some(matrix)) => Mounting::from_matrix(matrix_from_rows(matrix)),
        _ if first == "axes" => Mounting::from_name(&axes),
        _ => {
            let [yaw_rad, pitch_rad, roll_rad] =
                [yaw_deg, pitch_deg, roll_deg].map(|angle_deg| angle_deg.unwrap_or(0.0).to_radians());
            Mounting::from_angles(Angles { yaw_rad, pitch_rad, roll_rad })
        }
    };
    match mounting {
        Ok(mounting) => *out = to_rows(mounting.matrix()),
        Err(error) => {
            let help =
                nearest_mounting(&axes).filter(|_| first == "axes").map(|name| format!("did you mean {name:?}?"));
            reject_mounting(section, first, error, help);
        }
    }
}

const ANGLES: [&str; 3] = ["yaw_deg", "pitch_deg", "roll_deg"];

fn reject_mounting(section: &mut Section<'_, '_>, key: &str, error: CalibrationError, help: Option<String>) {
    let title = format!("ingest.mounting.{key}: {error}");
    let span = section.span(key).unwrap_or_default();
    section.report(Problem { help, ..Problem::new(span, title, "not a rotation") });
}

/// Returns the valid mounting name most similar to `found`, or `None` if the directions in `found`
/// are spelt correctly.
fn nearest_mounting(found: &str) -> Option<String> {
    let pairs =
        Mounting::DIRECTIONS.iter().flat_map(|x| Mounting::DIRECTIONS.iter().map(move |y| format!("x-{x}-y-{y}")));
    let pairs: Vec<_> = pairs.collect();
    if pairs.iter().any(|pair| pair == found) {
        return None;
    }
    let rotations = pairs.iter().map(String::as_str).filter(|name| Mounting::from_name(name).is_ok());
    let names: Vec<_> = Mounting::SHORT_NAMES.iter().map(|(name, _)| *name).chain(rotations).collect();
    nearest(found, names).map(str::to_owned)
}

fn reject(section: &mut Section<'_, '_>, key: &str, title: &str, label: &str, note: Option<String>) {
    let span = section.span(key).unwrap_or_default();
    section.report(Problem { note, ..Problem::new(span, title, label) });
}

fn matrix_from_rows(matrix: [[f64; 3]; 3]) -> Matrix3<f64> {
    Matrix3::from_fn(|row, column| matrix[row][column])
}

fn to_rows(matrix: &Matrix3<f64>) -> [[f64; 3]; 3] {
    std::array::from_fn(|row| std::array::from_fn(|column| matrix[(row, column)]))
}

#[cfg(test)]
mod tests {
    use crate::Launch;

    fn ingest(text: &str) -> crate::Ingest {
        Launch::parse("launch.toml", text).unwrap().ingest
    }

    #[test]
    fn calibration_by_factors_equals_calibration_by_matrix() {
        let from_matrix =
            ingest("[ingest.calibration.accel]\nbias = [0.1, 0, 0]\nmatrix = [[2, 0.2, 0], [0, 2, 0], [0, 0, 2]]");
        let from_factors = ingest(
            "[ingest.calibration.accel]\nbias = [0.1, 0, 0]\nscale = [2, 2, 2]\nmisalignment = [[1, 0.1, 0], [0, 1, 0], [0, 0, 1]]",
        );
        assert_eq!(from_matrix, from_factors);
        assert_eq!(from_matrix.calibration.accel.bias, [0.1, 0.0, 0.0]);
    }

    #[test]
    fn mounting_by_axes_angles_quaternion_and_matrix_agree() {
        let settings = [
            "axes = \"x-forward-y-left\"",
            "yaw_deg = 90",
            "quaternion = [0.7071067811865476, 0, 0, 0.7071067811865476]",
            "matrix = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]",
        ];
        for input in settings {
            let found = ingest(&format!("[ingest.mounting]\n{input}")).mounting;
            let expected = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
            let off = found.iter().flatten().zip(expected.iter().flatten()).map(|(a, b): (&f64, &f64)| (a - b).abs());
            assert!(off.fold(0.0, f64::max) < 1e-15, "{input}: {found:?}");
        }
    }

    #[test]
    fn invalid_rotation_or_calibration_is_rejected() {
        let cases = [
            ("ingest.mounting.matrix = [[1, 0, 0], [0, 1, 0], [0, 0, -1]]", "found a reflection", ":1:26\n"),
            ("ingest.mounting.matrix = [[1, 0, 0], [0, 1, 0]]", "three rows of three", ":1:26\n"),
            ("ingest.mounting.quaternion = [2, 0, 0, 0]", "of length 2", ":1:30\n"),
            ("ingest.mounting.axes = \"x-up-y-down\"", "two directions at right angles", ":1:24\n"),
            ("[ingest.mounting]\naxes = \"x-right-y-up\"\nyaw_deg = 3", "both axes and yaw_deg are set", ":3:11\n"),
            ("ingest.calibration.mag.bias = [1, 2]", "an array of 3 finite numbers", ":1:31\n"),
            ("ingest.calibration.gyro.scale = [1, nan, 1]", "an array of 3 finite numbers", ":1:33\n"),
            ("ingest.calibration.mag.matrix = [[1, 0, 0], [1, 0, 0], [0, 0, 1]]", "matrix is singular", ":1:33\n"),
            (
                "[ingest.calibration.mag]\nscale = [1, 1, 1]\nmatrix = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]",
                "set together with",
                ":3:10\n",
            ),
        ];
        for (text, expected, location) in cases {
            let shown = Launch::parse("launch.toml", text).unwrap_err().to_string();
            assert!(
                shown.contains(expected) && shown.contains(location) && shown.ends_with("1 problem"),
                "{expected}:\n{shown}"
            );
        }
    }
}
