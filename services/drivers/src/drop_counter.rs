//! Number of datagrams that the kernel dropped because the buffer of a socket was full.
//!
//! Input: the column `drops` of `/proc/net/udp` and `/proc/net/udp6`.
//!
//! Time: the tables are read once per [`UPDATE_INTERVAL`], because they list all sockets of the
//! host.
//!
//! Failure: if a table cannot be read, the number stays unchanged.

use std::{
    fs::File,
    io::{self, BufRead, BufReader},
    net::UdpSocket,
    time::{Duration, Instant},
};

const TABLES: [&str; 2] = ["/proc/net/udp", "/proc/net/udp6"];
/// Interval between two reads of the tables.
const UPDATE_INTERVAL: Duration = Duration::from_secs(1);
/// Maximum number of sockets that are searched per table.
const MAX_SOCKETS: usize = 1 << 16;
/// Indices of the table columns with the inode of a socket and the number of its dropped datagrams.
const INODE_COLUMN: usize = 9;
const DROPS_COLUMN: usize = 12;

/// Counter of the dropped datagrams of one socket.
pub(crate) struct DropCounter {
    inode: u64,
    /// Last count reported by the kernel. This count wraps.
    last: u32,
    total: u64,
    next_update: Instant,
}

impl DropCounter {
    pub(crate) fn new(socket: &UdpSocket) -> io::Result<Self> {
        let inode = rustix::fs::fstat(socket)?.st_ino;
        Ok(Self { inode, last: 0, total: 0, next_update: Instant::now() })
    }

    /// Returns the number of dropped datagrams at the last update.
    pub(crate) fn total(&self) -> u64 {
        self.total
    }

    /// Reads the number from the kernel if an update is due.
    pub(crate) fn update(&mut self) {
        let now = Instant::now();
        if now < self.next_update {
            return;
        }
        self.next_update = now + UPDATE_INTERVAL;
        let found = TABLES.iter().find_map(|table| drops_in(BufReader::new(File::open(table).ok()?), self.inode));
        if let Some(drops) = found {
            self.total += u64::from(drops.wrapping_sub(self.last));
            self.last = drops;
        }
    }
}

/// Returns the number of datagrams dropped at the socket with the given inode, or `None` if the
/// table does not list the socket.
fn drops_in(table: impl BufRead, inode: u64) -> Option<u32> {
    table.lines().take(MAX_SOCKETS).map_while(Result::ok).find_map(|line| {
        let mut columns = line.split_ascii_whitespace();
        let found: u64 = columns.nth(INODE_COLUMN)?.parse().ok()?;
        let drops = columns.nth(DROPS_COLUMN - INODE_COLUMN - 1)?.parse().ok()?;
        (found == inode).then_some(drops)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drops_are_read_from_the_line_of_the_socket() {
        let table = "   sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode ref pointer drops\n\
             351: 0100007F:8913 00000000:0000 07 00000000:00000000 00:00000000 00000000     0        0 4711 2 0000000000000000 17\n\
             352: 0100007F:8914 00000000:0000 07 00000000:00000000 00:00000000 00000000     0        0 4712 2 0000000000000000 0\n";
        assert_eq!([4711, 4712, 17].map(|inode| drops_in(table.as_bytes(), inode)), [Some(17), Some(0), None]);
    }

    #[test]
    fn overflow_of_socket_buffer_is_counted() {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let mut drops = DropCounter::new(&socket).unwrap();
        let sender = UdpSocket::bind("127.0.0.1:0").unwrap();
        for _ in 0..20_000 {
            sender.send_to(&[0; 1000], socket.local_addr().unwrap()).unwrap();
        }
        drops.update();
        socket.set_nonblocking(true).unwrap();
        let received = std::iter::from_fn(|| socket.recv(&mut [0; 1000]).ok()).count() as u64;
        assert_eq!(received + drops.total(), 20_000);
        assert!(drops.total() > 0);
    }
}
