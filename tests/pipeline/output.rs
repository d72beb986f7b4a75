//! The attitude as it is given to others: the frame of `[output]`, and the columns of `--out`.
use std::{fs, path::Path};

use attitude::{
    Quaternion,
    angles::Angles,
    frames::{self, Frame, QuaternionOrder},
    metrics::AttitudeError,
};
use serde_json::Value;

use crate::common::{System, attitudes, data, plumb, python::python, rms};

const HEAD: &str = "t_s,qw,qx,qy,qz,chart,u,v,z_rad,yaw_rad,pitch_rad,roll_rad,course_rad,course_reference,\
                    bias_x_rad_s,bias_y_rad_s,bias_z_rad_s,inclination_sd_rad,course_sd_rad,flags";

/// The text of the file that a run writes.
fn written(system: &System, arguments: &[&str]) -> String {
    let out = system.path("out.csv");
    let _ = fs::remove_file(&out);
    system
        .run(&[arguments, &["--speed", "max", "--for", "3s", "--out", out.to_str().unwrap()]].concat())
        .assert_whole();
    fs::read_to_string(out).unwrap()
}

/// The numbers of a line by the names in the head; words are not among them.
fn number(head: &str, line: &str, name: &str) -> f64 {
    let place = head.split(',').position(|column| column == name).unwrap_or_else(|| panic!("no {name} in {head}"));
    line.split(',').nth(place).unwrap().parse().unwrap()
}

#[test]
fn every_column_is_the_same_with_processes_and_in_one_and_the_default_has_none() {
    let system = System::new("ingest.sim.scenario = \"tumble\"");
    let plain = written(&system, &["--in-process"]);
    let [by_processes, in_one] =
        [&[][..], &["--in-process"]].map(|way| written(&system, &[way, &["--columns", "all"]].concat()));
    assert!(by_processes == in_one, "the bytes differ");
    assert_eq!((plain.lines().next(), in_one.lines().next()), (Some("t_s,qw,qx,qy,qz"), Some(HEAD)));
    assert_eq!((plain.lines().count(), in_one.lines().count()), (3001, 3001));
    for (short, long) in plain.lines().zip(in_one.lines()).skip(1) {
        assert!(long.starts_with(&format!("{short},")) && !long.contains("nan"), "{short}\n{long}");
    }
    // What the columns say is one attitude.
    for line in in_one.lines().skip(1).step_by(97) {
        let of = |name: &str| number(HEAD, line, name);
        let (q, chart) = ([of("qw"), of("qx"), of("qy"), of("qz")], line.split(',').nth(5).unwrap());
        let inverted = match chart {
            "upright" => 1.0,
            "inverted" => -1.0,
            other => panic!("{other}"),
        };
        let up = [2.0 * (q[1] * q[3] - q[0] * q[2]), 2.0 * (q[2] * q[3] + q[0] * q[1])];
        let along = 1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2]);
        let [u, v] = [up[0], inverted * up[1]].map(|part| part / (1.0 + inverted * along));
        assert!((u - of("u")).abs() < 1e-9 && (v - of("v")).abs() < 1e-9, "{u} {v}: {line}");
        assert!((up[1].asin() - of("pitch_rad")).abs() < 1e-9, "{line}");
        assert!(of("inclination_sd_rad") > 0.0 && of("course_sd_rad") > 0.0, "{line}");
    }
    assert!(in_one.lines().skip(1).any(|line| number(HEAD, line, "bias_x_rad_s") != 0.0));
    assert!(in_one.contains(",inverted,") && in_one.contains(",upright,") && in_one.contains(",arbitrary,"));
    assert!(in_one.lines().nth(1).unwrap().ends_with("rate-instant aligned"), "{:?}", in_one.lines().nth(1));
}

