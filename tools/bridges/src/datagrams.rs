//! Datagrams to one address, by UDP.
//!
//! Input: bytes. Output: a datagram each. Time: none; sending never waits. Failure: what the network does not take is dropped.

use std::{
    fmt, io,
    net::{Ipv4Addr, Ipv6Addr, SocketAddr, ToSocketAddrs, UdpSocket},
    str::FromStr,
};

/// How an address is written.
const BEGIN: &str = "udpout:";

/// Where datagrams go, as `udpout:127.0.0.1:14550`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Endpoint(String);

/// Why datagrams cannot be sent.
#[derive(Debug, thiserror::Error)]
pub enum DatagramError {
    /// It is no endpoint.
    #[error("reading the endpoint {text:?}: expected udpout:HOST:PORT, as udpout:127.0.0.1:14550")]
    NoEndpoint {
        /// What was read.
        text: String,
    },
    /// The host has no address.
    #[error("sending to {endpoint}: looking up its host: {cause}")]
    Unknown {
        /// Where to.
        endpoint: Endpoint,
        /// What the resolver says.
        cause: io::Error,
    },
    /// There is no socket.
    #[error("sending to {endpoint}: opening a socket: {cause}")]
    NoSocket {
        /// Where to.
        endpoint: Endpoint,
        /// What the kernel says.
        cause: io::Error,
    },
}

impl FromStr for Endpoint {
    type Err = DatagramError;

    fn from_str(text: &str) -> Result<Self, DatagramError> {
        let address = text.strip_prefix(BEGIN).filter(|address| {
            let port = address.rsplit_once(':').filter(|(host, _)| !host.is_empty());
            port.is_some_and(|(_, port)| port.parse::<u16>().is_ok_and(|port| port != 0))
        });
        address.map(|it| Self(it.into())).ok_or_else(|| DatagramError::NoEndpoint { text: text.into() })
    }
}

impl fmt::Display for Endpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{BEGIN}{}", self.0)
    }
}

/// An open way to an endpoint.
#[derive(Debug)]
pub struct Datagrams {
    socket: UdpSocket,
    to: SocketAddr,
}

impl Datagrams {
    /// Looks the host up, once, and opens a socket. Whether anybody listens is not asked.
    pub fn open(endpoint: &Endpoint) -> Result<Self, DatagramError> {
        let unknown = |cause| DatagramError::Unknown { endpoint: endpoint.clone(), cause };
        let none = || unknown(io::Error::new(io::ErrorKind::NotFound, "it has no address"));
        let to = endpoint.0.to_socket_addrs().map_err(unknown)?.next().ok_or_else(none)?;
        let from: SocketAddr =
            if to.is_ipv4() { (Ipv4Addr::UNSPECIFIED, 0).into() } else { (Ipv6Addr::UNSPECIFIED, 0).into() };
        let opened = || {
            let socket = UdpSocket::bind(from)?;
            socket.set_nonblocking(true)?;
            Ok(socket)
        };
        let socket = opened().map_err(|cause| DatagramError::NoSocket { endpoint: endpoint.clone(), cause })?;
        Ok(Self { socket, to })
    }

    /// Sends a datagram; whether the kernel took it.
    #[must_use]
    pub fn send(&self, bytes: &[u8]) -> bool {
        self.socket.send_to(bytes, self.to).is_ok_and(|sent| sent == bytes.len())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_endpoint_is_refused_with_one_that_is() {
        for text in
            ["", "127.0.0.1:14550", "udpout:", "udpout::14550", "udpout:127.0.0.1", "udpout:a:0", "udpout:a:70000"]
        {
            let said = text.parse::<Endpoint>().unwrap_err().to_string();
            assert!(said.contains(&format!("{text:?}")) && said.contains("udpout:127.0.0.1:14550"), "{said}");
        }
        for text in ["udpout:127.0.0.1:14550", "udpout:[::1]:1", "udpout:station.example:14550"] {
            assert_eq!(text.parse::<Endpoint>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn a_receiver_that_is_not_there_or_reads_nothing_is_not_waited_for() {
        let frozen = UdpSocket::bind("127.0.0.1:0").unwrap();
        let port = frozen.local_addr().unwrap().port();
        let datagrams = Datagrams::open(&format!("udpout:127.0.0.1:{port}").parse().unwrap()).unwrap();
        // Far more than a socket holds.
        let _sent = (0..20_000).filter(|_| datagrams.send(&[0; 100])).count();
        drop(frozen);
        assert!((0..1000).all(|_| datagrams.send(&[0; 100])), "nobody is there, and each datagram still goes out");
    }
}
