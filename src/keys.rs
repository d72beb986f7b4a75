//! `plumb keys`: who may do what beyond the board.

use std::{path::PathBuf, process::ExitCode};

use ::keys::{Host, Keys, KeysError, Party, Role, Written, certificate::DAYS};
use clap::{Args, Subcommand};
use serde::Serialize;

use crate::{fail, fail_after_result, out::print};

/// Certificates that end sooner are pointed at, days.
const SOON_DAYS: i64 = 30;

/// What is to be done with keys.
#[derive(Subcommand)]
pub(crate) enum Command {
    /// Make an authority of one's own, and the router's certificate.
    Init {
        #[command(flatten)]
        router: Router,
        #[command(flatten)]
        made: Made,
    },
    /// Make the router's certificate anew: for other hosts, or before it ends.
    Router {
        #[command(flatten)]
        router: Router,
        #[command(flatten)]
        made: Made,
    },
    /// Make a certificate for a vehicle: it publishes and takes commands below its own name.
    Vehicle {
        #[command(flatten)]
        named: Named,
        /// An IPv4 address or name at which it listens itself, without a router; several may be given.
        #[arg(long = "host", value_name = "HOST")]
        hosts: Vec<String>,
        /// Another vehicle whose ticks it takes, as the two are hosts of one system; several may be given.
        #[arg(long, value_name = "VEHICLE")]
        imports: Vec<String>,
    },
    /// Make a certificate for an operator: reads everything and commands.
    Operator(Named),
    /// Make a certificate for a viewer: reads everything.
    Viewer(Named),
    /// Take a party from the access list for ever.
    Revoke {
        /// Who, as `plumb keys list` says it: vehicle.NAME, operator.NAME or viewer.NAME.
        party: String,
        #[command(flatten)]
        place: KeyFolder,
    },
    /// Who has a certificate, and until when.
    List(KeyFolder),
    /// Like list, and fails when a certificate has ended or ends within 30 days.
    Check(KeyFolder),
}

/// Where the router is found.
#[derive(Args)]
pub(crate) struct Router {
    /// Its IPv4 address or name, as vehicles and ground reach it; several may be given.
    #[arg(long = "router", value_name = "HOST", default_value = "127.0.0.1")]
    hosts: Vec<String>,
}

/// Whose certificate.
#[derive(Args)]
pub(crate) struct Named {
    /// 1 to 32 of a-z, 0-9, - and _.
    name: String,
    #[command(flatten)]
    made: Made,
}

/// How it is made.
#[derive(Args)]
pub(crate) struct Made {
    /// Validity in days.
    #[arg(long, default_value_t = DAYS)]
    days: u32,
    /// Replace what is there.
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    place: KeyFolder,
}

/// The folder of keys.
#[derive(Args)]
pub(crate) struct KeyFolder {
    /// The folder.
    #[arg(long, default_value = "keys")]
    dir: PathBuf,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(command: Command) -> ExitCode {
    let done = match command {
        Command::Init { router, made } => init(&router, &made),
        Command::Router { router, made } => {
            let written = |keys: Keys| keys.router(&parsed(&router.hosts)?, made.days, made.force);
            made.place.open().and_then(written).map(|written| show(&[written], &made.place))
        }
        Command::Vehicle { named, hosts, imports } => vehicle(&named, &hosts, &imports),
        Command::Operator(named) => named.issue(Role::Operator, &[], &[]),
        Command::Viewer(named) => named.issue(Role::Viewer, &[], &[]),
        Command::Revoke { party, place } => revoke(&party, &place),
        Command::List(place) => list(&place, false),
        Command::Check(place) => list(&place, true),
    };
    done.unwrap_or_else(|error| fail(&error, error.exit_code()))
}

fn init(router: &Router, made: &Made) -> Result<ExitCode, KeysError> {
    let (_, written) = Keys::init(&made.place.dir, &parsed(&router.hosts)?, made.days, made.force)?;
    Ok(show(&written, &made.place))
}

fn vehicle(named: &Named, hosts: &[String], imports: &[String]) -> Result<ExitCode, KeysError> {
    let imports: Vec<_> = imports.iter().map(|name| Party::new(Role::Vehicle, name)).collect::<Result<_, _>>()?;
    named.issue(Role::Vehicle, &parsed(hosts)?, &imports)
}

fn revoke(party: &str, place: &KeyFolder) -> Result<ExitCode, KeysError> {
    let party: Party = party.parse()?;
    place.open()?.revoke(&party)?;
    if place.json {
        return Ok(json(&serde_json::json!({ "revoked": party })));
    }
    let router = place.dir.join("router");
    Ok(print(&format_args!(
        "{party} is revoked once {} is copied to the router and the router restarted",
        router.display()
    )))
}

fn list(place: &KeyFolder, judged: bool) -> Result<ExitCode, KeysError> {
    let holders = place.open()?.holders()?;
    let due: Vec<_> = holders.iter().filter(|it| !it.revoked && it.days_left < SOON_DAYS).collect();
    let printed = if place.json {
        json(&holders)
    } else {
        let line = |holder: &::keys::Holder| {
            let state = match (holder.revoked, holder.days_left) {
                (true, _) => "revoked".to_owned(),
                (false, ..0) => "ended".to_owned(),
                (false, days) => format!("{days} days left"),
            };
            let imports: String = holder.imports.iter().map(|from| format!(", takes the ticks of {from}")).collect();
            format!("{:<42}until {}  {state}{imports}", holder.name, holder.until)
        };
        print(&holders.iter().map(line).collect::<Vec<_>>().join("\n"))
    };
    if judged && !due.is_empty() {
        let names: Vec<_> = due.iter().map(|holder| holder.name.as_str()).collect();
        return Ok(fail_after_result(
            &format_args!("ended or about to: {}; make them anew with --force", names.join(", ")),
            1,
        ));
    }
    Ok(printed)
}

/// What was written, and what to do with it.
fn show(written: &[Written], place: &KeyFolder) -> ExitCode {
    if place.json {
        return json(&written);
    }
    let mut lines = Vec::new();
    for one in written {
        lines.push(format!("{}, valid until {}:", one.name, one.until));
        lines.extend(one.files.iter().map(|file| format!("  {}", file.display())));
        lines.push(match one.copy_to {
            Some(to) => format!("  copy {} to {to} of that machine", one.folder.display()),
            None => "  authority.key stays here: whoever has it can be anybody".into(),
        });
    }
    if written.iter().all(|one| one.name != "router") {
        let router = place.dir.join("router/router.json5");
        lines.push(format!("the router knows them once it has the new {} and is restarted", router.display()));
    }
    print(&lines.join("\n"))
}

fn json(value: &impl Serialize) -> ExitCode {
    print(&serde_json::to_string(value).unwrap_or_default())
}

fn parsed(hosts: &[String]) -> Result<Vec<Host>, KeysError> {
    hosts.iter().map(|host| host.parse()).collect()
}

impl Named {
    fn issue(&self, role: Role, hosts: &[Host], imports: &[Party]) -> Result<ExitCode, KeysError> {
        let Self { name, made } = self;
        let party = Party::new(role, name)?;
        let written = made.place.open()?.issue(&party, hosts, imports, made.days, made.force)?;
        Ok(show(&[written], &made.place))
    }
}

impl KeyFolder {
    fn open(&self) -> Result<Keys, KeysError> {
        Keys::open(&self.dir)
    }
}
