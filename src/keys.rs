//! `plumb keys`: manages certificates and access lists.

use std::{path::PathBuf, process::ExitCode};

use ::keys::{Host, Keys, KeysError, Party, Role, WrittenFolder, certificate::DEFAULT_DAYS};
use clap::{Args, Subcommand};

use crate::{
    failure::{Outcome, fail_after_result},
    stdout::print,
};

/// Remaining validity below which `plumb keys check` fails, in days.
const RENEWAL_WARNING_DAYS: i64 = 30;

#[derive(Subcommand)]
pub(crate) enum Command {
    /// Create an authority and the router's certificate
    #[command(after_help = "\
Examples:
  plumb keys init --router 192.168.1.5
  plumb keys init --router router.example.net --router 10.0.0.1 --dir keys
  plumb keys init --force             # invalidates all existing certificates")]
    Init {
        #[command(flatten)]
        router: RouterArgs,
        #[command(flatten)]
        issue: IssueArgs,
    },
    /// Renew the router's certificate, optionally for other hosts
    #[command(after_help = "\
Examples:
  plumb keys router --router 192.168.1.5 --force
  plumb keys router --router router.example.net --days 90 --force")]
    Router {
        #[command(flatten)]
        router: RouterArgs,
        #[command(flatten)]
        issue: IssueArgs,
    },
    /// Create a vehicle's certificate, to publish and receive commands
    #[command(after_help = "\
Examples:
  plumb keys vehicle alpha
  plumb keys vehicle board --host 192.168.1.7 # can listen without a router
  plumb keys vehicle base --imports board     # second host of a split system")]
    Vehicle {
        #[command(flatten)]
        party: PartyArgs,
        /// IPv4 address or name at which the vehicle listens, repeatable
        #[arg(long = "host", value_name = "HOST")]
        hosts: Vec<String>,
        /// Vehicle of the same split system to import ticks from, repeatable
        #[arg(long, value_name = "VEHICLE")]
        imports: Vec<String>,
    },
    /// Create an operator's certificate, to read all data and send commands
    #[command(after_help = "\
Examples:
  plumb keys operator ann
  plumb keys operator ann --days 30 --force   # renews it")]
    Operator(PartyArgs),
    /// Create a viewer's certificate, to read all data
    #[command(after_help = "\
Examples:
  plumb keys viewer wall
  plumb keys viewer wall --days 30 --force    # renews it")]
    Viewer(PartyArgs),
    /// Revoke a certificate permanently
    #[command(after_help = "\
Examples:
  plumb keys revoke viewer.wall
  plumb keys revoke operator.ann --dir keys --json")]
    Revoke {
        /// Party: vehicle.NAME, operator.NAME or viewer.NAME
        party: String,
        #[command(flatten)]
        folder: FolderArgs,
    },
    /// List certificate holders and expiry dates
    #[command(after_help = "\
Examples:
  plumb keys list
  plumb keys list --dir keys --json")]
    List(FolderArgs),
    /// List certificates and fail if one expires within 30 days
    #[command(after_help = "\
Examples:
  plumb keys check
  plumb keys check --dir keys --json

Exit codes: 0 all valid for at least 30 days, 1 otherwise.")]
    Check(FolderArgs),
}

/// Arguments that name the router's hosts.
#[derive(Args)]
pub(crate) struct RouterArgs {
    /// IPv4 address or name of the router, repeatable
    #[arg(long = "router", value_name = "HOST", default_value = "127.0.0.1")]
    hosts: Vec<String>,
}

/// Arguments that name a party.
#[derive(Args)]
pub(crate) struct PartyArgs {
    /// Name: 1 to 32 characters of a-z, 0-9, - and _
    name: String,
    #[command(flatten)]
    issue: IssueArgs,
}

/// Arguments of a new certificate.
#[derive(Args)]
pub(crate) struct IssueArgs {
    /// Validity, days, 1 to 3650
    #[arg(long, default_value_t = DEFAULT_DAYS)]
    days: u32,
    /// Replace existing files
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    folder: FolderArgs,
}

