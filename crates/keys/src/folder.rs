//! All of it as files.
//!
//! ```text
//! DIR/authority.pem, authority.key    the authority; its key stays here
//! DIR/router/                         ca.pem, cert.pem, key.pem, router.json5
//! DIR/vehicle.NAME/                   ca.pem, cert.pem, key.pem, vehicle.json5; one that listens itself: access.json5; one that takes
//!                                     ticks of others: imports, with a party on each line
//! DIR/operator.NAME/, viewer.NAME/    ca.pem, cert.pem, key.pem, ground.json5
//! DIR/revoked/                        folders of the parties that may do nothing any more
//! ```
//!
//! The access list is that of the folders that are there.

use std::{
    fs::{self, DirBuilder, OpenOptions},
    io::{self, Write},
    os::unix::fs::{DirBuilderExt, OpenOptionsExt, PermissionsExt},
    path::{Path, PathBuf},
};

use serde::Serialize;

use crate::{
    Host, KeysError, Party, Role,
    access::{AccessList, Import},
    certificate::{Authority, Contents, Issued},
    configuration,
};

const AUTHORITY_CERTIFICATE: &str = "authority.pem";
const AUTHORITY_KEY: &str = "authority.key";
const ROUTER: &str = "router";
const REVOKED: &str = "revoked";
const IMPORTS: &str = "imports";

/// For the owner only.
const PRIVATE: u32 = 0o600;
const PUBLIC: u32 = 0o644;
const PRIVATE_FOLDER: u32 = 0o700;

/// A folder of keys with its authority.
pub struct Keys {
    folder: PathBuf,
    authority: Authority,
}

/// What was written.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Written {
    /// Whose it is, as its certificate says.
    pub name: String,
    /// The last day of the certificate, `YYYY-MM-DD`, UTC.
    pub until: String,
    /// The folder.
    pub folder: PathBuf,
    /// The files.
    pub files: Vec<PathBuf>,
    /// Where the folder is to be copied to; nothing for what stays here.
    pub copy_to: Option<&'static str>,
}

/// Somebody who has a certificate of this authority.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Holder {
    /// As the certificate says.
    pub name: String,
    /// The last day, `YYYY-MM-DD`, UTC.
    pub until: String,
    /// Whole days until the certificate ends; negative after it.
    pub days_left: i64,
    /// It was revoked.
    pub revoked: bool,
    /// The vehicles whose ticks it may take.
    pub imports: Vec<Party>,
}

impl Keys {
    /// A new authority in `folder`, and a router at `hosts`. To replace one makes everything void that it signed, so that is removed.
    pub fn init(folder: &Path, hosts: &[Host], days: u32, force: bool) -> Result<(Self, [Written; 2]), KeysError> {
        let paths = [AUTHORITY_CERTIFICATE, AUTHORITY_KEY].map(|file| folder.join(file));
        if let Some(path) = paths.iter().find(|path| path.exists() && !force) {
            let consequence = ", and everything that it signed is void";
            return Err(KeysError::Exists { path: path.clone(), consequence });
        }
        let (authority, issued) = Authority::new()?;
        let router = authority.router(hosts, days)?;
        make_folder(folder)?;
        let keys = Self { folder: folder.into(), authority };
        for void in keys.parties()?.iter().map(Party::to_string).chain([ROUTER.into(), REVOKED.into()]) {
            remove(&folder.join(void))?;
        }
        let [certificate, key] = &paths;
        write(key, &issued.key, PRIVATE)?;
        write(certificate, &issued.certificate, PUBLIC)?;
        let until = keys.read(certificate)?.until.date().to_string();
        let own =
            Written { name: "authority".into(), until, folder: folder.into(), files: paths.to_vec(), copy_to: None };
        let router = keys.write(ROUTER, &router, "router.json5", configuration::ROUTER)?;
        keys.write_list()?;
        Ok((keys, [own, router]))
    }

    /// The keys in `folder`.
    pub fn open(folder: &Path) -> Result<Self, KeysError> {
        let [certificate, key] = [AUTHORITY_CERTIFICATE, AUTHORITY_KEY].map(|file| folder.join(file));
        if !certificate.exists() {
            return Err(KeysError::NoAuthority { path: certificate });
        }
        let kept = Issued { certificate: read(&certificate)?, key: read(&key)? };
        let authority = Authority::from_pem(&kept)
            .map_err(|cause| KeysError::Damaged { path: certificate, why: cause.to_string() })?;
        Ok(Self { folder: folder.into(), authority })
    }

