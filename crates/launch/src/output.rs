//! Reference frame of published attitudes: `[output]`.

use attitude::frames::{Frame, QuaternionOrder};
use serde::{Deserialize, Serialize};

use crate::{keys::keys, kind::one_of};

keys! {
    /// Frame and quaternion order of attitudes for output.
    #[derive(Copy, Eq)]
    #[serde(try_from = "Names", into = "Names")]
    pub struct Output {
        /// Reference and body axes: "enu-rfu" is east-north-up and right-forward-up, "enu-flu" is
        /// that of ROS, "ned-frd" that of PX4 and ArduPilot.
        frame: Frame = Frame::default(), one_of(Frame::NAMES);
        /// Order of a quaternion's components in formats that do not name the components.
        quaternion: QuaternionOrder = QuaternionOrder::default(), one_of(QuaternionOrder::NAMES);
    }
}

/// Serialised form of [`Output`].
#[derive(Serialize, Deserialize)]
struct Names {
    frame: String,
    quaternion: String,
}

impl From<Output> for Names {
    fn from(Output { frame, quaternion }: Output) -> Self {
        Self { frame: frame.name().into(), quaternion: quaternion.name().into() }
    }
}

impl TryFrom<Names> for Output {
    type Error = String;

    fn try_from(Names { frame, quaternion }: Names) -> Result<Self, String> {
        fn lookup<T: Copy>(names: &[(&str, T)], found: &str) -> Result<T, String> {
            let known = names.iter().find(|(name, _)| *name == found).map(|(_, value)| *value);
            known.ok_or_else(|| format!("unknown frame or quaternion order {found:?} in the output settings"))
        }
        Ok(Self { frame: lookup(&Frame::NAMES, &frame)?, quaternion: lookup(&QuaternionOrder::NAMES, &quaternion)? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Launch;

    #[test]
    fn frame_and_order_are_read_and_serialised() {
        assert_eq!(Launch::parse("x", "").unwrap().output, Output::default());
        for (frame, order) in
            Frame::NAMES.into_iter().flat_map(|frame| QuaternionOrder::NAMES.map(|order| (frame, order)))
        {
            let text = format!("[output]\nframe = {:?}\nquaternion = {:?}", frame.0, order.0);
            let output = Launch::parse("x", &text).unwrap().output;
            assert_eq!(output, Output { frame: frame.1, quaternion: order.1 });
            assert_eq!(Names::from(output).try_into(), Ok(output));
        }
    }

    #[test]
    fn misspelt_name_is_rejected_with_suggestion() {
        for (text, expected) in [
            ("output.frame = \"ned-fdr\"", "did you mean \"ned-frd\"?"),
            ("output.frame = \"ENU-FLU\"", "did you mean \"enu-flu\"?"),
            ("output.quaternion = \"xyzx\"", "did you mean \"xyzw\"?"),
            ("output.frames = \"ned-frd\"", "did you mean \"frame\"?"),
            ("ingest.mounting.axes = \"fru\"", "did you mean \"rfu\"?"),
            ("ingest.mounting.axes = \"FRD\"", "did you mean \"frd\"?"),
            ("ingest.mounting.axes = \"x-foward-y-right\"", "did you mean \"x-forward-y-right\"?"),
        ] {
            let shown = Launch::parse("launch.toml", text).unwrap_err().to_string();
            assert!(shown.contains(expected) && shown.ends_with("1 problem"), "{expected}:\n{shown}");
        }
    }
}
