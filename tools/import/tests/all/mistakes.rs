//! What is wrong is said with its place, what was found, what was expected.

use std::{path::PathBuf, slice::from_ref};

use import::{ImportError, Mapping, Options, convert};

use crate::common::{ATTITUDE, COMBINED, Folder, Log};

const NAMES: &str = "t=t,gx=p,gy=q,gz=r,ax=u,ay=v,az=w";

fn parsed(maps: &[&str], units: &str, frame: &str) -> String {
    ImportError::from(Mapping::parse(maps, Some(units), Some(frame)).unwrap_err()).to_string()
}

fn said(folder: &Folder, paths: &[PathBuf], maps: &[&str]) -> String {
    let mapping = Mapping::parse(maps, None, None).unwrap();
    folder.said(&folder.import(paths, Some(mapping)).unwrap_err())
}

#[test]
fn a_mapping_that_is_none_is_refused() {
    for (maps, said) in [
        (
            &["gyro"][..],
            "reading --map: found \"gyro\", expected TARGET=COLUMN with TARGET one of t, gx, gy, gz, ax, ay, az, mx, my, mz, qw, qx, qy, qz, ve, vn, vu, vd, lat, lon, alt",
        ),
        (
            &["gxx=a"],
            "reading --map: found \"gxx\" (did you mean \"gx\"?), expected one of t, gx, gy, gz, ax, ay, az, mx, my, mz, qw, qx, qy, qz, ve, vn, vu, vd, lat, lon, alt",
        ),
        (&[NAMES, "gx=a"], "reading --map: found gx twice, expected one column for it"),
        (&["t=t,gx=p,gy=q"], "reading --map: found no gz, ax, ay, az, expected all of t, gx, gy, gz, ax, ay, az"),
        (&[NAMES, "my=a"], "reading --map: found no mx, mz, expected all of mx, my, mz"),
    ] {
        assert_eq!(parsed(maps, "", "rfu"), said);
    }
    let units = "expected one of rad/s, deg/s, m/s2, g, uT, nT, gauss, mT, s, ms, us, ns";
    assert_eq!(
        parsed(&[NAMES], "deg/s,degs", "rfu"),
        format!("reading --units: found \"degs\" (did you mean \"deg/s\"?), {units}")
    );
    assert_eq!(parsed(&[NAMES], "US", "rfu"), format!("reading --units: found \"US\" (did you mean \"us\"?), {units}"));
    assert_eq!(
        parsed(&[NAMES], "g,m/s2", "rfu"),
        "reading --units: found \"g\" and \"m/s2\", expected one unit of the force"
    );
    assert_eq!(
        parsed(&[NAMES], "", "ned"),
        "reading --frame: found \"ned\", expected body axes, one of rfu, flu, frd; with a reference preceded by earth axes, one of enu, nwu, ned, as in ned-frd"
    );
}

#[test]
fn a_column_that_is_not_there_is_named_with_the_nearest_and_all() {
    let folder = Folder::new();
    let a = folder.file("a.csv", "time,gyro_x,q,r,u,v,w\n0,0,0,0,0,0,0\n");
    let names = "t=time,gx=gyrox,gy=q,gz=r,ax=u,ay=v,az=w";
    assert_eq!(
        said(&folder, from_ref(&a), &[names]),
        "mapping gx: there is no column \"gyrox\", did you mean \"gyro_x\"?; \
         there are \"time\", \"gyro_x\", \"q\", \"r\", \"u\", \"v\", \"w\""
    );
    let b = folder.file("b.csv", "time,q,u,v,w\n0,0,0,0,0\n");
    let names = names.replace("gyrox", "gyro_x");
    assert_eq!(
        said(&folder, &[a.clone(), b.clone()], &[&names]),
        "mapping gy: there is more than one column \"q\"; say a:q or b:q"
    );
    let names = names.replace("gy=q", "gy=b:q");
    assert_eq!(
        said(&folder, &[a, b], &[&names]),
        "mapping gx, gy, gz: found columns of \"a.csv\", \"b.csv\", \"a.csv\", expected all of them in one file"
    );
    let c = folder.file("c.csv", "t,p,p,q,r,u,v,w\n0,0,0,0,0,0,0,0\n");
    assert_eq!(
        said(&folder, &[c], &[NAMES]),
        "mapping gx: there is more than one column \"p\"; say which by giving each column a name of its own in the header"
    );
}

