//! The attitude as MAVLink: what a ground station such as QGroundControl listens for.
//!
//! Input: attitudes in order, in MAVLink's frame (body forward, right, down; reference north, east, down), and when it is looked for them.
//! Output: datagrams of HEARTBEAT once a second, and of ATTITUDE_QUATERNION and ATTITUDE at a rate of their own. Time: that of the
//! samples for the rate, CLOCK_MONOTONIC for the heartbeat and for `time_boot_ms`. Failure: what the socket does not take is dropped and counted; a
//! port that cannot be opened is tried again. Nothing is read: no message from outside is acted upon.
//!
//! An attitude that is not known yet is not sent. The heartbeat says MAV_STATE_ACTIVE while attitudes come, MAV_STATE_STANDBY before the first one
//! and MAV_STATE_CRITICAL when none has come for a second.

use std::{
    io::{self, ErrorKind},
    net::{Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket},
    time::{Duration, Instant},
};

use launch::{MavlinkOut, Rate, VehicleKind};
use mavlink::{
    MAVLinkV2MessageRaw, MavHeader,
    dialects::ardupilotmega::{
        ATTITUDE_DATA, ATTITUDE_QUATERNION_DATA, HEARTBEAT_DATA, MavAutopilot, MavMessage, MavModeFlag, MavState,
        MavType,
    },
};
use messages::{AttitudeOutput, Flags};
use runtime::clock::monotonic_ns;

use crate::decimator::Decimator;

const HEARTBEAT_INTERVAL: Duration = Duration::from_secs(1);
/// Without an attitude for so long there is none.
const STALE: Duration = Duration::from_secs(1);
/// From one attempt to open the socket to the next.
const AGAIN: Duration = Duration::from_secs(5);
/// The version of MAVLink that a heartbeat names.
const MAVLINK_VERSION: u8 = 3;

/// Tells a ground station the attitude.
pub(crate) struct Mavlink {
    settings: MavlinkOut,
    decimator: Decimator,
    port: Port,
    sequence: u8,
    beaten: Option<Instant>,
    told: Option<Instant>,
    dropped: u64,
}

enum Port {
    Open(UdpSocket),
    /// Not since then.
    Shut(Option<Instant>),
}

impl Mavlink {
    pub(crate) fn new(settings: MavlinkOut) -> Self {
        let decimator = Decimator::to(Rate::Hz(settings.rate_hz));
        Self { settings, decimator, port: Port::Shut(None), sequence: 0, beaten: None, told: None, dropped: 0 }
    }

    /// Datagrams that did not go out.
    pub(crate) fn dropped(&self) -> u64 {
        self.dropped
    }

    /// Sends a heartbeat when one is due.
    pub(crate) fn beat(&mut self) {
        if self.beaten.is_some_and(|beaten| beaten.elapsed() < HEARTBEAT_INTERVAL) {
            return;
        }
        self.beaten = Some(Instant::now());
        let system_status = match self.told {
            None => MavState::MAV_STATE_STANDBY,
            Some(told) if told.elapsed() < STALE => MavState::MAV_STATE_ACTIVE,
            Some(_) => MavState::MAV_STATE_CRITICAL,
        };
        self.send(&MavMessage::HEARTBEAT(HEARTBEAT_DATA {
            custom_mode: 0,
            mavtype: kind(self.settings.vehicle),
            autopilot: MavAutopilot::MAV_AUTOPILOT_GENERIC,
            base_mode: MavModeFlag::empty(),
            system_status,
            mavlink_version: MAVLINK_VERSION,
        }));
    }

    /// Takes the next attitude, of the source's time `t_ns`, in MAVLink's frame.
    pub(crate) fn take(&mut self, output: &AttitudeOutput, t_ns: i64) {
        if output.header.flags.any(Flags::UNALIGNED) || !self.decimator.keeps(t_ns) {
            return;
        }
        self.told = Some(Instant::now());
        let since_boot_ms = (monotonic_ns() / 1_000_000) as u32;
        messages(output, since_boot_ms).iter().for_each(|message| self.send(message));
    }

    fn send(&mut self, message: &MavMessage) {
        let header = MavHeader {
            system_id: self.settings.system.into(),
            component_id: self.settings.component,
            sequence: self.sequence,
        };
        self.sequence = self.sequence.wrapping_add(1);
        let mut raw = MAVLinkV2MessageRaw::new();
        raw.serialize_message(header, message);
        if self.given(raw.raw_bytes()).is_err() {
            self.dropped += 1;
        }
    }

    fn given(&mut self, bytes: &[u8]) -> io::Result<()> {
        if let Port::Shut(since) = self.port {
            if since.is_some_and(|since| since.elapsed() < AGAIN) {
                return Err(ErrorKind::NotConnected.into());
            }
            self.port = match opened(self.settings.to) {
                Ok(socket) => Port::Open(socket),
                Err(_) => Port::Shut(Some(Instant::now())),
            };
        }
        let Port::Open(socket) = &self.port else { return Err(ErrorKind::NotConnected.into()) };
        let sent = socket.send_to(bytes, self.settings.to);
        match sent {
            Ok(_) => Ok(()),
            // Nobody listens yet, or the line is full: the next one goes out.
            Err(error) if matches!(error.kind(), ErrorKind::ConnectionRefused | ErrorKind::WouldBlock) => Err(error),
            Err(error) => {
                self.port = Port::Shut(Some(Instant::now()));
                Err(error)
            }
        }
    }
}

fn opened(to: SocketAddr) -> io::Result<UdpSocket> {
    let any: SocketAddr =
        if to.is_ipv4() { (Ipv4Addr::UNSPECIFIED, 0).into() } else { (Ipv6Addr::UNSPECIFIED, 0).into() };
    let socket = UdpSocket::bind(any)?;
    socket.set_nonblocking(true)?;
    // A ground station that is sought for has no address of its own yet.
    socket.set_broadcast(true)?;
    Ok(socket)
}

fn messages(output: &AttitudeOutput, time_boot_ms: u32) -> [MavMessage; 2] {
    let [q1, q2, q3, q4] = output.quaternion.map(|part| part as f32);
    let [rollspeed, pitchspeed, yawspeed] = output.rate_rad_s.map(|part| part as f32);
    let [roll, pitch, yaw] = [output.roll_rad, output.pitch_rad, output.yaw_rad].map(|angle| angle as f32);
    [
        MavMessage::ATTITUDE_QUATERNION(ATTITUDE_QUATERNION_DATA {
            time_boot_ms,
            q1,
            q2,
            q3,
            q4,
            rollspeed,
            pitchspeed,
            yawspeed,
            ..ATTITUDE_QUATERNION_DATA::default()
        }),
        MavMessage::ATTITUDE(ATTITUDE_DATA { time_boot_ms, roll, pitch, yaw, rollspeed, pitchspeed, yawspeed }),
    ]
}

fn kind(vehicle: VehicleKind) -> MavType {
    match vehicle {
        VehicleKind::Generic => MavType::MAV_TYPE_GENERIC,
        VehicleKind::FixedWing => MavType::MAV_TYPE_FIXED_WING,
        VehicleKind::Multicopter => MavType::MAV_TYPE_QUADROTOR,
        VehicleKind::Rover => MavType::MAV_TYPE_GROUND_ROVER,
        VehicleKind::Boat => MavType::MAV_TYPE_SURFACE_BOAT,
        VehicleKind::Submarine => MavType::MAV_TYPE_SUBMARINE,
    }
}
