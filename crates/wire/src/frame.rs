//! Coordinate frame and quaternion order that an envelope declares for its samples.

use attitude::frames::{Frame, QuaternionOrder};

use crate::v1::{self, Envelope};

impl Envelope {
    /// Sets the frame and quaternion order of the samples.
    pub fn with_frame(mut self, frame: Frame, order: QuaternionOrder) -> Self {
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

    /// Returns the frame of the samples and the quaternion order of the publishing vehicle.
    ///
    /// Returns `None` if either is unspecified or unknown to this version.
    pub fn frame_and_order(&self) -> Option<(Frame, QuaternionOrder)> {
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
    fn frame_and_order_round_trip_through_envelope() {
        for (_, frame) in Frame::NAMES {
            for (_, order) in QuaternionOrder::NAMES {
                assert_eq!(Envelope::default().with_frame(frame, order).frame_and_order(), Some((frame, order)));
            }
        }
        assert_eq!(Envelope::default().frame_and_order(), None);
        assert_eq!(Envelope { frame: 99, quaternion_order: 1, ..Envelope::default() }.frame_and_order(), None);
    }
}
