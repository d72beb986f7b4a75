//! Recordings from other systems, imported or read directly like native recordings.
use std::{fs, io::Read, path::Path};

use crate::common::{System, data, plumb};
use flate2::read::GzDecoder;
use serde_json::Value;

/// Maximum inclination error of `wz` against PX4's own estimate, in degrees.
const MAX_INCLINATION_ERROR_DEG: f64 = 0.3;

fn inclination_deg(files: &[&str]) -> f64 {
    let output = plumb(&["score", "--fuser", "wz", "--json"]).args(files).output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{stderr}");
    let scores: Value = serde_json::from_slice(&output.stdout).unwrap();
    let rmse = scores.pointer("/stages/0/trials/0/inclination").and_then(Value::as_f64);
    rmse.unwrap_or_else(|| panic!("{scores}"))
}

#[recorded::test]
fn px4_log_is_scored_replayed_and_imported_alike() {
    let Some(data) = data() else { return };
    let log = data.join("logs/px4_sample.ulg");
    let log = log.to_str().unwrap();
    let system = System::new("");
    let imported = system.path("flight_imu.csv.gz");
    let imported = imported.to_str().unwrap();
    let output = plumb(&["import", log, "-o", imported]).output().unwrap();
    let summary = String::from_utf8(output.stdout).unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(summary.contains("17070 samples") && summary.contains("with reference"), "{summary}");
    let [direct, via_import] = [log, imported].map(|file| inclination_deg(&[file]));
    println!("inclination against PX4: {direct:.3}°");
    assert!(direct < MAX_INCLINATION_ERROR_DEG && direct == via_import, "{direct} and {via_import}");

    let copy = system.path("flight.ulg");
    fs::copy(log, &copy).unwrap();
    let run = system.run(&["--replay", copy.to_str().unwrap(), "--speed", "max", "--out", copy.to_str().unwrap()]);
    assert_eq!(run.code, Some(2), "{}", run.stderr);
    assert_eq!(fs::read(&copy).unwrap(), fs::read(log).unwrap(), "the recording was overwritten");

    let outs = [log, imported].map(|file| {
        let out = system.path("out.csv");
        let run = system.run(&["--replay", file, "--in-process", "--speed", "max", "--out", out.to_str().unwrap()]);
        run.assert_complete();
        fs::read(out).unwrap()
    });
    assert!(outs[0] == outs[1] && outs[0].len() > 1_000_000);
}

/// Runs `plumb import` and returns the path of the file that it wrote.
fn import(system: &System, file: &str, out: &str) -> String {
    let out = system.path(out);
    let output = plumb(&["import", file, "-o", out.to_str().unwrap()]).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    out.to_str().unwrap().to_owned()
}

/// Returns the header and the numbers of a CSV file.
fn table(file: &Path) -> (String, Vec<Vec<f64>>) {
    let is_packed = file.extension().is_some_and(|ending| ending == "gz");
    let mut text = String::new();
    match is_packed {
        true => GzDecoder::new(fs::File::open(file).unwrap()).read_to_string(&mut text).unwrap(),
        false => fs::File::open(file).unwrap().read_to_string(&mut text).unwrap(),
    };
    let (names, rows) = text.split_once('\n').unwrap();
    let numbers = |row: &str| row.split(',').map(|number| number.parse().unwrap()).collect();
    (names.to_owned(), rows.lines().map(numbers).collect())
}

fn is_same(original: f64, returned: f64) -> bool {
    original == returned || original.is_nan() && returned.is_nan()
}

#[recorded::test]
fn recording_survives_mcap_round_trip() {
    let Some(data) = data() else { return };
    let system = System::new("");
    // The first recording has gaps in its reference. The second one has a fixes file.
    for file in ["broad/02_undisturbed_slow_rotation_B.csv.gz", "flights/apm_plane_log2_imu.csv.gz"] {
        let file = data.join(file);
        let back = import(&system, &import(&system, file.to_str().unwrap(), "way.mcap"), "back_imu.csv");
        let [(names, original), (same_names, returned)] = [&file, Path::new(&back)].map(table);
        assert_eq!((&names, original.len()), (&same_names, returned.len()));
        assert!(names.starts_with("t_s,gx,gy,gz,ax,ay,az,mx,my,mz,qw,qx,qy,qz,mov") && original.len() > 10_000);
        for (original, returned) in original.iter().zip(&returned) {
            let length = original[10..14].iter().map(|part| part * part).sum::<f64>().sqrt();
            let t_s = original[0];
            for (column, (original, returned)) in original.iter().zip(returned).enumerate() {
                let is_equal = match column {
                    // Imported quaternions are normalised.
                    10..14 => is_same(*original, *returned) || (original / length - returned).abs() < 1e-15,
                    _ => is_same(*original, *returned),
                };
                assert!(is_equal, "column {column} at {t_s} s: {original} and {returned}");
            }
        }
        let attitudes = [file.to_str().unwrap(), &back].map(|file| {
            let out = system.path("out.csv");
            let arguments = ["--replay", file, "--in-process", "--speed", "max", "--out", out.to_str().unwrap()];
            system.run(&arguments).assert_complete();
            fs::read(out).unwrap()
        });
        assert!(attitudes[0] == attitudes[1] && attitudes[0].len() > 500_000, "the attitudes differ");
    }
    let (names, original) = table(&data.join("flights/apm_plane_log2_gnss.csv"));
    assert_eq!(table(&system.path("back_gnss.csv")), (names, original));
}

