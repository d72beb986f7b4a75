//! What a running system can be asked, read from bytes that come from anywhere.

use prost::Message;

use crate::{
    Refusal,
    refusal::{malformed, within_size},
    v1::{Envelope, GatewayReport, Services, SwapAnswer, SwapRequest},
};

/// Letters of a name at most.
pub const NAME_MAX: usize = 64;
/// Parameters in a request at most.
pub const PARAMETERS_MAX: usize = 32;
/// Services in an answer at most.
const SERVICES_MAX: usize = 64;
/// Letters of what is said to people at most.
const REASON_MAX: usize = 4096;

/// A message that is sent alone.
pub trait ControlMessage: Message + Default {
    /// Its name in `plumbline.v1`.
    const NAME: &'static str;

    /// Refuses what it cannot say.
    fn check(&self) -> Result<(), Refusal>;

    /// The message as bytes.
    fn encoded(&self) -> Vec<u8> {
        self.encode_to_vec()
    }

    /// The message of bytes from anywhere, checked.
    fn decoded(bytes: &[u8]) -> Result<Self, Refusal> {
        within_size(bytes)?;
        let letter = Self::decode(bytes).map_err(malformed(Self::NAME))?;
        letter.check()?;
        Ok(letter)
    }
}

impl ControlMessage for SwapRequest {
    const NAME: &'static str = "SwapRequest";

    fn check(&self) -> Result<(), Refusal> {
        for (field, name) in [("request_id", &self.request_id), ("slot", &self.slot), ("stage", &self.stage)] {
            text(name, field, NAME_MAX)?;
            if name.is_empty() {
                return Err(Refusal::Missing { field });
            }
        }
        if self.set.len() > PARAMETERS_MAX {
            return Err(Refusal::TooMany { message: Self::NAME, what: "parameters", max: PARAMETERS_MAX });
        }
        for (name, value) in &self.set {
            text(name, "set", NAME_MAX)?;
            finite(*value, "set")?;
        }
        if self.expected_epoch == 0 {
            return Err(Refusal::Missing { field: "expected_epoch" });
        }
        if self.t_deadline_ns == 0 {
            return Err(Refusal::Missing { field: "t_deadline_ns" });
        }
        Ok(())
    }
}

impl ControlMessage for SwapAnswer {
    const NAME: &'static str = "SwapAnswer";

    fn check(&self) -> Result<(), Refusal> {
        text(&self.reason, "reason", REASON_MAX)?;
        finite(self.gap_s, "gap_s")?;
        finite(self.jump_rad, "jump_rad")
    }
}

impl ControlMessage for Services {
    const NAME: &'static str = "Services";

    fn check(&self) -> Result<(), Refusal> {
        if self.services.len() > SERVICES_MAX {
            return Err(Refusal::TooMany { message: Self::NAME, what: "services", max: SERVICES_MAX });
        }
        self.services.iter().try_for_each(|service| text(&service.service, "service", NAME_MAX))
    }
}

impl ControlMessage for GatewayReport {
    const NAME: &'static str = "GatewayReport";

    fn check(&self) -> Result<(), Refusal> {
        if self.topics.len() > SERVICES_MAX {
            return Err(Refusal::TooMany { message: Self::NAME, what: "topics", max: SERVICES_MAX });
        }
        self.envelope.ok_or(Refusal::Missing { field: "envelope" }).map(|_: Envelope| ())
    }
}

/// Refuses a text that is long or has control characters.
pub(crate) fn text(text: &str, field: &'static str, max: usize) -> Result<(), Refusal> {
    if text.len() <= max && !text.chars().any(|letter| letter.is_control() && letter != '\n') {
        return Ok(());
    }
    let value = format!("{} bytes", text.len());
    Err(Refusal::OutOfRange { field, value, expected: "a short text without control characters" })
}

fn finite(number: f64, field: &'static str) -> Result<(), Refusal> {
    if number.is_finite() { Ok(()) } else { Err(Refusal::NotFinite { field }) }
}