    /// A certificate for the router, reached at `hosts`. Its configuration stays as it is.
    pub fn router(&self, hosts: &[Host], days: u32, force: bool) -> Result<Written, KeysError> {
        self.refuse_existing(ROUTER, force)?;
        let issued = self.authority.router(hosts, days)?;
        let configuration = self.folder.join(ROUTER).join("router.json5");
        let text = if configuration.exists() { read(&configuration)? } else { configuration::ROUTER.into() };
        let written = self.write(ROUTER, &issued, "router.json5", &text)?;
        self.write_list()?;
        Ok(written)
    }

    /// A certificate for a party, whom the router then knows; with `hosts` it is also good to listen there. A vehicle may take the ticks of
    /// the vehicles that it `imports` from.
    pub fn issue(
        &self,
        party: &Party,
        hosts: &[Host],
        imports: &[Party],
        days: u32,
        force: bool,
    ) -> Result<Written, KeysError> {
        let name = party.to_string();
        let revoked = self.folder.join(REVOKED).join(&name).join("cert.pem");
        if revoked.exists() {
            let until = self.read(&revoked)?.until.date().to_string();
            return Err(KeysError::Revoked { party: party.clone(), until });
        }
        self.refuse_existing(&name, force)?;
        let known = self.parties()?;
        if let Some(unknown) = imports.iter().find(|import| !known.contains(import)) {
            return Err(KeysError::NoParty { party: unknown.clone(), folder: self.folder.clone() });
        }
        let router = self.read(&self.folder.join(ROUTER).join("cert.pem"))?.hosts;
        let issued = self.authority.party(party, hosts, days)?;
        let mut written = match party.role() {
            Role::Vehicle => self.write(&name, &issued, "vehicle.json5", &configuration::vehicle(&router)),
            Role::Operator | Role::Viewer => {
                self.write(&name, &issued, "ground.json5", &configuration::ground(&router))
            }
        }?;
        let file = self.folder.join(&name).join(IMPORTS);
        if imports.is_empty() {
            remove(&file)?;
        } else {
            write(&file, &imports.iter().map(|import| format!("{import}\n")).collect::<String>(), PUBLIC)?;
            written.files.push(file);
        }
        self.write_list()?;
        Ok(written)
    }

    /// Takes a party from the access list for ever: its name is not given again, because its certificate would be good for it.
    pub fn revoke(&self, party: &Party) -> Result<(), KeysError> {
        let folder = self.folder.join(party.to_string());
        if !folder.exists() {
            return Err(KeysError::NoParty { party: party.clone(), folder: self.folder.clone() });
        }
        let revoked = self.folder.join(REVOKED);
        make_folder(&revoked)?;
        let to = revoked.join(party.to_string());
        fs::rename(&folder, to).map_err(|cause| KeysError::File { doing: "moving", path: folder, cause })?;
        self.write_list()
    }

    /// Everybody who has a certificate, the authority and the router first.
    pub fn holders(&self) -> Result<Vec<Holder>, KeysError> {
        let of = |parties: Vec<Party>, folder: &Path| {
            parties.iter().map(|party| folder.join(party.to_string()).join("cert.pem")).collect::<Vec<_>>()
        };
        let first = [self.folder.join(AUTHORITY_CERTIFICATE), self.folder.join(ROUTER).join("cert.pem")];
        let valid = [first.to_vec(), of(self.parties()?, &self.folder)].concat();
        let revoked = self.folder.join(REVOKED);
        let revoked = of(parties(&revoked)?, &revoked);
        let (now, imports) = (time::OffsetDateTime::now_utc(), self.imports(&self.parties()?)?);
        let holder = |path: &PathBuf, revoked| {
            let Contents { common_name: name, until, .. } = self.read(path)?;
            let imports =
                imports.iter().filter(|import| import.by.to_string() == name).map(|it| it.from.clone()).collect();
            Ok(Holder {
                name,
                until: until.date().to_string(),
                days_left: (until - now).whole_days(),
                revoked,
                imports,
            })
        };
        let valid = valid.iter().map(|path| holder(path, false));
        valid.chain(revoked.iter().map(|path| holder(path, true))).collect()
    }

    /// The parties that may do something.
    pub fn parties(&self) -> Result<Vec<Party>, KeysError> {
        parties(&self.folder)
    }

    fn refuse_existing(&self, name: &str, force: bool) -> Result<(), KeysError> {
        let path = self.folder.join(name);
        if path.exists() && !force {
            let consequence = " by new ones; the old certificate stays good until it ends";
            return Err(KeysError::Exists { path, consequence });
        }
        Ok(())
    }

