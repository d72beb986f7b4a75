//! Minimal system for a gateway. It has a name, a control socket that accepts every request, and
//! the gateway itself, which is started in the same way as by the supervisor.

use std::{
    ffi::OsStr,
    io::{BufRead, BufReader, Write},
    net::TcpListener,
    os::unix::net::UnixListener,
    thread,
    time::{Duration, Instant},
};

use bus::{Bus, Claim, SystemName};
use launch::{Gateway, Launch};
use messages::Health;
use runtime::{
    ServiceConfig,
    service_config::{CONTROL_BUFFER, Pace},
};

use crate::{Failure, process::Process};

/// Time allowed for a gateway to start and listen.
const START_TIMEOUT: Duration = Duration::from_secs(15);

/// System without any service except the gateway.
pub(crate) struct System {
    config: ServiceConfig,
    system_name: SystemName,
    port: u16,
    _claim: Claim,
}

impl System {
    /// Creates a system with the given name and gateway settings.
    pub(crate) fn new(name: &str, rate_hz: u32, gateway: Gateway) -> Result<Self, Failure> {
        let system_name = SystemName::new(name)?;
        let claim = system_name.claim()?;
        let listener = UnixListener::bind(system_name.control_socket_path()?)?;
        // The thread ends with the process.
        thread::spawn(move || {
            for mut stream in listener.incoming().flatten() {
                let _ = BufReader::new(&stream).read_line(&mut String::new());
                let _ = stream.write_all(b"{\"ok\":null}\n");
            }
        });
        let port = TcpListener::bind("127.0.0.1:0")?.local_addr()?.port();
        let gateway = Gateway { listen: vec![format!("tcp/127.0.0.1:{port}")], ..gateway };
        let launch = Launch { name: name.into(), gateway, ..Launch::default() };
        Ok(Self { config: config(launch, rate_hz), system_name, port, _claim: claim })
    }

    /// Returns the endpoint on which the gateway listens.
    pub(crate) fn endpoint(&self) -> String {
        format!("tcp/127.0.0.1:{}", self.port)
    }

    /// Starts the gateway and waits until it has joined the bus and is listening.
    pub(crate) fn gateway(&self) -> Result<Process, Failure> {
        let bus = Bus::join(&self.system_name, "bench")?;
        let health = bus.subscriber::<Health>(CONTROL_BUFFER)?;
        let mut process = Process::start(OsStr::new(env!("CARGO_BIN_EXE_plumb")), ["service", "gateway"])?;
        process.write_input(&serde_json::to_string(&self.config)?)?;
        let deadline = Instant::now() + START_TIMEOUT;
        let is_free = || TcpListener::bind(("127.0.0.1", self.port)).is_ok();
        let mut is_running = false;
        while !is_running || is_free() {
            if Instant::now() > deadline {
                return Err("the gateway did not start in time".into());
            }
            thread::sleep(Duration::from_millis(10));
            is_running = is_running || health.receive()?.is_some();
        }
        Ok(process)
    }
}

/// Returns the capacity of a topic on the data path, in messages.
pub(crate) fn buffer_ticks(rate_hz: u32) -> usize {
    config(Launch::default(), rate_hz).buffer_ticks()
}

fn config(launch: Launch, rate_hz: u32) -> ServiceConfig {
    ServiceConfig {
        incarnation: 1,
        supervisor_pid: std::process::id(),
        ..ServiceConfig::standalone(launch, f64::from(rate_hz), Pace::Speed(1.0))
    }
}
