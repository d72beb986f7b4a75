//! Drop-in for the systemd unit `plumbline.service` that permits access to devices and networks.
//!
//! Input: a launch file.
//!
//! Output: the text of a drop-in. The unit denies all access that the drop-in does not permit.

use std::{
    collections::BTreeSet,
    fmt::{self, Write},
    net::{IpAddr, SocketAddr},
    path::{Path, PathBuf},
};

use graph::Service;

use crate::{Gateway, Launch, endpoint::is_loopback, ingest::Source, live_sources::Port};

/// Networks of private addresses, RFC 1918, RFC 4193 and link-local.
const PRIVATE_NETWORKS: &str = "10.0.0.0/8 172.16.0.0/12 192.168.0.0/16 169.254.0.0/16 fc00::/7 fe80::/10";

/// A device file cannot be named in a unit.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "cannot permit access to {}: systemd reads only letters, digits and any of - _ . : + @ / in a device file; create a symbolic link with such a name by a udev rule",
    foreign::path(path)
)]
pub struct UnsupportedDevicePath {
    path: PathBuf,
}

impl Launch {
    /// Returns the drop-in that permits the access that this launch file needs.
    ///
    /// # Errors
    ///
    /// Returns an error if the name of a device file has characters that are special in systemd
    /// units.
    pub fn unit_drop_in(&self) -> Result<String, UnsupportedDevicePath> {
        let mut access = Access::default();
        let ingest = &self.ingest;
        if self.services.contains(&Service::Drivers) {
            let receiver = ingest.live.receiver.port.clone();
            let ports = [ingest.port(), receiver.filter(|_| !ingest.source.is_repeatable())];
            ports.into_iter().flatten().try_for_each(|port| access.permit_port(&port))?;
            access.uses_iio = ingest.source == Source::Iio;
        }
        if self.services.contains(&Service::Gateway) {
            access.permit_gateway(&self.gateway);
        }
        if self.services.contains(&Service::Cockpit) && !self.cockpit.listen.ip().is_loopback() {
            access.permit_clients("cockpit", &self.cockpit.listen.to_string());
        }
        Ok(access.to_string())
    }
}

/// Access that a launch file needs.
#[derive(Default)]
struct Access {
    /// Patterns of `DeviceAllow=` for serial ports.
    serial_ports: BTreeSet<String>,
    uses_iio: bool,
    /// Addresses of hosts that the launch file gives as IP addresses.
    hosts: BTreeSet<IpAddr>,
    /// Reasons for access to all private networks.
    private: Vec<String>,
}

impl Access {
    fn permit_port(&mut self, port: &Port) -> Result<(), UnsupportedDevicePath> {
        match port {
            Port::Stdin => {}
            Port::Udp(address) => match address.parse::<SocketAddr>() {
                Ok(address) if address.ip().is_loopback() => {}
                _ => self.permit_clients("datagrams", address),
            },
            Port::Tcp(address) => self.permit_host(address),
            Port::Serial { path, .. } => self.permit_serial_port(path)?,
        }
        Ok(())
    }

    /// Permits a serial port. The permission is given to the port's driver, because a port that is
    /// plugged in after the start of the unit is a new device.
    fn permit_serial_port(&mut self, path: &Path) -> Result<(), UnsupportedDevicePath> {
        let unsupported = || UnsupportedDevicePath { path: path.into() };
        let text = path.to_str().ok_or_else(unsupported)?;
        if !text.chars().all(|letter| letter.is_ascii_alphanumeric() || "-_.:+@/".contains(letter)) {
            return Err(unsupported());
        }
        let driver =
            text.strip_prefix("/dev/").map(|name| name.trim_end_matches(|letter: char| letter.is_ascii_digit()));
        match driver.filter(|driver| driver.starts_with("tty") && !driver.contains('/') && driver.len() > 3) {
            Some(driver) => drop(self.serial_ports.insert(format!("char-{driver}"))),
            // The target of a symbolic link is known only while the device is present.
            None => {
                self.serial_ports.extend(["char-ttyACM".into(), "char-ttyUSB".into()]);
                if text.starts_with("/dev/") {
                    self.serial_ports.insert(text.into());
                }
            }
        }
        Ok(())
    }

