//! iceoryx2's own tunnel over Zenoh: a process publishes in one domain, another reads in the other, a tunnel at each.
//!
//! The tunnels do what their options allow to be quick: the near one is woken by the event that goes with each sample, the far one by
//! the network. The far end sleeps on that event, which is carried as well.

use std::{ffi::OsStr, fs, path::Path, thread, time::Duration};

use iceoryx2::prelude::{Config, FileName, Node, NodeBuilder, SemanticString, ServiceName, ipc};
use tempfile::TempDir;

use crate::{
    Cost, Failure, Variant, bare,
    part::{self, End, Part, WAIT_LIMIT},
    process::Process,
    watched,
};

/// As many bytes as an IMU sample has: tick, time, and the rest.
type Sample = [u64; 14];
const SERVICE: &str = "bench";
const BUFFER: usize = 1024;
const SHARED_MEMORY: &str = "/dev/shm";
/// Until both tunnels have found what there is to carry.
const SETTLING: Duration = Duration::from_secs(3);

/// The folder of both hosts. What processes that were ended have left outside of it goes with it.
struct Folder(TempDir);

impl Drop for Folder {
    fn drop(&mut self) {
        let made_here = prefix(&self.0.path().to_string_lossy());
        for file in fs::read_dir(SHARED_MEMORY).into_iter().flatten().flatten() {
            if file.file_name().to_string_lossy().starts_with(&made_here) {
                // What cannot be removed is in the way of nobody.
                let _ = fs::remove_file(file.path());
            }
        }
    }
}

/// Measures the variant.
pub(crate) fn run(program: Option<&Path>, rate_hz: u32, seconds: f64) -> Result<Cost, Failure> {
    let program = program.ok_or("--tunnel says where the tunnel's executable is")?;
    let program = program.to_str().ok_or("the path of the tunnel is not text")?;
    let folder = Folder(tempfile::tempdir_in(SHARED_MEMORY)?);
    let endpoint = format!("tcp/127.0.0.1:{}", bare::free_port()?);
    let part = |end, at: &str| Part::new(Variant::Tunnel, end, at, rate_hz, seconds);
    let hosts = ["near", "far"].map(|host| folder.0.path().join(host));
    let mut tunnels = Vec::new();
    for (host, end, other, wake) in [
        (&hosts[0], "listen", "connect", ["--listener", SERVICE].as_slice()),
        (&hosts[1], "connect", "listen", &["--reactive"]),
    ] {
        fs::create_dir_all(host.join("config"))?;
        let name = host.to_str().ok_or("the path of a folder is not text")?;
        let prefix = prefix(name);
        fs::write(
            host.join("config/iceoryx2.toml"),
            format!("[global]\nroot-path = \"{name}/\"\nprefix = \"{prefix}\"\n"),
        )?;
        let zenoh = host.join("zenoh.json5");
        let scouting = "scouting: { multicast: { enabled: false }, gossip: { enabled: false } }";
        fs::write(
            &zenoh,
            format!(
                "{{ mode: \"peer\", {end}: {{ endpoints: [\"{endpoint}\"] }}, {other}: {{ endpoints: [] }}, {scouting} }}"
            ),
        )?;
        let zenoh = zenoh.to_str().ok_or("the path of a file is not text")?;
        // Without polling it does not find what there is to carry.
        let arguments = ["-C", name, program, "--zenoh-config", zenoh, "--allow", SERVICE, "--poll", "100"];
        tunnels.push((arguments.map(str::to_owned), wake));
    }
    let [near, far] = hosts.each_ref().map(|host| host.to_str().unwrap_or_default());
    let mut near = watched::start(&part(End::Near, near))?;
    let mut far = watched::start(&part(End::Far, far))?;
    let mut between = Vec::new();
    for (arguments, wake) in &tunnels {
        let arguments = arguments.iter().map(String::as_str).chain(wake.iter().copied());
        between.push(Process::start(OsStr::new("env"), arguments)?);
        thread::sleep(SETTLING / 2);
    }
    watched::watch(&part(End::Far, ""), &mut near, &between, &mut far)
}

/// One process of the variant.
pub(crate) fn be(part: &Part) -> Result<(), Failure> {
    let node = node(&part.at)?;
    let name = ServiceName::new(SERVICE)?;
    let event = node.service_builder(&name).event().open_or_create()?;
    let samples = node
        .service_builder(&name)
        .publish_subscribe::<Sample>()
        .enable_safe_overflow(true)
        .subscriber_max_buffer_size(BUFFER)
        .open_or_create()?;
    match part.end {
        End::Near => {
            let (publisher, notifier) = (samples.publisher_builder().create()?, event.notifier_builder().create()?);
            part::send(part, |tick, now_ns| {
                let mut sample = [0x5a; 14];
                (sample[0], sample[1]) = (tick, now_ns);
                publisher.send_copy(sample)?;
                notifier.notify()?;
                Ok(())
            })
        }
        End::Far => {
            let (subscriber, listener) =
                (samples.subscriber_builder().buffer_size(BUFFER).create()?, event.listener_builder().create()?);
            part::receive(part, |take| {
                listener.timed_wait(|_| {}, WAIT_LIMIT)?;
                while let Some(sample) = subscriber.receive()? {
                    take(sample[0], sample[1]);
                }
                Ok(())
            })
        }
    }
}

fn node(root: &str) -> Result<Node<ipc::Service>, Failure> {
    let mut config = Config::default();
    config.global.prefix = FileName::new(prefix(root).as_bytes())?;
    config.global.set_root_path(&iceoryx2::prelude::Path::new(root.as_bytes())?);
    Ok(NodeBuilder::new().config(&config).create::<ipc::Service>()?)
}

/// No two hosts have the same.
fn prefix(root: &str) -> String {
    root.replace(['/', '.'], "_")
}
