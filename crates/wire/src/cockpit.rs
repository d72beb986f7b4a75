//! Messages exchanged with the cockpit page.

use prost::encoding::{self, WireType};

use crate::{
    DecodeError,
    command::{ControlMessage, MAX_NAME_BYTES, check_parameters, check_text},
    v1::{PageCommand, Snapshot, ToPage, page_command::Kind},
};

/// Field number of `Snapshots.snapshots`.
const SNAPSHOTS_FIELD: u32 = 1;

/// Encodes a `Snapshots` message from `Snapshot` messages that are encoded already.
pub fn encode_snapshots<'p>(encoded: impl IntoIterator<Item = &'p [u8]>) -> Vec<u8> {
    let mut bytes = Vec::new();
    for snapshot in encoded {
        encoding::encode_key(SNAPSHOTS_FIELD, WireType::LengthDelimited, &mut bytes);
        encoding::encode_varint(snapshot.len() as u64, &mut bytes);
        bytes.extend_from_slice(snapshot);
    }
    bytes
}

impl ControlMessage for ToPage {
    const NAME: &'static str = "ToPage";

    fn validate(&self) -> Result<(), DecodeError> {
        self.content.as_ref().ok_or(DecodeError::Missing { field: "content" }).map(drop)
    }
}

impl ControlMessage for Snapshot {
    const NAME: &'static str = "Snapshot";

    fn validate(&self) -> Result<(), DecodeError> {
        Ok(())
    }
}

impl ControlMessage for PageCommand {
    const NAME: &'static str = "PageCommand";

    fn validate(&self) -> Result<(), DecodeError> {
        let Self { request_id, token, slot, stage, what, set, .. } = self;
        check_parameters(Self::NAME, set.iter().map(|setting| (&*setting.name, setting.value)))?;
        for (field, value) in
            [("request_id", request_id), ("token", token), ("slot", slot), ("stage", stage), ("what", what)]
        {
            check_text(value, field, MAX_NAME_BYTES)?;
        }
        let needs_slot = matches!(self.kind(), Kind::Swap | Kind::Shadow | Kind::Cancel);
        let needs_stage = matches!(self.kind(), Kind::Swap | Kind::Shadow);
        let missing = |field| Err(DecodeError::Missing { field });
        match self {
            Self { request_id, .. } if request_id.is_empty() => missing("request_id"),
            Self { slot, .. } if slot.is_empty() && needs_slot => missing("slot"),
            Self { stage, .. } if stage.is_empty() && needs_stage => missing("stage"),
            _ if self.kind() == Kind::Unspecified => missing("kind"),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{command::MAX_PARAMETERS, v1::Setting};

    fn setting(name: &str, value: f64) -> Setting {
        Setting { name: name.into(), value }
    }

    fn command() -> PageCommand {
        let [request_id, token, slot, stage] = ["1", "t", "fuser", "vqf"].map(String::from);
        PageCommand { request_id, token, kind: Kind::Swap.into(), slot, stage, ..PageCommand::default() }
    }

    #[test]
    fn snapshots_concatenate_into_one_message() {
        let all = [7, 300].map(|number| Snapshot { number, ..Snapshot::default() });
        let encoded = all.clone().map(|snapshot| snapshot.to_bytes());
        let read: crate::v1::Snapshots =
            prost::Message::decode(&*encode_snapshots(encoded.iter().map(Vec::as_slice))).unwrap();
        assert_eq!(read.snapshots, all);
    }

    #[test]
    fn page_command_rejects_missing_and_oversized_fields() {
        assert_eq!(PageCommand::from_bytes(&command().to_bytes()).unwrap(), command());
        let with_parameters = PageCommand { set: vec![setting("beta_1_s", 1.0); MAX_PARAMETERS], ..command() };
        assert_eq!(PageCommand::from_bytes(&with_parameters.to_bytes()).unwrap(), with_parameters);
        let cancel = PageCommand { kind: Kind::Cancel.into(), stage: String::new(), ..command() };
        assert_eq!(PageCommand::from_bytes(&cancel.to_bytes()).unwrap(), cancel);
        let view = PageCommand { kind: Kind::View.into(), slot: String::new(), ..cancel };
        assert_eq!(PageCommand::from_bytes(&view.to_bytes()).unwrap(), view);
        let calibrate = PageCommand { kind: Kind::Calibrate.into(), what: "mag".into(), ..view };
        assert_eq!(PageCommand::from_bytes(&calibrate.to_bytes()).unwrap(), calibrate);
        for wrong in [
            PageCommand { kind: 0, ..command() },
            PageCommand { kind: 9, ..command() },
            PageCommand { stage: String::new(), ..command() },
            PageCommand { slot: String::new(), ..command() },
            PageCommand { request_id: String::new(), ..command() },
            PageCommand { token: "x".repeat(MAX_NAME_BYTES + 1), ..command() },
            PageCommand { stage: "a\u{7}b".into(), ..command() },
            PageCommand { what: "x".repeat(MAX_NAME_BYTES + 1), ..calibrate },
            PageCommand { set: vec![setting("beta_1_s", f64::NAN)], ..command() },
            PageCommand { set: vec![setting("a\u{7}b", 1.0)], ..command() },
            PageCommand { set: vec![setting("beta_1_s", 1.0); MAX_PARAMETERS + 1], ..command() },
        ] {
            assert!(PageCommand::from_bytes(&wrong.to_bytes()).is_err(), "{wrong:?}");
        }
        assert!(PageCommand::from_bytes(&[0xff; 40]).is_err());
    }
}
