//! Sends UDP datagrams to one address.
//!
//! - Input: bytes.
//! - Output: one datagram for each call.
//! - Time: sending never blocks.
//! - Failure: a datagram that the kernel does not accept is dropped.

use std::{
    fmt, io,
    net::{Ipv4Addr, Ipv6Addr, SocketAddr, ToSocketAddrs, UdpSocket},
    str::FromStr,
};

/// Prefix of an endpoint.
const SCHEME: &str = "udpout:";

/// Destination of datagrams, for example `udpout:127.0.0.1:14550`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Endpoint(String);

/// Error that prevents datagrams from being sent.
#[derive(Debug, thiserror::Error)]
pub enum DatagramError {
    /// The text does not have the form `udpout:HOST:PORT` with a port from 1 to 65535.
    #[error("invalid endpoint {text:?}: expected udpout:HOST:PORT, for instance udpout:127.0.0.1:14550")]
    InvalidEndpoint {
        /// Rejected text.
        text: String,
    },
    /// The host name cannot be resolved.
    #[error("sending to {endpoint}: cannot resolve the host: {cause}")]
    HostLookup {
        /// Destination.
        endpoint: Endpoint,
        /// Resolver error.
        cause: io::Error,
    },
    /// A socket cannot be opened.
    #[error("sending to {endpoint}: cannot open a socket: {cause}")]
    Socket {
        /// Destination.
        endpoint: Endpoint,
        /// Operating system error.
        cause: io::Error,
    },
}

impl FromStr for Endpoint {
    type Err = DatagramError;

    fn from_str(text: &str) -> Result<Self, DatagramError> {
        let address = text.strip_prefix(SCHEME).filter(|address| {
            let port = address.rsplit_once(':').filter(|(host, _)| !host.is_empty());
            port.is_some_and(|(_, port)| port.parse::<u16>().is_ok_and(|port| port != 0))
        });
        address.map(|it| Self(it.into())).ok_or_else(|| DatagramError::InvalidEndpoint { text: text.into() })
    }
}

impl fmt::Display for Endpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{SCHEME}{}", self.0)
    }
}

/// Sends datagrams to one endpoint.
#[derive(Debug)]
pub struct DatagramSender {
    socket: UdpSocket,
    destination: SocketAddr,
}

impl DatagramSender {
    /// Resolves the host once and opens a socket. Does not check whether a receiver exists.
    ///
    /// # Errors
    ///
    /// Returns an error if the host cannot be resolved or no socket can be opened.
    pub fn open(endpoint: &Endpoint) -> Result<Self, DatagramError> {
        let lookup_error = |cause| DatagramError::HostLookup { endpoint: endpoint.clone(), cause };
        let no_address = || lookup_error(io::Error::new(io::ErrorKind::NotFound, "the host has no address"));
        let destination = endpoint.0.to_socket_addrs().map_err(lookup_error)?.next().ok_or_else(no_address)?;
        let local: SocketAddr =
            if destination.is_ipv4() { (Ipv4Addr::UNSPECIFIED, 0).into() } else { (Ipv6Addr::UNSPECIFIED, 0).into() };
        let open_socket = || {
            let socket = UdpSocket::bind(local)?;
            socket.set_nonblocking(true)?;
            Ok(socket)
        };
        let socket = open_socket().map_err(|cause| DatagramError::Socket { endpoint: endpoint.clone(), cause })?;
        Ok(Self { socket, destination })
    }

    /// Sends a datagram. Returns `true` if the kernel accepted it.
    #[must_use]
    pub fn send(&self, bytes: &[u8]) -> bool {
        self.socket.send_to(bytes, self.destination).is_ok_and(|sent| sent == bytes.len())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn invalid_endpoint_error_shows_a_valid_one() {
        for text in
            ["", "127.0.0.1:14550", "udpout:", "udpout::14550", "udpout:127.0.0.1", "udpout:a:0", "udpout:a:70000"]
        {
            let error = text.parse::<Endpoint>().unwrap_err().to_string();
            assert!(error.contains(&format!("{text:?}")) && error.contains("udpout:127.0.0.1:14550"), "{error}");
        }
        for text in ["udpout:127.0.0.1:14550", "udpout:[::1]:1", "udpout:station.example:14550"] {
            assert_eq!(text.parse::<Endpoint>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn send_does_not_wait_for_absent_or_frozen_receiver() {
        let frozen = UdpSocket::bind("127.0.0.1:0").unwrap();
        let port = frozen.local_addr().unwrap().port();
        let sender = DatagramSender::open(&format!("udpout:127.0.0.1:{port}").parse().unwrap()).unwrap();
        // These are more datagrams than the receive buffer of a socket can hold.
        let _sent = (0..20_000).filter(|_| sender.send(&[0; 100])).count();
        drop(frozen);
        assert!((0..1000).all(|_| sender.send(&[0; 100])), "without a receiver, datagrams are still sent");
    }
}
