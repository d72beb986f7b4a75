//! Conversions and outputs, compared with `docs/reference/conventions.json`, which is computed with
//! matrices.
use std::collections::BTreeMap;

use attitude::{
    Complex, Matrix3, Quaternion, angles::Angles, frames, frames::Frame, point, state::Attitude, state::wrapped_rad,
};
use launch::Launch;
use messages::{AttitudeOutput, Flags, FusedState};
use pipeline::{AttitudeFile, Collector};
use runtime::{
    Pace, ServiceConfig, SlotProcessor,
    convert::chart_to_payload,
    frames::{attitude_to_frame, fused_to_frame},
};
use serde::Deserialize;

const TOLERANCE: f64 = 1e-12;

#[derive(Deserialize)]
struct Vector {
    name: String,
    yaw_rad: f64,
    pitch_rad: f64,
    roll_rad: f64,
    course_rad: f64,
    near_gimbal: bool,
    chart: String,
    u: f64,
    v: f64,
    z_rad: f64,
    inclination_rad: f64,
    matrix_reference_to_body: [[f64; 3]; 3],
    quaternion_wxyz: [f64; 4],
    rate_rad_s: [f64; 3],
    frames: BTreeMap<String, FrameVector>,
    force_at_rest_m_s2: [f64; 3],
}

/// Attitude of a test vector in another frame.
#[derive(Deserialize)]
struct FrameVector {
    quaternion_wxyz: [f64; 4],
    yaw_rad: f64,
    pitch_rad: f64,
    roll_rad: f64,
    u: f64,
    v: f64,
    z_rad: f64,
    rate_rad_s: [f64; 3],
}

impl Vector {
    /// Returns the attitude given by chart, w and z.
    fn attitude(&self) -> Attitude {
        let chart = if self.chart == "inverted" { point::Chart::Inverted } else { point::Chart::Upright };
        Attitude { up: point::Point { w: Complex::new(self.u, self.v), chart }, z_rad: self.z_rad }
    }

    fn matrix(&self) -> Matrix3<f64> {
        Matrix3::from_fn(|row, column| self.matrix_reference_to_body[row][column])
    }
}

fn vectors() -> Vec<Vector> {
    serde_json::from_str(include_str!("../../docs/reference/conventions.json")).unwrap()
}

/// Asserts that two quaternions describe the same rotation, so that only their sign may differ.
fn assert_rotation(name: &str, actual: [f64; 4], expected: [f64; 4]) {
    let difference = |sign: f64| {
        actual.iter().zip(expected).map(|(actual, expected)| (actual - sign * expected).abs()).fold(0.0, f64::max)
    };
    assert!(difference(1.0).min(difference(-1.0)) < TOLERANCE, "{name}: found {actual:?}, expected {expected:?}");
}

fn assert_angle(name: &str, actual_rad: f64, expected_rad: f64) {
    assert!(
        wrapped_rad(actual_rad - expected_rad).abs() < TOLERANCE,
        "{name}: found {actual_rad}, expected {expected_rad}"
    );
}

fn wxyz(q: Quaternion<f64>) -> [f64; 4] {
    [q.w, q.i, q.j, q.k]
}

#[test]
fn vectors_include_inverted_and_vertical_attitudes() {
    let vectors = vectors();
    assert!(vectors.len() >= 12);
    assert!(vectors.iter().filter(|vector| vector.chart == "inverted").count() >= 3);
    assert_eq!(vectors.iter().filter(|vector| vector.near_gimbal).count(), 2);
}

#[test]
fn point_and_z_give_matrix_quaternion_and_angles() {
    for vector in vectors() {
        let (name, attitude) = (&vector.name, vector.attitude());
        assert!((attitude.matrix() - vector.matrix()).amax() < TOLERANCE, "{name}: {}", attitude.matrix());
        assert_rotation(name, wxyz(attitude.quaternion()), vector.quaternion_wxyz);
        let angles = attitude.angles();
        assert_angle(name, angles.pitch_rad, vector.pitch_rad);
        if vector.near_gimbal {
            // Yaw and roll are ambiguous at this attitude, but their combination must yield the
            // attitude.
            assert!(
                (Attitude::from_angles(angles).matrix() - vector.matrix()).amax() < TOLERANCE,
                "{name}: {angles:?}"
            );
        } else {
            assert_angle(name, angles.yaw_rad, vector.yaw_rad);
            assert_angle(name, angles.roll_rad, vector.roll_rad);
        }
        let force_m_s2 = attitude.up.direction() * attitude::GRAVITY_M_S2;
        assert!((force_m_s2 - attitude::Vector3::from(vector.force_at_rest_m_s2)).amax() < 10.0 * TOLERANCE, "{name}");
        let up = attitude.up.direction();
        assert_angle(name, up.x.hypot(up.y).atan2(up.z), vector.inclination_rad);
    }
}

