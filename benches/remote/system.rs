//! As much of a system as a gateway needs: a name, a door at which nobody objects, and the gateway, started as the supervisor does.

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
    Role, ServiceConfig,
    service_config::{CONTROL_BUFFER, FIRST_EPOCH, Pace},
};

use crate::{Failure, process::Process};

/// From the start of a gateway until it must run and listen.
const LIMIT: Duration = Duration::from_secs(15);

/// A system without services.
pub(crate) struct System {
    config: ServiceConfig,
    system_name: SystemName,
    port: u16,
    _claim: Claim,
}

impl System {
    /// A system of this name whose gateway is as `gateway` says.
    pub(crate) fn new(name: &str, rate_hz: u32, gateway: Gateway) -> Result<Self, Failure> {
        let system_name = SystemName::new(name)?;
        let claim = system_name.claim()?;
        let listener = UnixListener::bind(system_name.control_socket_path()?)?;
        // It ends with the process.
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

    /// Where its gateway listens.
    pub(crate) fn endpoint(&self) -> String {
        format!("tcp/127.0.0.1:{}", self.port)
    }

    /// Its gateway, once it looks at the bus and listens.
    pub(crate) fn gateway(&self) -> Result<Process, Failure> {
        let bus = Bus::join(&self.system_name, "bench")?;
        let health = bus.subscriber::<Health>(CONTROL_BUFFER)?;
        let mut process = Process::start(OsStr::new(env!("CARGO_BIN_EXE_plumb")), ["service", "gateway"])?;
        process.write_line(&serde_json::to_string(&self.config)?)?;
        let deadline = Instant::now() + LIMIT;
        let is_free = || TcpListener::bind(("127.0.0.1", self.port)).is_ok();
        let mut runs = false;
        while !runs || is_free() {
            if Instant::now() > deadline {
                return Err("the gateway did not start in time".into());
            }
            thread::sleep(Duration::from_millis(10));
            runs = runs || health.receive()?.is_some();
        }
        Ok(process)
    }
}

/// Messages that a topic of the path holds.
pub(crate) fn buffer_ticks(rate_hz: u32) -> usize {
    config(Launch::default(), rate_hz).buffer_ticks()
}

fn config(launch: Launch, rate_hz: u32) -> ServiceConfig {
    ServiceConfig {
        launch,
        rate_hz: f64::from(rate_hz),
        pace: Pace::Speed(1.0),
        max_ticks: None,
        incarnation: 1,
        epoch: FIRST_EPOCH,
        role: Role::Owner { from_tick: 0 },
        prior: None,
        resume: None,
        publishes_readings: false,
        supervisor_pid: std::process::id(),
    }
}
