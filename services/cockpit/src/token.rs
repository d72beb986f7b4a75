//! What commands need, and beyond the loopback looking, too: tokens that only the user who runs the system can read.
//!
//! An operator's commands and looks, a viewer's looks. It is in the address that is printed, behind `#`: a browser sends that part to nobody.
//! The page keeps it for its tab.

use std::{
    env,
    fs::{self, DirBuilder, File, OpenOptions},
    io::{self, Read as _, Write as _},
    os::unix::fs::{DirBuilderExt as _, MetadataExt as _, OpenOptionsExt as _},
    path::{Path, PathBuf},
};

use rustix::rand::{GetRandomFlags, getrandom};

/// Random bytes of a token.
const BYTES: usize = 24;
/// The files' names.
const OPERATOR_FILE: &str = "cockpit.token";
const VIEWER_FILE: &str = "cockpit.viewer.token";

/// Why there is no token.
#[derive(Debug, thiserror::Error)]
pub enum TokenError {
    /// There is no folder for it.
    #[error("keeping the cockpit's token: no folder is known for it; set HOME, or XDG_STATE_HOME")]
    NoFolder,
    /// The file cannot be made or read.
    #[error("keeping the cockpit's token in {path}: {cause}")]
    File {
        /// The file.
        path: PathBuf,
        /// What the system said.
        cause: io::Error,
    },
    /// Something is there that others could have put there, or could read.
    #[error("reading the cockpit's token in {path}: {what}; remove it, and a new one is made")]
    Unsafe {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        what: &'static str,
    },
    /// There are no random numbers.
    #[error("making the cockpit's token: {0}")]
    Random(io::Error),
}

/// What somebody may do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// Look and command.
    Operator,
    /// Look.
    Viewer,
}

/// The tokens of a user.
#[derive(Debug, Clone)]
pub struct Tokens {
    operator: Token,
    viewer: Token,
}

impl Tokens {
    /// Those of this user, made at the first time.
    pub fn of_user() -> Result<Self, TokenError> {
        let folder = folder(|name| env::var_os(name).map(PathBuf::from)).ok_or(TokenError::NoFolder)?;
        let kept = |file| Token::kept_in(&folder, file);
        Ok(Self { operator: kept(OPERATOR_FILE)?, viewer: kept(VIEWER_FILE)? })
    }

    /// That of a role.
    pub fn of(&self, role: Role) -> &Token {
        match role {
            Role::Operator => &self.operator,
            Role::Viewer => &self.viewer,
        }
    }

    /// What whoever shows this may do; nothing more than others where it is none of them.
    pub(crate) fn role(&self, shown: &str) -> Option<Role> {
        [Role::Operator, Role::Viewer].into_iter().find(|role| self.of(*role).is(shown))
    }
}

/// A token.
#[derive(Clone, PartialEq, Eq)]
pub struct Token(String);

/// It is not to be seen in what is printed of a program's state.
impl std::fmt::Debug for Token {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Token(…)")
    }
}

impl Token {
    /// As it stands in an address.
    pub fn text(&self) -> &str {
        &self.0
    }

    /// Whether somebody has it; how long that takes tells nothing of it.
    pub fn is(&self, shown: &str) -> bool {
        let (own, shown) = (self.0.as_bytes(), shown.as_bytes());
        own.len() == shown.len() && own.iter().zip(shown).fold(0, |all, (a, b)| all | (a ^ b)) == 0
    }

    fn kept_in(folder: &Path, file: &str) -> Result<Self, TokenError> {
        let path = folder.join(file);
        let failed = |cause| TokenError::File { path: path.clone(), cause };
        // Two that begin at once: one of them makes it, the other reads it.
        for _ in 0..2 {
            match read(&path)? {
                Some(token) => return Ok(token),
                None => {
                    DirBuilder::new().recursive(true).mode(0o700).create(folder).map_err(failed)?;
                    match make(&path) {
                        Err(TokenError::File { cause, .. }) if cause.kind() == io::ErrorKind::AlreadyExists => {}
                        made => return made,
                    }
                }
            }
        }
        read(&path)?.ok_or_else(|| failed(io::Error::other("it comes and goes")))
    }
}

/// The token of a file that only this user can have made and read; `None` where there is no file.
fn read(path: &Path) -> Result<Option<Token>, TokenError> {
    let failed = |cause| TokenError::File { path: path.to_owned(), cause };
    let doubtful = |what| Err(TokenError::Unsafe { path: path.to_owned(), what });
    let flags = (rustix::fs::OFlags::NOFOLLOW | rustix::fs::OFlags::NONBLOCK).bits().cast_signed();
    let file = match OpenOptions::new().read(true).custom_flags(flags).open(path) {
        Ok(file) => file,
        Err(cause) if cause.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(cause) if fs::symlink_metadata(path).is_ok_and(|there| there.is_symlink()) => {
            let _ = cause;
            return doubtful("it is a link");
        }
        Err(cause) => return Err(failed(cause)),
    };
    let there = file.metadata().map_err(failed)?;
    if !there.is_file() {
        return doubtful("it is no file");
    }
    if there.uid() != rustix::process::geteuid().as_raw() || there.mode() & 0o077 != 0 {
        return doubtful("it is another user's, or others can read it");
    }
    let mut text = String::new();
    file.take(256).read_to_string(&mut text).map_err(failed)?;
    let text = text.trim_end();
    if text.len() != 2 * BYTES || !text.bytes().all(|byte| byte.is_ascii_hexdigit()) {
        return doubtful("it holds no token");
    }
    Ok(Some(Token(text.into())))
}

