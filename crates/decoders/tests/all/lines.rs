//! Lines of numbers, mapped with the syntax of `plumb import`.

use decoders::{
    Counts, DeviceTime, Framed, Measurement, Position, Value,
    lines::{LineSettings, Lines, LinesError},
};
use mapping::Mapping;
use recording::{Layout, Reference, Row};

use crate::streams::decoded;

fn read(settings: &LineSettings, text: &str) -> (Vec<Measurement>, Counts) {
    decoded(Box::new(Framed::new(Lines::new(settings).unwrap())), [text.as_bytes()])
}

fn settings_of(maps: &[&str], units: &str, frame: &str) -> LineSettings {
    let mapping = Mapping::parse_live(maps, Some(units), Some(frame)).unwrap();
    LineSettings { mapping, ..LineSettings::default() }
}

fn imu(time: Option<DeviceTime>, rate_rad_s: [f64; 3], force_m_s2: [f64; 3], field: Option<[f64; 3]>) -> Measurement {
    Measurement { time, value: Value::Imu { rate_rad_s, force_m_s2, field_ut: field } }
}

#[test]
fn recording_is_read_back_exactly() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a_imu.csv");
    let mut writer = recording::Writer::create(&path, Layout { field: true, reference: true }).unwrap();
    let rows: Vec<_> = (0..50u8)
        .map(|n| Row {
            t_ns: 1_000_000_007 + i64::from(n) * 4_999_999,
            rate_rad_s: [0.1 + f64::from(n) / 3.0, -1e-9, 2.0],
            force_m_s2: [0.3, f64::from(n) / 7.0, 9.80665],
            field_ut: n.is_multiple_of(5).then_some([20.1, -3.3, 44.0 + f64::from(n)]),
            reference: Some(Reference { quaternion: [1.0, 0.0, 0.0, 0.0], scored: true }),
        })
        .collect();
    rows.iter().for_each(|row| writer.write(row).unwrap());
    writer.finish().unwrap();
    let (found, counts) = read(&LineSettings::default(), &std::fs::read_to_string(&path).unwrap());
    let wanted: Vec<_> = rows
        .iter()
        .map(|row| {
            let time = DeviceTime::SinceBoot { now_ns: row.t_ns.unsigned_abs() };
            imu(Some(time), row.rate_rad_s, row.force_m_s2, row.field_ut)
        })
        .collect();
    assert_eq!(found, wanted);
    assert_eq!(counts, Counts { frames: 51, ..Counts::default() });
}

#[test]
fn columns_are_converted_by_name_unit_and_axis() {
    let maps = ["t=ms,gx=p,gy=q,gz=r,ax=u,ay=v,az=w,mx=a,my=b,mz=c"];
    let text = "ms;p;q;r;u;v;w;battery;a;b;c\n1000,5;90;0;0;0;1;0;3,7;0,5;0;0\n";
    let (found, _) = read(&settings_of(&maps, "deg/s,g,gauss,ms", "flu"), text);
    // (forward, left, up) becomes (right, forward, up).
    let quarter = 90f64.to_radians();
    let time = Some(DeviceTime::SinceBoot { now_ns: 1_000_500_000 });
    assert_eq!(found, [imu(time, [0.0, quarter, 0.0], [-9.80665, 0.0, 0.0], Some([0.0, 50.0, 0.0]))]);
}

#[test]
fn columns_without_header_come_from_settings() {
    let columns = ["gx", "gy", "gz", "ax", "ay", "az"].map(str::to_owned).to_vec();
    let settings = LineSettings { columns: Some(columns), ..LineSettings::default() };
    let (found, counts) =
        read(&settings, "7 1 2 3 4 5\n0 0 0 0 0 9.8\n\n# remark\n0 0 0\n1 2 3 4 5 x\n1 2 3 4 5 6\r\n");
    let (rate, force) = ([1.0, 2.0, 3.0], [4.0, 5.0, 6.0]);
    assert_eq!(found, [imu(None, [0.0; 3], [0.0, 0.0, 9.8], None), imu(None, rate, force, None)]);
    // The first line may lack its beginning, so it is skipped although it is valid here.
    assert_eq!(counts, Counts { frames: 4, rejected: 2, skipped_bytes: 12 + 6 + 12, foreign: 0, ambiguous_dates: 0 });
}

