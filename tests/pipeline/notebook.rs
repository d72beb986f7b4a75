//! Scores in Python: the notebook reproduces `plumb score`, and the module rejects invalid input.
use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

use super::score::{folder_with, scores};
use crate::common::python::python;
use serde_json::Value;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Runs Python in a folder, with the module on the Python path and `PLUMB` set for the notebook.
fn run(python: &Path, folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(python);
    command.arg("-B").args(arguments).current_dir(folder).env("PYTHONPATH", root().join("tools/score/python"));
    command.env("PLUMB", env!("CARGO_BIN_EXE_plumb")).env("PYTHONUTF8", "1").output().unwrap()
}

/// Returns the last line printed by a successful run.
fn last_line(output: &Output) -> &str {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    std::str::from_utf8(&output.stdout).unwrap().lines().last().unwrap()
}

#[test]
fn notebook_reproduces_scores() {
    let Some(python) = python() else { return };
    let output = run(python, root(), &["tests/foreign/notebook.py", "docs/reference/s1.ipynb"]);
    let report: Value = serde_json::from_str(last_line(&output)).unwrap();
    assert_eq!(report["pictures"], serde_json::json!(["errors-over-time", "plane-of-w", "sweep", "yaw-over-time"]));
}

#[test]
fn chapter_example_prints_equal_errors() {
    let Some(python) = python() else { return };
    let chapter = fs::read_to_string(root().join("docs/how-to/score.md")).unwrap();
    let lines = chapter.lines().skip_while(|line| !line.starts_with("    from plumbscore"));
    let example = lines.map_while(|line| line.strip_prefix("    ").or(line.is_empty().then_some("")));
    let example = example.collect::<Vec<_>>().join("\n");
    let folder = folder_with(&[("example.py", example.replace("target/release/plumb", env!("CARGO_BIN_EXE_plumb")))]);
    let output = run(python, folder.path(), &["example.py"]);
    let errors: Vec<f64> = last_line(&output).split_whitespace().map(|word| word.parse().unwrap()).collect();
    assert!(matches!(errors[..], [a, b] if (a - b).abs() < 1e-9 && a > 0.01), "{errors:?}");
}

#[test]
fn table_and_scores_become_pandas_frames() {
    let Some(python) = python() else { return };
    let program = "
import plumbscore as p, sys
run = p.run(sys.argv[1], ['sim:s1?duration_s=2', 'sim:s3?duration_s=2'], ['wz', 'vqf'], folder='tables')
table = run.table('wz', 'sim_s1_duration_s_2')
frame = table.to_pandas()
assert frame.index.name == 't_s' and len(frame) == len(table['t_s']) == 201, frame
assert (frame['qw'] == table['qw']).all() and set(frame['chart']) <= {'upright', 'inverted'}, frame
scores = run.to_pandas()
assert scores.index.names == ['fuser', 'trial'] and len(scores) == 4, scores
trial = run.stage('vqf')['trials'][1]
assert scores.loc[('vqf', trial['name']), 'inclination'] == trial['inclination'], scores
sys.modules['pandas'] = None
try:
    table.to_pandas()
except p.ScoreError as cause:
    assert 'pip install pandas' in str(cause), cause
    print('passed')
";
    let folder = folder_with(&[]);
    let output = run(python, folder.path(), &["-c", program, env!("CARGO_BIN_EXE_plumb")]);
    assert_eq!(last_line(&output), "passed");
}

/// Returns the error message of a Python expression that must fail.
fn error_message(python: &Path, folder: &Path, read: &str) -> String {
    let program = format!(
        "import plumbscore as p\ntry:\n    {read}\nexcept p.ScoreError as cause:\n    print(str(cause).replace(chr(10), ' '))"
    );
    let output = run(python, folder, &["-c", &program]);
    assert!(!output.stdout.is_empty(), "{read} is accepted: {}", String::from_utf8_lossy(&output.stderr));
    last_line(&output).to_owned()
}

#[test]
fn damaged_table_is_rejected_with_position_and_remedy() {
    let Some(python) = python() else { return };
    let folder = folder_with(&[]);
    scores(folder.path(), &["sim:s1?duration_s=0.05", "--csv", "."]);
    let valid = fs::read_to_string(folder.path().join("sim_s1_duration_s_0.05.csv")).unwrap();
    let read = |text: &str| {
        fs::write(folder.path().join("table.csv"), text).unwrap();
        error_message(python, folder.path(), "p.read_table('table.csv')")
    };
    let third = valid.lines().nth(2).unwrap();
    for (damaged, message) in [
        (valid.replace(",true_u,", ",true_x,"), "table.csv:1: no column true_u; write the table again"),
        (valid.replace(third, &third.replacen("upright", "upright,0", 1)), "table.csv:3: 45 values, expected 44"),
        (valid[..valid.len() - 30].to_owned(), "the file may be truncated"),
        (valid.replacen("\n0.02", "\n0,02", 1), "table.csv:4: "),
        (valid.replacen("\n0.02", "\n0.o2", 1), "table.csv:4: t_s is '0.o20000000', expected a number"),
        (String::new(), "table.csv:1: no column t_s, qw,"),
    ] {
        assert!(read(&damaged).contains(message), "no {message:?} in {}", read(&damaged));
    }
    let message = error_message(python, folder.path(), "p.read_table('none.csv')");
    assert!(
        message.contains("none.csv") && message.contains("expected a file written by `plumb score --csv DIR`"),
        "{message}"
    );
}

