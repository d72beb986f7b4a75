//! `plumb service`: runs one service of a system as this process.

use std::process::ExitCode;

use launch::Service;
use mapping::names::UnknownName;

#[cfg(not(feature = "cockpit"))]
use crate::absent::cockpit;
#[cfg(not(feature = "network"))]
use crate::absent::gateway;
use crate::failure::{OrFail as _, Outcome};

/// Expands to a `match` that calls the function `run` of the crate of each service.
macro_rules! run_service {
    ({ $service:expr }
        $($group:ident { $($(#[$doc:meta])* $Service:ident = $name:ident: $($property:ident)*;)* })*
    ) => {
        match $service { $($(Service::$Service => $name::run().or_fail(1),)*)* }
    };
}

/// Runs a service with the function `run` of the crate that has its name.
pub(crate) fn run(service: Service) -> Outcome {
    graph::services!(run_service { service }).map(|()| ExitCode::SUCCESS)
}

/// Parses the name of a service.
pub(crate) fn parse(name: &str) -> Result<Service, String> {
    let unknown = || UnknownName::new("service", name, Service::ALL.map(Service::name));
    Service::from_name(name).ok_or_else(|| unknown().to_string())
}
