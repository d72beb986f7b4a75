//! Nodes of `hiroz`, a ROS 2 in Rust on Zenoh, as the other end of the bridges.
//!
//! They define the messages by themselves, so that name, hash, encoding, attachment and signs of life are what somebody else made of ROS 2's rules.
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

const DOMAIN: usize = 7;
const GRAVITY_M_S2: f64 = 9.80665;
/// By then what was asked for must have come; the machine may be busy.
const PATIENCE: Duration = Duration::from_secs(60);

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

impl ZMessage for Imu {
    type Serdes = SerdeCdrSerdes<Self>;
}

#[test]
fn hiroz_hears_the_attitude_that_the_system_writes() {
    let (ros, port) = router();
    let node = ros.create_node("listener").build().unwrap();
    let imus = node.create_sub::<Imu>("imu/data").build().unwrap();
    let system = System::start(port, "ingest.sim.scenario = \"tumble\"");
    let mut bridge = system.bridge("ros", port, &["--frame-id", "body"]);

    let heard: Vec<Imu> = (0..200).map(|_| imus.recv_timeout(PATIENCE).unwrap()).collect();
    let publisher = endpoint(&ros, EndpointKind::Publisher, "/imu/data");
    assert_eq!(publisher.node.as_ref().map(|node| node.name.as_str()), Some("plumbline"), "{publisher:?}");
    println!("{:?}", publisher.type_info);
    assert_eq!(publisher.type_info, Some(Imu::type_info()));
    interrupt(&bridge);
    assert!(bridge.wait().unwrap().success());
    until("its sign of life to go", || ros.graph().count(EndpointKind::Publisher, "/imu/data") == 0);
    let rows = system.attitudes();

    // Forward, left, up is right, forward, up turned by 90° about up.
    let quarter = [0.5f64.sqrt(), 0.0, 0.0, 0.5f64.sqrt()];
    let ours: Vec<[f64; 4]> = rows.into_iter().map(|row| product(row, quarter)).collect();
    let of = |imu: &Imu| [imu.orientation.w, imu.orientation.x, imu.orientation.y, imu.orientation.z];
    let first = of(&heard[0]);
    let begins = (0..ours.len()).min_by(|a, b| apart(first, ours[*a]).total_cmp(&apart(first, ours[*b]))).unwrap();
    let furthest = heard.iter().zip(ours[begins..].iter().step_by(10)).map(|(imu, row)| apart(of(imu), *row));
    let furthest = furthest.fold(0.0, f64::max);
    println!("{} messages, at most {furthest} from the file", heard.len());
    assert!(ours.len() >= begins + 10 * heard.len() && furthest < 1e-15, "from row {begins} of {}", ours.len());
    let nanoseconds = |imu: &Imu| i64::from(imu.header.stamp.sec) * 1_000_000_000 + i64::from(imu.header.stamp.nanosec);
    assert!(heard.windows(2).all(|two| nanoseconds(&two[1]) > nanoseconds(&two[0])));
    let step_ns = (nanoseconds(&heard[199]) - nanoseconds(&heard[0])) / 199;
    assert!((9_500_000..10_500_000).contains(&step_ns), "{step_ns} ns from one to the next");
    assert!(heard.iter().all(|imu| imu.header.frame_id == "body" && imu.orientation_covariance[0] > 0.0));
}

