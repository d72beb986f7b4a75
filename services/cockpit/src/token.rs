//! Access tokens. They are valid for one run of one system or, if the page is served by `plumb
//! view`, until that command ends.
//!
//! The tokens of a system are stored in files that are private to the user running the system, so
//! that they stay valid if the cockpit is restarted within the run. Each token begins with the
//! identifier of its run. The next run recognises old tokens by this identifier and replaces them.
//!
//! Commands require the operator's token. On addresses beyond the loopback interface, viewing
//! requires the operator's or the viewer's token. The printed address contains the token as its
//! fragment, which a browser never sends. The page keeps the token for the lifetime of its tab.

use std::{
    fs::{self, DirBuilder, File, OpenOptions},
    io::{self, Read as _, Write as _},
    os::unix::fs::{DirBuilderExt as _, MetadataExt as _, OpenOptionsExt as _},
    path::{Path, PathBuf},
};

use runtime::machine::state_folder;
use rustix::rand::{GetRandomFlags, getrandom};

/// Number of random bytes in a token.
const RANDOM_BYTES: usize = 24;
/// Number of characters of a token: the run's identifier and the random bytes, in hexadecimal.
const TOKEN_CHARACTERS: usize = 2 * (size_of::<u64>() + RANDOM_BYTES);
const OPERATOR_FILE: &str = "cockpit.token";
const VIEWER_FILE: &str = "cockpit.viewer.token";

/// Error when loading or creating a token.
#[derive(Debug, thiserror::Error)]
pub enum TokenError {
    /// The folder for the token files is unknown.
    #[error("no folder known for the cockpit's token; set HOME or XDG_STATE_HOME")]
    NoFolder,
    /// The file cannot be created or read.
    #[error("cannot store the cockpit's token in {path}: {cause}", path = foreign::path(path))]
    File {
        /// Path of the file.
        path: PathBuf,
        /// Operating system error.
        cause: io::Error,
    },
    /// The file may have been created or read by another user, or it does not contain a token.
    #[error("cannot use the cockpit's token in {path}: {reason}; remove the file and restart the system", path = foreign::path(path))]
    Insecure {
        /// Path of the file.
        path: PathBuf,
        /// Reason for the rejection.
        reason: &'static str,
    },
    /// The running system has stored no token where this process looks for it.
    #[error(
        "no cockpit token in {path}; set HOME, XDG_STATE_HOME and STATE_DIRECTORY to the values that the system runs with", path = foreign::path(path)
    )]
    Missing {
        /// Path of the file.
        path: PathBuf,
    },
    /// The operating system provides no random numbers.
    #[error("cannot create the cockpit's token: {0}")]
    Random(io::Error),
}

/// Permissions granted by a token.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// Permission to view and to send commands.
    Operator,
    /// Permission to view.
    Viewer,
}

/// Tokens for one server, one per role.
#[derive(Debug, Clone)]
pub struct Tokens {
    operator: Token,
    viewer: Token,
}

impl Tokens {
    /// Creates tokens that are not stored.
    ///
    /// # Errors
    ///
    /// Returns an error if the operating system provides no random numbers.
    pub fn create() -> Result<Self, TokenError> {
        // No run of a system has the identifier 0.
        Ok(Self { operator: Token::create(0)?, viewer: Token::create(0)? })
    }

    /// Loads the tokens of this run of a system. Missing tokens and those of an earlier run are
    /// replaced by new ones.
    ///
    /// # Errors
    ///
    /// Returns an error if no folder is known, or a file is insecure or cannot be read or created.
    pub fn load_or_create(system: &str, run_id: u64) -> Result<Self, TokenError> {
        let folder = system_folder(system)?;
        let load = |file| Token::load_or_create(&folder, file, run_id);
        Ok(Self { operator: load(OPERATOR_FILE)?, viewer: load(VIEWER_FILE)? })
    }

