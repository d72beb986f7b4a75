//! Messages of a bag.

use std::rc::Rc;

use foreign::ForeignText;

use super::topics::Topic;
use crate::ImportError;

/// Message on a readable topic.
pub(super) struct Message {
    pub(super) topic: Rc<Topic>,
    /// Time at which the message was logged, ns since 1970.
    pub(super) log_ns: i64,
    pub(super) data: Vec<u8>,
}

/// Error while reading the next message. After damage, reading continues with the next file; a
/// fatal error ends the import.
pub(super) enum ReadError {
    Fatal(ImportError),
    Damage(ForeignText),
}
