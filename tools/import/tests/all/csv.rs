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
        point.replace('\n', "\r"),
        point.replace('\n', "\r\n"),
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
fn long_file_with_carriage_returns_is_read() {
    let rows: String = (0..20_000).map(|n| format!("{n},0.1,0.2,0.3,0.4,0.5,9.8\r")).collect();
    let found = imported(format!("t,p,q,r,u,v,w\r{rows}"), mapping(&[NAMES], "ms", "rfu"));
    assert_eq!(found.rows.len(), 20_000);
}

#[test]
fn own_columns_with_carriage_returns_are_read() {
    let folder = Folder::new();
    let path = folder.file("own_imu.csv", "t_s,gx,gy,gz,ax,ay,az\r0,0,0,0,0,0,9.8\r0.01,0,0,0,0,0,9.8\r");
    assert_eq!(folder.import(&[path], None).unwrap().rows.len(), 2);
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

/// Header of a table, and the factors that convert its rate, force and magnetic field.
const HEADERS: [(&str, [f64; 3]); 12] = [
    ("t_s,gx,gy,gz,ax,ay,az,mx,my,mz", [1.0, 1.0, 1.0]),
    ("t[ms],gx [deg/s],gy [deg/s],gz [deg/s],ax [g],ay [g],az [g],mx,my,mz", [DEG, G, 1.0]),
    ("time_ms,gyro_x_dps,gyro_y_dps,gyro_z_dps,acc_x_g,acc_y_g,acc_z_g,mag_x_uT,mag_y_uT,mag_z_uT", [DEG, G, 1.0]),
    (
        "time (s),gyro_x (deg/s),gyro_y (deg/s),gyro_z (deg/s),acc_x (g),acc_y (g),acc_z (g),MagX (mGauss),MagY (mGauss),MagZ (mGauss)",
        [DEG, G, 0.1],
    ),
    (
        "Timestamp_us,GyroX[rad/s],GyroY[rad/s],GyroZ[rad/s],accel_x_mps2,accel_y_mps2,accel_z_mps2,MagX[nT],MagY[nT],MagZ[nT]",
        [1.0, 1.0, 1e-3],
    ),
    ("TIME (S),wx(rad/s),wy(rad/s),wz(rad/s),fx(m/s^2),fy(m/s^2),fz(m/s^2),BX (G),BY (G),BZ (G)", [1.0, 1.0, 100.0]),
    (
        "\"time, s\",\"gyro x [mdps]\",\"gyro y [mdps]\",\"gyro z [mdps]\",\"acc x [mg]\",\"acc y [mg]\",\"acc z [mg]\",\"mag x [T]\",\"mag y [T]\",\"mag z [T]\"",
        [DEG / 1000.0, G / 1000.0, 1e6],
    ),
    (
        "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2],mx,my,mz",
        [1.0, 1.0, 1.0],
    ),
    // The unit of one component applies to the whole vector.
    ("time_ms,gyro_x_dps,gyro_y,gyro_z,acc_x_g,acc_y,acc_z,mag_x_uT,mag_y,mag_z", [DEG, G, 1.0]),
    // Names of the recording format take precedence.
    (
        "t_s,gx,gy,gz,acc_x_mg,acc_y_mg,acc_z_mg,mx,my,mz,time_ms,gyro_x_dps,gyro_y_dps,gyro_z_dps",
        [1.0, G / 1000.0, 1.0],
    ),
    (
        "Time (sec),Gyro X (deg/sec),Gyro Y (deg/sec),Gyro Z (deg/sec),Accel X (m/s²),Accel Y (m/s²),Accel Z (m/s²),Mag X (µT),Mag Y (µT),Mag Z (µT)",
        [DEG, 1.0, 1.0],
    ),
    (
        "elapsed_ms;x_gyro_dps;y_gyro_dps;z_gyro_dps;x_acc_mg;y_acc_mg;z_acc_mg;x_mag_mgauss;y_mag_mgauss;z_mag_mgauss",
        [DEG, G / 1000.0, 0.1],
    ),
];
const DEG: f64 = std::f64::consts::PI / 180.0;
const G: f64 = 9.80665;

/// Returns a table with two rows at 0 and 20 ms, in the unit of time that the header names.
fn table(header: &str) -> String {
    let separator = if header.contains(';') { ";" } else { "," };
    let lower = header.to_lowercase();
    let step = match lower.split([',', ';']).next().unwrap_or_default() {
        time if time.contains("ns") => "20000000",
        time if time.contains("us") => "20000",
        time if time.contains("ms") => "20",
        _ => "0.02",
    };
    let count = header.split(separator).count() - 1 - usize::from(header.contains("\"time, s\""));
    let values = ["1", "2", "3", "4", "5", "6", "7", "8", "9", "1", "1", "1", "1"];
    let row = |time: &str| format!("{time}{separator}{}\n", values[..count].join(separator));
    format!("{header}\n{}{}", row("0"), row(step))
}

#[test]
fn units_in_column_names_apply_without_mapping() {
    let folder = Folder::new();
    for (header, [rate, force, field]) in HEADERS {
        let found =
            folder.import(&[folder.file("a.csv", table(header))], None).unwrap_or_else(|error| panic!("{error}"));
        let scaled = |factor: f64, values: [f64; 3]| values.map(|value| value * factor);
        for (row, t_ns) in found.rows.iter().zip([0, 20 * MS]) {
            assert_eq!(row.t_ns, t_ns, "{header}");
            assert_eq!(row.rate_rad_s, scaled(rate, [1.0, 2.0, 3.0]), "{header}");
            assert_eq!(row.force_m_s2, scaled(force, [4.0, 5.0, 6.0]), "{header}");
            assert_eq!(row.field_ut, Some(scaled(field, [7.0, 8.0, 9.0])), "{header}");
        }
        assert_eq!(found.rows.len(), 2, "{header}");
        let has_note = found.summary.notes.iter().any(|note| matches!(note, Note::HeaderUnits { .. }));
        let is_default = [rate, force, field] == [1.0; 3] && header.starts_with("t_s");
        assert_eq!(has_note, !is_default, "{header}");
    }
}

#[test]
fn named_units_override_those_of_column_names() {
    let folder = Folder::new();
    let path = folder.file("a.csv", table(HEADERS[3].0));
    let mapping = Mapping::parse::<&str>(&[], Some("rad/s,uT"), None).unwrap();
    let row = folder.import(&[path], Some(mapping)).unwrap().rows[0];
    assert_eq!((row.rate_rad_s[0], row.force_m_s2[0], row.field_ut), (1.0, 4.0 * G, Some([7.0, 8.0, 9.0])));
    let mapped = imported(
        "s,a [deg/s],b [deg/s],c [deg/s],d,e,f\n0,1,2,3,4,5,6\n",
        Mapping::parse(&["t=s,gx=a,gy=b,gz=c,ax=d,ay=e,az=f"], None, None).unwrap(),
    );
    assert_eq!(mapped.rows[0].rate_rad_s, [DEG, 2.0 * DEG, 3.0 * DEG], "also of mapped columns");
}

/// Each message suggests options for reading the file. The test takes them from the message and
/// reads the file.
#[test]
fn remedies_for_ambiguous_headers_read_the_file() {
    let folder = Folder::new();
    for (header, message) in [
        (
            "time_ms,gyro_x_dps,gyro_y_dps,gyro_z (rad/s),acc_x_g,acc_y_g,acc_z_g",
            "importing a.csv: the column names \"gyro_x_dps\" and \"gyro_z (rad/s)\" state the units deg/s and rad/s of the rate; name the right units, as with --units deg/s",
        ),
        (
            "time_ms,gyro_x_dps (rad/s),gyro_y,gyro_z,acc_x_g,acc_y_g,acc_z_g",
            "importing a.csv: the column names \"gyro_x_dps (rad/s)\" and \"gyro_x_dps (rad/s)\" state the units deg/s and rad/s of the rate; name the right units, as with --units deg/s",
        ),
        (
            "time,gyro_x,gyro_y,gyro_z,acc_x (raw),acc_y,acc_z",
            "importing a.csv: the column names \"gyro_x\", \"acc_x (raw)\", \"time\" state no unit; name the right units, as with --units rad/s,m/s2,s",
        ),
        (
            "time_ms,timestamp (s),gyro_x_dps,gyro_y_dps,gyro_z_dps,acc_x_g,acc_y_g,acc_z_g",
            "importing a.csv: t may be any of the columns \"a:time_ms\", \"a:timestamp (s)\"; choose with --map t=time_ms,gx=gyro_x_dps,gy=gyro_y_dps,gz=gyro_z_dps,ax=acc_x_g,ay=acc_y_g,az=acc_z_g",
        ),
        (
            "t (ms),gyro_x (dps),gyro_y (dps),gyro_z (dps),gyro_x (rad/s),acc_x_g,acc_y_g,acc_z_g",
            "importing a.csv: gx may be any of the columns \"a:gyro_x (dps)\", \"a:gyro_x (rad/s)\"; choose with --map 't=t (ms),gx=gyro_x (dps),gy=gyro_y (dps),gz=gyro_z (dps),ax=acc_x_g,ay=acc_y_g,az=acc_z_g'",
        ),
    ] {
        let path = folder.file("a.csv", table(header));
        let error = folder.import(std::slice::from_ref(&path), None).unwrap_err();
        assert_eq!((folder.message(&error).as_str(), error.exit_code()), (message, 2), "{header}");
        let option = |name: &str| message.split_once(name).map(|(_, value)| value.trim_matches('\''));
        let maps: Vec<&str> = option("--map ").into_iter().collect();
        let mapping = Mapping::parse(&maps, option("--units "), None).unwrap();
        assert_eq!(folder.import(&[path], Some(mapping)).unwrap().rows.len(), 2, "{header}");
    }
    let path = folder.file("a.csv", "time,gyro_x,gyro_y,gyro_z,u,v,w\n0,1,2,3,4,5,6\n");
    let error = folder.message(&folder.import(&[path], None).unwrap_err());
    assert!(error.contains("--map t=time,gx=gyro_x,gy=gyro_y,gz=gyro_z,ax=COLUMN,ay=COLUMN,az=COLUMN;"), "{error}");
}

#[test]
fn column_names_in_latin_1_are_read() {
    let names = b"t (s),gx (\xb0/s),gy (\xb0/s),gz (\xb0/s),ax (m/s\xb2),ay (m/s\xb2),az (m/s\xb2)\n";
    let folder = Folder::new();
    let text = [&names[..], b"0,1,2,3,4,5,6\n0.02,1,2,3,4,5,6\n"].concat();
    let rows = folder.import(&[folder.file("a.csv", text)], None).unwrap().rows;
    assert_eq!((rows.len(), rows[0].rate_rad_s[0], rows[0].force_m_s2[0]), (2, DEG, 4.0));
}

#[test]
fn times_of_day_need_no_unit_in_their_name() {
    let folder = Folder::new();
    let text = "time,gx,gy,gz,ax,ay,az\n13:05:00.000,1,2,3,4,5,6\n13:05:00.020,1,2,3,4,5,6\n";
    let rows = folder.import(&[folder.file("a.csv", text)], None).unwrap().rows;
    assert_eq!(rows[1].t_ns - rows[0].t_ns, 20 * MS);
}
