//! Attitude output: the frame of `[output]` and the columns of `--out`.
use std::{fs, path::Path};

use attitude::{
    Quaternion,
    angles::Angles,
    frames::{self, Frame, QuaternionOrder},
    metrics::AttitudeError,
};
use serde_json::Value;

use crate::common::{System, attitudes, data, plumb, python::python, rms};

const HEADER: &str = "t_s,qw,qx,qy,qz,chart,u,v,z_rad,yaw_rad,pitch_rad,roll_rad,course_rad,course_reference,\
                    bias_x_rad_s,bias_y_rad_s,bias_z_rad_s,inclination_sd_rad,course_sd_rad,flags";

/// Returns the attitude file written by a run.
fn run_output(system: &System, arguments: &[&str]) -> String {
    let out = system.path("out.csv");
    let _ = fs::remove_file(&out);
    system
        .run(&[arguments, &["--speed", "max", "--for", "3s", "--out", out.to_str().unwrap()]].concat())
        .assert_complete();
    fs::read_to_string(out).unwrap()
}

/// Returns the number in the named column of a line.
fn number(header: &str, line: &str, name: &str) -> f64 {
    let index = header.split(',').position(|column| column == name).unwrap_or_else(|| panic!("no {name} in {header}"));
    line.split(',').nth(index).unwrap().parse().unwrap()
}

#[test]
fn all_columns_are_equal_in_one_process_and_five() {
    let system = System::new("ingest.sim.scenario = \"tumble\"");
    let plain = run_output(&system, &["--in-process"]);
    let [in_five, in_one] =
        [&[][..], &["--in-process"]].map(|mode| run_output(&system, &[mode, &["--columns", "all"]].concat()));
    assert!(in_five == in_one, "the bytes differ");
    assert_eq!((plain.lines().next(), in_one.lines().next()), (Some("t_s,qw,qx,qy,qz"), Some(HEADER)));
    assert_eq!((plain.lines().count(), in_one.lines().count()), (3001, 3001));
    for (short, long) in plain.lines().zip(in_one.lines()).skip(1) {
        assert!(long.starts_with(&format!("{short},")) && !long.contains("nan"), "{short}\n{long}");
    }
    // All columns in a line must describe the same attitude.
    for line in in_one.lines().skip(1).step_by(97) {
        let value = |name: &str| number(HEADER, line, name);
        let (q, chart) = ([value("qw"), value("qx"), value("qy"), value("qz")], line.split(',').nth(5).unwrap());
        let sign = match chart {
            "upright" => 1.0,
            "inverted" => -1.0,
            other => panic!("{other}"),
        };
        let up = [2.0 * (q[1] * q[3] - q[0] * q[2]), 2.0 * (q[2] * q[3] + q[0] * q[1])];
        let along = 1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2]);
        let [u, v] = [up[0], sign * up[1]].map(|part| part / (1.0 + sign * along));
        assert!((u - value("u")).abs() < 1e-9 && (v - value("v")).abs() < 1e-9, "{u} {v}: {line}");
        assert!((up[1].asin() - value("pitch_rad")).abs() < 1e-9, "{line}");
        assert!(value("inclination_sd_rad") > 0.0 && value("course_sd_rad") > 0.0, "{line}");
    }
    assert!(in_one.lines().skip(1).any(|line| number(HEADER, line, "bias_x_rad_s") != 0.0));
    assert!(in_one.contains(",inverted,") && in_one.contains(",upright,") && in_one.contains(",arbitrary,"));
    assert!(in_one.lines().nth(1).unwrap().ends_with("rate-instant aligned"), "{:?}", in_one.lines().nth(1));
}

