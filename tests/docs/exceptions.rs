//! Examples in the documentation that are not run, each with the reason.
//!
//! Add a line here if an example needs a device, another machine or several minutes. A test fails
//! if a line here no longer matches any example.

/// Beginnings of shell lines that the test does not run, with the reason.
pub(super) const NOT_RUN: &[(&str, &str)] = &[
    // Builds and installation.
    ("cargo ", "builds or tests this tree, which takes minutes"),
    (".ci/api", "changes the tree; tested by `.ci/run docs`"),
    (".ci/processors", "builds this tree for other processors; run by .ci/run"),
    ("examples/cortex-m/table", "builds a program for each stage, which takes minutes"),
    ("chrt --fifo 20 cargo ", "builds this tree, which takes minutes"),
    ("rustup ", "changes the toolchain"),
    ("python3 -m venv", "downloads packages"),
    (".venv/bin/", "needs packages and recordings; tested by `pipeline::accuracy`"),
    ("git clone", "downloads files"),
    ("plumb score trials/", "needs converted recordings; tested by `pipeline::accuracy`"),
    ("export CARGO_TARGET_", "configures a cross compiler"),
    ("sudo apt ", "installs packages"),
    ("sudo install ", "changes the machine; tested by deploy/trial"),
    ("sudo systemd-sysusers", "changes the machine; tested by deploy/trial"),
    ("sudo udevadm ", "changes the machine; deploy/check tests the rules"),
    ("sudo systemctl ", "changes the machine; tested by deploy/trial"),
    ("sudo -u plumbline ", "needs the user of an installation; tested by deploy/trial"),
    ("systemctl ", "needs systemd; tested by deploy/trial"),
    ("deploy/package", "builds and installs packages; tested by `.ci/run package`"),
    ("diff --recursive target/packages", "needs packages; tested by `.ci/run package`"),
    ("sudo tar ", "changes the machine"),
    ("scp ", "needs another machine"),
    ("ssh -L ", "needs another machine"),
    ("sudo adduser ", "changes the machine"),
    ("sudo reboot", "restarts the machine"),
    ("ls -l /dev/serial", "needs a device"),
    ("export PATH=", "sets the path of the built program"),
    // Other hosts.
    ("plumb station --connect quic/192.168.1.5", "needs a router; tested by `certificates`"),
    ("plumb topic hz attitude --remote alpha", "needs a router and a vehicle; tested by `certificates`"),
    ("plumb swap fuser vqf --remote alpha", "needs a router and a vehicle; tested by `certificates`"),
    ("plumb swap --remote alpha fuser vqf", "needs a vehicle and an operator's keys; tested by `certificates`"),
    ("plumb bridge ros", "needs a ROS 2 router; tested by `bridge`"),
    // Browsers and monitoring.
    ("plumb view", "serves a page until it is interrupted; tested by `cockpit`"),
    ("curl ", "needs a running cockpit; tested by `cockpit`"),
    // Devices.
    ("plumb up --detach", "leaves a system running; tested by `detached`"),
    ("plumb logs", "needs a system in the background; tested by `detached`"),
    ("plumb down", "ends a running system; tested by `detached`"),
    ("plumb detect", "needs a device; tested by `detect`"),
    ("plumb up --source '/dev/ttyUSB0", "needs a device; tested by `detect`"),
    ("plumb up --source 'serial:", "needs a device; tested by `drivers`"),
    ("plumb up --source 'mavlink:", "needs an autopilot; tested by `sources`"),
    ("plumb up --source 'iio:", "needs devices; tested by `sources`"),
    ("plumb up --launch mine.toml --source 'serial:", "needs a device; tested by `serial_tutorial`"),
    ("python3 examples/serial_imu.py", "simulates a device; tested by `serial_tutorial`"),
    ("plumb score flights/*.mcap --reference", "needs the reference of a flight; tested by `serial_tutorial`"),
    ("python3 my_imu.py |", "needs the reader's program; tested by `sources`"),
    // Files and samples that the reader supplies.
    ("plumb up --replay flights/NAME", "needs the name of a flight; tested by `reliability`"),
    ("plumb calibrate accel", "needs a recording of six positions; tested by `cli`"),
    ("plumb calibrate mag", "needs a rotated magnetometer; tested by `cli`"),
    ("plumb calibrate mounting", "needs a recording of two poses; tested by `cli`"),
    ("plumb calibrate clock", "needs a rotated magnetometer; tested by `cli`"),
    ("plumb calibrate gyro --live", "needs a sensor at rest; tested by `cli`"),
    ("plumb score flight.bin", "needs an ArduPilot log; tested by tools/import"),
    ("plumb info flight.bin", "needs an ArduPilot log; tested by tools/import"),
    ("plumb import flight.bin", "needs an ArduPilot log; tested by tools/import"),
    ("plumb score flight.tlog", "needs the log of a ground station; tested by tools/import"),
    ("plumb score walk.mcap", "needs an MCAP file; tested by tools/import"),
    ("plumb score bag/", "needs a ROS 2 bag; tested by tools/import"),
    ("plumb import bag/", "needs a ROS 2 bag; tested by tools/import"),
    ("plumb up --launch my-fuser/launch.toml", "runs until it is interrupted; tested by `own_stage`"),
    ("plumb swap fuser my-fuser", "needs a system with the stage; tested by `own_stage`"),
    ("plumb stage test my-fuser", "tests a Python stage for minutes; tested by `own_stage`"),
];

/// Beginnings of the first lines of blocks that are not examples, each with the kind of its
/// content.
///
/// Fence a new drawing or output as `text` instead of adding it to this list.
pub(super) const NOT_EXAMPLES: &[(&str, &str)] = &[
    ("[dependencies]", "manifest of another project"),
    ("from plumbline_ahrs import", "needs the package; tested by tools/ahrs-python/tests"),
    ("use plumbline_ahrs::", "Rust; a shorter form of the example of the crate's documentation"),
    ("launch.toml        everything that runs", "file tree"),
    ("sensor, receiver ─►", "drawing"),
    ("topics ─► gateway", "drawing"),
    ("RMSE, degrees", "output"),
    ("gyro: 1 rest", "output"),
    ("fn ", "Rust; compared with benches/kernels/libraries.rs by `code_of_libraries_is_that_of_benchmark`"),
    ("let mut sensor", "part of examples/driver.rs, which is built with the tests"),
    ("scrape_configs:", "configuration of Prometheus; tested by `cockpit`"),
    ("request_id:", "fields of a message; tested by tests/foreign/client.py"),
];

/// Folders in which no Markdown file has examples, each with the reason.
pub(super) const FOLDERS_WITHOUT_EXAMPLES: &[(&str, &str)] =
    &[("crates/sdk/templates/", "contains placeholders; tested by `own_stage`")];

/// Beginnings of commands that run until they are interrupted, unless `--for` limits them.
pub(super) const UNLIMITED: &[&str] =
    &["plumb station", "plumb shadow", "plumb top", "plumb topic echo", "plumb topic hz", "plumb topic bw"];

/// Beginnings of commands that need a running system. If none runs, one is started.
pub(super) const NEEDS_SYSTEM: &[&str] = &["plumb swap", "plumb shadow", "plumb ps", "plumb top", "plumb station"];

/// Beginnings of commands that may fail, because they check the machine.
pub(super) const MAY_FAIL: &[&str] = &["plumb doctor"];

/// Name of a PX4 log in examples. It is copied from the test data, if present.
pub(super) const LOG: &str = "flight.ulg";
/// Flight that an example creates from [`LOG`].
pub(super) const FLIGHT_FROM_LOG: &str = "flights/*.mcap";