#[test]
fn unnamed_columns_get_default_names() {
    let complete = LineSettings { starts_at_line_start: true, ..LineSettings::default() };
    let (rate, force) = ([1.0, 2.0, 3.0], [4.0, 5.0, 6.0]);
    let time = Some(DeviceTime::SinceBoot { now_ns: 500_000_000 });
    let (found, counts) = read(&complete, "0.5,1,2,3,4,5,6\n0.5,1,2,3,4,5,6\n0.5,1,2,3,4,5,6,7,8,9\n");
    assert_eq!(found, [imu(time, rate, force, None); 2]);
    assert_eq!((counts.frames, counts.rejected), (2, 1), "the columns do not change");
    let (found, _) = read(&complete, "x,1,2,3,4,5,6\n0.5 1 2 3 4 5 6 7 8 9\n");
    assert_eq!(found, [imu(time, rate, force, Some([7.0, 8.0, 9.0]))]);
    let (found, counts) = read(&LineSettings::default(), "0.5,1,2,3,4,5,6\n");
    assert_eq!((found.len(), counts.skipped_bytes), (0, 16), "the line may lack its beginning");
}

#[test]
fn time_counter_has_configured_period() {
    let maps = ["t=us,gx=gx,gy=gy,gz=gz,ax=ax,ay=ay,az=az"];
    let settings = LineSettings { time_bits: Some(32), ..settings_of(&maps, "us", "rfu") };
    let (found, _) = read(&settings, "us,gx,gy,gz,ax,ay,az\n4294967295,0,0,0,0,0,9.8\n,0,0,0,0,0,9.8\n");
    let times: Vec<_> = found.iter().map(|found| found.time).collect();
    let period_ns = (1 << 32) * 1000;
    assert_eq!(times, [Some(DeviceTime::Counter { now_ns: 4_294_967_295_000, period_ns }), None]);
    let unix = "t,gx,gy,gz,ax,ay,az\n1700000000.5,0,0,0,0,0,9.8\n-1,0,0,0,0,0,9.8\n";
    let times: Vec<_> = read(&LineSettings::default(), unix).0.iter().map(|found| found.time).collect();
    let before = DeviceTime::SinceBoot { now_ns: (-1_000_000_000i64).cast_unsigned() };
    assert_eq!(times, [Some(DeviceTime::Unix { now_ns: 1_700_000_000_500_000_000 }), Some(before)]);
    let (found, counts) = read(&settings, "us,gx,gy,gz,ax,ay,az\n-1,0,0,0,0,0,9.8\n");
    assert_eq!((found.len(), counts.rejected), (0, 1), "a counter is never negative");
}

