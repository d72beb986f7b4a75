//! Bridges to ROS 2, tested against nodes of `hiroz`, a ROS 2 implementation in Rust on Zenoh.
//!
//! The nodes define the messages themselves, so that names, hashes, encoding, attachments and
//! liveliness tokens come from an independent implementation.
#[path = "../../common/walk.rs"]
mod walk;

use std::{
    fs,
    io::{BufRead as _, BufReader, Read as _},
    net::TcpListener,
    path::{Path, PathBuf},
    process::{Child, ChildStderr, Command, Stdio},
    sync::atomic::{AtomicBool, Ordering},
    thread,
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

use hiroz::{
    Builder as _, MessageTypeInfo,
    context::{ZContext, ZContextBuilder},
    entity::{EndpointEntity, EndpointKind},
    msg::{SerdeCdrSerdes, ZMessage},
};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use tempfile::TempDir;
use walk::Walk;

const DOMAIN: usize = 7;
const GRAVITY_M_S2: f64 = 9.80665;
/// Timeout for messages and states. It allows for a busy machine.
const TIMEOUT: Duration = Duration::from_secs(60);

#[derive(Debug, Clone, Default, Serialize, Deserialize, MessageTypeInfo)]
#[ros_msg(type_name = "builtin_interfaces/msg/Time")]
struct Time {
    sec: i32,
    nanosec: u32,
}

#[derive(Debug, Clone, Default, Serialize, Deserialize, MessageTypeInfo)]
#[ros_msg(type_name = "std_msgs/msg/Header")]
struct Header {
    stamp: Time,
    frame_id: String,
}

#[derive(Debug, Clone, Default, Serialize, Deserialize, MessageTypeInfo)]
#[ros_msg(type_name = "geometry_msgs/msg/Quaternion")]
struct Quaternion {
    x: f64,
    y: f64,
    z: f64,
    w: f64,
}

#[derive(Debug, Clone, Default, Serialize, Deserialize, MessageTypeInfo)]
#[ros_msg(type_name = "geometry_msgs/msg/Vector3")]
struct Vector3 {
    x: f64,
    y: f64,
    z: f64,
}

#[derive(Debug, Clone, Default, Serialize, Deserialize, MessageTypeInfo)]
#[ros_msg(type_name = "sensor_msgs/msg/Imu")]
struct Imu {
    header: Header,
    orientation: Quaternion,
    orientation_covariance: [f64; 9],
    angular_velocity: Vector3,
    angular_velocity_covariance: [f64; 9],
    linear_acceleration: Vector3,
    linear_acceleration_covariance: [f64; 9],
}

#[derive(Debug, Clone, Default, Serialize, Deserialize, MessageTypeInfo)]
#[ros_msg(type_name = "sensor_msgs/msg/MagneticField")]
struct MagneticField {
    header: Header,
    magnetic_field: Vector3,
    magnetic_field_covariance: [f64; 9],
}

#[derive(Debug, Clone, Default, Serialize, Deserialize, MessageTypeInfo)]
#[ros_msg(type_name = "geometry_msgs/msg/Transform")]
struct Transform {
    translation: Vector3,
    rotation: Quaternion,
}

#[derive(Debug, Clone, Default, Serialize, Deserialize, MessageTypeInfo)]
#[ros_msg(type_name = "geometry_msgs/msg/TransformStamped")]
struct TransformStamped {
    header: Header,
    child_frame_id: String,
    transform: Transform,
}

#[derive(Debug, Clone, Default, Serialize, Deserialize, MessageTypeInfo)]
#[ros_msg(type_name = "tf2_msgs/msg/TFMessage")]
struct TfMessage {
    transforms: Vec<TransformStamped>,
}

impl ZMessage for Imu {
    type Serdes = SerdeCdrSerdes<Self>;
}

impl ZMessage for MagneticField {
    type Serdes = SerdeCdrSerdes<Self>;
}

impl ZMessage for TfMessage {
    type Serdes = SerdeCdrSerdes<Self>;
}

#[test]
fn hiroz_node_receives_attitudes_of_output_file() {
    let mut walk = Walk::start("integrator, attitudes in a ROS 2 node");
    let (ros, port) = router();
    let node = ros.create_node("listener").build().unwrap();
    let imus = node.create_sub::<Imu>("imu/data").build().unwrap();
    let transforms = node.create_sub::<TfMessage>("tf").build().unwrap();
    let fields = node.create_sub::<MagneticField>("imu/mag").build().unwrap();
    let system = System::start(port, "ingest.sim.scenario = \"s3\"");
    walk.step("start a system");
    let mut bridge = system.bridge("ros", port, &["--frame-id", "body"]);

    let received: Vec<Imu> = (0..200).map(|_| imus.recv_timeout(TIMEOUT).unwrap()).collect();
    let transform = transforms.recv_timeout(TIMEOUT).unwrap();
    let field = fields.recv_timeout(TIMEOUT).unwrap();
    walk.step("start the bridge, receive 200 messages, a transform and a field");
    let type_info = |topic| endpoint(&ros, EndpointKind::Publisher, topic).type_info;
    assert_eq!(type_info("/tf"), Some(TfMessage::type_info()));
    assert_eq!(type_info("/imu/mag"), Some(MagneticField::type_info()));
    assert_eq!(ros.graph().count(EndpointKind::Publisher, "/diagnostics"), 1);
    let publisher = endpoint(&ros, EndpointKind::Publisher, "/imu/data");
    assert_eq!(publisher.node.as_ref().map(|node| node.name.as_str()), Some("plumbline"), "{publisher:?}");
    println!("{:?}", publisher.type_info);
    assert_eq!(publisher.type_info, Some(Imu::type_info()));
    interrupt(&bridge);
    assert!(bridge.wait().unwrap().success());
    wait_for("its liveliness token to disappear", || ros.graph().count(EndpointKind::Publisher, "/imu/data") == 0);
    let rows = system.attitudes();

    // ROS uses the body frame forward, left, up, which is Plumbline's body frame rotated by 90°
    // about the up axis.
    let quarter = [0.5f64.sqrt(), 0.0, 0.0, 0.5f64.sqrt()];
    let expected: Vec<[f64; 4]> = rows.into_iter().map(|row| product(row, quarter)).collect();
    let of = |imu: &Imu| [imu.orientation.w, imu.orientation.x, imu.orientation.y, imu.orientation.z];
    let first = of(&received[0]);
    let start_row = (0..expected.len())
        .min_by(|a, b| max_difference(first, expected[*a]).total_cmp(&max_difference(first, expected[*b])))
        .unwrap();
    let largest_difference =
        received.iter().zip(expected[start_row..].iter().step_by(10)).map(|(imu, row)| max_difference(of(imu), *row));
    let largest_difference = largest_difference.fold(0.0, f64::max);
    println!("{} messages, at most {largest_difference} from the file", received.len());
    assert!(
        expected.len() >= start_row + 10 * received.len() && largest_difference < 1e-15,
        "from row {start_row} of {}",
        expected.len()
    );
    let nanoseconds = |imu: &Imu| i64::from(imu.header.stamp.sec) * 1_000_000_000 + i64::from(imu.header.stamp.nanosec);
    assert!(received.windows(2).all(|two| nanoseconds(&two[1]) > nanoseconds(&two[0])));
    let step_ns = (nanoseconds(&received[199]) - nanoseconds(&received[0])) / 199;
    assert!((9_500_000..10_500_000).contains(&step_ns), "{step_ns} ns between messages");
    assert!(received.iter().all(|imu| imu.header.frame_id == "body" && imu.orientation_covariance[0] > 0.0));

    let [transform] = transform.transforms.as_slice() else { panic!("{transform:?}") };
    assert_eq!((transform.header.frame_id.as_str(), transform.child_frame_id.as_str()), ("map", "body"));
    let Quaternion { x, y, z, w } = transform.transform.rotation;
    let nearest = received.iter().map(|imu| max_difference(of(imu), [w, x, y, z])).fold(f64::INFINITY, f64::min);
    assert!(nearest < 1e-15, "no Imu has the orientation of {transform:?}");
    let Vector3 { x, y, z } = field.magnetic_field;
    let field_t = (x * x + y * y + z * z).sqrt();
    assert!(field.header.frame_id == "body" && (20e-6..70e-6).contains(&field_t), "{field:?}");
}

#[test]
fn hiroz_node_feeds_readings_to_system() {
    let mut walk = Walk::start("integrator, readings of a ROS 2 node");
    let (ros, port) = router();
    let node = ros.create_node("imu_driver").build().unwrap();
    let imus = node.create_pub::<Imu>("vehicle/imu").build().unwrap();
    let system = System::start(port, "ingest.source = \"bus\"\ningest.bus.rate_hz = 200");
    let bridge = system.bridge("ros-sensor", port, &["--topic", "vehicle/imu"]);
    wait_for("a subscription", || ros.graph().count(EndpointKind::Subscription, "/vehicle/imu") == 1);
    let subscription = endpoint(&ros, EndpointKind::Subscription, "/vehicle/imu");
    assert_eq!(subscription.type_info, Some(Imu::type_info()));
    walk.step("start a system and the bridge");

    // The body leans to the right by 20° and rotates at 10 °/s about the vertical.
    let (lean, rate_rad_s) = (20f64.to_radians(), 10f64.to_radians());
    let along_up = |length: f64| Vector3 { x: 0.0, y: length * lean.sin(), z: length * lean.cos() };
    let stop = AtomicBool::new(false);
    let (report, sent) = thread::scope(|scope| {
        let publisher = scope.spawn(|| {
            let (started, start_time) = (Instant::now(), SystemTime::now().duration_since(UNIX_EPOCH).unwrap());
            let mut sent = 0u32;
            while !stop.load(Ordering::Relaxed) {
                let after = Duration::from_millis(5) * sent;
                thread::sleep(after.saturating_sub(started.elapsed()));
                let at = start_time + after;
                let stamp = Time { sec: at.as_secs() as i32, nanosec: at.subsec_nanos() };
                let message = Imu {
                    header: Header { stamp, frame_id: "body".into() },
                    orientation: Quaternion { w: 1.0, ..Quaternion::default() },
                    angular_velocity: along_up(rate_rad_s),
                    linear_acceleration: along_up(GRAVITY_M_S2),
                    ..Imu::default()
                };
                imus.publish(&message).unwrap();
                sent += 1;
            }
            sent
        });
        wait_for("attitudes", || system.ticks() > 600);
        walk.step("receive 600 readings");
        interrupt(&bridge);
        let output = bridge.wait_with_output().unwrap();
        stop.store(true, Ordering::Relaxed);
        assert!(output.status.success(), "{output:?}");
        (serde_json::from_slice::<Value>(&output.stdout).unwrap(), publisher.join().unwrap())
    });
    println!("{sent} sent, {report}");
    let number = |name: &str| report[name].as_f64().unwrap();
    assert!(number("rejected") == 0.0 && number("undelivered") == 0.0, "{report}");
    assert!(number("readings") > 600.0 && number("readings") <= f64::from(sent), "{sent} {report}");
    let rows = system.attitudes();
    let up = |[w, x, y, z]: [f64; 4]| [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)];
    let expected_up = [-lean.sin(), 0.0, lean.cos()];
    let up_error =
        |row| up(row).into_iter().zip(expected_up).map(|(a, b): (f64, f64)| (a - b).abs()).fold(0.0, f64::max);
    let worst = rows[rows.len() / 2..].iter().map(|row| up_error(*row)).fold(0.0, f64::max);
    assert!(worst < 0.01, "error of the up vector: {worst}");
}