    /// Permits the host of `HOST:PORT`.
    fn permit_host(&mut self, address: &str) {
        let host = address.rsplit_once(':').map_or(address, |(host, _)| host);
        match host.trim_start_matches('[').trim_end_matches(']').parse() {
            _ if is_loopback(host) => {}
            Ok(ip) => drop(self.hosts.insert(ip)),
            Err(_) => self.private.push(format!("{} is a name", foreign::path(Path::new(host)))),
        }
    }

    /// Permits all private networks, because any host can send to `address`.
    fn permit_clients(&mut self, what: &str, address: &str) {
        self.private.push(format!("{what}: any host can send to {address}"));
    }

    fn permit_gateway(&mut self, gateway: &Gateway) {
        let addresses = |endpoints: &'_ [String]| -> Vec<String> {
            endpoints.iter().filter_map(|endpoint| Some(endpoint.split_once('/')?.1.to_owned())).collect()
        };
        for address in addresses(&gateway.listen) {
            if !is_loopback(address.rsplit_once(':').map_or(&*address, |(host, _)| host)) {
                self.permit_clients("gateway", &address);
            }
        }
        addresses(&gateway.connect).iter().for_each(|address| self.permit_host(address));
    }

    /// Returns the kernel modules that register the device classes. Without its module, a class is
    /// unknown to systemd, and access to it is not permitted.
    fn modules(&self) -> Vec<&'static str> {
        let uses = |class: &str| self.serial_ports.contains(class);
        let modules =
            [("cdc_acm", uses("char-ttyACM")), ("usbserial", uses("char-ttyUSB")), ("industrialio", self.uses_iio)];
        modules.into_iter().filter(|(_, is_used)| *is_used).map(|(module, _)| module).collect()
    }

    fn is_empty(&self) -> bool {
        self.serial_ports.is_empty() && !self.uses_iio && self.hosts.is_empty() && self.private.is_empty()
    }
}

