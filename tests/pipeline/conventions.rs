//! Every conversion and every output against `docs/conventions.json`, which is computed by matrices alone.
use std::collections::BTreeMap;

use attitude::{
    Complex, Matrix3, Quaternion, angles::Angles, frames, frames::Frame, point, state::Attitude, state::wrapped_rad,
};
use launch::Launch;
use messages::{AttitudeOutput, Flags, FusedState};
use pipeline::{Collector, AttitudeFile};
use runtime::{
    Pace, ServiceConfig, Slot,
    frames::{attitude_to_frame, fused_to_frame},
    convert::chart_to_payload,
};
use serde::Deserialize;

const SAME: f64 = 1e-12;

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
    frames: BTreeMap<String, Framed>,
    force_at_rest_m_s2: [f64; 3],
}

/// The same in a frame of others.
#[derive(Deserialize)]
struct Framed {
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
    /// The attitude by its chart, w and z.
    fn attitude(&self) -> Attitude {
        let chart = if self.chart == "inverted" { point::Chart::Inverted } else { point::Chart::Upright };
        Attitude { up: point::Point { w: Complex::new(self.u, self.v), chart }, z_rad: self.z_rad }
    }

    fn matrix(&self) -> Matrix3<f64> {
        Matrix3::from_fn(|row, column| self.matrix_reference_to_body[row][column])
    }
}

fn vectors() -> Vec<Vector> {
    serde_json::from_str(include_str!("../../docs/conventions.json")).unwrap()
}

/// The same numbers, or all of them with the other sign.
fn assert_rotation(name: &str, got: [f64; 4], want: [f64; 4]) {
    let apart = |sign: f64| got.iter().zip(want).map(|(got, want)| (got - sign * want).abs()).fold(0.0, f64::max);
    assert!(apart(1.0).min(apart(-1.0)) < SAME, "{name}: {got:?} is not {want:?}");
}

fn assert_angle(name: &str, got_rad: f64, want_rad: f64) {
    assert!(wrapped_rad(got_rad - want_rad).abs() < SAME, "{name}: {got_rad} is not {want_rad}");
}

fn wxyz(q: Quaternion<f64>) -> [f64; 4] {
    [q.w, q.i, q.j, q.k]
}

#[test]
fn there_are_a_dozen_attitudes_some_of_them_inverted_and_some_vertical() {
    let vectors = vectors();
    assert!(vectors.len() >= 12);
    assert!(vectors.iter().filter(|it| it.chart == "inverted").count() >= 3);
    assert_eq!(vectors.iter().filter(|it| it.near_gimbal).count(), 2);
}

#[test]
fn w_and_z_in_their_chart_give_matrix_quaternion_and_angles() {
    for it in vectors() {
        let (name, attitude) = (&it.name, it.attitude());
        assert!((attitude.matrix() - it.matrix()).amax() < SAME, "{name}: {}", attitude.matrix());
        assert_rotation(name, wxyz(attitude.quaternion()), it.quaternion_wxyz);
        let angles = attitude.angles();
        assert_angle(name, angles.pitch_rad, it.pitch_rad);
        if it.near_gimbal {
            // Yaw and roll are not told apart, but together they are the attitude.
            assert!((Attitude::from_angles(angles).matrix() - it.matrix()).amax() < SAME, "{name}: {angles:?}");
        } else {
            assert_angle(name, angles.yaw_rad, it.yaw_rad);
            assert_angle(name, angles.roll_rad, it.roll_rad);
        }
        let force_m_s2 = attitude.up.direction() * attitude::GRAVITY_M_S2;
        assert!((force_m_s2 - attitude::Vector3::from(it.force_at_rest_m_s2)).amax() < 10.0 * SAME, "{name}");
        let up = attitude.up.direction();
        assert_angle(name, up.x.hypot(up.y).atan2(up.z), it.inclination_rad);
    }
}

#[test]
fn quaternion_and_angles_give_w_and_z_in_their_chart() {
    for it in vectors() {
        let [w, x, y, z] = it.quaternion_wxyz;
        let angles = Angles { yaw_rad: it.yaw_rad, pitch_rad: it.pitch_rad, roll_rad: it.roll_rad };
        for got in [Attitude::from_quaternion(Quaternion::new(w, x, y, z)), Attitude::from_angles(angles)] {
            let want = it.attitude();
            assert!((got.matrix() - it.matrix()).amax() < SAME, "{}", it.name);
            // On the equator either chart is right.
            if (it.inclination_rad - std::f64::consts::FRAC_PI_2).abs() > 1e-9 {
                assert_eq!(got.up.chart, want.up.chart, "{}", it.name);
                assert!((got.up.w - want.up.w).norm_sqr().sqrt() < SAME, "{}: {:?}", it.name, got.up.w);
                assert_angle(&it.name, got.z_rad, want.z_rad);
            }
        }
    }
}

