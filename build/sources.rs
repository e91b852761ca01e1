//! What the SPIR-V is made from.

use std::fs;
use std::path::{Path, PathBuf};

/// Shaders, their contracts, and what compiles them.
pub const PATHS: [&str; 4] = ["glsl", "build", "build.rs", "src/kernels"];

/// The file beside compiled shaders that says of which sources they are.
pub const STAMP: &str = "sources.hash";

/// A hash of every file of [`PATHS`], by name and content; the same with every release of Rust (FNV-1a).
///
/// # Errors
/// A file that cannot be read, by name.
pub fn hash() -> Result<u64, String> {
    let mut files = Vec::new();
    for path in PATHS {
        list(Path::new(path), &mut files)?;
    }
    files.sort();
    let mut hash = 0xcbf2_9ce4_8422_2325_u64;
    for file in files {
        let content = fs::read(&file).map_err(|e| format!("{}: {e}", file.display()))?;
        let name = file.to_string_lossy().replace('\\', "/");
        for byte in name.bytes().chain([0]).chain((content.len() as u64).to_le_bytes()).chain(content) {
            hash = (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }
    Ok(hash)
}

fn list(path: &Path, files: &mut Vec<PathBuf>) -> Result<(), String> {
    if !path.is_dir() {
        files.push(path.into());
        return Ok(());
    }
    let failed = |e: std::io::Error| format!("{}: {e}", path.display());
    for entry in fs::read_dir(path).map_err(failed)? {
        list(&entry.map_err(failed)?.path(), files)?;
    }
    Ok(())
}
