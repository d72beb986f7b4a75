//! Key folder on disk.
//!
//! ```text
//! DIR/authority.pem, authority.key    the authority; its key stays here
//! DIR/router/                         ca.pem, cert.pem, key.pem, router.json5
//! DIR/vehicle.NAME/                   ca.pem, cert.pem, key.pem, vehicle.json5; access.json5 if
//!                                     the vehicle listens; imports, one party per line, if it
//!                                     imports ticks of other vehicles
//! DIR/operator.NAME/, viewer.NAME/    ca.pem, cert.pem, key.pem, ground.json5
//! DIR/revoked/                        folders of revoked parties
//! ```
//!
//! Every party with a folder is on the access list.

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
    certificate::{Authority, Contents, IssuedCertificate},
    configuration,
};

const AUTHORITY_CERTIFICATE: &str = "authority.pem";
const AUTHORITY_KEY: &str = "authority.key";
const ROUTER: &str = "router";
const REVOKED: &str = "revoked";
const IMPORTS: &str = "imports";

/// Mode of private keys: accessible to the owner only.
const PRIVATE: u32 = 0o600;
const PUBLIC: u32 = 0o644;
const PRIVATE_FOLDER: u32 = 0o700;

/// Key folder with its authority.
pub struct Keys {
    folder: PathBuf,
    authority: Authority,
}

/// Files written for one certificate.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct WrittenFolder {
    /// Common name of the certificate; `authority` for the authority.
    pub name: String,
    /// Last day of validity, `YYYY-MM-DD`, UTC.
    pub until: String,
    /// Folder that contains the files.
    pub folder: PathBuf,
    /// Paths of the written files.
    pub files: Vec<PathBuf>,
    /// Path to which the folder must be copied; `None` for the authority, because its files stay on
    /// this machine.
    pub copy_to: Option<&'static str>,
}

/// Holder of a certificate of this authority.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Holder {
    /// Common name of the certificate.
    pub name: String,
    /// Last day of validity, `YYYY-MM-DD`, UTC.
    pub until: String,
    /// Whole days until the certificate expires; negative after expiry.
    pub days_left: i64,
    /// `true` if the party is revoked.
    pub revoked: bool,
    /// Vehicles from which the party may import ticks.
    pub imports: Vec<Party>,
}

impl Keys {
    /// Creates an authority in `folder` and issues a router certificate for `hosts`. The
    /// certificate is valid for `days` days, the authority for
    /// [`AUTHORITY_DAYS`](crate::certificate::AUTHORITY_DAYS).
    ///
    /// With `force` an existing authority is replaced. Its certificates become invalid and their
    /// folders are removed.
    ///
    /// # Errors
    ///
    /// Returns [`KeysError::Exists`] if there is an authority and `force` is not set,
    /// [`KeysError::InvalidValidity`] if `days` is out of range, and [`KeysError::Io`] if a file
    /// cannot be written.
    pub fn init(
        folder: &Path,
        hosts: &[Host],
        days: u32,
        force: bool,
    ) -> Result<(Self, [WrittenFolder; 2]), KeysError> {
        let paths = [AUTHORITY_CERTIFICATE, AUTHORITY_KEY].map(|file| folder.join(file));
        if let Some(path) = paths.iter().find(|path| path.exists() && !force) {
            let consequence = ", which invalidates every certificate it signed";
            return Err(KeysError::Exists { path: path.clone(), consequence });
        }
        let (authority, issued) = Authority::new()?;
        let router = authority.issue_router(hosts, days)?;
        create_folder(folder)?;
        let keys = Self { folder: folder.into(), authority };
        for void in keys.parties()?.iter().map(Party::to_string).chain([ROUTER.into(), REVOKED.into()]) {
            remove(&folder.join(void))?;
        }
        let [certificate, key] = &paths;
        write(key, &issued.key, PRIVATE)?;
        write(certificate, &issued.certificate, PUBLIC)?;
        let until = keys.read(certificate)?.not_after.date().to_string();
        let own = WrittenFolder {
            name: "authority".into(),
            until,
            folder: folder.into(),
            files: paths.to_vec(),
            copy_to: None,
        };
        let router = keys.write_folder(ROUTER, &router, "router.json5", configuration::ROUTER)?;
        keys.write_access_lists()?;
        Ok((keys, [own, router]))
    }

    /// Opens an existing key folder.
    ///
    /// # Errors
    ///
    /// Returns [`KeysError::NoAuthority`] if there is no authority, and [`KeysError::InvalidFile`]
    /// if it is malformed.
    pub fn open(folder: &Path) -> Result<Self, KeysError> {
        let [certificate, key] = [AUTHORITY_CERTIFICATE, AUTHORITY_KEY].map(|file| folder.join(file));
        if !certificate.exists() {
            return Err(KeysError::NoAuthority { path: certificate });
        }
        let kept = IssuedCertificate { certificate: read(&certificate)?, key: read(&key)? };
        let authority = Authority::from_pem(&kept)
            .map_err(|cause| KeysError::InvalidFile { path: certificate, why: cause.to_string().into() })?;
        Ok(Self { folder: folder.into(), authority })
    }

