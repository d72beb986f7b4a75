//! What the cockpit's page is told and asks for.

use prost::encoding::{self, WireType};

use crate::{
    Refusal,
    command::{ControlMessage, NAME_MAX, text},
    v1::{PageCommand, Picture, ToPage, page_command::Kind},
};

/// The field of `Pictures`.
const PICTURES: u32 = 1;

/// Encoded pictures as one message `Pictures`.
pub fn pictures<'p>(encoded: impl IntoIterator<Item = &'p [u8]>) -> Vec<u8> {
    let mut bytes = Vec::new();
    for picture in encoded {
        encoding::encode_key(PICTURES, WireType::LengthDelimited, &mut bytes);
        encoding::encode_varint(picture.len() as u64, &mut bytes);
        bytes.extend_from_slice(picture);
    }
    bytes
}

impl ControlMessage for ToPage {
    const NAME: &'static str = "ToPage";

    fn check(&self) -> Result<(), Refusal> {
        self.said.as_ref().ok_or(Refusal::Missing { field: "said" }).map(drop)
    }
}

impl ControlMessage for Picture {
    const NAME: &'static str = "Picture";

    fn check(&self) -> Result<(), Refusal> {
        Ok(())
    }
}

impl ControlMessage for PageCommand {
    const NAME: &'static str = "PageCommand";

    fn check(&self) -> Result<(), Refusal> {
        let Self { request_id, token, slot, stage, what, .. } = self;
        for (field, value) in
            [("request_id", request_id), ("token", token), ("slot", slot), ("stage", stage), ("what", what)]
        {
            text(value, field, NAME_MAX)?;
        }
        let is_of_a_slot = matches!(self.kind(), Kind::Swap | Kind::Shadow | Kind::Cancel);
        let is_of_a_stage = matches!(self.kind(), Kind::Swap | Kind::Shadow);
        let missing = |field| Err(Refusal::Missing { field });
        match self {
            Self { request_id, .. } if request_id.is_empty() => missing("request_id"),
            Self { slot, .. } if slot.is_empty() && is_of_a_slot => missing("slot"),
            Self { stage, .. } if stage.is_empty() && is_of_a_stage => missing("stage"),
            _ if self.kind() == Kind::Unspecified => missing("kind"),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn command() -> PageCommand {
        let [request_id, token, slot, stage] = ["1", "t", "fuser", "vqf"].map(String::from);
        PageCommand { request_id, token, kind: Kind::Swap.into(), slot, stage, ..PageCommand::default() }
    }

    #[test]
    fn encoded_pictures_are_one_message() {
        let all = [7, 300].map(|number| Picture { number, ..Picture::default() });
        let encoded = all.clone().map(|picture| picture.encoded());
        let read: crate::v1::Pictures = prost::Message::decode(&*pictures(encoded.iter().map(Vec::as_slice))).unwrap();
        assert_eq!(read.pictures, all);
    }

    #[test]
    fn a_command_lacks_nothing_and_is_short() {
        assert_eq!(PageCommand::decoded(&command().encoded()).unwrap(), command());
        let cancel = PageCommand { kind: Kind::Cancel.into(), stage: String::new(), ..command() };
        assert_eq!(PageCommand::decoded(&cancel.encoded()).unwrap(), cancel);
        let look = PageCommand { kind: Kind::Look.into(), slot: String::new(), ..cancel };
        assert_eq!(PageCommand::decoded(&look.encoded()).unwrap(), look);
        let calibrate = PageCommand { kind: Kind::Calibrate.into(), what: "mag".into(), ..look };
        assert_eq!(PageCommand::decoded(&calibrate.encoded()).unwrap(), calibrate);
        for wrong in [
            PageCommand { kind: 0, ..command() },
            PageCommand { kind: 9, ..command() },
            PageCommand { stage: String::new(), ..command() },
            PageCommand { slot: String::new(), ..command() },
            PageCommand { request_id: String::new(), ..command() },
            PageCommand { token: "x".repeat(NAME_MAX + 1), ..command() },
            PageCommand { stage: "a\u{7}b".into(), ..command() },
            PageCommand { what: "x".repeat(NAME_MAX + 1), ..calibrate },
        ] {
            assert!(PageCommand::decoded(&wrong.encoded()).is_err(), "{wrong:?}");
        }
        assert!(PageCommand::decoded(&[0xff; 40]).is_err());
    }
}
