//! Files that save work between processes, in a folder of the user's. They hold nothing that cannot be made again: one
//! that is missing, damaged or cannot be written costs time, and is no error.

use crate::kernels::spirv;
use crate::vk::caps::Identity;
use std::convert::Infallible;
use std::fs::{self, File, OpenOptions};
use std::hash::Hasher;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::process;
use std::str::FromStr;
use std::sync::atomic::{AtomicU64, Ordering};

/// Where compiled kernels are kept between processes.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Cache {
    /// `vkdenoise` in the user's folder for such files: `$XDG_CACHE_HOME`, else `$HOME/.cache`. As [`Cache::Off`] where
    /// neither is an absolute path.
    #[default]
    User,
    /// Nowhere.
    Off,
    /// This folder. It is made when there is something to keep.
    Folder(PathBuf),
}

impl Cache {
    /// The folder; `None`: nothing is kept.
    pub fn folder(&self) -> Option<PathBuf> {
        match self {
            Self::Off => None,
            Self::Folder(folder) => Some(folder.clone()),
            Self::User => {
                let absolute = |name| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
                let base = absolute("XDG_CACHE_HOME").or_else(|| Some(absolute("HOME")?.join(".cache")));
                base.map(|base| base.join("vkdenoise"))
            }
        }
    }
}

impl FromStr for Cache {
    type Err = Infallible;

    /// `user`, `off` or a folder.
    fn from_str(text: &str) -> Result<Self, Infallible> {
        Ok(match text {
            "user" => Self::User,
            "off" => Self::Off,
            folder => Self::Folder(folder.into()),
        })
    }
}

/// What a file begins with, then the length of the payload and its hash, both in 64 bits, little-endian.
const MAGIC: &[u8; 16] = b"vkdenoise cache\n";
const HEADER: usize = MAGIC.len() + 16;
/// The largest payload read or written.
const MOST: u64 = 1 << 28;

/// A file of a cache.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct CacheFile {
    folder: PathBuf,
    name: String,
}

impl CacheFile {
    /// The file for `what`, made on a device with its driver from this library's kernels; `None` without a folder.
    pub fn of_device(cache: &Cache, what: &str, identity: &Identity) -> Option<Self> {
        let Identity { vendor, device, driver, uuid, subgroup } = identity;
        let (uuid, kernels) = (u128::from_be_bytes(*uuid), spirv::HASH);
        let name = format!("{what}-{vendor:x}-{device:x}-{driver:x}-{uuid:032x}-{subgroup}-{kernels:016x}");
        cache.folder().map(|folder| Self { folder, name })
    }

    /// The payload, if the file is there and whole.
    pub fn read(&self) -> Option<Vec<u8>> {
        let file = File::open(self.folder.join(&self.name)).ok()?;
        let size = file.metadata().ok().filter(|metadata| metadata.is_file())?.len();
        if size > MOST + HEADER as u64 {
            return None;
        }
        let mut bytes = Vec::new();
        file.take(size).read_to_end(&mut bytes).ok()?;
        let (header, payload) = bytes.split_at_checked(HEADER)?;
        (header == Self::header(payload)).then(|| payload.to_vec())
    }

    /// Replaces the file as a whole: whoever reads it meanwhile, in this process or another, sees the old one or the
    /// new one.
    pub fn write(&self, payload: &[u8]) -> io::Result<()> {
        static WRITTEN: AtomicU64 = AtomicU64::new(0);
        if payload.len() as u64 > MOST {
            return Err(io::Error::new(io::ErrorKind::FileTooLarge, format!("{} bytes", payload.len())));
        }
        fs::create_dir_all(&self.folder)?;
        let number = WRITTEN.fetch_add(1, Ordering::Relaxed);
        let part = self.folder.join(format!("{}.{}.{number}", self.name, process::id()));
        let written = write_new(&part, &Self::header(payload), payload);
        let moved = written.and_then(|()| fs::rename(&part, self.folder.join(&self.name)));
        if moved.is_err() {
            // It may never have been made.
            let _ = fs::remove_file(&part);
        }
        moved
    }