#[test]
fn invalid_scores_and_failed_runs_are_rejected_with_remedy() {
    let Some(python) = python() else { return };
    let folder = folder_with(&[]);
    let plumb = format!("{:?}", env!("CARGO_BIN_EXE_plumb"));
    for (read, message) in [
        ("p.Table({'t_s': []})['roll']", "no column roll; available: t_s"),
        ("p.read_scores('')", "no scores on the last line, found ''"),
        ("p.read_scores('RMSE, degrees  fuser')", "pass the standard output of `plumb score … --json`"),
        ("p.read_scores('{\"error\": \"no such file\"}')", "no such file"),
        ("p.run('no-plumb', ['sim:s1'])", "build it with `cargo build --release`"),
        (&format!("p.run({plumb}, ['none.csv'])"), "exited with 3: opening the recording none.csv"),
        (&format!("p.run({plumb}, ['sim:s1?duration_s=1']).table('wz')"), "pass `folder` to `run`"),
        (
            &format!("p.run({plumb}, ['sim:s1?duration_s=1']).stage('vqf')"),
            "no fuser vqf in this run; available: multiple-model",
        ),
        (&format!("p.run({plumb}, ['sim:s1?duration_s=1']).curve('wz', 'fuser.x')"), "settings={'fuser.x': 'a..b'}"),
        (
            &format!("p.run({plumb}, ['sim:s1?seed=1..2&duration_s=1'], ['wz'], folder='two').table('wz')"),
            "2 tables of wz, expected one; set `trial` to one of: sim_s1_seed_1_duration_s_1, ",
        ),
    ] {
        let found = error_message(python, folder.path(), read);
        assert!(found.contains(message), "no {message:?} in {found}");
    }
}

#[test]
fn angles_wrap_and_points_convert_between_charts() {
    let Some(python) = python() else { return };
    let program = "
import numpy as np
import plumbscore as p
angles = np.radians([0.0, 179.0, 180.0, 181.0, -180.0, 359.0, -359.0, 720.0])
assert np.allclose(p.wrapped_deg(angles), [0, 179, 180, -179, 180, -1, 1, 0], atol=1e-9), p.wrapped_deg(angles)
columns = {name: np.zeros(3) for name in p.COLUMNS} | {'qw': np.ones(3), 'true_qw': np.array([1.0, -1.0, np.nan])}
columns |= {'u': np.array([0.3, 0.3, 0.0]), 'v': np.full(3, 0.4), 'chart': np.array(['upright', 'inverted', ''])}
columns |= {'course_reference': np.array(['true', 'arbitrary', 'true']), 'course_rad': np.full(3, 6.2), 'true_course_rad': np.full(3, 0.1)}
table = p.Table(columns | {'course_sd_rad': np.array([0.1, 0.1, 0.0]), 'pitch_rad': np.array([0.0, 0.0, 1.56])})
# 1/w of 0.3 + 0.4j is its conjugate over a quarter.
assert np.allclose(table.w(), [0.3 + 0.4j, 1.2 - 1.6j, 0.4j]), table.w()
errors = table.errors_deg()
assert errors['total'][:2].tolist() == [0.0, 0.0] and np.isnan(errors['total'][2]), 'q and -q are one attitude'
assert np.allclose(errors['course'][0], np.degrees(6.1) - 360.0) and np.isnan(errors['course'][1:]).all(), errors['course']
assert np.allclose(table.normalised()['course'][0], (6.1 - 2.0 * np.pi) / 0.1)
rotated = {'qw': np.cos(np.full(3, 0.1)), 'qz': np.sin(np.full(3, 0.1)), 'true_qw': np.ones(3), 'scored': np.array([1.0, 1.0, 0.0])}
for reference, heading in [(['arbitrary', 'true', 'arbitrary'], np.degrees(0.2)), (['true', 'arbitrary', 'true'], np.nan)]:
    table = p.Table(columns | rotated | {'heading_reference': np.array(reference), 'heading_sd_rad': np.full(3, 0.1)})
    ratios, rms = table.normalised()['heading'], table.rms()
    assert np.allclose(ratios, [np.nan if word == 'arbitrary' else 2.0 for word in reference], equal_nan=True), ratios
    assert np.allclose([rms['total'], rms['heading'], rms['inclination']], [heading, heading, 0.0], equal_nan=True), rms
print('passed')
";
    let folder = folder_with(&[]);
    assert_eq!(last_line(&run(python, folder.path(), &["-c", program])), "passed");
}