#[test]
fn output_frame_applies_to_all_columns_without_minus_zero() {
    let native = run_output(&System::new(""), &["--in-process", "--columns", "all"]);
    for (name, frame) in Frame::NAMES.into_iter().skip(1) {
        let system = System::new(&format!("output = {{ frame = {name:?}, quaternion = \"xyzw\" }}"));
        let converted = run_output(&system, &["--in-process", "--columns", "all"]);
        let header = HEADER.replacen("qw,qx,qy,qz", "qx,qy,qz,qw", 1);
        assert_eq!(converted.lines().next(), Some(header.as_str()));
        assert!(!converted.contains(",-0,") && converted.lines().count() == native.lines().count());
        for (native_line, converted_line) in native.lines().zip(converted.lines()).skip(1).step_by(53) {
            let (from, to) =
                (|name: &str| number(HEADER, native_line, name), |name: &str| number(&header, converted_line, name));
            let names = ["qw", "qx", "qy", "qz"];
            let q = frame.quaternion(names.map(from));
            assert_eq!(names.map(to), q, "{name}");
            let ordered: Vec<f64> =
                converted_line.split(',').skip(1).take(4).map(|part| part.parse().unwrap()).collect();
            assert_eq!(ordered, QuaternionOrder::Xyzw.ordered(q));
            let [yaw_rad, pitch_rad, roll_rad] = ["yaw_rad", "pitch_rad", "roll_rad"].map(from);
            let angles = frame.angles(Angles { yaw_rad, pitch_rad, roll_rad });
            assert_eq!(
                [to("yaw_rad"), to("pitch_rad"), to("roll_rad")],
                [angles.yaw_rad, angles.pitch_rad, angles.roll_rad]
            );
            let bias = ["bias_x_rad_s", "bias_y_rad_s", "bias_z_rad_s"];
            assert_eq!(bias.map(to), frame.body().vector(bias.map(from)), "{name}");
            assert_eq!(frame.point([from("u"), from("v")], from("z_rad")), ([to("u"), to("v")], to("z_rad")));
            assert_eq!(from("course_rad"), to("course_rad"));
        }
    }
}

#[test]
fn replayed_flight_writes_same_columns_and_records_frame() {
    let system = System::new("output.frame = \"ned-frd\"");
    let flights = system.path("flights");
    let recorded = run_output(&system, &["--columns", "bias,uvz", "--record", flights.to_str().unwrap()]);
    let flight = fs::read_dir(&flights).unwrap().next().unwrap().unwrap().path();
    let replayed = run_output(&system, &["--columns", "bias,uvz", "--replay", flight.to_str().unwrap()]);
    assert!(recorded == replayed, "the bytes differ");
    assert!(recorded.starts_with("t_s,qw,qx,qy,qz,bias_x_rad_s,bias_y_rad_s,bias_z_rad_s,chart,u,v,z_rad\n"));
    // In a flight, the topics keep the system's own axes and only the file header names the output
    // frame. Importing the flight must not require that frame.
    let info = plumb(&["info", flight.to_str().unwrap(), "--json"]).output().unwrap();
    let info: Value = serde_json::from_slice(&info.stdout).unwrap();
    let text = info.to_string();
    assert!(text.contains("\"output_frame\":\"ned-frd\"") && text.contains("\"topics_frame\":\"enu-rfu\""), "{text}");
}

#[test]
fn standard_output_has_the_bytes_of_the_file() {
    let system = System::new("ingest.sim.scenario = \"tumble\"");
    let file = run_output(&system, &["--in-process"]);
    let up = |arguments: &[&str]| {
        let launch = system.path("launch.toml");
        let common = ["up", "--launch", launch.to_str().unwrap(), "--speed", "max", "--for", "3s", "--out", "-"];
        plumb(&[&common[..], arguments].concat()).output().unwrap()
    };
    for mode in [&["--in-process"][..], &[]] {
        let output = up(mode);
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(0), "{stderr}");
        assert!(output.stdout == file.as_bytes(), "{mode:?}: {} bytes\n{stderr}", output.stdout.len());
    }
    let rejected = up(&["--json"]);
    let stderr = String::from_utf8_lossy(&rejected.stderr);
    assert_eq!(rejected.status.code(), Some(2));
    assert!(stderr.contains("both write to standard output"), "{stderr}");
}

#[test]
fn unknown_columns_are_rejected_with_suggestions() {
    for (columns, message) in
        [("angels", "did you mean `angles`?"), ("w", "expected one of uvz, angles, course, bias, sd, flags, all")]
    {
        let output = plumb(&["up", "--in-process", "--out", "x.csv", "--columns", columns]).output().unwrap();
        assert_eq!(output.status.code(), Some(2));
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(stderr.contains(message), "{stderr}");
    }
}

/// Prints PX4's own attitude estimates with pyulog, independently of the importer. Each line has
/// the time and the quaternion w x y z of the rotation from forward-right-down to north-east-down.
const PRINT_ESTIMATES: &str = "
import sys
from pyulog import ULog
topic = ULog(sys.argv[1], ['vehicle_attitude']).data_list[0].data
for row in zip(topic['timestamp'], *(topic[f'q[{i}]'] for i in range(4))):
    print(*(float(part).hex() if i else int(part) for i, part in enumerate(row)))
";

