//! Failure of a command, and its exit code.

use std::{fmt::Display, process::ExitCode};

use bus::BusError;
use calibrate::Rejection;
use campaign::CampaignError;
use control::ControlError;
use flight::FlightError;
use import::{ImportError, MappingError};
use launch::{EditError, LaunchError};
use mapping::names::UnknownName;
use observe::readings::ReadingsError;
use papers::PaperError;
use readings::source::SourceError;
use recording::RecordingError;
use score::ScoreError;

use crate::stdout::write_line;

/// Error that ends a command, with the exit code. It is reported by [`Failure::report`].
#[derive(Debug)]
pub(crate) struct Failure {
    message: String,
    code: u8,
}

/// Exit code of a command, or its failure before a result was printed.
pub(crate) type Outcome = Result<ExitCode, Failure>;

impl Failure {
    pub(crate) fn new(error: impl Display, code: u8) -> Self {
        Self { message: error.to_string(), code }
    }

    /// Reports the failure of a command that has not printed a result.
    pub(crate) fn report(&self) -> ExitCode {
        print_error_object(&self.message);
        fail_after_result(&self.message, self.code)
    }
}

/// Adds an exit code to the error of a result.
pub(crate) trait OrFail<T> {
    fn or_fail(self, code: u8) -> Result<T, Failure>;
}

impl<T, E: Display> OrFail<T> for Result<T, E> {
    fn or_fail(self, code: u8) -> Result<T, Failure> {
        self.map_err(|error| Failure::new(error, code))
    }
}

/// Implements the conversion to [`Failure`] for errors with the same exit code in every command.
macro_rules! exit_codes {
    ($($(#[$attribute:meta])* $error:ty => $code:expr;)*) => { $(
        $(#[$attribute])*
        impl From<$error> for Failure {
            fn from(error: $error) -> Self {
                let code: fn(&$error) -> u8 = $code;
                Self::new(&error, code(&error))
            }
        }
    )* };
}

exit_codes! {
    BusError => |_| 1;
    CampaignError => |_| 1;
    ControlError => |_| 1;
    EditError => |_| 1;
    FlightError => |_| 3;
    ImportError => ImportError::exit_code;
    LaunchError => |_| 3;
    PaperError => |_| 1;
    ReadingsError => |_| 1;
    RecordingError => |_| 3;
    Rejection => |_| 1;
    ScoreError => ScoreError::exit_code;
    SourceError => |_| 1;
    UnknownName => |_| 2;
    bridges::datagrams::DatagramError => |_| 1;
    driver::DriverError => |_| 1;
    #[cfg(feature = "cockpit")]
    cockpit::server::ServerError => |_| 1;
    #[cfg(feature = "cockpit")]
    cockpit::token::TokenError => |_| 1;
    #[cfg(feature = "network")]
    keys::KeysError => keys::KeysError::exit_code;
    #[cfg(feature = "network")]
    link::LinkError => |_| 1;
    #[cfg(feature = "network")]
    remote::RemoteError => remote::RemoteError::exit_code;
}

impl From<MappingError> for Failure {
    fn from(error: MappingError) -> Self {
        ImportError::from(error).into()
    }
}

/// Reports the error of a command that has already printed its result.
pub(crate) fn fail_after_result(error: &dyn Display, code: u8) -> ExitCode {
    supervisor::announce(error);
    ExitCode::from(code)
}

/// Prints `{"error": …}` if `--json` was given, so that scripts always get an object.
pub(crate) fn print_error_object(error: &dyn Display) {
    if std::env::args_os().any(|argument| argument == "--json") {
        // If the output is closed, the exit code still reports the failure.
        let _ = write_line(&serde_json::json!({ "error": error.to_string().trim_end() }));
    }
}