/// A new token in a file that was not there; another one sees the file whole or not at all.
fn make(path: &Path) -> Result<Token, TokenError> {
    let failed = |cause| TokenError::File { path: path.to_owned(), cause };
    let text = hex(&random::<BYTES>()?);
    let beside = path.with_extension(hex(&random::<8>()?));
    let mut file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(&beside).map_err(failed)?;
    let written = writeln!(file, "{text}").and_then(|()| file.sync_all());
    // Where there is a file by now, that one holds.
    let placed = written.and_then(|()| fs::hard_link(&beside, path));
    let _ = fs::remove_file(&beside);
    placed.map_err(failed)?;
    if let Some(folder) = path.parent().and_then(|folder| File::open(folder).ok()) {
        let _ = folder.sync_all();
    }
    Ok(Token(text))
}

fn random<const N: usize>() -> Result<[u8; N], TokenError> {
    let mut bytes = [0; N];
    let count = getrandom(&mut bytes, GetRandomFlags::empty()).map_err(|cause| TokenError::Random(cause.into()))?;
    if count == N { Ok(bytes) } else { Err(TokenError::Random(io::Error::other("there are too few"))) }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The folder for such files: systemd's, else that of the XDG base directory specification.
fn folder(variable: impl Fn(&str) -> Option<PathBuf>) -> Option<PathBuf> {
    let absolute = |name| variable(name).filter(|path: &PathBuf| path.is_absolute());
    // systemd separates several by colons.
    let systemd = variable("STATE_DIRECTORY").and_then(|all| env::split_paths(&all).next());
    let user = || absolute("XDG_STATE_HOME").or_else(|| absolute("HOME").map(|home| home.join(".local/state")));
    systemd.filter(|path| path.is_absolute()).or_else(|| user().map(|folder| folder.join("plumbline")))
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::{PermissionsExt as _, symlink};

    use super::*;

    #[test]
    fn it_is_made_once_and_for_its_user_alone() {
        let folder = tempfile::tempdir().unwrap();
        let own = folder.path().join("state");
        let first = Token::kept_in(&own, OPERATOR_FILE).unwrap();
        assert_eq!(Token::kept_in(&own, OPERATOR_FILE).unwrap(), first);
        assert_eq!(fs::metadata(own.join(OPERATOR_FILE)).unwrap().mode() & 0o7777, 0o600);
        assert_eq!(fs::read_dir(&own).unwrap().count(), 1, "nothing else is left");
        let other = tempfile::tempdir().unwrap();
        assert_ne!(Token::kept_in(other.path(), OPERATOR_FILE).unwrap(), first);
        assert!(first.is(first.text()) && !first.is("") && !first.is(&"0".repeat(2 * BYTES)));
        assert!(!format!("{first:?}").contains(first.text()));
    }

    #[test]
    fn many_that_begin_at_once_have_the_same() {
        let folder = tempfile::tempdir().unwrap();
        let tokens: Vec<_> = std::thread::scope(|scope| {
            let all: Vec<_> =
                (0..8).map(|_| scope.spawn(|| Token::kept_in(folder.path(), OPERATOR_FILE).unwrap())).collect();
            all.into_iter().map(|one| one.join().unwrap()).collect()
        });
        assert!(tokens.iter().all(|one| *one == tokens[0]));
    }

    #[test]
    fn what_others_planted_is_neither_read_nor_written_through() {
        let folder = tempfile::tempdir().unwrap();
        let (path, target) = (folder.path().join(OPERATOR_FILE), folder.path().join("target"));
        symlink(&target, &path).unwrap();
        let error = Token::kept_in(folder.path(), OPERATOR_FILE).unwrap_err().to_string();
        assert!(error.contains("is a link") && error.contains("remove it"), "{error}");
        assert!(!target.exists());
        fs::write(&target, "a".repeat(2 * BYTES)).unwrap();
        assert!(Token::kept_in(folder.path(), OPERATOR_FILE).is_err(), "nor where it leads somewhere");
        fs::remove_file(&path).unwrap();
        fs::write(&path, "a".repeat(2 * BYTES)).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o644)).unwrap();
        let error = Token::kept_in(folder.path(), OPERATOR_FILE).unwrap_err().to_string();
        assert!(error.contains("others can read it"), "{error}");
        fs::set_permissions(&path, fs::Permissions::from_mode(0o600)).unwrap();
        assert!(Token::kept_in(folder.path(), OPERATOR_FILE).is_ok());
        fs::write(&path, "short").unwrap();
        assert!(Token::kept_in(folder.path(), OPERATOR_FILE).unwrap_err().to_string().contains("holds no token"));
    }

    #[test]
    fn the_folder_is_that_of_the_service_or_of_the_user() {
        let of = |set: &[(&str, &str)]| {
            let found = folder(|name| set.iter().find(|(own, _)| *own == name).map(|(_, value)| value.into()));
            found.map(|path| path.display().to_string())
        };
        assert_eq!(of(&[("STATE_DIRECTORY", "/var/lib/a:/b"), ("HOME", "/h")]).as_deref(), Some("/var/lib/a"));
        assert_eq!(of(&[("XDG_STATE_HOME", "/s"), ("HOME", "/h")]).as_deref(), Some("/s/plumbline"));
        assert_eq!(of(&[("XDG_STATE_HOME", "s"), ("HOME", "/h")]).as_deref(), Some("/h/.local/state/plumbline"));
        assert_eq!(of(&[]), None);
    }
}