    /// Issues a router certificate for `hosts`. An existing router configuration is kept.
    ///
    /// # Errors
    ///
    /// Returns [`KeysError::Exists`] if there is a router certificate and `force` is not set.
    pub fn router(&self, hosts: &[Host], days: u32, force: bool) -> Result<WrittenFolder, KeysError> {
        self.check_absent(ROUTER, force)?;
        let issued = self.authority.issue_router(hosts, days)?;
        let configuration = self.folder.join(ROUTER).join("router.json5");
        let text = if configuration.exists() { read(&configuration)? } else { configuration::ROUTER.into() };
        let written = self.write_folder(ROUTER, &issued, "router.json5", &text)?;
        self.write_access_lists()?;
        Ok(written)
    }

    /// Issues a certificate to a party and adds the party to the access list.
    ///
    /// If `hosts` is not empty, the certificate is also a server certificate for these hosts. A
    /// vehicle may import the ticks of the vehicles in `imports`.
    ///
    /// # Errors
    ///
    /// Returns [`KeysError::Revoked`] if the name was revoked, [`KeysError::Exists`] if the party
    /// exists and `force` is not set, and [`KeysError::UnknownParty`] if a vehicle in `imports` has
    /// no certificate.
    pub fn issue(
        &self,
        party: &Party,
        hosts: &[Host],
        imports: &[Party],
        days: u32,
        force: bool,
    ) -> Result<WrittenFolder, KeysError> {
        let name = party.to_string();
        let revoked = self.folder.join(REVOKED).join(&name).join("cert.pem");
        if revoked.exists() {
            let until = self.read(&revoked)?.not_after.date().to_string();
            return Err(KeysError::Revoked { party: party.clone(), until });
        }
        self.check_absent(&name, force)?;
        let known = self.parties()?;
        if let Some(unknown) = imports.iter().find(|import| !known.contains(import)) {
            return Err(KeysError::UnknownParty { party: unknown.clone(), folder: self.folder.clone() });
        }
        let router = self.read(&self.folder.join(ROUTER).join("cert.pem"))?.hosts;
        let issued = self.authority.issue_party(party, hosts, days)?;
        let mut written = match party.role() {
            Role::Vehicle => self.write_folder(&name, &issued, "vehicle.json5", &configuration::vehicle(&router)),
            Role::Operator | Role::Viewer => {
                self.write_folder(&name, &issued, "ground.json5", &configuration::ground(&router))
            }
        }?;
        let file = self.folder.join(&name).join(IMPORTS);
        if imports.is_empty() {
            remove(&file)?;
        } else {
            write(&file, &imports.iter().map(|import| format!("{import}\n")).collect::<String>(), PUBLIC)?;
            written.files.push(file);
        }
        self.write_access_lists()?;
        Ok(written)
    }

    /// Revokes a party: removes it from the access list permanently.
    ///
    /// No further certificate can be issued for its name, because a new entry of the name on the
    /// access list would also admit the revoked certificate.
    ///
    /// # Errors
    ///
    /// Returns [`KeysError::UnknownParty`] if the folder contains no such party.
    pub fn revoke(&self, party: &Party) -> Result<(), KeysError> {
        let folder = self.folder.join(party.to_string());
        if !folder.exists() {
            return Err(KeysError::UnknownParty { party: party.clone(), folder: self.folder.clone() });
        }
        let revoked = self.folder.join(REVOKED);
        create_folder(&revoked)?;
        let to = revoked.join(party.to_string());
        fs::rename(&folder, to).map_err(|cause| KeysError::Io { action: "move", path: folder, cause })?;
        self.write_access_lists()
    }

