//! The attitude as the launch file wants it shown.

use attitude::frames::{Frame, QuaternionOrder};
use control::{ControlRequest, send_request};
use launch::Output;
use messages::{AttitudeOutput, Layout};
use observe::record::{NotOfLayout, Record};
use runtime::{ServiceConfig, frames::attitude_to_frame};

use crate::system::System;

/// In which frame attitudes are shown that come in the system's own.
pub(crate) struct Shown(Output);

impl Shown {
    /// As the launch file of a system on this machine says; its own where it does not answer. What comes over the network is in the frame of its
    /// envelope already.
    pub(crate) fn of(system: &System) -> Self {
        if system.remote().is_none() { Self::on_board(&system.name()) } else { Self(Output::default()) }
    }

    /// The same of a system on this machine.
    pub(crate) fn on_board(name: &str) -> Self {
        let config = send_request::<ServiceConfig>(name, &ControlRequest::ServiceConfig).ok();
        Self(config.map_or_else(Output::default, |config| config.launch.output))
    }

    /// The frame.
    pub(crate) fn frame(&self) -> Frame {
        self.0.frame
    }

    /// A message taken apart, an attitude in the frame and order that are named in it: as it came where it `said` so, else as is to be shown.
    pub(crate) fn record(&self, layout: &Layout, bytes: &[u8], said: Option<Output>) -> Result<Record, NotOfLayout> {
        let is_attitude = layout.topic == Some(graph::Topic::Attitude.name());
        let attitude: Option<AttitudeOutput> = bytemuck::try_pod_read_unaligned(bytes).ok().filter(|_| is_attitude);
        let Some(attitude) = attitude else { return Record::new(layout, bytes) };
        let Output { frame, quaternion } = said.unwrap_or(self.0);
        let shown = if said.is_some() { attitude } else { attitude_to_frame(frame, attitude) };
        let ordered = |q: [f64; 4]| QuaternionOrder::ordered(quaternion, q);
        let shown = AttitudeOutput { quaternion: ordered(shown.quaternion), jump: ordered(shown.jump), ..shown };
        let record = Record::new(layout, bytemuck::bytes_of(&shown))?;
        Ok(record.with_word("frame", frame.name()).with_word("quaternion_order", quaternion.name()))
    }
}
