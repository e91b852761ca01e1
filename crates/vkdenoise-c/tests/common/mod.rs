//! What the tests share.

use std::fs;
use std::path::Path;

/// Compares a text with the file that is kept of it. With `VKDENOISE_WRITE_STORED=1` in the environment the file is
/// written.
pub fn assert_stored(file: &Path, made: &str) {
    if std::env::var_os("VKDENOISE_WRITE_STORED").is_some_and(|value| value == "1") {
        fs::write(file, made).unwrap();
    }
    let stored = fs::read_to_string(file).unwrap_or_default();
    let differs = stored.lines().zip(made.lines()).position(|(stored, made)| stored != made);
    let line = differs.unwrap_or(stored.lines().count().min(made.lines().count()));
    assert!(
        stored == made,
        "{} is not what the sources give, from line {} on:\n  stored: {}\n  now:    {}\n\
         If that is meant, run the test once more with VKDENOISE_WRITE_STORED=1 and commit the file.",
        file.display(),
        line + 1,
        stored.lines().nth(line).unwrap_or("(its end)"),
        made.lines().nth(line).unwrap_or("(its end)"),
    );
}