#[test]
fn others_get_their_own_frames() {
    for it in vectors() {
        assert_eq!(it.frames.len() + 1, Frame::NAMES.len());
        for (frame_name, want) in &it.frames {
            let frame = Frame::NAMES.iter().find(|(other, _)| other == frame_name).unwrap().1;
            let name = format!("{}, {frame_name}", it.name);
            let state = FusedState { bias_rad_s: it.rate_rad_s, ..fused(&it) };
            let output = AttitudeOutput { rate_rad_s: it.rate_rad_s, jump: it.quaternion_wxyz, ..published(&it) };
            let (given, fused) = (attitude_to_frame(frame, output), fused_to_frame(frame, state));
            assert_rotation(&name, given.quaternion, want.quaternion_wxyz);
            assert_rotation(&name, frames::quaternion_to_native(frame.earth(), frame.body(), given.quaternion), it.quaternion_wxyz);
            assert_angle(&name, given.pitch_rad, want.pitch_rad);
            if !it.near_gimbal {
                assert_angle(&name, given.yaw_rad, want.yaw_rad);
                assert_angle(&name, given.roll_rad, want.roll_rad);
            }
            let apart =
                |got: &[f64], want: &[f64]| got.iter().zip(want).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(
                apart(&given.rate_rad_s, &want.rate_rad_s) == 0.0 && fused.bias_rad_s == given.rate_rad_s,
                "{name}"
            );
            assert_eq!(
                given.jump[1..],
                frame.body().vector([output.jump[1], output.jump[2], output.jump[3]]),
                "{name}"
            );
            assert!(apart(&fused.w, &[want.u, want.v]) < SAME, "{name}: {:?}", fused.w);
            assert_angle(&name, fused.z_rad, want.z_rad);
            assert_eq!((given.course_rad, given.header, fused.chart), (output.course_rad, output.header, state.chart));
        }
    }
}

fn fused(it: &Vector) -> FusedState {
    let attitude = it.attitude();
    FusedState {
        w: [attitude.up.w.re, attitude.up.w.im],
        z_rad: attitude.z_rad,
        chart: chart_to_payload(attitude.up.chart),
        ..bytemuck::Zeroable::zeroed()
    }
}

/// What the course slot publishes for an attitude.
fn published(it: &Vector) -> AttitudeOutput {
    let config = ServiceConfig {
        launch: Launch::default(),
        rate_hz: 100.0,
        pace: Pace::Max,
        max_ticks: None,
        incarnation: 0,
        epoch: runtime::service_config::FIRST_EPOCH,
        role: runtime::Role::Owner { from_tick: 0 },
        prior: None,
        resume: None,
        publishes_readings: false,
        supervisor_pid: 0,
    };
    let mut output = None;
    course::slot(&config).unwrap().offer(fused(it).into(), &mut |published| output = Some(published));
    output.unwrap()
}

#[test]
fn the_attitude_that_is_published_is_in_our_conventions() {
    for it in vectors() {
        let output = published(&it);
        assert_rotation(&it.name, output.quaternion, it.quaternion_wxyz);
        assert_angle(&it.name, output.pitch_rad, it.pitch_rad);
        assert_eq!(output.header.flags.any(Flags::NEAR_GIMBAL), it.near_gimbal, "{}", it.name);
        if !it.near_gimbal {
            assert_angle(&it.name, output.yaw_rad, it.yaw_rad);
            assert_angle(&it.name, output.roll_rad, it.roll_rad);
            assert_angle(&it.name, output.course_rad, it.course_rad);
        }
        assert!((0.0..std::f64::consts::TAU).contains(&output.course_rad), "{}: {}", it.name, output.course_rad);
    }
}

#[test]
fn the_file_that_is_written_has_w_x_y_z() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.csv");
    let mut collector = Collector::new(Some(&AttitudeFile::new(&path))).unwrap();
    let vectors = vectors();
    for (tick, it) in (0..).zip(&vectors) {
        let mut output = published(it);
        output.header.tick = tick;
        output.header.t_end_ns = tick as i64 * 250_000_000;
        collector.record_attitude(&output);
    }
    collector.finish().unwrap();
    let text = std::fs::read_to_string(path).unwrap();
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some("t_s,qw,qx,qy,qz"));
    for (tick, it) in (0..).zip(&vectors) {
        let row: Vec<f64> = lines.next().unwrap().split(',').map(|x| x.parse().unwrap()).collect();
        assert_eq!(row[0], f64::from(tick) * 0.25);
        assert_rotation(&it.name, [row[1], row[2], row[3], row[4]], it.quaternion_wxyz);
    }
    assert_eq!(lines.next(), None);
}