#[test]
fn hiroz_gives_the_readings_of_a_system() {
    let (ros, port) = router();
    let node = ros.create_node("imu_driver").build().unwrap();
    let imus = node.create_pub::<Imu>("vehicle/imu").build().unwrap();
    let system = System::start(port, "ingest.source = \"bus\"\ningest.bus.rate_hz = 200");
    let bridge = system.bridge("ros-sensor", port, &["--topic", "vehicle/imu"]);
    until("a subscription", || ros.graph().count(EndpointKind::Subscription, "/vehicle/imu") == 1);
    let subscription = endpoint(&ros, EndpointKind::Subscription, "/vehicle/imu");
    assert_eq!(subscription.type_info, Some(Imu::type_info()));

    // The body leans to its right side by 20° and turns by 10 °/s about the vertical.
    let (lean, rate_rad_s) = (20f64.to_radians(), 10f64.to_radians());
    let along_up = |length: f64| Vector3 { x: 0.0, y: length * lean.sin(), z: length * lean.cos() };
    let ends = AtomicBool::new(false);
    let (taken, sent) = thread::scope(|scope| {
        let sender = scope.spawn(|| {
            let (began, began_at) = (Instant::now(), SystemTime::now().duration_since(UNIX_EPOCH).unwrap());
            let mut sent = 0u32;
            while !ends.load(Ordering::Relaxed) {
                let after = Duration::from_millis(5) * sent;
                thread::sleep(after.saturating_sub(began.elapsed()));
                let at = began_at + after;
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
        until("attitudes", || system.ticks() > 600);
        interrupt(&bridge);
        let output = bridge.wait_with_output().unwrap();
        ends.store(true, Ordering::Relaxed);
        assert!(output.status.success(), "{output:?}");
        (serde_json::from_slice::<Value>(&output.stdout).unwrap(), sender.join().unwrap())
    });
    println!("{sent} sent, {taken}");
    let number = |name: &str| taken[name].as_f64().unwrap();
    assert!(number("rejected") == 0.0 && number("undelivered") == 0.0, "{taken}");
    assert!(number("readings") > 600.0 && number("readings") <= f64::from(sent), "{sent} {taken}");
    let rows = system.attitudes();
    let up = |[w, x, y, z]: [f64; 4]| [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)];
    let wanted = [-lean.sin(), 0.0, lean.cos()];
    let off = |row| up(row).into_iter().zip(wanted).map(|(a, b): (f64, f64)| (a - b).abs()).fold(0.0, f64::max);
    let worst = rows[rows.len() / 2..].iter().map(|row| off(*row)).fold(0.0, f64::max);
    assert!(worst < 0.01, "up is off by {worst}");
}

/// The router of a ROS, and its port.
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

/// A system that runs until its attitudes are asked for.
struct System {
    name: String,
    folder: TempDir,
    process: Option<Child>,
    people: Option<BufReader<ChildStderr>>,
}

impl System {
    fn start(port: u16, settings: &str) -> Self {
        let folder = TempDir::new().unwrap();
        let name = format!("ros-{}-{port}", std::process::id());
        fs::write(folder.path().join("launch.toml"), format!("name = \"{name}\"\n{settings}\n")).unwrap();
        let mut command = Command::new(plumb());
        command.args(["up", "launch.toml", "--json", "--out", "out.csv"]).current_dir(folder.path());
        command.env("XDG_STATE_HOME", folder.path()).stdin(Stdio::null()).stdout(Stdio::null());
        let mut process = command.stderr(Stdio::piped()).spawn().unwrap();
        let people = process.stderr.take().map(BufReader::new);
        let system = Self { name, folder, process: Some(process), people };
        until("the system to answer", || system.is_up());
        system
    }

    fn bridge(&self, kind: &str, port: u16, more: &[&str]) -> Child {
        let to = format!("tcp/127.0.0.1:{port}");
        let domain = DOMAIN.to_string();
        let mut command = Command::new(plumb());
        command.args(["bridge", kind, "--json", "--system", &self.name, "--connect", &to, "--domain", &domain]);
        command.args(more).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
    }

    fn services(&self) -> Vec<Value> {
        let output = Command::new(plumb()).args(["ps", "--json", "--system", &self.name]).output().unwrap();
        serde_json::from_slice(&output.stdout).unwrap_or_default()
    }

    fn is_up(&self) -> bool {
        let services = self.services();
        !services.is_empty() && services.iter().all(|one| one["state"] == "ready" || one["state"] == "running")
    }

    fn ticks(&self) -> u64 {
        let course = self.services().into_iter().find(|one| one["service"] == "course");
        course.and_then(|one| one["ticks"].as_u64()).unwrap_or_default()
    }

    /// Ends it; its attitudes, w x y z, of right, forward, up in east, north, up.
    fn attitudes(mut self) -> Vec<[f64; 4]> {
        let mut process = self.process.take().unwrap();
        interrupt(&process);
        let mut people = String::new();
        self.people.take().unwrap().read_to_string(&mut people).unwrap();
        assert!(process.wait().unwrap().success(), "{people}");
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
            // A test that failed; the supervisor takes its services with it.
            interrupt(&process);
            drop(self.people.take());
            let _ = process.wait();
        }
    }
}

/// The program, which this workspace does not build.
fn plumb() -> PathBuf {
    let program = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target/release/plumb");
    assert!(program.is_file(), "{} is not there: cargo build --release at the top", program.display());
    program
}

fn interrupt(process: &Child) {
    let status = Command::new("kill").args(["-INT", &process.id().to_string()]).status().unwrap();
    assert!(status.success());
}

fn until(what: &str, mut holds: impl FnMut() -> bool) {
    let deadline = Instant::now() + PATIENCE;
    while !holds() {
        assert!(Instant::now() < deadline, "waited in vain for {what}");
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

/// The largest difference of a component, whichever sign stands for the attitude.
fn apart(a: [f64; 4], b: [f64; 4]) -> f64 {
    let off = |sign: f64| a.into_iter().zip(b).map(|(a, b)| (a - sign * b).abs()).fold(0.0, f64::max);
    off(1.0).min(off(-1.0))
}