    fn write(&self, name: &str, issued: &Issued, file: &str, text: &str) -> Result<Written, KeysError> {
        let folder = self.folder.join(name);
        make_folder(&folder)?;
        let files = ["key.pem", "cert.pem", "ca.pem", file].map(|file| folder.join(file));
        let [key, certificate, authority, configuration] = &files;
        write(key, &issued.key, PRIVATE)?;
        write(certificate, &issued.certificate, PUBLIC)?;
        write(authority, self.authority.certificate(), PUBLIC)?;
        write(configuration, text, PUBLIC)?;
        let until = self.read(certificate)?.until.date().to_string();
        let (name, files) = (name.to_owned(), files.to_vec());
        Ok(Written { name, until, folder, files, copy_to: Some(configuration::INSTALLED_AT) })
    }

    /// Writes the access list into the router's configuration, and beside the certificates of vehicles that listen themselves.
    fn write_list(&self) -> Result<(), KeysError> {
        let parties = self.parties()?;
        let list = AccessList::new(&parties, &self.imports(&parties)?);
        for folder in parties.iter().map(|party| self.folder.join(party.to_string())) {
            if !self.read(&folder.join("cert.pem"))?.hosts.is_empty() {
                write(&folder.join("access.json5"), &list.text(), PUBLIC)?;
            }
        }
        let path = self.folder.join(ROUTER).join("router.json5");
        match configuration::with_list(&read(&path)?, &list) {
            Some(text) => write(&path, &text, PUBLIC),
            None => Err(KeysError::NoPlaceForList { path }),
        }
    }

    /// Which ticks go from one party to another.
    fn imports(&self, parties: &[Party]) -> Result<Vec<Import>, KeysError> {
        let mut imports = Vec::new();
        for by in parties {
            let path = self.folder.join(by.to_string()).join(IMPORTS);
            let text = if path.exists() { read(&path)? } else { String::new() };
            for line in text.lines() {
                let damaged = |error: KeysError| KeysError::Damaged { path: path.clone(), why: error.to_string() };
                imports.push(Import { from: line.parse().map_err(damaged)?, by: by.clone() });
            }
        }
        Ok(imports)
    }

    fn read(&self, certificate: &Path) -> Result<Contents, KeysError> {
        Contents::read(&read(certificate)?).map_err(|why| KeysError::Damaged { path: certificate.into(), why })
    }
}

/// Whose folders are in `folder`, in order.
fn parties(folder: &Path) -> Result<Vec<Party>, KeysError> {
    let entries = match fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(cause) if cause.kind() == io::ErrorKind::NotFound => return Ok(vec![]),
        Err(cause) => return Err(KeysError::File { doing: "reading", path: folder.into(), cause }),
    };
    let named = entries.flatten().filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    let mut parties: Vec<Party> = named.collect();
    parties.sort();
    Ok(parties)
}

fn read(path: &Path) -> Result<String, KeysError> {
    fs::read_to_string(path).map_err(|cause| KeysError::File { doing: "reading", path: path.into(), cause })
}

/// Writes beside and then puts in place, so that nobody ever finds half a file; a key is never readable for others.
fn write(path: &Path, text: &str, mode: u32) -> Result<(), KeysError> {
    let failed = |cause| KeysError::File { doing: "writing", path: path.into(), cause };
    let beside = path.with_extension("new");
    // What an interrupted writer left may have another mode.
    remove(&beside)?;
    let mut file = OpenOptions::new().write(true).create_new(true).mode(mode).open(&beside).map_err(failed)?;
    file.set_permissions(fs::Permissions::from_mode(mode)).map_err(failed)?;
    file.write_all(text.as_bytes()).and_then(|()| file.sync_all()).map_err(failed)?;
    fs::rename(&beside, path).map_err(failed)
}

fn make_folder(path: &Path) -> Result<(), KeysError> {
    let made = DirBuilder::new().recursive(true).mode(PRIVATE_FOLDER).create(path);
    made.map_err(|cause| KeysError::File { doing: "making", path: path.into(), cause })
}

fn remove(path: &Path) -> Result<(), KeysError> {
    let removed = if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
    match removed {
        Err(cause) if cause.kind() != io::ErrorKind::NotFound => {
            Err(KeysError::File { doing: "removing", path: path.into(), cause })
        }
        _ => Ok(()),
    }
}