/// Starts a ROS 2 router. Returns its context and its port.
fn router() -> (ZContext, u16) {
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let ros = ZContextBuilder::default()
        .with_domain_id(DOMAIN)
        .with_mode("router")
        .with_listen_endpoints([format!("tcp/127.0.0.1:{port}")])
        .with_connect_endpoints([] as [String; 0])
        .disable_multicast_scouting()
        .build()
        .unwrap();
    (ros, port)
}

fn endpoint(ros: &ZContext, kind: EndpointKind, topic: &str) -> EndpointEntity {
    let entities = ros.graph().get_entities_by_topic(kind, topic);
    let [entity] = entities.as_slice() else { panic!("{entities:?}") };
    let hiroz::entity::Entity::Endpoint(endpoint) = &**entity else { panic!("{entity:?}") };
    endpoint.clone()
}

/// Running system, which is interrupted on drop.
struct System {
    name: String,
    folder: TempDir,
    process: Option<Child>,
    stderr: Option<BufReader<ChildStderr>>,
}

impl System {
    fn start(port: u16, settings: &str) -> Self {
        let folder = TempDir::new().unwrap();
        let name = format!("ros-{}-{port}", std::process::id());
        let services = r#"services = ["ingest", "gyro", "accel", "fuser", "course"]"#;
        let launch = format!("name = \"{name}\"\n{services}\n{settings}\n");
        fs::write(folder.path().join("launch.toml"), launch).unwrap();
        let mut command = Command::new(plumb());
        command.args(["up", "--launch", "launch.toml", "--json", "--out", "out.csv"]).current_dir(folder.path());
        command.env("XDG_STATE_HOME", folder.path()).stdin(Stdio::null()).stdout(Stdio::null());
        let mut process = command.stderr(Stdio::piped()).spawn().unwrap();
        let stderr = process.stderr.take().map(BufReader::new);
        let system = Self { name, folder, process: Some(process), stderr };
        wait_for("the system to respond", || system.is_up());
        system
    }

