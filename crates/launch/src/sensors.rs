//! How the sensors are calibrated and mounted: `[ingest.calibration.*]` and `[ingest.mounting]`.

use attitude::{
    Matrix3, Quaternion, Vector3,
    angles::Angles,
    calibration::{self, CalibrationError, Mounting},
};

use crate::{
    model::{Calibration, IDENTITY},
    problem::{Problem, nearest},
    walk::Section,
};

/// `bias`, and either `matrix` or its parts `scale` and `misalignment`.
pub(crate) fn calibration(section: &mut Section<'_, '_>, sensor: &'static str, out: &mut Calibration) {
    section.section(sensor, |section| {
        let (mut scale, mut misalignment) = ([1.0; 3], IDENTITY);
        let mut taken = section.vector("bias", &mut out.bias);
        taken &= section.vector("scale", &mut scale);
        taken &= section.matrix("misalignment", &mut misalignment);
        taken &= section.matrix("matrix", &mut out.matrix);
        let in_parts = section.has("scale") || section.has("misalignment");
        if section.has("matrix") && in_parts {
            let note = Some("the matrix is the misalignment times the scale".into());
            refuse(
                section,
                "matrix",
                "matrix: given together with its parts",
                "remove this, or scale and misalignment",
                note,
            );
        } else if taken {
            if in_parts {
                let parts = rows_of(misalignment) * Matrix3::from_diagonal(&Vector3::from(scale));
                out.matrix = rows(&parts);
            }
            if let Err(error) = calibration::Calibration::new(out.bias.into(), rows_of(out.matrix)) {
                let key = if section.has("matrix") { "matrix" } else { "misalignment" };
                refuse(section, key, &format!("ingest.calibration.{sensor}: {error}"), "this is no calibration", None);
            }
        }
    });
}

/// One of `axes`, `quaternion`, `matrix`, or the angles.
pub(crate) fn mounting(section: &mut Section<'_, '_>, out: &mut [[f64; 3]; 3]) {
    section.section("mounting", |section| {
        let (mut axes, mut quaternion, mut matrix) = (String::new(), [1.0, 0.0, 0.0, 0.0], IDENTITY);
        let mut angles_deg = [0.0; 3];
        let mut taken = section.text("axes", "x-DIRECTION-y-DIRECTION", |name| Some(name.into()), &mut axes);
        taken &= section.vector("quaternion", &mut quaternion);
        taken &= section.matrix("matrix", &mut matrix);
        for (key, angle_deg) in ANGLES.into_iter().zip(&mut angles_deg) {
            taken &= section.number(key, -360.0..=360.0, angle_deg);
        }
        let angles = ANGLES.into_iter().filter(|key| section.has(key));
        let ways: Vec<_> =
            ["axes", "quaternion", "matrix"].into_iter().filter(|key| section.has(key)).chain(angles).collect();
        let Some(first) = ways.first().copied().filter(|_| taken) else { return };
        if let Some(second) =
            ways.iter().find(|key| **key != first && !(ANGLES.contains(&first) && ANGLES.contains(key)))
        {
            let title = format!("ingest.mounting: given by {first} and by {second}");
            refuse(section, second, &title, "one of the two", None);
            return;
        }
        let mounting = match first {
            "axes" => Mounting::named(&axes),
            "quaternion" => {
                let [w, x, y, z] = quaternion;
                Mounting::of_quaternion(Quaternion::new(w, x, y, z))
            }
            "matrix" => Mounting::of_matrix(rows_of(matrix)),
            _ => {
                let [yaw_rad, pitch_rad, roll_rad] = angles_deg.map(f64::to_radians);
                Mounting::of_angles(Angles { yaw_rad, pitch_rad, roll_rad })
            }
        };
        match mounting {
            Ok(mounting) => *out = rows(mounting.matrix()),
            Err(error) => {
                let help =
                    nearest_mounting(&axes).filter(|_| first == "axes").map(|name| format!("did you mean {name:?}?"));
                refuse_mounting(section, first, error, help);
            }
        }
    });
}

const ANGLES: [&str; 3] = ["yaw_deg", "pitch_deg", "roll_deg"];

fn refuse_mounting(section: &mut Section<'_, '_>, key: &str, error: CalibrationError, help: Option<String>) {
    let title = format!("ingest.mounting.{key}: {error}");
    let span = section.span(key).unwrap_or_default();
    section.report(Problem { help, ..Problem::new(span, title, "this is no rotation") });
}