impl fmt::Display for Access {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(
            "# Devices and networks of the launch file, by `plumb config unit`. Install as\n\
             # /etc/systemd/system/plumbline.service.d/launch.conf.\n",
        )?;
        let modules = self.modules();
        if !modules.is_empty() {
            let units = modules.iter().fold(String::new(), |mut units, module| {
                // Writing to a string cannot fail.
                let _ = write!(units, " modprobe@{module}.service");
                units
            });
            let units = units.trim_start();
            write!(
                f,
                "[Unit]\n# Without its module, a class of devices is unknown to systemd.\nWants={units}\nAfter={units}\n\n"
            )?;
        }
        f.write_str("[Service]\n")?;
        if self.uses_iio || !self.serial_ports.is_empty() {
            // DevicePolicy=closed of the unit remains in force.
            f.write_str("PrivateDevices=no\n")?;
        }
        for device in &self.serial_ports {
            writeln!(f, "DeviceAllow={device} rw")?;
        }
        if !self.serial_ports.is_empty() {
            f.write_str("# Group of serial ports; on Arch Linux it is uucp.\nSupplementaryGroups=dialout\n")?;
        }
        if self.uses_iio {
            f.write_str("DeviceAllow=char-iio rw\n# Settings of the device are in /sys.\nProtectKernelTunables=no\n")?;
        }
        for host in &self.hosts {
            writeln!(f, "IPAddressAllow={host}")?;
        }
        if !self.private.is_empty() {
            f.write_str("# Private networks. Replace them by the addresses of the hosts:\n")?;
            for reason in &self.private {
                writeln!(f, "# {reason}")?;
            }
            writeln!(f, "IPAddressAllow={PRIVATE_NETWORKS}")?;
        }
        if self.is_empty() {
            f.write_str("# No access beyond that of plumbline.service is needed.\n")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use crate::Launch;

    /// Returns the settings of the drop-in, without comments.
    fn settings(text: &str) -> Vec<String> {
        let drop_in = Launch::parse("launch.toml", text).unwrap().unit_drop_in().unwrap();
        let is_setting = |line: &&str| !line.is_empty() && !line.starts_with('#');
        drop_in.lines().filter(is_setting).map(str::to_owned).collect()
    }

    fn with_source(line: &str) -> Vec<String> {
        settings(&crate::with_overrides("", Some(line), None).unwrap())
    }

    #[test]
    fn loopback_and_repeatable_sources_need_no_access() {
        for line in ["sim:s1", "replay:a.csv", "bus", "stdin", "udp", "tcp:localhost:5555", "mavlink"] {
            assert_eq!(with_source(line), ["[Service]"], "{line}");
        }
        let ignored = "ingest.receiver.endpoint = \"serial:/dev/ttyACM0\"";
        assert_eq!(settings(ignored), ["[Service]"], "a simulation has no receiver");
    }

    #[test]
    fn serial_port_is_permitted_by_its_driver() {
        let modules =
            |module: &str| [format!("Wants=modprobe@{module}.service"), format!("After=modprobe@{module}.service")];
        for (line, module, class) in [
            ("serial:/dev/ttyUSB0", Some("usbserial"), "ttyUSB"),
            ("mavlink:serial:/dev/ttyACM1", Some("cdc_acm"), "ttyACM"),
            ("serial:/dev/ttyAMA0?baud=921600", None, "ttyAMA"),
        ] {
            let mut expected = Vec::new();
            if let Some(module) = module {
                expected.push("[Unit]".to_owned());
                expected.extend(modules(module));
            }
            let device = format!("DeviceAllow=char-{class} rw");
            expected
                .extend(["[Service]", "PrivateDevices=no", &device, "SupplementaryGroups=dialout"].map(str::to_owned));
            assert_eq!(with_source(line), expected, "{line}");
        }
    }

    #[test]
    fn symbolic_link_permits_usb_ports_and_its_target() {
        let found = with_source("serial:/dev/serial/by-id/usb-FTDI_FT232R-if00-port0");
        let devices: Vec<_> = found.iter().filter(|line| line.starts_with("DeviceAllow=")).collect();
        let expected = ["/dev/serial/by-id/usb-FTDI_FT232R-if00-port0", "char-ttyACM", "char-ttyUSB"];
        assert_eq!(devices, expected.map(|device| format!("DeviceAllow={device} rw")).each_ref());
        let outside_dev = with_source("serial:/tmp/imu");
        assert!(!outside_dev.iter().any(|line| line.contains("/tmp")), "{outside_dev:?}");
    }

    #[test]
    fn receiver_and_iio_device_are_both_permitted() {
        let text =
            "ingest = { source = \"iio\", iio.device = \"bmi160\", receiver.endpoint = \"serial:/dev/ttyACM0\" }";
        let found = settings(text);
        for expected in ["DeviceAllow=char-iio rw", "DeviceAllow=char-ttyACM rw", "ProtectKernelTunables=no"] {
            assert!(found.iter().any(|line| line == expected), "{expected}: {found:?}");
        }
        assert!(
            found.contains(&"Wants=modprobe@cdc_acm.service modprobe@industrialio.service".to_owned()),
            "{found:?}"
        );
    }

    #[test]
    fn network_access_is_limited_to_named_or_private_hosts() {
        let private = format!("IPAddressAllow={}", super::PRIVATE_NETWORKS);
        for (line, expected) in [
            ("tcp:192.168.1.7:5555", "IPAddressAllow=192.168.1.7"),
            ("tcp:[fd00::7]:5555", "IPAddressAllow=fd00::7"),
            ("tcp:imu.local:5555", &*private),
            ("udp:0.0.0.0:14560", &*private),
            ("mavlink:udpin:0.0.0.0:14540", &*private),
        ] {
            assert_eq!(with_source(line), ["[Service]", expected], "{line}");
        }
        let tls = "access = \"access.json5\"\ntls = { ca = \"ca.pem\", cert = \"cert.pem\", key = \"key.pem\" }";
        for (gateway, expected) in [
            ("connect = [\"quic/192.0.2.10:7447\"]", "IPAddressAllow=192.0.2.10"),
            ("connect = [\"quic/station.example:7447\"]", &*private),
            ("listen = [\"quic/0.0.0.0:7447\"]", &*private),
        ] {
            assert_eq!(settings(&format!("[gateway]\n{gateway}\n{tls}")), ["[Service]", expected], "{gateway}");
        }
    }

    #[test]
    fn text_of_launch_file_adds_no_line_to_the_drop_in() {
        for path in ["/dev/imu rw\\nDeviceAllow=/dev/sda", "/dev/%h", "/dev/my imu", "/dev/é"] {
            let launch = Launch::parse("x", &format!("ingest = {{ source = \"serial\", serial.port = \"{path}\" }}"));
            let error = launch.unwrap().unit_drop_in().unwrap_err().to_string();
            assert!(error.contains("udev rule") && !error.contains('\n'), "{error}");
        }
        let named = with_source("tcp:a\nDeviceAllow=/dev/sda:5555");
        assert!(!named.iter().any(|line| line.starts_with("DeviceAllow=")), "{named:?}");
    }
}
