//! Calibration and mounting of the sensors: `[ingest.calibration.*]` and `[ingest.mounting]`.

use attitude::{
    Matrix3, Quaternion, Vector3,
    angles::Angles,
    calibration::{self, CalibrationError, Mounting},
};

use crate::{
    model::{Calibration, IDENTITY},
    problem::{Problem, nearest},
    toml_reader::Section,
};

/// Reads `bias`, and either `matrix` or its factors `scale` and `misalignment`.
pub(crate) fn calibration(section: &mut Section<'_, '_>, sensor: &'static str, out: &mut Calibration) {
    section.section(sensor, |section| {
        let (mut scale, mut misalignment) = ([1.0; 3], IDENTITY);
        let mut valid = section.vector("bias", &mut out.bias);
        valid &= section.vector("scale", &mut scale);
        valid &= section.matrix("misalignment", &mut misalignment);
        valid &= section.matrix("matrix", &mut out.matrix);
        let has_factors = section.has("scale") || section.has("misalignment");
        if section.has("matrix") && has_factors {
            let note = Some("the matrix is the misalignment times the scale".into());
            reject(
                section,
                "matrix",
                "matrix: set together with scale or misalignment",
                "keep either this or scale and misalignment",
                note,
            );
        } else if valid {
            if has_factors {
                let product = matrix_from_rows(misalignment) * Matrix3::from_diagonal(&Vector3::from(scale));
                out.matrix = to_rows(&product);
            }
            if let Err(error) = calibration::Calibration::new(out.bias.into(), matrix_from_rows(out.matrix)) {
                let key = if section.has("matrix") { "matrix" } else { "misalignment" };
                reject(section, key, &format!("ingest.calibration.{sensor}: {error}"), "invalid calibration", None);
            }
        }
    });
}

/// Reads one of `axes`, `quaternion`, `matrix` or the angles.
pub(crate) fn mounting(section: &mut Section<'_, '_>, out: &mut [[f64; 3]; 3]) {
    section.section("mounting", |section| {
        let (mut axes, mut quaternion, mut matrix) = (String::new(), [1.0, 0.0, 0.0, 0.0], IDENTITY);
        let mut angles_deg = [0.0; 3];
        let mut valid = section.parsed("axes", "x-DIRECTION-y-DIRECTION", |name| Some(name.into()), &mut axes);
        valid &= section.vector("quaternion", &mut quaternion);
        valid &= section.matrix("matrix", &mut matrix);
        for (key, angle_deg) in ANGLES.into_iter().zip(&mut angles_deg) {
            valid &= section.number(key, -360.0..=360.0, angle_deg);
        }
        let angles = ANGLES.into_iter().filter(|key| section.has(key));
        let settings: Vec<_> =
            ["axes", "quaternion", "matrix"].into_iter().filter(|key| section.has(key)).chain(angles).collect();
        let Some(first) = settings.first().copied().filter(|_| valid) else { return };
        if let Some(second) =
            settings.iter().find(|key| **key != first && !(ANGLES.contains(&first) && ANGLES.contains(key)))
        {
            let title = format!("ingest.mounting: both {first} and {second} are set");
            reject(section, second, &title, "keep one of the two", None);
            return;
        }
        let mounting = match first {
            "axes" => Mounting::from_name(&axes),
            "quaternion" => {
                let [w, x, y, z] = quaternion;
                Mounting::from_quaternion(Quaternion::new(w, x, y, z))
            }
            "matrix" => Mounting::from_matrix(matrix_from_rows(matrix)),
            _ => {
                let [yaw_rad, pitch_rad, roll_rad] = angles_deg.map(f64::to_radians);
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
    });
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
    nearest(found, &names).map(str::to_owned)
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