#[recorded::test]
fn px4_log_survives_mcap_round_trip() {
    let Some(data) = data() else { return };
    let system = System::new("");
    let log = data.join("logs/px4_sample.ulg");
    let direct = import(&system, log.to_str().unwrap(), "direct_imu.csv");
    let through = import(&system, &import(&system, log.to_str().unwrap(), "log.mcap"), "through_imu.csv");
    let [(names, original), (same_names, returned)] = [&direct, &through].map(|file| table(Path::new(file)));
    assert_eq!((&names, original.len(), returned.len()), (&same_names, 17070, 17070));
    for (original, returned) in original.iter().zip(&returned) {
        // The reference has single precision, so its length equals 1 only to that precision.
        let is_equal = |(column, (original, returned)): (usize, (&f64, &f64))| {
            is_same(*original, *returned) || (10..14).contains(&column) && (original - returned).abs() < 1e-6
        };
        assert!(original.iter().zip(returned).enumerate().all(is_equal), "{original:?} and {returned:?}");
    }
    let files = [direct.as_str(), system.path("log.mcap").to_str().unwrap()].map(|file| inclination_deg(&[file]));
    assert_eq!(files[0], files[1]);
}

#[test]
fn foreign_columns_units_and_frame_are_mapped() {
    let system = System::new("");
    let (file, out) = (system.path("phone.csv"), system.path("imported.csv"));
    let rows: String = (0..200).map(|row| format!("{};0,0;0,0;{};0,0;0,0;-1,0\n", row * 10, 0.5)).collect();
    fs::write(&file, format!("ms;wx;wy;wz;fx;fy;fz\n{}", rows.replace("0.5", "0,5"))).unwrap();
    let map = "t=ms,gx=wx,gy=wy,gz=wz,ax=fx,ay=fy,az=fz";
    let arguments = ["--map", map, "--units", "deg/s,g,ms", "--frame", "frd", "-o", out.to_str().unwrap()];
    let output = plumb(&["import", file.to_str().unwrap()]).args(arguments).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let text = fs::read_to_string(&out).unwrap();
    let row: Vec<f64> = text.lines().nth(2).unwrap().split(',').map(|number| number.parse().unwrap()).collect();
    let down_rad_s = 0.5_f64.to_radians();
    for (found, expected) in row.iter().zip([0.01, 0.0, 0.0, -down_rad_s, 0.0, 0.0, 9.80665]) {
        assert!((found - expected).abs() < 1e-12, "{text}");
    }
    let replayed = |file: &str, mapping: &[&str]| {
        let attitudes = system.path("attitudes.csv");
        let replay = ["--replay", file, "--in-process", "--speed", "max", "--out", attitudes.to_str().unwrap()];
        system.run(&[&replay[..], mapping].concat()).assert_complete();
        fs::read(attitudes).unwrap()
    };
    let via_import = replayed(out.to_str().unwrap(), &[]);
    assert!(replayed(file.to_str().unwrap(), &arguments[..6]) == via_import && via_import.len() > 5000);
    // The body is level throughout, and so is the mapped reference.
    let rows: String = (0..200).map(|row| format!("{},0,0,0,0,0,-9.8,1,0,0,0\n", row * 10)).collect();
    fs::write(&file, format!("ms,wx,wy,wz,fx,fy,fz,a,b,c,d\n{rows}")).unwrap();
    let output = plumb(&["score", file.to_str().unwrap(), "--json", "--map", map, "--map", "qw=a,qx=b,qy=c,qz=d"])
        .args(["--units", "ms", "--frame", "ned-frd"])
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let scores: Value = serde_json::from_slice(&output.stdout).unwrap();
    let inclination = scores.pointer("/stages/0/trials/0/inclination").and_then(Value::as_f64);
    assert!(inclination.is_some_and(|deg| deg < 1e-6), "{scores}");
}

#[test]
fn unreadable_input_is_rejected_with_remedy() {
    let system = System::new("");
    let (bag, text, out) = (system.path("bag.mcap"), system.path("other.csv"), system.path("out.csv"));
    let archive = system.path("bag.zip");
    fs::write(&bag, b"\x89MCAP0\r\nrest").unwrap();
    fs::write(&archive, b"PK\x03\x04rest").unwrap();
    fs::write(&text, "a,b\n1,2\n").unwrap();
    let [bag, text, out, archive] = [&bag, &text, &out, &archive].map(|path| path.to_str().unwrap());
    let rejected = system.run(&["--replay", archive, "--in-process"]);
    assert!(rejected.json["error"].as_str().unwrap().contains("unpack it"), "{}", rejected.json);
    for (arguments, code, message) in [
        (&["import", bag, "-o", out][..], 3, "bag.mcap is damaged: byte 8"),
        (&["score", bag], 3, "found no sample of rate and force"),
        (&["up", "--replay", archive], 3, "unpack it"),
        (&["import", text, "-o", out, "--topic", "/imu"], 2, "leave out --topic"),
        (&["score", text, "--map", "gx"], 2, "gx"),
        (&["import", text, "-o", out], 2, "--map"),
        (&["import", text, "-o", out, "--map", "gx=c"], 2, "--map"),
        (&["import", text, "-o", out, "--map", "gx"], 2, "gx"),
    ] {
        let output = plumb(arguments).output().unwrap();
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {stderr}");
        assert!(stderr.contains(message), "{arguments:?}: {stderr}");
    }
}
