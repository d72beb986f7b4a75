//! Formats of files and folders, and commands that convert unsupported ones.

use std::fmt;

/// Format of a file or folder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Format {
    /// Plumbline recording, plain or compressed.
    Recording,
    /// Other CSV text, plain or compressed.
    Csv,
    /// PX4 log.
    Ulog,
    /// MCAP file: a recorded Plumbline flight or a ROS 2 log.
    Mcap,
    /// ROS 2 bag folder.
    Bag,
    /// ArduPilot DataFlash log.
    ArduPilot,
    /// SQLite database, as used by ROS 2 bags.
    Sqlite,
    /// Ground station telemetry log: MAVLink messages with their arrival times.
    Tlog,
    /// ROS 2 bag folder without `metadata.yaml`.
    BagWithoutMetadata,
    /// ROS 1 bag.
    Ros1Bag,
    /// Betaflight, INAV or Cleanflight log.
    Blackbox,
    /// Text form of an ArduPilot log.
    ArduPilotText,
    /// Xsens sensor output.
    Xsens,
    /// WitMotion sensor output.
    WitMotion,
    /// UBX or NMEA output of a satellite receiver.
    Receiver,
    /// Text in UTF-16, little-endian.
    Utf16Le,
    /// Text in UTF-16, big-endian.
    Utf16Be,
    /// Text in UTF-32 with a byte order mark.
    Utf32,
    /// Excel or LibreOffice spreadsheet.
    Spreadsheet,
    /// Apache Parquet.
    Parquet,
    /// HDF5, including `.mat` files of MATLAB 7.3.
    Hdf5,
    /// MATLAB 5 to 7.2 data file.
    Matlab,
    /// NumPy array.
    Numpy,
    /// JSON, either one document or one object per line.
    Json,
    /// Zip archive.
    Zip,
    /// Tar archive.
    Tar,
    /// 7z archive.
    SevenZip,
    /// RAR archive.
    Rar,
    /// gzip file that does not contain text.
    Gzip,
    /// zstd file that does not contain text.
    Zstd,
    /// xz file.
    Xz,
    /// bzip2 file.
    Bzip2,
    /// LZ4 file.
    Lz4,
}