/// The name meant, where a direction is misspelt.
fn nearest_mounting(found: &str) -> Option<String> {
    let pairs =
        Mounting::DIRECTIONS.iter().flat_map(|x| Mounting::DIRECTIONS.iter().map(move |y| format!("x-{x}-y-{y}")));
    let pairs: Vec<_> = pairs.collect();
    if pairs.iter().any(|pair| pair == found) {
        return None;
    }
    let rotations = pairs.iter().map(String::as_str).filter(|name| Mounting::named(name).is_ok());
    let names: Vec<_> = Mounting::SHORT_NAMES.iter().map(|(name, _)| *name).chain(rotations).collect();
    nearest(found, &names).map(str::to_owned)
}

fn refuse(section: &mut Section<'_, '_>, key: &str, title: &str, label: &str, note: Option<String>) {
    let span = section.span(key).unwrap_or_default();
    section.report(Problem { note, ..Problem::new(span, title, label) });
}

fn rows_of(matrix: [[f64; 3]; 3]) -> Matrix3<f64> {
    Matrix3::from_fn(|row, column| matrix[row][column])
}

fn rows(matrix: &Matrix3<f64>) -> [[f64; 3]; 3] {
    std::array::from_fn(|row| std::array::from_fn(|column| matrix[(row, column)]))
}

#[cfg(test)]
mod tests {
    use crate::Launch;

    fn ingest(text: &str) -> crate::Ingest {
        Launch::parse("launch.toml", text).unwrap().ingest
    }

    #[test]
    fn a_calibration_is_its_matrix_or_its_parts() {
        let whole =
            ingest("[ingest.calibration.accel]\nbias = [0.1, 0, 0]\nmatrix = [[2, 0.2, 0], [0, 2, 0], [0, 0, 2]]");
        let parts = ingest(
            "[ingest.calibration.accel]\nbias = [0.1, 0, 0]\nscale = [2, 2, 2]\nmisalignment = [[1, 0.1, 0], [0, 1, 0], [0, 0, 1]]",
        );
        assert_eq!(whole, parts);
        assert_eq!(whole.calibration.accel.bias, [0.1, 0.0, 0.0]);
    }

    #[test]
    fn a_mounting_is_named_or_given_by_angles_quaternion_or_matrix() {
        let ways = [
            "axes = \"x-forward-y-left\"",
            "yaw_deg = 90",
            "quaternion = [0.7071067811865476, 0, 0, 0.7071067811865476]",
            "matrix = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]",
        ];
        for way in ways {
            let found = ingest(&format!("[ingest.mounting]\n{way}")).mounting;
            let expected = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
            let off = found.iter().flatten().zip(expected.iter().flatten()).map(|(a, b): (&f64, &f64)| (a - b).abs());
            assert!(off.fold(0.0, f64::max) < 1e-15, "{way}: {found:?}");
        }
    }

    #[test]
    fn what_is_no_rotation_or_no_calibration_is_refused_at_its_place() {
        let cases = [
            ("ingest.mounting.matrix = [[1, 0, 0], [0, 1, 0], [0, 0, -1]]", "a mirror", ":1:26\n"),
            ("ingest.mounting.matrix = [[1, 0, 0], [0, 1, 0]]", "three rows of three", ":1:26\n"),
            ("ingest.mounting.quaternion = [2, 0, 0, 0]", "of length 2", ":1:30\n"),
            ("ingest.mounting.axes = \"x-up-y-down\"", "two directions at right angles", ":1:24\n"),
            ("[ingest.mounting]\naxes = \"x-right-y-up\"\nyaw_deg = 3", "by axes and by yaw_deg", ":3:11\n"),
            ("ingest.calibration.mag.bias = [1, 2]", "an array of 3 finite numbers", ":1:31\n"),
            ("ingest.calibration.gyro.scale = [1, nan, 1]", "an array of 3 finite numbers", ":1:33\n"),
            ("ingest.calibration.mag.matrix = [[1, 0, 0], [1, 0, 0], [0, 0, 1]]", "loses a direction", ":1:33\n"),
            (
                "[ingest.calibration.mag]\nscale = [1, 1, 1]\nmatrix = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]",
                "with its parts",
                ":3:10\n",
            ),
        ];
        for (text, said, place) in cases {
            let shown = Launch::parse("launch.toml", text).unwrap_err().to_string();
            assert!(shown.contains(said) && shown.contains(place) && shown.ends_with("1 problem"), "{said}:\n{shown}");
        }
    }
}
