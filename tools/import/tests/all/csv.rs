//! CSV files of other systems.

use std::io::Write as _;

use flate2::{Compression, write::GzEncoder};
use import::{Mapping, Note, Options, convert};
use recording::Row;

use crate::common::{Folder, Imported};

/// Column mapping used for most tables in these tests.
const NAMES: &str = "t=t,gx=p,gy=q,gz=r,ax=u,ay=v,az=w";
const MS: i64 = 1_000_000;

fn mapping(maps: &[&str], units: &str, frame: &str) -> Mapping {
    Mapping::parse(maps, Some(units), Some(frame)).unwrap()
}

fn imported(contents: impl AsRef<[u8]>, mapping: Mapping) -> Imported {
    let folder = Folder::new();
    folder.import(&[folder.file("a.txt", contents)], Some(mapping)).unwrap()
}

fn row(t_ns: i64, rate_rad_s: [f64; 3], force_m_s2: [f64; 3]) -> Row {
    Row { t_ns, rate_rad_s, force_m_s2, field_ut: None, reference: None }
}

#[test]
fn csv_dialect_and_gzip_detected_from_content() {
    let expected =
        [row(500 * MS, [1.5, 0.0, -2.0], [0.25, 0.0, 9.75]), row(510 * MS, [1e-3, 0.0, 0.0], [0.0, 0.0, 9.75])];
    let point = "t,p,q,r,u,v,w\n0.5,1.5,0,-2,.25,0,9.75\n0.51,1e-3,0,0,0,0,9.75\n";
    let mut gzip = GzEncoder::new(Vec::new(), Compression::default());
    gzip.write_all(point.as_bytes()).unwrap();
    for contents in [
        point.to_owned(),
        point.replace(',', "\t"),
        point.replace(',', ";"),
        point.replace(',', ";").replace('.', ","),
        point.replace(',', "\t").replace('.', ","),
        format!("sep=;\r\n# a remark\r\n\r\n{}", point.replace(',', " ; ").replace('\n', "\r\n")),
        format!("\u{feff}{}", point.replace("p,q", "\"p\",\"q\"").replace("1.5", "\"1.5\"")),
        "t,p,q,r,u,v,w\n\"0,5\",\"1,5\",0,-2,\",25\",0,\"9,75\"\n\"0,51\",1e-3,0,0,0,0,\"9,75\"\n".to_owned(),
    ] {
        assert_eq!(imported(&contents, mapping(&[NAMES], "", "rfu")).rows, expected, "{contents}");
    }
    assert_eq!(imported(gzip.finish().unwrap(), mapping(&[NAMES], "", "rfu")).rows, expected);
}

#[test]
fn units_converted_to_native() {
    let table = "t,p,q,r,u,v,w,x,y,z\n1700000000123456,180,0,-90,0,0.5,1,1,0,-2\n";
    let names = format!("{NAMES},mx=x,my=y,mz=z");
    for (units, t_ns, rate, force, field) in [
        ("deg/s,g,gauss,us", 1_700_000_000_123_456_000, std::f64::consts::PI, 9.80665, 100.0),
        ("us, nT ,deg/s", 1_700_000_000_123_456_000, std::f64::consts::PI, 1.0, 1e-3),
        ("ns,mT", 1_700_000_000_123_456, 180.0, 1.0, 1000.0),
        ("rad/s,m/s2,uT,ns", 1_700_000_000_123_456, 180.0, 1.0, 1.0),
    ] {
        let rows = imported(table, mapping(&[&names], units, "rfu")).rows;
        let force = [0.0, 0.5 * force, force];
        let expected = Row { field_ut: Some([field, 0.0, -2.0 * field]), ..row(t_ns, [rate, 0.0, -rate / 2.0], force) };
        assert_eq!(rows, [expected], "{units}");
    }
    let times = "t,p,q,r,u,v,w\n1.5,0,0,0,0,0,1\n2.000001,0,0,0,0,0,1\n";
    let rows = imported(times, mapping(&[NAMES], "ms", "rfu")).rows;
    assert_eq!(rows.iter().map(|row| row.t_ns).collect::<Vec<_>>(), [1_500_000, 2_000_001]);
}