    fn header(payload: &[u8]) -> [u8; HEADER] {
        let mut header = [0; HEADER];
        header[..16].copy_from_slice(MAGIC);
        header[16..24].copy_from_slice(&(payload.len() as u64).to_le_bytes());
        header[24..].copy_from_slice(&hash(payload).to_le_bytes());
        header
    }
}

fn write_new(path: &Path, header: &[u8], payload: &[u8]) -> io::Result<()> {
    let mut file = OpenOptions::new().write(true).create_new(true).open(path)?;
    file.write_all(header)?;
    file.write_all(payload)
}

/// Tells damage, not intent: whoever writes to the user's folder can do worse.
pub(crate) fn hash(bytes: &[u8]) -> u64 {
    // One implementation for a release of the standard library; another one reads the file as damaged and writes it
    // again.
    let mut hasher = std::hash::DefaultHasher::new();
    hasher.write(bytes);
    hasher.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(folder: &Path) -> CacheFile {
        CacheFile { folder: folder.join("made/when/needed"), name: "name".into() }
    }

    #[test]
    fn what_was_written_is_read_and_no_damage_is() {
        let folder = tempfile::tempdir().unwrap();
        let file = file(folder.path());
        assert_eq!(file.read(), None);
        for payload in [&b"payload"[..], b"", b"another payload"] {
            file.write(payload).unwrap();
            assert_eq!(file.read().as_deref(), Some(payload));
        }
        let path = folder.path().join("made/when/needed/name");
        let whole = fs::read(&path).unwrap();
        for at in 0..whole.len() {
            let mut damaged = whole.clone();
            damaged[at] ^= 0x10;
            fs::write(&path, &damaged).unwrap();
            assert_eq!(file.read(), None, "byte {at}");
            fs::write(&path, &whole[..at]).unwrap();
            assert_eq!(file.read(), None, "cut at {at}");
        }
        fs::write(&path, [&whole[..], b"x"].concat()).unwrap();
        assert_eq!(file.read(), None);
        // Nothing else is left in the folder.
        assert_eq!(fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
    }

    /// Readers and writers side by side: a file is never seen half written.
    #[test]
    fn writers_do_not_disturb_readers() {
        let folder = tempfile::tempdir().unwrap();
        let file = file(folder.path());
        let payload = |i: u8| vec![i; 20_000 + usize::from(i)];
        file.write(&payload(0)).unwrap();
        std::thread::scope(|scope| {
            for writer in 0..4 {
                let file = &file;
                scope.spawn(move || (0..50).for_each(|i| file.write(&payload(4 * i + writer)).unwrap()));
            }
            for _ in 0..500 {
                let found = file.read().unwrap();
                assert_eq!(found, payload(found[0]));
            }
        });
        assert_eq!(fs::read_dir(folder.path().join("made/when/needed")).unwrap().count(), 1);
    }

    #[test]
    fn a_folder_that_cannot_be_made_is_an_error_of_the_write_alone() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("made"), "a file in the way").unwrap();
        assert!(file(folder.path()).write(b"payload").is_err());
        assert_eq!(file(folder.path()).read(), None);
    }

    #[test]
    fn another_driver_has_another_file() {
        let identity = Identity { vendor: 5, device: 6, driver: 7, uuid: [9; 16], subgroup: 8 };
        let file = |identity| CacheFile::of_device(&Cache::Folder("here".into()), "this", &identity).unwrap();
        for other in [
            Identity { vendor: 8, ..identity },
            Identity { device: 8, ..identity },
            Identity { driver: 8, ..identity },
            Identity { uuid: [8; 16], ..identity },
            Identity { subgroup: 16, ..identity },
        ] {
            assert_ne!(file(other), file(identity));
        }
        assert_eq!(CacheFile::of_device(&Cache::Off, "this", &identity), None);
    }

    #[test]
    fn a_cache_is_a_folder_or_off() {
        let parsed = ["user", "off", "here"].map(|text| text.parse::<Cache>().unwrap());
        assert_eq!(parsed, [Cache::User, Cache::Off, Cache::Folder("here".into())]);
        assert_eq!(Cache::Off.folder(), None);
        assert_eq!(Cache::Folder("here".into()).folder(), Some("here".into()));
        assert!(Cache::User.folder().is_none_or(|folder| folder.is_absolute() && folder.ends_with("vkdenoise")));
    }
}