    fn bridge(&self, kind: &str, port: u16, more: &[&str]) -> Child {
        let to = format!("tcp/127.0.0.1:{port}");
        let domain = DOMAIN.to_string();
        let mut command = Command::new(plumb());
        command.args(["bridge", kind, "--json", "--system", &self.name, "--connect", &to, "--domain", &domain]);
        command.args(more).stdin(Stdio::null()).stdout(Stdio::piped()).spawn().unwrap()
    }

    fn services(&self) -> Vec<Value> {
        let output = Command::new(plumb()).args(["ps", "--json", "--system", &self.name]).output().unwrap();
        let status: Value = serde_json::from_slice(&output.stdout).unwrap_or_default();
        status["services"].as_array().cloned().unwrap_or_default()
    }

    fn is_up(&self) -> bool {
        let services = self.services();
        !services.is_empty() && services.iter().all(|one| one["state"] == "ready" || one["state"] == "running")
    }

    fn ticks(&self) -> u64 {
        let course = self.services().into_iter().find(|one| one["service"] == "course");
        course.and_then(|one| one["ticks"].as_u64()).unwrap_or_default()
    }

    /// Stops the system and returns its attitudes as w, x, y, z (right-forward-up, east-north-up).
    fn attitudes(mut self) -> Vec<[f64; 4]> {
        let mut process = self.process.take().unwrap();
        interrupt(&process);
        let mut stderr = String::new();
        self.stderr.take().unwrap().read_to_string(&mut stderr).unwrap();
        assert!(process.wait().unwrap().success(), "{stderr}");
        let file = fs::File::open(self.folder.path().join("out.csv")).unwrap();
        let rows = BufReader::new(file).lines().skip(1).map(|line| {
            let line = line.unwrap();
            let numbers: Vec<f64> = line.split(',').map(|number| number.parse().unwrap()).collect();
            [numbers[1], numbers[2], numbers[3], numbers[4]]
        });
        rows.collect()
    }
}

