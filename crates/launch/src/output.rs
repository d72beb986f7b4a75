//! In which frame the attitude leaves the system: `[output]`.

use attitude::frames::{Frame, QuaternionOrder};
use serde::{Deserialize, Serialize};

use crate::walk::Section;

/// In which frame and order the attitude is given to others.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(try_from = "Names", into = "Names")]
pub struct Output {
    /// Reference and body axes.
    pub frame: Frame,
    /// The order of a quaternion's parts, where they have no names.
    pub quaternion: QuaternionOrder,
}

/// Reads `[output]`.
pub(crate) fn output(section: &mut Section<'_, '_>, out: &mut Output) {
    section.choice("frame", Frame::NAMES, &mut out.frame);
    section.choice("quaternion", QuaternionOrder::NAMES, &mut out.quaternion);
}

/// What a service is told.
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
        fn of<T: Copy>(names: &[(&str, T)], found: &str) -> Result<T, String> {
            let known = names.iter().find(|(name, _)| *name == found).map(|(_, value)| *value);
            known.ok_or_else(|| format!("reading the output's frame: there is none of the name {found:?}"))
        }
        Ok(Self { frame: of(&Frame::NAMES, &frame)?, quaternion: of(&QuaternionOrder::NAMES, &quaternion)? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Launch;

    #[test]
    fn frame_and_order_are_taken_and_go_to_a_service_as_they_are() {
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
    fn a_wrong_name_is_answered_by_the_one_that_was_meant() {
        for (text, said) in [
            ("output.frame = \"ned-fdr\"", "did you mean \"ned-frd\"?"),
            ("output.frame = \"ENU-FLU\"", "did you mean \"enu-flu\"?"),
            ("output.quaternion = \"xyzx\"", "did you mean \"xyzw\"?"),
            ("output.frames = \"ned-frd\"", "did you mean \"frame\"?"),
            ("ingest.mounting.axes = \"fru\"", "did you mean \"rfu\"?"),
            ("ingest.mounting.axes = \"FRD\"", "did you mean \"frd\"?"),
            ("ingest.mounting.axes = \"x-foward-y-right\"", "did you mean \"x-forward-y-right\"?"),
        ] {
            let shown = Launch::parse("launch.toml", text).unwrap_err().to_string();
            assert!(shown.contains(said) && shown.ends_with("1 problem"), "{said}:\n{shown}");
        }
    }
}
