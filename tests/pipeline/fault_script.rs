//! Faults on purpose, by the script in `launch.toml`: what is flagged, and how long the attitude takes to be level again.
use crate::common::{Run, System, assert_sound, attitudes, inclination_deg, rms};
use scenario::{Motion, Scenario};

/// S1 at 200 Hz; every fault begins when the estimate has settled.
const SOURCE: &str = "[ingest.sim]\nscenario = \"s1\"\nrate_hz = 200\nseed = 11\n";
const FROM_S: f64 = 20.0;

fn entry(sensor: &str, kind: &str, until_s: f64) -> String {
    format!("[[ingest.fault]]\nsensor = {sensor:?}\nkind = {kind}\nfrom_s = {FROM_S}\nuntil_s = {until_s}\n")
}

/// The run in one process, with the inclination error in degrees at the time of each tick.
fn run(script: &str) -> (Run, Vec<(f64, f64)>) {
    let system = System::new(&format!("faults = true\n{SOURCE}{script}"));
    let out = system.path("out.csv");
    let run = system.run(&["--in-process", "--speed", "max", "--for", "60s", "--out", out.to_str().unwrap()]);
    run.assert_whole();
    let attitudes = attitudes(&out);
    assert_sound(&attitudes);
    let error = |(t_s, q)| {
        let truth = Motion::S1.at(t_s).attitude.quaternion();
        (t_s, inclination_deg(q, [truth.w, truth.i, truth.j, truth.k]))
    };
    (run, attitudes.into_iter().map(error).collect())
}

#[test]
fn every_kind_shows_in_the_flags_and_the_attitude_is_level_again_within_a_stated_time() {
    let (whole, errors) = run("");
    assert!(!whole.line("flags").contains("fault-injected"), "{}", whole.people);
    let bound_deg = 2.0 * rms(errors.iter().filter(|(t_s, _)| *t_s > FROM_S).map(|(_, error_deg)| *error_deg)) + 0.05;
    println!("level again: below {bound_deg:.3}°");
    // What is finite and lives is believed: only the estimate itself can take back what it did.
    let cases = [
        ("gyro", "\"off\"", 2.0, "rate-invalid", 7.0),
        ("accel", "\"off\"", 3.0, "force-invalid", 0.0),
        ("all", "\"off\"", 0.5, "gap", 5.0),
        ("gyro", "\"stuck\"", 3.0, "rate-stuck", 1.0),
        ("accel", "\"stuck\"", 3.0, "force-stuck", 15.0),
        ("all", "\"stuck\"", 3.0, "rate-stuck force-stuck", 15.0),
        ("gyro", "\"garbage\"", 1.0, "rate-invalid", 15.0),
        ("accel", "\"garbage\"", 1.0, "force-invalid", 20.0),
        ("all", "\"garbage\"\nseed = 3", 1.0, "rate-invalid force-invalid", 15.0),
        ("gyro", "\"miscalibrated\"\nfactor = 1000", 1.0, "rate-clipped", 7.0),
        ("accel", "\"miscalibrated\"\noffset = [0, 2, 0]", 3.0, "", 40.0),
        ("gyro", "\"slow\"\nevery = 200", 3.0, "rate-stuck", 30.0),
        ("all", "\"slow\"\nevery = 50", 3.0, "gap", 5.0),
        ("gyro", "\"delayed\"\ndelay_s = 0.2", 3.0, "", 30.0),
        ("accel", "\"delayed\"\ndelay_s = 0.2", 3.0, "", 30.0),
        ("all", "\"delayed\"\ndelay_s = 0.2", 3.0, "", 30.0),
        ("gyro", "\"intermittent\"\nshare = 0.5", 3.0, "rate-invalid", 15.0),
        ("accel", "\"intermittent\"\nshare = 0.5", 3.0, "force-invalid", 0.0),
        ("all", "\"intermittent\"\nshare = 0.02", 3.0, "gap", 5.0),
    ];
    let mut late = Vec::new();
    for (sensor, kind, duration_s, flags, within_s) in cases {
        let what = kind.replace('\n', " ");
        let (run, errors) = run(&entry(sensor, kind, FROM_S + duration_s));
        let later = errors.iter().filter(|(t_s, _)| *t_s >= FROM_S);
        let worst_deg = later.clone().fold(0.0, |worst: f64, (_, error_deg)| worst.max(*error_deg));
        let last_s = later.filter(|(_, error_deg)| *error_deg > bound_deg).fold(0.0, |_, (t_s, _)| *t_s);
        let recovery_s = f64::max(last_s - FROM_S - duration_s, 0.0);
        let seen = run.line("flags");
        println!("| {sensor} {what} for {duration_s} s | {worst_deg:.2}° | {recovery_s:.1} s | {seen}");
        assert!(seen.contains("fault-injected"), "{sensor} {what}: {}", run.people);
        assert!(flags.split_whitespace().all(|flag| seen.contains(flag)), "{sensor} {what}: {}", run.people);
        if recovery_s > within_s {
            late.push(format!("{sensor} {what}: {recovery_s:.1} s instead of {within_s} s"));
        }
    }
    assert_eq!(late, Vec::<String>::new(), "to be below {bound_deg:.3}° again");
}

#[test]
fn fields_and_fixes_fail_too_and_the_attitude_stays_sound() {
    let kinds = [
        ("\"off\"", ""),
        ("\"stuck\"", ""),
        ("\"garbage\"", "field-invalid fix-invalid"),
        ("\"miscalibrated\"\nfactor = 1e4", "field-invalid fix-invalid"),
        ("\"slow\"\nevery = 5", ""),
        ("\"delayed\"\ndelay_s = 1", ""),
        ("\"intermittent\"\nshare = 0.3", ""),
    ];
    for (sensor, scenario, kept) in [("mag", "s3", "field"), ("gnss", "cruise", "fix")] {
        assert!(Scenario::parse(scenario).is_ok());
        for (kind, flags) in kinds {
            let script = entry(sensor, kind, 30.0).replace("from_s = 20", "from_s = 2");
            let source = format!("[ingest.sim]\nscenario = {scenario:?}\nrate_hz = 200\n[fuser]\nstage = \"aided\"\n");
            let system = System::new(&format!("faults = true\n{source}{script}"));
            let out = system.path("out.csv");
            let run = system.run(&["--in-process", "--speed", "max", "--for", "40s", "--out", out.to_str().unwrap()]);
            run.assert_whole();
            assert_sound(&attitudes(&out));
            let seen = run.line("flags");
            println!("{sensor} {}: {seen}", kind.replace('\n', " "));
            let flags = flags.split_whitespace().filter(|flag| flag.starts_with(kept)).chain(["fault-injected", kept]);
            assert!(flags.into_iter().all(|flag| seen.contains(flag)), "{sensor} {kind}: {}", run.people);
        }
    }
}

#[test]
fn a_script_that_is_not_allowed_stops_the_start() {
    let system = System::written(&entry("gyro", "\"off\"", 30.0));
    let output = system.command(&["--in-process"]).output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert_ne!(output.status.code(), Some(0), "{said}");
    assert!(said.contains("launch.toml:2:1") && said.contains("write faults = true"), "{said}");
}