#[recorded::test]
fn ned_frd_output_matches_px4_estimate() {
    let Some(data) = data() else { return };
    let log = data.join("logs/px4_sample.ulg");
    let Some(interpreter) = python() else { return };
    let output = std::process::Command::new(interpreter).args(["-c", PRINT_ESTIMATES]).arg(&log).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let px4 = estimates(&String::from_utf8(output.stdout).unwrap());
    assert!(px4.len() > 1000);
    let error = |frame: &str| {
        let system = System::new(&format!("output.frame = {frame:?}"));
        let out = system.path("out.csv");
        let arguments =
            ["--replay", log.to_str().unwrap(), "--in-process", "--speed", "max", "--out", out.to_str().unwrap()];
        system.run(&arguments).assert_complete();
        error_deg(&attitudes(Path::new(&out)), &px4)
    };
    let [inclination, total] = error("ned-frd");
    println!("ned-frd against PX4's quaternion: inclination {inclination:.3}°, total {total:.2}° (RMS)");
    assert!(inclination < 0.3 && total < 3.0, "{inclination}° {total}°");
    let [_, total] = error("nwu-flu");
    assert!(total > 45.0, "another frame has a similar error: {total}°");
}

fn estimates(text: &str) -> Vec<(f64, [f64; 4])> {
    let hex = |text: &str| {
        let (sign, rest) = text.strip_prefix('-').map_or((1.0, text), |rest| (-1.0, rest));
        let (mantissa, exponent) = rest.strip_prefix("0x").unwrap().split_once('p').unwrap();
        let (whole, fraction) = mantissa.split_once('.').unwrap_or((mantissa, "0"));
        let digits = u64::from_str_radix(&format!("{whole}{fraction}"), 16).unwrap() as f64;
        sign * digits * 2.0_f64.powi(exponent.parse::<i32>().unwrap() - 4 * fraction.len() as i32)
    };
    text.lines()
        .map(|line| {
            let parts: Vec<_> = line.split(' ').collect();
            (parts[0].parse::<f64>().unwrap() * 1e-6, [1, 2, 3, 4].map(|i| hex(parts[i])))
        })
        .collect()
}

/// Returns the RMS inclination and total error in degrees after the first 10 s. Attitudes are
/// compared with the reference nearest in time.
fn error_deg(attitudes: &[(f64, [f64; 4])], reference: &[(f64, [f64; 4])]) -> [f64; 2] {
    let from_s = attitudes[0].0 + 10.0;
    let (mut next, mut errors) = (0, Vec::new());
    for (t_s, q) in attitudes.iter().filter(|(t_s, _)| *t_s > from_s) {
        while next + 1 < reference.len() && reference[next].0 < *t_s {
            next += 1;
        }
        if (reference[next].0 - t_s).abs() < 0.01 {
            let quaternion = |[w, x, y, z]: [f64; 4]| Quaternion::new(w, x, y, z);
            errors.push(AttitudeError::between(quaternion(*q), quaternion(reference[next].1)));
        }
    }
    assert!(errors.len() > 1000, "{}", errors.len());
    [rms(errors.iter().map(|error| error.inclination_deg)), rms(errors.iter().map(|error| error.total_deg))]
}

#[test]
fn enu_flu_angles_follow_rep_103() {
    let Some(interpreter) = python() else { return };
    let system =
        System::new("output = { frame = \"enu-flu\", quaternion = \"xyzw\" }\ningest.sim.scenario = \"tumble\"");
    let out = system.path("out.csv");
    fs::write(&out, run_output(&system, &["--in-process", "--columns", "angles"])).unwrap();
    // By REP 103, the angles are intrinsic rotations about z, y and x.
    let check = "
import csv, sys
from scipy.spatial.transform import Rotation
rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(open(sys.argv[1]))]
largest = 0.0
for row in rows:
    angles = [row[name] for name in ('yaw_rad', 'pitch_rad', 'roll_rad')]
    rotation = Rotation.from_quat([row[name] for name in ('qx', 'qy', 'qz', 'qw')])
    largest = max(largest, (rotation * Rotation.from_euler('ZYX', angles).inv()).magnitude())
print(len(rows), largest)
";
    let output = std::process::Command::new(interpreter).args(["-c", check]).arg(&out).output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    let (rows, largest_rad) =
        text.trim().split_once(' ').unwrap_or_else(|| panic!("{}", String::from_utf8_lossy(&output.stderr)));
    assert_eq!(rows, "3000");
    assert!(largest_rad.parse::<f64>().unwrap() < 1e-7, "{text}");
    let native_quaternion = frames::quaternion_to_native(frames::Earth::Enu, frames::Body::Flu, [1.0, 0.0, 0.0, 0.0]);
    assert!(
        native_quaternion[0] > 0.0 && native_quaternion[3] < 0.0,
        "attitude of a level body facing east: {native_quaternion:?}"
    );
}