impl Drop for System {
    fn drop(&mut self) {
        if let Some(mut process) = self.process.take() {
            // The test has failed. Interrupting the supervisor also stops the services.
            interrupt(&process);
            drop(self.stderr.take());
            let _ = process.wait();
        }
    }
}

/// Returns the path of `plumb`, which must have been built in the main workspace.
fn plumb() -> PathBuf {
    let program = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target/release/plumb");
    assert!(program.is_file(), "{} does not exist; run cargo build --release in the main workspace", program.display());
    program
}

fn interrupt(process: &Child) {
    let status = Command::new("kill").args(["-INT", &process.id().to_string()]).status().unwrap();
    assert!(status.success());
}

fn wait_for(what: &str, mut holds: impl FnMut() -> bool) {
    let deadline = Instant::now() + TIMEOUT;
    while !holds() {
        assert!(Instant::now() < deadline, "timed out waiting for {what}");
        thread::sleep(Duration::from_millis(20));
    }
}

fn product([a, b, c, d]: [f64; 4], [w, x, y, z]: [f64; 4]) -> [f64; 4] {
    [
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    ]
}

/// Returns the largest component difference. Takes into account that q and −q are the same
/// attitude.
fn max_difference(a: [f64; 4], b: [f64; 4]) -> f64 {
    let difference = |sign: f64| a.into_iter().zip(b).map(|(a, b)| (a - sign * b).abs()).fold(0.0, f64::max);
    difference(1.0).min(difference(-1.0))
}
