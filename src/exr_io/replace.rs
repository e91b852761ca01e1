//! Writing a file whole or not at all.

use super::error::ExrError;
use std::fs::{File, Permissions};
use std::io::{BufWriter, Error};
use std::path::{Path, PathBuf};

/// Writes a file beside `path` and renames it to `path` when it is complete and on disk.
///
/// Until then a file that was there stays as it was, so a file may be replaced by one made from it. A symbolic link is
/// followed; the permissions of a file that was there are kept. If `write` fails, nothing is left behind.
///
/// # Errors
/// [`ExrError::Write`]: `write`'s own error, a directory that is missing or cannot be written, or a `path` that is
/// there and is not a regular file.
pub fn replace_file(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> std::io::Result<()>,
) -> Result<(), ExrError> {
    replace(path, write).map_err(|source| ExrError::Write { path: path.into(), source })
}

fn replace(path: &Path, write: impl FnOnce(&mut BufWriter<File>) -> std::io::Result<()>) -> std::io::Result<()> {
    let (target, permissions) = match std::fs::metadata(path) {
        Ok(old) if old.is_file() => (path.canonicalize()?, Some(old.permissions())),
        Ok(_) => return Err(Error::other("it is there and is not a regular file")),
        Err(_) => (path.to_path_buf(), None),
    };
    let directory = match target.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent.to_path_buf(),
        _ => PathBuf::from("."),
    };
    let mut builder = tempfile::Builder::new();
    let mut prefix = std::ffi::OsString::from(".");
    prefix.push(target.file_name().ok_or_else(|| Error::other("it names no file"))?);
    builder.prefix(&prefix).suffix(".tmp");
    if let Some(usual) = usual_permissions() {
        builder.permissions(usual);
    }
    let temporary = builder.tempfile_in(directory)?;
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
