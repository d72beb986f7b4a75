//! Stand-ins for the commands and services of features that this build lacks.
//!
//! Each submodule has the interface of the module that it replaces. Its commands accept any
//! arguments and fail with [`MissingFeature`].

#[cfg(not(all(feature = "network", feature = "cockpit", feature = "tui")))]
use std::ffi::OsString;

use launch::{Launch, Service};

use crate::failure::Failure;

/// A command, option or service needs a feature that this build lacks.
#[derive(Debug, thiserror::Error)]
#[error("{what} needs the feature `{feature}`, which this build lacks; rebuild plumb with --features {feature}")]
pub(crate) struct MissingFeature {
    pub(crate) what: &'static str,
    pub(crate) feature: &'static str,
}

impl From<MissingFeature> for Failure {
    fn from(error: MissingFeature) -> Self {
        Self::new(error, 2)
    }
}

/// Returns the services that this build lacks, each with the feature that adds it.
pub(crate) fn absent_services() -> Vec<(Service, &'static str)> {
    let optional = [
        (Service::Gateway, "network", cfg!(feature = "network")),
        (Service::Cockpit, "cockpit", cfg!(feature = "cockpit")),
    ];
    optional
        .into_iter()
        .filter(|(.., is_present)| !is_present)
        .map(|(service, feature, _)| (service, feature))
        .collect()
}

/// Returns the error for the first service that the launch file lists but this build lacks.
pub(crate) fn find_absent_service(launch: &Launch) -> Option<MissingFeature> {
    let (service, feature) = absent_services().into_iter().find(|(service, _)| launch.services.contains(service))?;
    Some(MissingFeature { what: service.name(), feature })
}

/// Arguments of a command that this build lacks.
#[cfg(not(all(feature = "network", feature = "cockpit", feature = "tui")))]
#[derive(clap::Args)]
pub(crate) struct AbsentCommand {
    #[arg(hide = true, trailing_var_arg = true, allow_hyphen_values = true)]
    arguments: Vec<OsString>,
}

/// Declares the stand-in of a service.
#[cfg(not(all(feature = "network", feature = "cockpit")))]
macro_rules! absent_service {
    ($module:ident, $feature:literal) => {
        pub(crate) mod $module {
            use crate::absent::MissingFeature;

            pub(crate) fn run() -> Result<(), MissingFeature> {
                Err(MissingFeature { what: stringify!($module), feature: $feature })
            }
        }
    };
}

/// Declares the stand-in of a command. `$argument` is the type of the parameter of `run`.
#[cfg(not(all(feature = "network", feature = "cockpit", feature = "tui")))]
macro_rules! absent_command {
    ($module:ident, $Command:ident, $argument:ty, $what:literal, $feature:expr) => {
        pub(crate) mod $module {
            pub(crate) use crate::absent::AbsentCommand as $Command;

            pub(crate) fn run(_: $argument) -> crate::failure::Outcome {
                Err(crate::absent::MissingFeature { what: $what, feature: $feature }.into())
            }
        }
    };
}

#[cfg(not(feature = "network"))]
absent_service!(gateway, "network");
#[cfg(not(feature = "cockpit"))]
absent_service!(cockpit, "cockpit");
#[cfg(not(feature = "cockpit"))]
absent_command!(view, View, &View, "plumb view", "cockpit");
#[cfg(not(feature = "tui"))]
absent_command!(top, TopCommand, TopCommand, "plumb top", "tui");
#[cfg(not(feature = "network"))]
absent_command!(station, Station, &Station, "plumb station", "network");
#[cfg(all(feature = "network", not(feature = "tui")))]
absent_command!(station, Station, &Station, "plumb station", "tui");
#[cfg(not(feature = "network"))]
absent_command!(ros, Ros, &Ros, "plumb bridge ros", "network");
#[cfg(not(feature = "network"))]
absent_command!(ros_sensor, RosSensor, &RosSensor, "plumb bridge ros-sensor", "network");

#[cfg(not(feature = "network"))]
pub(crate) mod keys {
    use std::ffi::OsString;

    #[derive(clap::Subcommand)]
    pub(crate) enum Command {
        #[allow(dead_code, reason = "any arguments are accepted")]
        #[command(external_subcommand)]
        Any(Vec<OsString>),
    }

    pub(crate) fn run(_: Command) -> crate::failure::Outcome {
        Err(crate::absent::MissingFeature { what: "plumb keys", feature: "network" }.into())
    }
}

#[cfg(not(feature = "network"))]
pub(crate) mod remote {
    use std::path::Path;

    use control::{ServiceStatus, SwapReport};
    use graph::Topic;
    use launch::StageConfig;

    pub(crate) use crate::absent::MissingFeature as RemoteError;

    pub(crate) const ERROR: RemoteError = RemoteError { what: "--remote", feature: "network" };

    /// Endpoint of a remote vehicle, which cannot be opened.
    pub(crate) struct RemoteEndpoint;

    impl RemoteEndpoint {
        pub(crate) fn new(_: &[String], _: Option<&Path>) -> Self {
            Self
        }

        pub(crate) fn open(&self) -> Result<Absent, RemoteError> {
            Err(ERROR)
        }
    }

    /// Stand-in for a link, vehicle or topic. It has no value, because none of these exists in this
    /// build.
    pub(crate) enum Absent {}

    pub(crate) use Absent as RemoteVehicle;
    pub(crate) use Absent as RemoteTopic;

    pub(crate) fn services(link: &Absent, _: &str) -> Result<Vec<ServiceStatus>, RemoteError> {
        match *link {}
    }

    pub(crate) fn swap(
        link: &Absent,
        _: &RemoteEndpoint,
        _: &str,
        _: &str,
        _: StageConfig,
    ) -> Result<SwapReport, RemoteError> {
        match *link {}
    }

    impl Absent {
        pub(crate) fn find(link: Self, _: &str) -> Result<Self, RemoteError> {
            match link {}
        }

        pub(crate) fn publishes(&self, _: Topic) -> bool {
            match *self {}
        }

        pub(crate) fn subscribe(&self, _: Topic) -> Result<Self, RemoteError> {
            match *self {}
        }

        pub(crate) fn is_reachable(&self) -> bool {
            match *self {}
        }

        pub(crate) fn unreachable_message(&self) -> String {
            match *self {}
        }

        pub(crate) fn poll(&mut self, _: usize, _: &mut OnDelivery<'_>) {
            match *self {}
        }
    }

    /// Callback for delivery statistics and messages of a remote topic.
    type OnDelivery<'a> = dyn FnMut(observe::flow::Delivery, Option<(&[u8], Option<launch::Output>)>) -> bool + 'a;
}