    /// Loads the tokens of a running system.
    ///
    /// # Errors
    ///
    /// Returns an error if no folder is known, or a file is missing, insecure or cannot be read.
    pub fn load(system: &str) -> Result<Self, TokenError> {
        let folder = system_folder(system)?;
        let load = |file| {
            let path = folder.join(file);
            read(&path)?.ok_or(TokenError::Missing { path })
        };
        Ok(Self { operator: load(OPERATOR_FILE)?, viewer: load(VIEWER_FILE)? })
    }

    /// Returns the token of a role.
    pub fn get(&self, role: Role) -> &Token {
        match role {
            Role::Operator => &self.operator,
            Role::Viewer => &self.viewer,
        }
    }

    /// Returns the role that `token` grants; `None` if it is not one of the tokens.
    pub(crate) fn role(&self, token: &str) -> Option<Role> {
        [Role::Operator, Role::Viewer].into_iter().find(|role| self.get(*role).matches(token))
    }
}

/// Secret token.
#[derive(Clone, PartialEq, Eq)]
pub struct Token(String);

// Keeps the token out of logs and debug output.
impl std::fmt::Debug for Token {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Token(…)")
    }
}

impl Token {
    /// Returns the token as it appears in an address.
    pub fn text(&self) -> &str {
        &self.0
    }

    /// Compares the token in constant time.
    pub fn matches(&self, token: &str) -> bool {
        let (expected, actual) = (self.0.as_bytes(), token.as_bytes());
        expected.len() == actual.len() && expected.iter().zip(actual).fold(0, |all, (a, b)| all | (a ^ b)) == 0
    }

    fn create(run_id: u64) -> Result<Self, TokenError> {
        Ok(Self(format!("{run_id:016x}{}", hex(&random::<RANDOM_BYTES>()?))))
    }

    fn load_or_create(folder: &Path, file: &str, run_id: u64) -> Result<Self, TokenError> {
        let path = folder.join(file);
        if let Some(token) = read(&path)?.filter(|token| token.0.starts_with(&format!("{run_id:016x}"))) {
            return Ok(token);
        }
        let token = Self::create(run_id)?;
        let failed = |cause| TokenError::File { path: path.clone(), cause };
        DirBuilder::new().recursive(true).mode(0o700).create(folder).map_err(failed)?;
        write(&path, &token)?;
        Ok(token)
    }
}

/// Reads the token from a file that only this user can have created and read. Returns `None` if the
/// file does not exist.
fn read(path: &Path) -> Result<Option<Token>, TokenError> {
    let failed = |cause| TokenError::File { path: path.to_owned(), cause };
    let insecure = |reason| Err(TokenError::Insecure { path: path.to_owned(), reason });
    let flags = (rustix::fs::OFlags::NOFOLLOW | rustix::fs::OFlags::NONBLOCK).bits().cast_signed();
    let file = match OpenOptions::new().read(true).custom_flags(flags).open(path) {
        Ok(file) => file,
        Err(cause) if cause.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(cause) if fs::symlink_metadata(path).is_ok_and(|metadata| metadata.is_symlink()) => {
            let _ = cause;
            return insecure("it is a symbolic link");
        }
        Err(cause) => return Err(failed(cause)),
    };
    let metadata = file.metadata().map_err(failed)?;
    if !metadata.is_file() {
        return insecure("it is not a regular file");
    }
    if metadata.uid() != rustix::process::geteuid().as_raw() || metadata.mode() & 0o077 != 0 {
        return insecure("it belongs to another user or is accessible to others");
    }
    let mut text = String::new();
    file.take(256).read_to_string(&mut text).map_err(failed)?;
    let text = text.trim_end();
    if text.len() != TOKEN_CHARACTERS || !text.bytes().all(|byte| byte.is_ascii_hexdigit()) {
        return insecure("it does not contain a token");
    }
    Ok(Some(Token(text.into())))
}