#[test]
fn axes_converted_to_native() {
    let table = "t,p,q,r,u,v,w,x,y,z\n0,1,2,3,4,5,6,7,8,9\n";
    let names = format!("{NAMES},mx=x,my=y,mz=z");
    for (frame, to_native) in [
        ("frd", (|[x, y, z]| [y, x, -z]) as fn([f64; 3]) -> [f64; 3]),
        ("flu", |[x, y, z]| [-y, x, z]),
        ("rfu", |body| body),
        ("FLU", |[x, y, z]| [-y, x, z]),
    ] {
        let expected = row(0, to_native([1.0, 2.0, 3.0]), to_native([4.0, 5.0, 6.0]));
        let expected = Row { field_ut: Some(to_native([7.0, 8.0, 9.0])), ..expected };
        assert_eq!(imported(table, mapping(&[&names], "", frame)).rows, [expected], "{frame}");
    }
}

/// The body is level, its forward axis points west and its right axis points north.
#[test]
fn reference_converted_from_all_frames() {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let west = [half, 0.0, 0.0, half];
    // The attitude is a rotation about the third axis by 180° in enu-flu, and by −90° in ned-frd.
    for (frame, [w, x, y, z]) in [
        ("enu-rfu", west),
        ("enu-flu", [0.0, 0.0, 0.0, 1.0]),
        ("NED-frd", [half, 0.0, 0.0, -half]),
        ("enu-frd", [0.0, 0.0, 1.0, 0.0]),
        ("ned-flu", [0.0, half, -half, 0.0]),
        ("ned-rfu", [0.0, 1.0, 0.0, 0.0]),
    ] {
        let table = format!("t,p,q,r,u,v,w,a,b,c,d\n0,0,0,0,1,1,1,{w},{x},{y},{z}\n0.01,0,0,0,1,1,1,nan,0,0,0\n");
        let rows = imported(table, mapping(&[NAMES, "qw=a,qx=b,qy=c,qz=d"], "", frame)).rows;
        let found = rows[0].reference.unwrap().quaternion;
        let dot = found.iter().zip(west).map(|(a, b)| a * b).sum::<f64>().abs();
        assert!((dot - 1.0).abs() < 1e-12 && rows[1].reference.is_none(), "{frame}: {found:?}");
    }
    let error = Mapping::parse(&[NAMES, "qw=a,qx=b,qy=c,qz=d"], None, Some("frd")).unwrap_err();
    assert_eq!(error, import::MappingError::MissingEarthFrame);
}

#[test]
fn velocities_and_positions_become_fixes() {
    let folder = Folder::new();
    let table = "t,p,q,r,u,v,w,n,e,d,f\n0,0,0,0,0,0,9.8,,,,\n0.01,0,0,0,0,0,9.8,1,2,-3,48\n0.02,0,0,0,0,0,9.8,1,2,-3,48\n0.03,0,0,0,0,0,9.8,1.5,2,-3,\n";
    let path = folder.file("wide.csv", table);
    let imported = folder.import(&[path], Some(mapping(&[NAMES, "ve=e,vn=n,vd=d,lat=f"], "", "frd"))).unwrap();
    let fixes: Vec<_> = imported.fixes.iter().map(|fix| (fix.t_ns / MS, fix.velocity_m_s, fix.latitude_deg)).collect();
    assert_eq!(fixes, [(10, [2.0, 1.0, 3.0], Some(48.0)), (30, [2.0, 1.5, 3.0], None)], "a repeated fix is skipped");

    let rows = folder.file("rows.csv", "t,p,q,r,u,v,w\n0,0,0,0,0,0,9.8\n0.01,0,0,0,0,0,9.8\n");
    let fixes = folder.file("fixes.csv", "t,e,n,z\n0,1,2,3\n0.01,1,2,3\n0.01,1,2,3\n");
    let imported = folder.import(&[rows, fixes], Some(mapping(&[NAMES, "ve=e,vn=n,vu=z"], "", "frd"))).unwrap();
    assert_eq!(imported.fixes.len(), 2, "each row of a separate file is a fix");
    let skipped = Note::Skipped { what: "fixes", count: 1, reason: "timestamps do not increase" };
    assert!(imported.summary.notes.contains(&skipped), "{:?}", imported.summary.notes);
}