#[test]
fn units_in_column_names_apply() {
    let header = "time_ms;gyro_x (deg/s);gyro_y (deg/s);gyro_z (deg/s);acc_x_g;acc_y_g;acc_z_g;MagX (mGauss);MagY (mGauss);MagZ (mGauss)\n";
    let row = "20;90;0;0;0;0;1;100;0;0\n";
    let quarter = 90f64.to_radians();
    let time = |now_ns| Some(DeviceTime::SinceBoot { now_ns });
    let complete = LineSettings { starts_at_line_start: true, ..LineSettings::default() };
    let (found, counts) = read(&complete, &format!("{header}{row}"));
    assert_eq!(found, [imu(time(20_000_000), [quarter, 0.0, 0.0], [0.0, 0.0, 9.80665], Some([10.0, 0.0, 0.0]))]);
    assert_eq!(counts, Counts { frames: 2, ..Counts::default() });
    // Units in the settings take precedence over those in the header.
    let named = LineSettings {
        mapping: Mapping::parse_live::<&str>(&[], Some("rad/s,uT"), None).unwrap(),
        starts_at_line_start: true,
        ..LineSettings::default()
    };
    let (found, _) = read(&named, &format!("{header}{row}"));
    assert_eq!(found, [imu(time(20_000_000), [90.0, 0.0, 0.0], [0.0, 0.0, 9.80665], Some([100.0, 0.0, 0.0]))]);
    // The unit of a counter is part of its column name. A time of unknown unit is not used.
    let wrapping = LineSettings { time_bits: Some(32), ..complete.clone() };
    let (found, _) = read(&wrapping, &format!("{}{row}", header.replace("time_ms", "micros")));
    assert_eq!(found.first().and_then(|found| found.time), None);
    let (found, _) = read(&wrapping, &format!("{}{row}", header.replace("time_ms", "t_us")));
    let period_ns = (1 << 32) * 1000;
    assert_eq!(found.first().and_then(|found| found.time), Some(DeviceTime::Counter { now_ns: 20_000, period_ns }));
    // A line with contradictory or missing units does not count as a header.
    for header in [header.replace("gyro_z (deg/s)", "gyro_z (rad/s)"), header.replace(" (deg/s)", "")] {
        let (found, counts) = read(&complete, &format!("{header}{row}"));
        assert_eq!((found.len(), counts.rejected), (0, 2), "{header}");
    }
    let names = "gyro_x,gyro_y,gyro_z,ax,ay,az".split(',').map(str::to_owned).collect();
    let error = Lines::new(&LineSettings { columns: Some(names), ..LineSettings::default() }).unwrap_err();
    assert_eq!(error.to_string(), "the column names \"gyro_x\" state no unit; set `units` to rad/s");
}

#[test]
fn lines_may_end_with_carriage_returns() {
    let text = "t,gx,gy,gz,ax,ay,az\n1,0,0,0,0,0,9.8\n2,0,0,0,0,0,9.8\n3,0,0,0,0,0,9.8\n";
    let (expected, counts) = read(&LineSettings::default(), text);
    assert_eq!(expected.len(), 3);
    assert_eq!(read(&LineSettings::default(), &text.replace('\n', "\r\n")), (expected.clone(), counts));
    // A final carriage return may be followed by a newline, so the last line ends only at the next
    // byte.
    let (found, _) = read(&LineSettings::default(), &format!("{}4", text.replace('\n', "\r")));
    assert_eq!(found, expected);
}

#[test]
fn repeated_fix_is_reported_once() {
    let maps = ["t=t,gx=gx,gy=gy,gz=gz,ax=ax,ay=ay,az=az,ve=e,vn=n,vd=d,lat=lat"];
    let text = "t,gx,gy,gz,ax,ay,az,e,n,d,lat\n1,0,0,0,0,0,9.8,1,2,3,-37.5\n2,0,0,0,0,0,9.8,1,2,3,-37.5\n\
                3,,,,,,,,,,\n4,,,,,,,4,5,6,\n";
    let (found, counts) = read(&settings_of(&maps, "", "rfu"), text);
    let fixes: Vec<_> = found.iter().filter(|found| matches!(found.value, Value::Fix { .. })).collect();
    let position = Position { latitude_rad: Some((-37.5f64).to_radians()), ..Position::default() };
    let first = Value::Fix { velocity_m_s: [1.0, 2.0, -3.0], sd_m_s: None, position };
    let second = Value::Fix { velocity_m_s: [4.0, 5.0, -6.0], sd_m_s: None, position: Position::default() };
    assert_eq!(fixes.iter().map(|fix| fix.value).collect::<Vec<_>>(), [first, second]);
    assert_eq!((found.len(), counts.frames, counts.rejected), (4, 5, 0));
}