    /// Returns all certificate holders, the authority and the router first and revoked parties
    /// last.
    ///
    /// # Errors
    ///
    /// Returns [`KeysError::Io`] or [`KeysError::InvalidFile`] if a certificate cannot be read.
    pub fn holders(&self) -> Result<Vec<Holder>, KeysError> {
        let of = |parties: Vec<Party>, folder: &Path| {
            parties.iter().map(|party| folder.join(party.to_string()).join("cert.pem")).collect::<Vec<_>>()
        };
        let first = [self.folder.join(AUTHORITY_CERTIFICATE), self.folder.join(ROUTER).join("cert.pem")];
        let valid = [first.to_vec(), of(self.parties()?, &self.folder)].concat();
        let revoked = self.folder.join(REVOKED);
        let revoked = of(parties(&revoked)?, &revoked);
        let (now, imports) = (time::OffsetDateTime::now_utc(), self.read_imports(&self.parties()?)?);
        let holder = |path: &PathBuf, revoked| {
            let Contents { common_name: name, not_after: until, .. } = self.read(path)?;
            let imports = imports
                .iter()
                .filter(|import| import.importer.to_string() == name)
                .map(|it| it.exporter.clone())
                .collect();
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

    /// Returns the parties on the access list, sorted by role and name.
    ///
    /// # Errors
    ///
    /// Returns [`KeysError::Io`] if the folder cannot be read.
    pub fn parties(&self) -> Result<Vec<Party>, KeysError> {
        parties(&self.folder)
    }

    fn check_absent(&self, name: &str, force: bool) -> Result<(), KeysError> {
        let path = self.folder.join(name);
        if path.exists() && !force {
            let consequence = "; the old certificate stays valid until it expires";
            return Err(KeysError::Exists { path, consequence });
        }
        Ok(())
    }

    fn write_folder(
        &self,
        name: &str,
        issued: &IssuedCertificate,
        file: &str,
        text: &str,
    ) -> Result<WrittenFolder, KeysError> {
        let folder = self.folder.join(name);
        create_folder(&folder)?;
        let files = ["key.pem", "cert.pem", "ca.pem", file].map(|file| folder.join(file));
        let [key, certificate, authority, configuration] = &files;
        write(key, &issued.key, PRIVATE)?;
        write(certificate, &issued.certificate, PUBLIC)?;
        write(authority, self.authority.certificate(), PUBLIC)?;
        write(configuration, text, PUBLIC)?;
        let until = self.read(certificate)?.not_after.date().to_string();
        let (name, files) = (name.to_owned(), files.to_vec());
        Ok(WrittenFolder { name, until, folder, files, copy_to: Some(configuration::INSTALL_DIR) })
    }

    /// Writes the access list to the router's configuration and to the folders of vehicles that
    /// listen.
    fn write_access_lists(&self) -> Result<(), KeysError> {
        let parties = self.parties()?;
        let list = AccessList::new(&parties, &self.read_imports(&parties)?);
        for folder in parties.iter().map(|party| self.folder.join(party.to_string())) {
            if !self.read(&folder.join("cert.pem"))?.hosts.is_empty() {
                write(&folder.join("access.json5"), &list.to_json(), PUBLIC)?;
            }
        }
        let path = self.folder.join(ROUTER).join("router.json5");
        match configuration::replace_access_list(&read(&path)?, &list) {
            Some(text) => write(&path, &text, PUBLIC),
            None => Err(KeysError::MissingListMarkers { path }),
        }
    }

    /// Returns the permitted imports of ticks, as recorded in the folders of the importing
    /// vehicles.
    fn read_imports(&self, parties: &[Party]) -> Result<Vec<Import>, KeysError> {
        let mut imports = Vec::new();
        for importer in parties {
            let path = self.folder.join(importer.to_string()).join(IMPORTS);
            let text = if path.exists() { read(&path)? } else { String::new() };
            for line in text.lines() {
                let damaged =
                    |error: KeysError| KeysError::InvalidFile { path: path.clone(), why: error.to_string().into() };
                imports.push(Import { exporter: line.parse().map_err(damaged)?, importer: importer.clone() });
            }
        }
        Ok(imports)
    }

    fn read(&self, certificate: &Path) -> Result<Contents, KeysError> {
        Contents::from_pem(&read(certificate)?)
            .map_err(|why| KeysError::InvalidFile { path: certificate.into(), why: why.into() })
    }
}

/// Returns the parties that have a folder in `folder`, sorted by role and name.
fn parties(folder: &Path) -> Result<Vec<Party>, KeysError> {
    let entries = match fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(cause) if cause.kind() == io::ErrorKind::NotFound => return Ok(vec![]),
        Err(cause) => return Err(KeysError::Io { action: "read", path: folder.into(), cause }),
    };
    let named = entries.flatten().filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    let mut parties: Vec<Party> = named.collect();
    parties.sort();
    Ok(parties)
}

fn read(path: &Path) -> Result<String, KeysError> {
    fs::read_to_string(path).map_err(|cause| KeysError::Io { action: "read", path: path.into(), cause })
}

/// Replaces a file atomically. A private key is never readable by other users.
fn write(path: &Path, text: &str, mode: u32) -> Result<(), KeysError> {
    let failed = |cause| KeysError::Io { action: "write", path: path.into(), cause };
    let temporary = path.with_extension("new");
    // A file left by an interrupted write may have a different mode, so it is removed first.
    remove(&temporary)?;
    let mut file = OpenOptions::new().write(true).create_new(true).mode(mode).open(&temporary).map_err(failed)?;
    file.set_permissions(fs::Permissions::from_mode(mode)).map_err(failed)?;
    file.write_all(text.as_bytes()).and_then(|()| file.sync_all()).map_err(failed)?;
    fs::rename(&temporary, path).map_err(failed)
}

fn create_folder(path: &Path) -> Result<(), KeysError> {
    let made = DirBuilder::new().recursive(true).mode(PRIVATE_FOLDER).create(path);
    made.map_err(|cause| KeysError::Io { action: "create", path: path.into(), cause })
}

fn remove(path: &Path) -> Result<(), KeysError> {
    let removed = if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
    match removed {
        Err(cause) if cause.kind() != io::ErrorKind::NotFound => {
            Err(KeysError::Io { action: "remove", path: path.into(), cause })
        }
        _ => Ok(()),
    }
}
