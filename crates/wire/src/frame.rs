//! In which frame samples are, as an envelope says it.

use attitude::frames::{Frame, QuaternionOrder};

use crate::v1::{self, Envelope};

impl Envelope {
    /// This envelope, of samples in this frame.
    pub fn in_frame(mut self, frame: Frame, order: QuaternionOrder) -> Self {
        self.set_frame(match frame {
            Frame::EnuRfu => v1::Frame::EnuRfu,
            Frame::EnuFlu => v1::Frame::EnuFlu,
            Frame::NwuFlu => v1::Frame::NwuFlu,
            Frame::NedFrd => v1::Frame::NedFrd,
        });
        self.set_quaternion_order(match order {
            QuaternionOrder::Wxyz => v1::QuaternionOrder::Wxyz,
            QuaternionOrder::Xyzw => v1::QuaternionOrder::Xyzw,
        });
        self
    }

    /// The frame of the samples, and how their sender orders a quaternion without names; `None` where it says neither, or one of a later version.
    pub fn frame_said(&self) -> Option<(Frame, QuaternionOrder)> {
        let frame = match v1::Frame::try_from(self.frame).ok()? {
            v1::Frame::Unspecified => return None,
            v1::Frame::EnuRfu => Frame::EnuRfu,
            v1::Frame::EnuFlu => Frame::EnuFlu,
            v1::Frame::NwuFlu => Frame::NwuFlu,
            v1::Frame::NedFrd => Frame::NedFrd,
        };
        let order = match v1::QuaternionOrder::try_from(self.quaternion_order).ok()? {
            v1::QuaternionOrder::Unspecified => return None,
            v1::QuaternionOrder::Wxyz => QuaternionOrder::Wxyz,
            v1::QuaternionOrder::Xyzw => QuaternionOrder::Xyzw,
        };
        Some((frame, order))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_frame_and_order_comes_back_and_nothing_said_is_none() {
        for (_, frame) in Frame::NAMES {
            for (_, order) in QuaternionOrder::NAMES {
                assert_eq!(Envelope::default().in_frame(frame, order).frame_said(), Some((frame, order)));
            }
        }
        assert_eq!(Envelope::default().frame_said(), None);
        assert_eq!(Envelope { frame: 99, quaternion_order: 1, ..Envelope::default() }.frame_said(), None);
    }
}
