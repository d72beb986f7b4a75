//! Text from other loggers in many dialects. Every dialect must be read as the same rows.

use import::{Format, ImportError, Mapping, Options};

use crate::common::{Folder, Imported};

const MAP: &str = "t=time,gx=wx,gy=wy,gz=wz,ax=fx,ay=fy,az=fz";
const NAMES: &str = "time,wx,wy,wz,fx,fy,fz";
const ROWS: u32 = 200;

fn row(n: u32, time: &str) -> String {
    format!("{time},0.25,-0.5,0.{n:03},0.5,-0.25,9.75\n")
}

/// Returns text with a header and rows. `time` returns the time field of the row with the given
/// number.
fn text(header: &str, time: impl Fn(u32) -> String) -> String {
    header.to_owned() + "\n" + &(0..ROWS).map(|n| row(n, &time(n))).collect::<String>()
}

fn import(folder: &Folder, contents: impl AsRef<[u8]>, units: &str) -> Result<Imported, ImportError> {
    let path = folder.file("a.csv", contents);
    folder.import(&[path], Some(Mapping::parse(&[MAP], Some(units), None).unwrap()))
}

/// Asserts that the text is read as [`ROWS`] rows at 100 Hz.
fn assert_rows(name: &str, contents: &str, units: &str) {
    let folder = Folder::new();
    let imported = import(&folder, contents, units).unwrap_or_else(|error| panic!("{name}: {error}"));
    assert_eq!(imported.rows.len(), ROWS as usize, "{name}: {:?}", imported.summary.notes);
    for (n, row) in (0u32..).zip(&imported.rows) {
        let expected = [0.25, -0.5, f64::from(n) / 1000.0, 0.5, -0.25, 9.75];
        assert_eq!([row.rate_rad_s, row.force_m_s2].as_flattened(), expected, "{name}: row {n}");
        assert_eq!(row.t_ns - imported.rows[0].t_ns, i64::from(n) * 10_000_000, "{name}: row {n}");
    }
}

#[test]
fn headers_and_separators_of_loggers_are_read() {
    let seconds = |n: u32| format!("{}.{:02}", n / 100, n % 100);
    let plain = text(NAMES, seconds);
    let rows = plain.split_once('\n').unwrap().1;
    let decimal_comma = |separator: &str| plain.replace(',', separator).replace('.', ",");
    let units = "[s],[rad/s],[rad/s],[rad/s],[m/s2],[m/s2],[m/s2]";
    for (name, contents) in [
        ("bars", plain.replace(',', "|")),
        ("bars and a decimal comma", decimal_comma(" | ")),
        ("a semicolon and a decimal comma", decimal_comma(";")),
        ("a separator after each row", text(NAMES, seconds).replace("9.75\n", "9.75,\n")),
        ("a comment after the names", format!("# {NAMES}\n# s rad/s m/s2\n{rows}")),
        ("a comment with as many fields", format!("# a,b,c,d,e,f,g\n# {NAMES}\n{rows}")),
        ("a line of units", format!("{NAMES}\n{units}\n{rows}")),
        ("a line of units in comments", format!("# {NAMES}\n# {units}\n{rows}")),
        ("text before the names", format!("Logger 1.2\nSerial: 5\n\n{NAMES}\n{rows}")),
    ] {
        assert_rows(name, &contents, "");
    }
    let scaled = format!("{NAMES}\n,deg/s,deg/s,deg/s,g,g,g\n{rows}");
    let imported = import(&Folder::new(), scaled, "").unwrap();
    let row = imported.rows[1];
    assert!((row.rate_rad_s[0] - 0.25f64.to_radians()).abs() < 1e-12, "{row:?}");
    assert!((row.force_m_s2[2] - 9.75 * 9.80665).abs() < 1e-12, "{row:?}");
}

#[test]
fn times_of_loggers_are_read() {
    let times: [(&str, &dyn Fn(u32) -> String); 6] = [
        ("hh:mm:ss:mmm", &|n| format!("23:59:{:02}:{:03}", n / 100, n % 100 * 10)),
        ("half days", &|n| format!("11:59:{:02}.{:02} PM", n / 100, n % 100)),
        ("a basic date", &|n| format!("20260501T1305{:02}.{:02}Z", n / 100, n % 100)),
        ("a date with points", &|n| format!("01.05.2026 13:05:{:02}.{:02}", n / 100, n % 100)),
        ("midnight in half days", &|n| match n {
            0..100 => format!("11:59:59.{n:02} PM"),
            _ => format!("12:00:00.{:02} AM", n - 100),
        }),
        ("a counter in ms that wraps", &|n| ((u64::from(n) * 10 + 4_294_966_296) % (1 << 32)).to_string()),
    ];
    for (name, time) in times {
        assert_rows(name, &text(NAMES, time), if name.contains("in ms") { "ms" } else { "" });
    }
}

#[test]
fn text_without_usable_times_is_rejected() {
    let folder = Folder::new();
    let error = import(&folder, text(NAMES, |_| "5.0".into()), "").unwrap_err();
    assert_eq!(error.exit_code(), 3);
    let message = folder.message(&error);
    assert!(message.starts_with("importing a.csv: found 200 samples whose times never increase"), "{message}");
    assert!(message.contains("`plumb up --source 'stdin?rate_hz=100' < "), "{message}");
    assert_eq!(folder.names(), ["a.csv"], "no file remains");
}

#[test]
fn sensor_numbers_do_not_apply_to_text() {
    let folder = Folder::new();
    let path = folder.file("a.csv", text("t_s,gx,gy,gz,ax,ay,az", |n| format!("{}.{:02}", n / 100, n % 100)));
    assert_eq!(Format::detect(&path).unwrap(), Format::Recording);
    for options in [
        Options { imu: Some(0), ..Options::default() },
        Options { mag: Some(1), ..Options::default() },
        Options { gnss: Some(1), ..Options::default() },
    ] {
        let error = folder.import_with(std::slice::from_ref(&path), &options).unwrap_err();
        assert!(error.to_string().contains("expected a log with several sensors; leave out the option"), "{error}");
        assert_eq!(error.exit_code(), 2);
    }
}
