//! Stand-ins for the commands and services of features that this build lacks.
//!
//! Each submodule has the interface of the module that it replaces. Its commands accept any
//! arguments and fail with [`MissingFeature`].

#[cfg(not(all(feature = "network", feature = "cockpit", feature = "tui")))]
use std::{ffi::OsString, process::ExitCode};

use launch::{Launch, Service};

/// A command, option or service needs a feature that this build lacks.
#[derive(Debug, thiserror::Error)]
#[error("{what} needs the feature `{feature}`, which this build lacks; rebuild plumb with --features {feature}")]
pub(crate) struct MissingFeature {
    pub(crate) what: &'static str,
    pub(crate) feature: &'static str,
}

/// Services that this build lacks, with their feature.
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

/// Returns the error for the first service of a launch file that this build lacks.
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

#[cfg(not(all(feature = "network", feature = "cockpit", feature = "tui")))]
fn fail(what: &'static str, feature: &'static str) -> ExitCode {
    crate::failure::fail(&MissingFeature { what, feature }, 2)
}

#[cfg(not(feature = "network"))]
pub(crate) mod gateway {
    use super::MissingFeature;

    pub(crate) fn run() -> Result<(), MissingFeature> {
        Err(MissingFeature { what: "gateway", feature: "network" })
    }
}

#[cfg(not(feature = "cockpit"))]
pub(crate) mod cockpit {
    use super::MissingFeature;

    pub(crate) fn run() -> Result<(), MissingFeature> {
        Err(MissingFeature { what: "cockpit", feature: "cockpit" })
    }
}

#[cfg(not(feature = "cockpit"))]
pub(crate) mod view {
    pub(crate) use super::AbsentCommand as View;

    pub(crate) fn run(_: &View) -> super::ExitCode {
        super::fail("plumb view", "cockpit")
    }
}

#[cfg(not(feature = "tui"))]
pub(crate) mod top {
    pub(crate) use super::AbsentCommand as TopCommand;

    pub(crate) fn run(_: TopCommand) -> super::ExitCode {
        super::fail("plumb top", "tui")
    }
}

#[cfg(not(all(feature = "network", feature = "tui")))]
pub(crate) mod station {
    pub(crate) use super::AbsentCommand as Station;

    pub(crate) fn run(_: &Station) -> super::ExitCode {
        super::fail("plumb station", if cfg!(feature = "network") { "tui" } else { "network" })
    }
}

#[cfg(not(feature = "network"))]
pub(crate) mod keys {
    use std::ffi::OsString;

    #[derive(clap::Subcommand)]
    pub(crate) enum Command {
        #[allow(dead_code, reason = "any arguments are accepted")]
        #[command(external_subcommand)]
        Any(Vec<OsString>),
    }

    pub(crate) fn run(_: Command) -> super::ExitCode {
        super::fail("plumb keys", "network")
    }
}

#[cfg(not(feature = "network"))]
pub(crate) mod ros {
    pub(crate) use super::AbsentCommand as Ros;

    pub(crate) fn run(_: &Ros) -> super::ExitCode {
        super::fail("plumb bridge ros", "network")
    }
}

#[cfg(not(feature = "network"))]
pub(crate) mod ros_sensor {
    pub(crate) use super::AbsentCommand as RosSensor;

    pub(crate) fn run(_: &RosSensor) -> super::ExitCode {
        super::fail("plumb bridge ros-sensor", "network")
    }
}

#[cfg(not(feature = "network"))]
pub(crate) mod remote {
    use std::path::Path;

    use control::{ServiceStatus, SwapReport};
    use graph::Topic;
    use launch::StageConfig;

    pub(crate) use super::MissingFeature as RemoteError;

    pub(crate) const ERROR: RemoteError = RemoteError { what: "--remote", feature: "network" };

    impl RemoteError {
        pub(crate) fn exit_code(&self) -> u8 {
            2
        }
    }

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

    /// Link, vehicle or topic, of which this build has none.
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