#[test]
fn quaternion_and_angles_give_point_and_z() {
    for vector in vectors() {
        let [w, x, y, z] = vector.quaternion_wxyz;
        let angles = Angles { yaw_rad: vector.yaw_rad, pitch_rad: vector.pitch_rad, roll_rad: vector.roll_rad };
        for actual in [Attitude::from_quaternion(Quaternion::new(w, x, y, z)), Attitude::from_angles(angles)] {
            let expected = vector.attitude();
            assert!((actual.matrix() - vector.matrix()).amax() < TOLERANCE, "{}", vector.name);
            // Both charts are valid at an inclination of 90°.
            if (vector.inclination_rad - std::f64::consts::FRAC_PI_2).abs() > 1e-9 {
                assert_eq!(actual.up.chart, expected.up.chart, "{}", vector.name);
                assert!(
                    (actual.up.w - expected.up.w).norm_sqr().sqrt() < TOLERANCE,
                    "{}: {:?}",
                    vector.name,
                    actual.up.w
                );
                assert_angle(&vector.name, actual.z_rad, expected.z_rad);
            }
        }
    }
}

#[test]
fn output_frames_match_vectors() {
    for vector in vectors() {
        assert_eq!(vector.frames.len() + 1, Frame::NAMES.len());
        for (frame_name, expected) in &vector.frames {
            let frame = Frame::NAMES.iter().find(|(other, _)| other == frame_name).unwrap().1;
            let name = format!("{}, {frame_name}", vector.name);
            let state = FusedState { bias_rad_s: vector.rate_rad_s, ..fused(&vector) };
            let output =
                AttitudeOutput { rate_rad_s: vector.rate_rad_s, jump: vector.quaternion_wxyz, ..published(&vector) };
            let (output_in_frame, fused) = (attitude_to_frame(frame, output), fused_to_frame(frame, state));
            assert_rotation(&name, output_in_frame.quaternion, expected.quaternion_wxyz);
            assert_rotation(
                &name,
                frames::quaternion_to_native(frame.earth(), frame.body(), output_in_frame.quaternion),
                vector.quaternion_wxyz,
            );
            assert_angle(&name, output_in_frame.pitch_rad, expected.pitch_rad);
            if !vector.near_gimbal {
                assert_angle(&name, output_in_frame.yaw_rad, expected.yaw_rad);
                assert_angle(&name, output_in_frame.roll_rad, expected.roll_rad);
            }
            let difference = |actual: &[f64], expected: &[f64]| {
                actual.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
            };
            assert!(
                difference(&output_in_frame.rate_rad_s, &expected.rate_rad_s) == 0.0
                    && fused.bias_rad_s == output_in_frame.rate_rad_s,
                "{name}"
            );
            assert_eq!(
                output_in_frame.jump[1..],
                frame.body().vector([output.jump[1], output.jump[2], output.jump[3]]),
                "{name}"
            );
            assert!(difference(&fused.w, &[expected.u, expected.v]) < TOLERANCE, "{name}: {:?}", fused.w);
            assert_angle(&name, fused.z_rad, expected.z_rad);
            assert_eq!(
                (output_in_frame.course_rad, output_in_frame.header, fused.chart),
                (output.course_rad, output.header, state.chart)
            );
        }
    }
}

fn fused(vector: &Vector) -> FusedState {
    let attitude = vector.attitude();
    FusedState {
        w: [attitude.up.w.re, attitude.up.w.im],
        z_rad: attitude.z_rad,
        chart: chart_to_payload(attitude.up.chart),
        ..bytemuck::Zeroable::zeroed()
    }
}

/// Returns the course slot's output for an attitude.
fn published(vector: &Vector) -> AttitudeOutput {
    let config = ServiceConfig::standalone(Launch::default(), 100.0, Pace::Max);
    let mut output = None;
    slots::course::slot(&config).unwrap().offer(fused(vector).into(), &mut |published| output = Some(published));
    output.unwrap()
}

#[test]
fn published_attitude_matches_vectors() {
    for vector in vectors() {
        let output = published(&vector);
        assert_rotation(&vector.name, output.quaternion, vector.quaternion_wxyz);
        assert_angle(&vector.name, output.pitch_rad, vector.pitch_rad);
        assert_eq!(output.header.flags.any(Flags::NEAR_GIMBAL), vector.near_gimbal, "{}", vector.name);
        if !vector.near_gimbal {
            assert_angle(&vector.name, output.yaw_rad, vector.yaw_rad);
            assert_angle(&vector.name, output.roll_rad, vector.roll_rad);
            assert_angle(&vector.name, output.course_rad, vector.course_rad);
        }
        assert!((0.0..std::f64::consts::TAU).contains(&output.course_rad), "{}: {}", vector.name, output.course_rad);
    }
}

#[test]
fn attitude_file_has_w_x_y_z_order() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.csv");
    let mut collector = Collector::new(Some(&AttitudeFile::new(&path))).unwrap();
    let vectors = vectors();
    for (tick, vector) in (0..).zip(&vectors) {
        let mut output = published(vector);
        output.header.tick = tick;
        output.header.t_end_ns = tick as i64 * 250_000_000;
        collector.record_attitude(&output);
    }
    collector.finish().unwrap();
    let text = std::fs::read_to_string(path).unwrap();
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some("t_s,qw,qx,qy,qz"));
    for (tick, vector) in (0..).zip(&vectors) {
        let row: Vec<f64> = lines.next().unwrap().split(',').map(|x| x.parse().unwrap()).collect();
        assert_eq!(row[0], f64::from(tick) * 0.25);
        assert_rotation(&vector.name, [row[1], row[2], row[3], row[4]], vector.quaternion_wxyz);
    }
    assert_eq!(lines.next(), None);
}