/// Writes a token to a file, replacing an earlier token. Other processes never see an incomplete
/// file.
fn write(path: &Path, token: &Token) -> Result<(), TokenError> {
    let failed = |cause| TokenError::File { path: path.to_owned(), cause };
    let temporary = path.with_extension(hex(&random::<8>()?));
    let mut file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(&temporary).map_err(failed)?;
    let written = writeln!(file, "{}", token.0).and_then(|()| file.sync_all());
    let renamed = written.and_then(|()| fs::rename(&temporary, path));
    if renamed.is_err() {
        let _ = fs::remove_file(&temporary);
    }
    renamed.map_err(failed)?;
    if let Some(folder) = path.parent().and_then(|folder| File::open(folder).ok()) {
        let _ = folder.sync_all();
    }
    Ok(())
}

fn random<const N: usize>() -> Result<[u8; N], TokenError> {
    let mut bytes = [0; N];
    let count = getrandom(&mut bytes, GetRandomFlags::empty()).map_err(|cause| TokenError::Random(cause.into()))?;
    if count == N { Ok(bytes) } else { Err(TokenError::Random(io::Error::other("too few random bytes"))) }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Returns the folder for the state files of a system.
fn system_folder(system: &str) -> Result<PathBuf, TokenError> {
    let folder = state_folder().ok_or(TokenError::NoFolder)?;
    Ok(folder.join(system))
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::{PermissionsExt as _, symlink};

    use super::*;

    #[test]
    fn token_is_private_and_valid_for_one_run() {
        let folder = tempfile::tempdir().unwrap();
        let state = folder.path().join("state");
        let first = Token::load_or_create(&state, OPERATOR_FILE, 1).unwrap();
        assert_eq!(Token::load_or_create(&state, OPERATOR_FILE, 1).unwrap(), first, "a restart keeps the token");
        assert_eq!(fs::metadata(state.join(OPERATOR_FILE)).unwrap().mode() & 0o7777, 0o600);
        assert_eq!(fs::metadata(&state).unwrap().mode() & 0o7777, 0o700);
        let second = Token::load_or_create(&state, OPERATOR_FILE, 2).unwrap();
        assert_ne!(second, first, "the next run has another token");
        assert_ne!(second.text()[16..], first.text()[16..]);
        assert_eq!(read(&state.join(OPERATOR_FILE)).unwrap(), Some(second));
        assert_eq!(fs::read_dir(&state).unwrap().count(), 1, "no temporary file remains");
        assert!(first.matches(first.text()) && !first.matches("") && !first.matches(&"0".repeat(TOKEN_CHARACTERS)));
        assert!(!format!("{first:?}").contains(first.text()));
        assert!(first.text().len() <= wire::command::MAX_NAME_BYTES, "a command holds the token");
    }

    #[test]
    fn planted_files_and_links_are_rejected() {
        let folder = tempfile::tempdir().unwrap();
        let (path, target) = (folder.path().join(OPERATOR_FILE), folder.path().join("target"));
        symlink(&target, &path).unwrap();
        let error = Token::load_or_create(folder.path(), OPERATOR_FILE, 1).unwrap_err().to_string();
        assert!(error.contains("is a symbolic link") && error.contains("remove the file"), "{error}");
        assert!(!target.exists());
        fs::write(&target, "a".repeat(TOKEN_CHARACTERS)).unwrap();
        assert!(
            Token::load_or_create(folder.path(), OPERATOR_FILE, 1).is_err(),
            "a link to a valid token is rejected, too"
        );
        fs::remove_file(&path).unwrap();
        fs::write(&path, "a".repeat(TOKEN_CHARACTERS)).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o644)).unwrap();
        let error = Token::load_or_create(folder.path(), OPERATOR_FILE, 1).unwrap_err().to_string();
        assert!(error.contains("accessible to others"), "{error}");
        fs::set_permissions(&path, fs::Permissions::from_mode(0o600)).unwrap();
        assert!(Token::load_or_create(folder.path(), OPERATOR_FILE, 1).is_ok());
        fs::write(&path, "short").unwrap();
        assert!(
            Token::load_or_create(folder.path(), OPERATOR_FILE, 1)
                .unwrap_err()
                .to_string()
                .contains("not contain a token")
        );
    }
}
