//! What was compiled by earlier builds: a shader whose text has not changed is not compiled again.

use crate::write;
use std::collections::HashSet;
use std::ffi::OsString;
use std::fs;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};

/// Compiled modules in a folder, each under the hash of all that it was made of.
pub struct Compiled {
    folder: PathBuf,
    used: HashSet<OsString>,
}

impl Compiled {
    /// # Errors
    /// A folder that cannot be made.
    pub fn in_folder(folder: PathBuf) -> Result<Self, String> {
        fs::create_dir_all(&folder).map_err(|e| format!("{}: {e}", folder.display()))?;
        Ok(Self { folder, used: HashSet::new() })
    }

    /// The words of an earlier build of the same sources, or those that `compile` makes.
    ///
    /// # Errors
    /// Those of `compile`; a file that cannot be written.
    pub fn words(
        &mut self,
        of: impl Hash,
        compile: impl FnOnce() -> Result<Vec<u32>, String>,
    ) -> Result<Vec<u32>, String> {
        let mut hasher = DefaultHasher::new();
        of.hash(&mut hasher);
        let name = OsString::from(format!("{:016x}", hasher.finish()));
        let file = self.folder.join(&name);
        self.used.insert(name);
        if let Some(words) = fs::read_to_string(&file).ok().and_then(|text| parse(&text)) {
            return Ok(words);
        }
        let words = compile()?;
        write(&file, &words.iter().map(|word| format!("{word:x}\n")).collect::<String>())?;
        Ok(words)
    }

    /// Removes what this build did not use.
    pub fn forget_others(&self) {
        let files = fs::read_dir(&self.folder).into_iter().flatten().flatten();
        for file in files.filter(|file| !self.used.contains(&file.file_name())) {
            // What stays costs nothing but its place.
            let _ = fs::remove_file(file.path());
        }
    }
}

/// Words of SPIR-V; `None` where a build was stopped while it wrote them.
fn parse(text: &str) -> Option<Vec<u32>> {
    let words = text.strip_suffix('\n')?.lines().map(|line| u32::from_str_radix(line, 16).ok());
    words.collect()
}

/// A shader's text with that of all that it includes, as often as it does.
///
/// # Errors
/// A file that cannot be read.
pub fn with_includes(folder: &Path, file: &str) -> Result<String, String> {
    let path = folder.join(file);
    let text = fs::read_to_string(&path).map_err(|e| format!("{}: {e}", path.display()))?;
    let included = text.lines().filter_map(|line| line.trim_start().strip_prefix("#include")?.split('"').nth(1));
    let mut all = text.clone();
    for name in included {
        all += &with_includes(folder, name)?;
    }
    Ok(all)
}
