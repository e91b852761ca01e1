//! Writing a file whole or not at all.

use super::error::ExrError;
use std::collections::HashSet;
use std::fs::{File, Permissions};
use std::io::{BufWriter, Error, ErrorKind};
use std::path::{Path, PathBuf};

/// Writes a file beside `path` and renames it to `path` when it is complete and on disk.
///
/// Until then a file that was there stays as it was, so a file may be replaced by one made from it. A symbolic link is
/// followed; the permissions of a file that was there are kept. If `write` fails, nothing is left behind.
///
/// # Errors
/// [`ExrError::Write`]: `write`'s own error, a directory that is missing or cannot be written, or a `path` that is
/// there and is not a regular file or may only be read.
pub fn replace_file(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> std::io::Result<()>,
) -> Result<(), ExrError> {
    replace(path, write).map_err(|source| ExrError::Write { path: path.into(), source })
}

/// Checks beforehand that files can be written: a folder is tried once, with a file that is removed at once.
#[derive(Default)]
pub struct WriteCheck {
    folders: HashSet<PathBuf>,
}

impl WriteCheck {
    /// Checks that [`replace_file`] may write a file there.
    ///
    /// # Errors
    /// [`ExrError::Write`].
    pub fn check(&mut self, path: &Path) -> Result<(), ExrError> {
        let try_folder = |target: Target| {
            if !self.folders.contains(&target.folder) {
                tempfile::Builder::new().prefix(".vkdenoise").suffix(".tmp").tempfile_in(&target.folder)?;
                self.folders.insert(target.folder);
            }
            Ok(())
        };
        Target::of(path).and_then(try_folder).map_err(|source| ExrError::Write { path: path.into(), source })
    }
}

/// The file that is really written.
struct Target {
    file: PathBuf,
    folder: PathBuf,
    /// Those of the file that is there.
    permissions: Option<Permissions>,
}

impl Target {
    fn of(path: &Path) -> std::io::Result<Self> {
        let (file, permissions) = match std::fs::metadata(path) {
            Ok(old) if !old.is_file() => return Err(Error::other("it is there and is not a regular file")),
            Ok(old) if old.permissions().readonly() => {
                return Err(Error::new(ErrorKind::PermissionDenied, "it is there and may only be read"));
            }
            Ok(old) => (path.canonicalize()?, Some(old.permissions())),
            Err(_) => (path.to_path_buf(), None),
        };
        let folder = match file.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent.to_path_buf(),
            _ => PathBuf::from("."),
        };
        Ok(Self { file, folder, permissions })
    }
}

fn replace(path: &Path, write: impl FnOnce(&mut BufWriter<File>) -> std::io::Result<()>) -> std::io::Result<()> {
    let Target { file: target, folder, permissions } = Target::of(path)?;
    let mut builder = tempfile::Builder::new();
    let mut prefix = std::ffi::OsString::from(".");
    prefix.push(target.file_name().ok_or_else(|| Error::other("it names no file"))?);
    builder.prefix(&prefix).suffix(".tmp");
    if let Some(usual) = usual_permissions() {
        builder.permissions(usual);
    }
    let temporary = builder.tempfile_in(folder)?;
    let mut writer = BufWriter::with_capacity(1 << 20, temporary.as_file().try_clone()?);
    write(&mut writer)?;
    let file = writer.into_inner().map_err(|e| e.into_error())?;
    if let Some(permissions) = permissions {
        file.set_permissions(permissions)?;
    }
    file.sync_all()?;
    temporary.persist(&target).map_err(|e| e.error)?;
    Ok(())
}

/// A temporary file is readable by its owner alone; an image is like any new file, subject to the umask.
#[cfg(unix)]
fn usual_permissions() -> Option<Permissions> {
    use std::os::unix::fs::PermissionsExt;
    Some(Permissions::from_mode(0o666))
}

#[cfg(not(unix))]
fn usual_permissions() -> Option<Permissions> {
    None
}