/// Name of each format and, for an unsupported one, the command that converts it.
const TABLE: [(Format, &str, Option<&str>); 33] = [
    (Format::Recording, "Plumbline recording", None),
    (Format::Csv, "CSV", None),
    (Format::Ulog, "ULog", None),
    (Format::Mcap, "MCAP", None),
    (Format::Bag, "ROS 2 bag", None),
    (Format::ArduPilot, "ArduPilot log (BIN)", None),
    (Format::Sqlite, "SQLite database (ROS 2 db3)", None),
    (Format::Tlog, "MAVLink telemetry log (tlog)", None),
    (
        Format::BagWithoutMetadata,
        "ROS 2 bag without metadata.yaml",
        Some("restore it with `ros2 bag reindex FOLDER`, or name the .mcap or .db3 file in it"),
    ),
    (
        Format::Ros1Bag,
        "ROS 1 bag",
        Some("convert it with `rosbags-convert --src FILE --dst FOLDER` (pip install rosbags)"),
    ),
    (
        Format::Blackbox,
        "Betaflight blackbox log",
        Some("convert it with `blackbox_decode FILE`, then map the columns of the CSV with --map"),
    ),
    (
        Format::ArduPilotText,
        "text form of an ArduPilot log",
        Some(
            "use the .BIN that it was made from, or convert it with `mavlogdump.py --format csv --types IMU FILE > FILE.csv` (pip install pymavlink) and read that with `--map t=timestamp,gx=GyrX,gy=GyrY,gz=GyrZ,ax=AccX,ay=AccY,az=AccZ --frame frd`",
        ),
    ),
    (
        Format::Xsens,
        "bytes of an Xsens sensor",
        Some("read it with `plumb up --source 'stdin?format=xsens&rate_hz=100' < FILE`, with its rate"),
    ),
    (
        Format::WitMotion,
        "bytes of a WitMotion sensor",
        Some("read it with `plumb up --source 'stdin?format=witmotion&rate_hz=100' < FILE`, with its rate"),
    ),
    (
        Format::Receiver,
        "UBX or NMEA of a satellite receiver",
        Some("it has no rate and force; record receiver and sensor together with `plumb record -o flight.mcap`"),
    ),
    (Format::Utf16Le, "text in UTF-16", Some("convert it with `iconv -f UTF-16LE -t UTF-8 FILE -o FILE.csv`")),
    (Format::Utf16Be, "text in UTF-16", Some("convert it with `iconv -f UTF-16BE -t UTF-8 FILE -o FILE.csv`")),
    (Format::Utf32, "text in UTF-32", Some("convert it with `iconv -f UTF-32 -t UTF-8 FILE -o FILE.csv`")),
    (
        Format::Spreadsheet,
        "spreadsheet",
        Some(
            "convert it with `python3 -c \"import pandas, sys; pandas.read_excel(sys.argv[1]).to_csv(sys.argv[2], index=False)\" FILE FILE.csv`, or save it as \"CSV UTF-8\"",
        ),
    ),
    (
        Format::Parquet,
        "Parquet file",
        Some(
            "convert it with `python3 -c \"import pandas, sys; pandas.read_parquet(sys.argv[1]).to_csv(sys.argv[2], index=False)\" FILE FILE.csv`",
        ),
    ),
    (
        Format::Hdf5,
        "HDF5 file",
        Some(
            "convert a table of it with `python3 -c \"import pandas, sys; pandas.read_hdf(sys.argv[1]).to_csv(sys.argv[2], index=False)\" FILE FILE.csv`",
        ),
    ),
    (
        Format::Matlab,
        "MATLAB file",
        Some("write its matrix as CSV with `writematrix` in MATLAB or `csvwrite` in Octave"),
    ),
    (
        Format::Numpy,
        "NumPy array",
        Some(
            "convert it with `python3 -c \"import numpy, sys; numpy.savetxt(sys.argv[2], numpy.load(sys.argv[1]), delimiter=',')\" FILE FILE.csv`",
        ),
    ),
    (
        Format::Json,
        "JSON",
        Some(
            "convert it with `python3 -c \"import pandas, sys; pandas.read_json(sys.argv[1]).to_csv(sys.argv[2], index=False)\" FILE FILE.csv`, with `lines=True` for one object per line",
        ),
    ),
    (Format::Zip, "zip archive", Some("unpack it with `unzip FILE` and name the file in it")),
    (Format::Tar, "tar archive", Some("unpack it with `tar xf FILE` and name the file in it")),
    (Format::SevenZip, "7z archive", Some("unpack it with `7z x FILE` and name the file in it")),
    (Format::Rar, "RAR archive", Some("unpack it with `unrar x FILE` and name the file in it")),
    (Format::Gzip, "gzip file without text", Some("unpack it with `gunzip FILE` and name the file in it")),
    (Format::Zstd, "zstd file without text", Some("unpack it with `zstd -d FILE` and name the file in it")),
    (Format::Xz, "xz file", Some("unpack it with `unxz FILE` and name the file in it")),
    (Format::Bzip2, "bzip2 file", Some("unpack it with `bunzip2 FILE` and name the file in it")),
    (Format::Lz4, "LZ4 file", Some("unpack it with `unlz4 -m FILE` and name the file in it")),
];

impl Format {
    /// Returns `true` if the format has topics that can be selected.
    pub fn has_topics(self) -> bool {
        matches!(self, Self::Mcap | Self::Bag | Self::Sqlite)
    }

    /// Returns `true` for text with columns.
    pub fn is_text(self) -> bool {
        matches!(self, Self::Recording | Self::Csv)
    }

    /// Returns the remedy for a format that is not supported; `None` for a supported format.
    pub fn remedy(self) -> Option<&'static str> {
        TABLE.iter().find(|(format, ..)| *format == self).and_then(|(_, _, remedy)| *remedy)
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(TABLE.iter().find(|(format, ..)| format == self).map_or("file", |(_, name, _)| name))
    }
}