#[test]
fn a_value_that_is_none_is_shown_with_its_place() {
    let folder = Folder::new();
    let header = "t;p;q;r;u;v;w\n";
    for (rows, said_of_it) in [
        ("0;1;2;3;4;5;6\n\n1;1;2;x;4;5;6\n", "line 4, column 4 (r): found \"x\", expected a number"),
        (
            "0;1.5;2;3;4;5;6\n1;1,5;2;3;4;5;6\n",
            "line 3, column 2 (p): found \"1,5\", expected a number with a decimal point, as before",
        ),
        (
            "0;1,5;2;3;4;5;6\n1;1.5;2;3;4;5;6\n",
            "line 3, column 2 (p): found \"1.5\", expected a number with a decimal comma, as before",
        ),
        ("0;1,234.5;2;3;4;5;6\n", "line 2, column 2 (p): found \"1,234.5\", expected a number"),
        (
            "2026-11-23 10:00;1;2;3;4;5;6\n",
            "line 2, column 1 (t): found \"2026-11-23 10:00\", expected a time in s, less than 9e9 s; say another with --units",
        ),
        (
            "1700000000000;1;2;3;4;5;6\n",
            "line 2, column 1 (t): found \"1700000000000\", expected a time in s, less than 9e9 s; say another with --units",
        ),
        ("0;1;2;3;4;5;6\n1;1;2\n", "line 3, column 4 (r): found 3 fields, expected 7 as in the header"),
        ("0;1;2;3;4;5;6\n1;1;2;3;4;5;6;7\n", "line 3, column 8: found 8 fields, expected 7 as in the header"),
        ("0;1;2\n", "line 2, column 4 (r): found 3 fields, expected 7 as in the header"),
        ("", "line 2: found the end of the file, expected a row"),
    ] {
        let path = folder.file("a.csv", format!("{header}{rows}"));
        assert_eq!(said(&folder, &[path], &[NAMES]), format!("reading a.csv: {said_of_it}"));
    }
    let path = folder.file("a.csv", [header.as_bytes(), b"0;\xb5;0;0;0;0;0\n"].concat());
    assert_eq!(
        said(&folder, &[path], &[NAMES]),
        "reading a.csv: line 2, column 2 (p): found \"\u{fffd}\", expected UTF-8 text"
    );
    let path = folder.file("a.csv", [header.as_bytes(), &[b'0'; 1 << 17]].concat());
    assert_eq!(
        said(&folder, &[path], &[NAMES]),
        "reading a.csv: line 2: found a line of more than 65536 bytes, expected a readable line"
    );
    let path = folder.file("a.csv", format!("{header}0;;;;1;1;1\n9;1;1;1;;;\n"));
    assert_eq!(
        said(&folder, &[path], &[NAMES]),
        "importing a.csv: found no sample of rate and force (1 of the rate have no force at their time), \
         expected numbers in the columns of --map, at times of one clock"
    );
    assert_eq!(folder.names(), ["a.csv"], "nothing is left behind");
}

#[test]
fn files_that_do_not_belong_together_are_refused() {
    let folder = Folder::new();
    let mut log = Log::of(&[COMBINED, ATTITUDE]);
    log.combined(1, [0.0; 3], 0, [0.0, 0.0, -9.8]);
    let log = folder.file("a.ulg", log.0);
    let csv = folder.file("a.csv", "t,p\n0,0\n");
    let error = |paths: &[PathBuf], mapping| folder.said(&folder.import(paths, mapping).unwrap_err());
    let mapping = || Some(Mapping::parse(&[NAMES], None, None).unwrap());
    assert_eq!(error(&[], None), "importing: found no file, expected one");
    assert_eq!(
        error(&[log.clone(), csv], None),
        "importing a.ulg: ULog is imported alone, found 2 files; import each by itself"
    );
    assert_eq!(
        error(from_ref(&log), mapping()),
        "importing a.ulg: ULog says itself what its columns are; leave out --map, --units and --frame"
    );
    let into = |out: &str| convert(from_ref(&log), &Options::default(), &folder.path(out), &mut |_| {});
    let error = into("a.ulg").unwrap_err();
    assert_eq!(folder.said(&error), "writing a.ulg: that is the file it is made of; name another");
    let interrupted = folder.file("a.csv.new", Log::of(&[COMBINED]).0);
    let error = convert(from_ref(&interrupted), &Options::default(), &folder.path("a.csv"), &mut |_| {}).unwrap_err();
    assert_eq!(folder.said(&error), "writing a.csv.new: that is the file it is made of; name another");
    std::fs::remove_file(interrupted).unwrap();
    assert!(matches!(into("no/such/folder_imu.csv"), Err(ImportError::Recording(_))));
    folder.file("b_gnss.csv", "t_s,ve,vn,vu\n0,0,0,0\n");
    assert_eq!(
        folder.said(&into("b_imu.csv").unwrap_err()),
        "writing b_imu.csv: there are no fixes, and those of another recording lie at b_gnss.csv; move them, or name another file"
    );
    assert_eq!(folder.names(), ["a.csv", "a.ulg", "b_gnss.csv"], "nothing is left behind");
}
