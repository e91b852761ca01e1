//! Takes the shaders that were compiled when the crate was packaged.

use crate::sources::STAMP;
use std::fs;
use std::path::Path;

/// Where a package has them.
pub const FOLDER: &str = "shaders";

/// Copies them, if they are of the sources that stand beside them.
///
/// # Errors
/// Where there are none, or they are of other sources: what to do. A file that cannot be read or written, by name.
pub fn copy(folder: &Path, sources: u64, out: &Path) -> Result<(), String> {
    println!("cargo::rerun-if-changed={FOLDER}");
    const COMPILE: &str = "build with the feature `shaderc`, which compiles them (a C++ compiler and CMake are needed)";
    let Ok(stamp) = fs::read_to_string(folder.join(STAMP)) else {
        return Err(format!("{} holds no compiled shaders; {COMPILE}", folder.display()));
    };
    if stamp.trim() != format!("{sources:016x}") {
        return Err(format!("the shaders in {} were compiled from other sources; {COMPILE}", folder.display()));
    }
    let failed = |e: std::io::Error| format!("{}: {e}", folder.display());
    for entry in fs::read_dir(folder).map_err(failed)? {
        let entry = entry.map_err(failed)?;
        let to = out.join(entry.file_name());
        fs::copy(entry.path(), &to).map_err(|e| format!("{}: {e}", to.display()))?;
    }
    Ok(())
}
