//! Variant `tunnel`, iceoryx2's own tunnel over Zenoh: one process publishes in one domain and
//! another process reads in a second domain, with a tunnel at each end.
//!
//! The tunnels run with their low-latency options. The near tunnel is woken by the event that
//! accompanies each sample, and the far tunnel is woken by the network. The far end waits for the
//! forwarded event.

use std::{ffi::OsStr, fs, path::Path, thread, time::Duration};

use iceoryx2::prelude::{Config, FileName, Node, NodeBuilder, SemanticString, ServiceName, ipc};
use tempfile::TempDir;

use crate::{
    Cost, Failure, Variant, bare, hop,
    hop_end::{self, End, MAX_WAIT, ProcessSettings},
    process::Process,
};

/// Sample with the size of an IMU sample. The first two words contain the tick and the time.
type Sample = [u64; 14];
const SERVICE: &str = "bench";
const BUFFER_SAMPLES: usize = 1024;
const SHARED_MEMORY: &str = "/dev/shm";
/// Time allowed for both tunnels to discover the service.
const DISCOVERY_TIME: Duration = Duration::from_secs(3);

/// Folder that contains the folders of both hosts. On drop, the shared-memory files of killed
/// processes are also removed.
struct Folder(TempDir);

impl Drop for Folder {
    fn drop(&mut self) {
        let own_prefix = prefix(&self.0.path().to_string_lossy());
        for file in fs::read_dir(SHARED_MEMORY).into_iter().flatten().flatten() {
            if file.file_name().to_string_lossy().starts_with(&own_prefix) {
                // A file that cannot be removed does no harm.
                let _ = fs::remove_file(file.path());
            }
        }
    }
}

/// Measures the variant `tunnel`.
pub(crate) fn run(program: Option<&Path>, rate_hz: u32, seconds: f64) -> Result<Cost, Failure> {
    let program = program.ok_or("expected the path of the tunnel executable in --tunnel")?;
    let program = program.to_str().ok_or("the path of the tunnel executable is not valid UTF-8")?;
    let folder = Folder(tempfile::tempdir_in(SHARED_MEMORY)?);
    let endpoint = format!("tcp/127.0.0.1:{}", bare::free_port()?);
    let settings = |end, root: &str| ProcessSettings::new(Variant::Tunnel, end, root, rate_hz, seconds);
    let hosts = ["near", "far"].map(|host| folder.0.path().join(host));
    let mut tunnels = Vec::new();
    for (host, end, other, wake) in [
        (&hosts[0], "listen", "connect", ["--listener", SERVICE].as_slice()),
        (&hosts[1], "connect", "listen", &["--reactive"]),
    ] {
        fs::create_dir_all(host.join("config"))?;
        let name = host.to_str().ok_or("the path of a folder is not valid UTF-8")?;
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
        let zenoh = zenoh.to_str().ok_or("the path of a file is not valid UTF-8")?;
        // Without polling, the tunnel would not discover the service.
        let arguments = ["-C", name, program, "--zenoh-config", zenoh, "--allow", SERVICE, "--poll", "100"];
        tunnels.push((arguments.map(str::to_owned), wake));
    }
    let [near, far] = hosts.each_ref().map(|host| host.to_str().unwrap_or_default());
    let mut near = hop::start(&settings(End::Near, near))?;
    let mut far = hop::start(&settings(End::Far, far))?;
    let mut tunnel_processes = Vec::new();
    for (arguments, wake) in &tunnels {
        let arguments = arguments.iter().map(String::as_str).chain(wake.iter().copied());
        tunnel_processes.push(Process::start(OsStr::new("env"), arguments)?);
        thread::sleep(DISCOVERY_TIME / 2);
    }
    hop::measure(&settings(End::Far, ""), &mut near, &tunnel_processes, &mut far)
}

/// Runs one process of the variant `tunnel`.
pub(crate) fn run_process(settings: &ProcessSettings) -> Result<(), Failure> {
    let node = node(&settings.address)?;
    let name = ServiceName::new(SERVICE)?;
    let event = node.service_builder(&name).event().open_or_create()?;
    let samples = node
        .service_builder(&name)
        .publish_subscribe::<Sample>()
        .enable_safe_overflow(true)
        .subscriber_max_buffer_size(BUFFER_SAMPLES)
        .open_or_create()?;
    match settings.end {
        End::Near => {
            let (publisher, notifier) = (samples.publisher_builder().create()?, event.notifier_builder().create()?);
            hop_end::send(settings, |tick, now_ns| {
                let mut sample = [0x5a; 14];
                (sample[0], sample[1]) = (tick, now_ns);
                publisher.send_copy(sample)?;
                notifier.notify()?;
                Ok(())
            })
        }
        End::Far => {
            let (subscriber, listener) = (
                samples.subscriber_builder().buffer_size(BUFFER_SAMPLES).create()?,
                event.listener_builder().create()?,
            );
            hop_end::receive(settings, |record| {
                listener.timed_wait(|_| {}, MAX_WAIT)?;
                while let Some(sample) = subscriber.receive()? {
                    record(sample[0], sample[1]);
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

/// Returns a file name prefix that is unique per host.
fn prefix(root: &str) -> String {
    root.replace(['/', '.'], "_")
}