#[test]
fn a_frame_of_others_is_that_of_every_column_and_nothing_is_minus_zero() {
    let ours = written(&System::new(""), &["--in-process", "--columns", "all"]);
    for (name, frame) in Frame::NAMES.into_iter().skip(1) {
        let system = System::new(&format!("output = {{ frame = {name:?}, quaternion = \"xyzw\" }}"));
        let theirs = written(&system, &["--in-process", "--columns", "all"]);
        let head = HEAD.replacen("qw,qx,qy,qz", "qx,qy,qz,qw", 1);
        assert_eq!(theirs.lines().next(), Some(head.as_str()));
        assert!(!theirs.contains(",-0,") && theirs.lines().count() == ours.lines().count());
        for (our, their) in ours.lines().zip(theirs.lines()).skip(1).step_by(53) {
            let (from, to) = (|name: &str| number(HEAD, our, name), |name: &str| number(&head, their, name));
            let four = ["qw", "qx", "qy", "qz"];
            let q = frame.quaternion(four.map(from));
            assert_eq!(four.map(to), q, "{name}");
            let place: Vec<f64> = their.split(',').skip(1).take(4).map(|part| part.parse().unwrap()).collect();
            assert_eq!(place, QuaternionOrder::Xyzw.ordered(q));
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
fn a_flight_that_is_flown_again_writes_the_same_columns_and_the_frame_is_told_in_it() {
    let system = System::new("output.frame = \"ned-frd\"");
    let flights = system.path("flights");
    let flown = written(&system, &["--columns", "bias,uvz", "--record", flights.to_str().unwrap()]);
    let flight = fs::read_dir(&flights).unwrap().next().unwrap().unwrap().path();
    let again = written(&system, &["--columns", "bias,uvz", "--replay", flight.to_str().unwrap()]);
    assert!(flown == again, "the bytes differ");
    assert!(flown.starts_with("t_s,qw,qx,qy,qz,bias_x_rad_s,bias_y_rad_s,bias_z_rad_s,chart,u,v,z_rad\n"));
    // The topics of the flight are in the system's own frame: imported, its reference is the simulation's.
    let info = plumb(&["info", flight.to_str().unwrap(), "--json"]).output().unwrap();
    let info: Value = serde_json::from_slice(&info.stdout).unwrap();
    let told = info.to_string();
    assert!(told.contains("\"output_frame\":\"ned-frd\"") && told.contains("\"topics_frame\":\"enu-rfu\""), "{told}");
}

#[test]
fn columns_that_are_none_are_refused_with_those_there_are() {
    for (columns, said) in
        [("angels", "did you mean \"angles\"?"), ("w", "expected one of uvz, angles, course, bias, sd, flags, all")]
    {
        let output = plumb(&["up", "--in-process", "--out", "x.csv", "--columns", columns]).output().unwrap();
        assert_eq!(output.status.code(), Some(2));
        let people = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(people.contains(said), "{people}");
    }
}

/// PX4's own estimate of the attitude, w x y z from forward, right, down to north, east, down, at its times; read without a line of the importer.
const READ: &str = "
import sys
from pyulog import ULog
topic = ULog(sys.argv[1], ['vehicle_attitude']).data_list[0].data
for row in zip(topic['timestamp'], *(topic[f'q[{i}]'] for i in range(4))):
    print(*(float(part).hex() if i else int(part) for i, part in enumerate(row)))
";

#[test]
fn what_is_given_as_ned_frd_is_what_px4_estimates_of_the_same_flight() {
    let Some(data) = data() else { return };
    let log = data.join("logs/px4_sample.ulg");
    let Some(interpreter) = python() else { return };
    let read = std::process::Command::new(interpreter).args(["-c", READ]).arg(&log).output().unwrap();
    assert!(read.status.success(), "{}", String::from_utf8_lossy(&read.stderr));
    let px4 = estimates(&String::from_utf8(read.stdout).unwrap());
    assert!(px4.len() > 1000);
    let error = |frame: &str| {
        let system = System::new(&format!("output.frame = {frame:?}"));
        let out = system.path("out.csv");
        let arguments =
            ["--replay", log.to_str().unwrap(), "--in-process", "--speed", "max", "--out", out.to_str().unwrap()];
        system.run(&arguments).assert_whole();
        error_deg(&attitudes(Path::new(&out)), &px4)
    };
    let [inclination, total] = error("ned-frd");
    println!("ned-frd against PX4's quaternion: inclination {inclination:.3}°, total {total:.2}° (RMS)");
    assert!(inclination < 0.3 && total < 3.0, "{inclination}° {total}°");
    let [_, total] = error("nwu-flu");
    assert!(total > 45.0, "another frame is told from it: {total}°");
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

/// Inclination and total angle, RMS from ten seconds on, of what is nearest in time.
fn error_deg(ours: &[(f64, [f64; 4])], theirs: &[(f64, [f64; 4])]) -> [f64; 2] {
    let from_s = ours[0].0 + 10.0;
    let (mut next, mut errors) = (0, Vec::new());
    for (t_s, q) in ours.iter().filter(|(t_s, _)| *t_s > from_s) {
        while next + 1 < theirs.len() && theirs[next].0 < *t_s {
            next += 1;
        }
        if (theirs[next].0 - t_s).abs() < 0.01 {
            let quaternion = |[w, x, y, z]: [f64; 4]| Quaternion::new(w, x, y, z);
            errors.push(AttitudeError::between(quaternion(*q), quaternion(theirs[next].1)));
        }
    }
    assert!(errors.len() > 1000, "{}", errors.len());
    [rms(errors.iter().map(|error| error.inclination_deg)), rms(errors.iter().map(|error| error.total_deg))]
}

#[test]
fn a_robot_of_ros_reads_what_is_given_as_enu_flu() {
    let Some(interpreter) = python() else { return };
    let system =
        System::new("output = { frame = \"enu-flu\", quaternion = \"xyzw\" }\ningest.sim.scenario = \"tumble\"");
    let out = system.path("given.csv");
    fs::write(&out, written(&system, &["--in-process", "--columns", "angles"])).unwrap();
    // Yaw, pitch and roll by REP 103: about z, y and x, each after it has turned.
    let check = "
import csv, sys
from scipy.spatial.transform import Rotation
rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(open(sys.argv[1]))]
far = 0.0
for row in rows:
    angles = [row[name] for name in ('yaw_rad', 'pitch_rad', 'roll_rad')]
    turn = Rotation.from_quat([row[name] for name in ('qx', 'qy', 'qz', 'qw')])
    far = max(far, (turn * Rotation.from_euler('ZYX', angles).inv()).magnitude())
print(len(rows), far)
";
    let output = std::process::Command::new(interpreter).args(["-c", check]).arg(&out).output().unwrap();
    let said = String::from_utf8(output.stdout).unwrap();
    let (rows, far_rad) =
        said.trim().split_once(' ').unwrap_or_else(|| panic!("{}", String::from_utf8_lossy(&output.stderr)));
    assert_eq!(rows, "3000");
    assert!(far_rad.parse::<f64>().unwrap() < 1e-7, "{said}");
    let ours = frames::quaternion_to_native(frames::Earth::Enu, frames::Body::Flu, [1.0, 0.0, 0.0, 0.0]);
    assert!(ours[0] > 0.0 && ours[3] < 0.0, "level and facing east: {ours:?}");
}