/// Arguments that select the key folder.
#[derive(Args)]
pub(crate) struct FolderArgs {
    /// Key folder
    #[arg(long, default_value = "keys")]
    dir: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(command: Command) -> Outcome {
    match command {
        Command::Init { router, issue } => init(&router, &issue),
        Command::Router { router, issue } => {
            let keys = issue.folder.open()?;
            let written = keys.router(&parse_hosts(&router.hosts)?, issue.days, issue.force)?;
            Ok(print_written(&[written], &issue.folder))
        }
        Command::Vehicle { party, hosts, imports } => vehicle(&party, &hosts, &imports),
        Command::Operator(party) => party.issue(Role::Operator, &[], &[]),
        Command::Viewer(party) => party.issue(Role::Viewer, &[], &[]),
        Command::Revoke { party, folder } => revoke(&party, &folder),
        Command::List(folder) => list(&folder, false),
        Command::Check(folder) => list(&folder, true),
    }
}

fn init(router: &RouterArgs, issue: &IssueArgs) -> Outcome {
    let (_, written) = Keys::init(&issue.folder.dir, &parse_hosts(&router.hosts)?, issue.days, issue.force)?;
    Ok(print_written(&written, &issue.folder))
}

fn vehicle(party: &PartyArgs, hosts: &[String], imports: &[String]) -> Outcome {
    let imports: Vec<_> = imports.iter().map(|name| Party::new(Role::Vehicle, name)).collect::<Result<_, _>>()?;
    party.issue(Role::Vehicle, &parse_hosts(hosts)?, &imports)
}

fn revoke(party: &str, folder: &FolderArgs) -> Outcome {
    let party: Party = party.parse()?;
    folder.open()?.revoke(&party)?;
    if folder.json {
        return Ok(print(&serde_json::json!({ "revoked": party })));
    }
    let router = folder.dir.join("router");
    Ok(print(&format_args!(
        "{party} revoked; to apply it, copy {} to the router and restart the router",
        foreign::path(&router)
    )))
}

fn list(folder: &FolderArgs, fail_if_due: bool) -> Outcome {
    let holders = folder.open()?.holders()?;
    let due: Vec<_> = holders.iter().filter(|it| !it.revoked && it.days_left < RENEWAL_WARNING_DAYS).collect();
    let printed = if folder.json {
        print(&serde_json::json!({ "holders": holders }))
    } else {
        let line = |holder: &::keys::Holder| {
            let state = match (holder.revoked, holder.days_left) {
                (true, _) => "revoked".to_owned(),
                (false, ..0) => "expired".to_owned(),
                (false, days) => format!("{days} days left"),
            };
            let imports: String = holder.imports.iter().map(|from| format!(", imports ticks of {from}")).collect();
            format!("{:<42}until {}  {state}{imports}", holder.name, holder.until)
        };
        print(&holders.iter().map(line).collect::<Vec<_>>().join("\n"))
    };
    if fail_if_due && !due.is_empty() {
        let names: Vec<_> = due.iter().map(|holder| holder.name.as_str()).collect();
        return Ok(fail_after_result(
            &format_args!("expired or expiring soon: {}; renew them with --force", names.join(", ")),
            1,
        ));
    }
    Ok(printed)
}

/// Prints the written files and where to copy them.
fn print_written(written: &[WrittenFolder], folder: &FolderArgs) -> ExitCode {
    if folder.json {
        return print(&serde_json::json!({ "written": written }));
    }
    let mut lines = Vec::new();
    for one in written {
        lines.push(format!("{}, valid until {}:", one.name, one.until));
        lines.extend(one.files.iter().map(|file| format!("  {}", foreign::path(file))));
        lines.push(match one.copy_to {
            Some(to) => format!("  copy {} to {to} on that machine", foreign::path(&one.folder)),
            None => "  authority.key stays here; its holder can impersonate any party".into(),
        });
    }
    if written.iter().all(|one| one.name != "router") {
        let router = folder.dir.join("router/router.json5");
        lines
            .push(format!("to apply it, copy the new {} to the router and restart the router", foreign::path(&router)));
    }
    print(&lines.join("\n"))
}

fn parse_hosts(hosts: &[String]) -> Result<Vec<Host>, KeysError> {
    hosts.iter().map(|host| host.parse()).collect()
}

impl PartyArgs {
    fn issue(&self, role: Role, hosts: &[Host], imports: &[Party]) -> Outcome {
        let Self { name, issue } = self;
        let party = Party::new(role, name)?;
        let written = issue.folder.open()?.issue(&party, hosts, imports, issue.days, issue.force)?;
        Ok(print_written(&[written], &issue.folder))
    }
}

impl FolderArgs {
    fn open(&self) -> Result<Keys, KeysError> {
        Keys::open(&self.dir)
    }
}
