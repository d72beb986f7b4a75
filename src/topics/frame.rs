//! Display of attitudes in the frame of the launch file's `[output]`.

use attitude::frames::{Frame, QuaternionOrder};
use control::{ControlRequest, send_request};
use launch::{LaunchError, Output};
use messages::{AttitudeOutput, Layout};
use observe::decode::{DecodedMessage, LayoutMismatch};
use runtime::{ServiceConfig, frames::attitude_to_frame};

use crate::system::SystemArgs;

/// Frame and quaternion order in which attitudes are displayed.
pub(crate) struct DisplayFrame(Output);

impl DisplayFrame {
    /// Returns the output frame of the selected system.
    ///
    /// The default frame is used if a local system does not respond. It is also used for a remote
    /// vehicle, because its envelopes name their frame.
    pub(crate) fn from_system(system: &SystemArgs) -> Result<Self, LaunchError> {
        Ok(if system.remote().is_none() { Self::from_local_system(&system.name()?) } else { Self(Output::default()) })
    }

    /// Returns the output frame of a system on this machine, or the default if it does not respond.
    pub(crate) fn from_local_system(name: &str) -> Self {
        let config = send_request::<ServiceConfig>(name, &ControlRequest::ServiceConfig).ok();
        Self(config.map_or_else(Output::default, |config| config.launch.output))
    }

    #[cfg_attr(not(feature = "tui"), allow(dead_code, reason = "only terminal views use it"))]
    pub(crate) fn frame(&self) -> Frame {
        self.0.frame
    }

    /// Decodes a message. An attitude is converted to the display frame, unless the publisher has
    /// `reported` the frame of its attitudes. The name of the attitude's frame is added to the
    /// result.
    pub(crate) fn record(
        &self,
        layout: &Layout,
        bytes: &[u8],
        reported: Option<Output>,
    ) -> Result<DecodedMessage, LayoutMismatch> {
        let is_attitude = layout.topic == Some(graph::Topic::Attitude.name());
        let attitude: Option<AttitudeOutput> = bytemuck::try_pod_read_unaligned(bytes).ok().filter(|_| is_attitude);
        let Some(attitude) = attitude else { return DecodedMessage::decode(layout, bytes) };
        let Output { frame, quaternion } = reported.unwrap_or(self.0);
        let shown = if reported.is_some() { attitude } else { attitude_to_frame(frame, attitude) };
        let ordered = |q: [f64; 4]| QuaternionOrder::ordered(quaternion, q);
        let shown = AttitudeOutput { quaternion: ordered(shown.quaternion), jump: ordered(shown.jump), ..shown };
        let record = DecodedMessage::decode(layout, bytemuck::bytes_of(&shown))?;
        Ok(record.with_name_field("frame", frame.name()).with_name_field("quaternion_order", quaternion.name()))
    }
}