#[test]
fn files_of_single_sensors_joined_by_time() {
    let folder = Folder::new();
    let gyro = "time,seconds_elapsed,z,y,x\n1000000000,0.0,0.3,0.2,0.1\n1010000000,0.01,0.3,0.2,0.1\n1020000000,0.02,0.3,0.2,0.1\n";
    let force = "time,seconds_elapsed,z,y,x\n995000000,0,9,0,0\n1015000000,0,11,2,-4\n";
    let field = "time,seconds_elapsed,z,y,x\n1002000000,0,3,2,1\n1019000000,0,6,5,4\n";
    let paths = [("Gyroscope.csv", gyro), ("TotalAcceleration.csv", force), ("Magnetometer.csv", field)]
        .map(|(name, text)| folder.file(name, text));
    let maps = [
        "t=time",
        "gx=Gyroscope:x,gy=Gyroscope:y,gz=Gyroscope.csv:z",
        "ax=TotalAcceleration:x,ay=TotalAcceleration:y",
        "az=TotalAcceleration:z",
        "mx=Magnetometer:x,my=Magnetometer:y,mz=Magnetometer:z",
    ];
    let Imported { summary, rows, .. } = folder.import(&paths, Some(mapping(&maps, "ns", "rfu"))).unwrap();
    let rate = [0.1, 0.2, 0.3];
    let expected = [
        Row { field_ut: Some([1.0, 2.0, 3.0]), ..row(1000 * MS, rate, [-1.0, 0.5, 9.5]) },
        row(1010 * MS, rate, [-3.0, 1.5, 10.5]),
        Row { field_ut: Some([4.0, 5.0, 6.0]), ..row(1020 * MS, rate, [-4.0, 2.0, 11.0]) },
    ];
    assert_eq!(rows, expected, "force interpolated, and the last sample held for 5 ms");
    assert_eq!((summary.rows, summary.field_rows, summary.notes), (3, 2, vec![]));
}

#[test]
fn blank_and_nan_values_are_not_samples() {
    let table = "t,p,q,r,u,v,w,x,y,z\n0,1,1,1,,,,,,\n0.01,,,,0,0,9,nan,nan,nan\n0.02,2,2,2,NaN,0,0,1,2,3\n0.03,,,,0,0,11,,,\n9,3,3,3,,,,,,\n";
    let Imported { summary, rows, .. } = imported(table, mapping(&[NAMES, "mx=x,my=y,mz=z"], "", "rfu"));
    let expected = [
        row(0, [1.0; 3], [0.0, 0.0, 9.0]),
        Row { field_ut: Some([1.0, 2.0, 3.0]), ..row(20 * MS, [2.0; 3], [0.0, 0.0, 10.0]) },
    ];
    assert_eq!(rows, expected);
    let skipped = Note::Skipped { what: "rate samples", count: 1, reason: "no force sample nearby" };
    assert_eq!(summary.notes, [skipped]);
}

#[test]
fn force_not_interpolated_over_long_gap() {
    let table = "t,p,q,r,u,v,w\n0,1,1,1,0,0,9\n0.2,1,1,1,,,\n0.39,1,1,1,,,\n0.4,1,1,1,0,0,11\n";
    let rows = imported(table, mapping(&[NAMES], "", "rfu")).rows;
    assert_eq!(
        rows.iter().map(|row| (row.t_ns / MS, row.force_m_s2[2])).collect::<Vec<_>>(),
        [(0, 9.0), (390, 11.0), (400, 11.0)]
    );
}

#[test]
fn plumbline_recording_axes_changed_by_mapping() {
    let table = "t_s,gx,gy,gz,ax,ay,az\n0,1,2,3,4,5,6\n";
    let names = "t=t_s,gx=gx,gy=gy,gz=gz,ax=ax,ay=ay,az=az";
    assert_eq!(imported(table, mapping(&[names], "", "frd")).rows, [row(0, [2.0, 1.0, -3.0], [5.0, 4.0, -6.0])]);
}

#[test]
fn column_names_with_special_characters_mapped() {
    let table = "\"t, in s\",Gyro x (rad/s),a=b,r:z,u,v,w\n0,1,2,3,4,5,6\n";
    let maps = ["t=t, in s,gx=Gyro x (rad/s)", "gy=a=b", "gz=r:z,ax=u,ay=v,az=w"];
    assert_eq!(imported(table, mapping(&maps, "", "rfu")).rows, [row(0, [1.0, 2.0, 3.0], [4.0, 5.0, 6.0])]);
}

#[test]
fn csv_progress_increases_to_total() {
    let folder = Folder::new();
    let rows: String = (0..20_000).map(|i| format!("{i},0.1,0.2,0.3,0.4,0.5,9.8\n")).collect();
    let path = folder.file("a.csv", format!("t,p,q,r,u,v,w\n{rows}"));
    let options = Options { mapping: Some(mapping(&[NAMES], "ms", "rfu")), ..Options::default() };
    let mut reports = Vec::new();
    convert(&[path], &options, &folder.path("b.csv.gz"), &mut |progress| reports.push(progress)).unwrap();
    assert!(
        reports.len() > 10 && reports.windows(2).all(|pair| pair[0].done_bytes <= pair[1].done_bytes),
        "{reports:?}"
    );
    let last = reports.last().unwrap();
    assert_eq!(last.done_bytes, last.total_bytes);
}