#[test]
fn invalid_settings_are_rejected() {
    let columns = |names: &[&str]| Some(names.iter().map(|name| (*name).to_owned()).collect());
    let settings = LineSettings {
        columns: columns(&["gx", "gy", "gyro_z", "ax", "ay", "az"]),
        ..settings_of(&["gx=gx,gy=gy,gz=gyroz,ax=ax,ay=ay,az=az"], "", "rfu")
    };
    let error = Lines::new(&settings).unwrap_err().to_string();
    assert!(error.contains("column \"gyroz\" for gz") && error.contains("did you mean \"gyro_z\"?"), "{error}");
    for bits in [0, 64, 60] {
        let settings = LineSettings { time_bits: Some(bits), ..LineSettings::default() };
        assert_eq!(Lines::new(&settings).unwrap_err(), LinesError::InvalidTimeBits { bits });
    }
}

#[test]
fn overlong_line_is_skipped_with_its_rest() {
    let header = "gx,gy,gz,ax,ay,az\n";
    let endless = "1,2,3,4,5,".repeat(500);
    let (found, counts) = read(&LineSettings::default(), &format!("{header}{endless}6,1,1,1,1,1\n1,2,3,4,5,6\n"));
    assert_eq!(found, [imu(None, [1.0, 2.0, 3.0], [4.0, 5.0, 6.0], None)]);
    assert_eq!((counts.frames, counts.rejected), (2, 0), "{counts:?}");
    assert_eq!(counts.skipped_bytes, 5000 + 12);
}

#[test]
fn line_before_header_is_rejected_and_header_may_change() {
    let text = "1,2\n1,2,3,4,5,6\nax,ay,az,gx,gy,gz\n4,5,6,1,2,3\ngx,gy,gz,ax,ay,az\n1,2,3,4,5,6\n";
    let (found, counts) = read(&LineSettings::default(), text);
    let row = imu(None, [1.0, 2.0, 3.0], [4.0, 5.0, 6.0], None);
    assert_eq!(found, [row, row]);
    assert_eq!((counts.frames, counts.rejected), (4, 1));
}

#[test]
fn header_may_be_a_comment_with_units() {
    let maps = ["t=timestamp,gx=wx,gy=wy,gz=wz,ax=fx,ay=fy,az=fz"];
    let row = imu(Some(DeviceTime::Unix { now_ns: 1_700_000_000_020_000_000 }), [1.0, 2.0, 3.0], [4.0, 5.0, 6.0], None);
    for (header, row_text) in [
        ("#timestamp [ns],wx [rad/s],wy [rad/s],wz [rad/s],fx,fy,fz [m/s^2]", "1700000000020000000,1,2,3,4,5,6"),
        ("% timestamp wx wy wz fx fy fz", "1700000000020000000 1,0 2,0 3 4 5 6"),
        ("// timestamp;wx;wy;wz;fx;fy;fz", "1700000000020000000;1;2;3;4;5;6"),
    ] {
        let (found, counts) = read(&settings_of(&maps, "ns", "rfu"), &format!("{header}\n{row_text}\n"));
        assert_eq!((found, counts.rejected), (vec![row], 0), "{header}");
    }
}

#[test]
fn dates_and_times_of_day_are_device_times() {
    let times = |text: &str| {
        let (found, _) = read(&LineSettings::default(), &format!("t,gx,gy,gz,ax,ay,az\n{text},0,0,0,0,0,9.8\n"));
        found[0].time
    };
    assert_eq!(times("2023-11-14T22:13:20.5Z"), Some(DeviceTime::Unix { now_ns: 1_700_000_000_500_000_000 }));
    let day = DeviceTime::Counter { now_ns: 47_100_020_000_000, period_ns: 86_400_000_000_000 };
    assert_eq!(times("13:05:00.020"), Some(day));
}
