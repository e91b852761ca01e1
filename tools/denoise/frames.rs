//! Frame patterns: `shot.####.exr`, `shot.%04d.exr` and globs.

use std::path::{Path, PathBuf};

/// A file and the number of its frame, if its name has one.
#[derive(Debug, PartialEq, Eq)]
pub struct FrameFile {
    pub path: PathBuf,
    pub number: Option<u64>,
}

/// A file name with a place for a frame number.
struct Pattern<'a> {
    before: &'a str,
    digits: usize,
    after: &'a str,
}

impl<'a> Pattern<'a> {
    /// Finds `####`, `%04d` or `%d` in a file name.
    fn parse(name: &'a str) -> Option<Self> {
        if let Some(start) = name.find('#') {
            let digits = name[start..].chars().take_while(|c| *c == '#').count();
            return Some(Self { before: &name[..start], digits, after: &name[start + digits..] });
        }
        let start = name.find('%')?;
        let (width, after) = name[start + 1..].split_once('d')?;
        let digits = if width.is_empty() { 1 } else { width.strip_prefix('0')?.parse().ok()? };
        Some(Self { before: &name[..start], digits, after })
    }

    /// The number of a file name that fits. Longer numbers fit too, as counters outgrow their padding.
    fn number(&self, name: &str) -> Option<u64> {
        let number = name.strip_prefix(self.before)?.strip_suffix(self.after)?;
        let padded = number.len() == self.digits || (number.len() > self.digits && !number.starts_with('0'));
        (padded && number.bytes().all(|b| b.is_ascii_digit())).then(|| number.parse().ok())?
    }

    fn name(&self, number: u64) -> String {
        format!("{}{number:0width$}{}", self.before, self.after, width = self.digits)
    }
}

fn file_name(path: &Path) -> &str {
    path.file_name().and_then(|name| name.to_str()).unwrap_or_default()
}

/// The last number in a file's name, before the extension.
fn own_number(path: &Path) -> Option<u64> {
    let stem = path.file_stem()?.to_str()?;
    stem.split(|c: char| !c.is_ascii_digit()).rfind(|run| !run.is_empty())?.parse().ok()
}

/// Finds the files that an argument names. A file of that very name comes before any meaning as a pattern.
pub fn expand(argument: &Path) -> Result<Vec<FrameFile>, String> {
    let text = argument.to_string_lossy();
    if argument.exists() {
        return Ok(vec![FrameFile { path: argument.into(), number: own_number(argument) }]);
    }
    let mut found = if let Some(pattern) = Pattern::parse(file_name(argument)) {
        matches(argument, &pattern)?
    } else if text.contains(['*', '?', '[']) {
        let paths = glob::glob(&text).map_err(|error| format!("bad pattern '{text}': {error}"))?;
        paths.filter_map(Result::ok).map(|path| FrameFile { number: own_number(&path), path }).collect()
    } else {
        // A missing file is reported when its turn comes, so that the others are done.
        return Ok(vec![FrameFile { path: argument.into(), number: own_number(argument) }]);
    };
    if found.is_empty() {
        return Err(format!("no file matches '{text}'"));
    }
    found.sort_by(|a, b| (a.number, &a.path).cmp(&(b.number, &b.path)));
    Ok(found)
}

fn matches(argument: &Path, pattern: &Pattern) -> Result<Vec<FrameFile>, String> {
    let directory = match argument.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let entries =
        std::fs::read_dir(directory).map_err(|e| format!("cannot read directory {}: {e}", directory.display()))?;
    let names = entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    let found = names.filter_map(|name| {
        let number = pattern.number(&name)?;
        Some(FrameFile { path: argument.with_file_name(name), number: Some(number) })
    });
    Ok(found.collect())
}

/// The file that goes with an input: the pattern with the input's frame number, or the file itself for every frame.
pub fn companion(argument: &Path, input: &FrameFile) -> Result<PathBuf, String> {
    let Some(pattern) = Pattern::parse(file_name(argument)).filter(|_| !argument.exists()) else {
        return Ok(argument.into());
    };
    let number = input.number.ok_or_else(|| {
        let (input, argument) = (input.path.display(), argument.display());
        format!("the name of {input} has no frame number to put into '{argument}'")
    })?;
    Ok(argument.with_file_name(pattern.name(number)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn number(pattern: &str, name: &str) -> Option<u64> {
        Pattern::parse(pattern).and_then(|p| p.number(name))
    }

    #[test]
    fn patterns_take_padded_and_outgrown_numbers() {
        assert_eq!(number("a.####.exr", "a.0007.exr"), Some(7));
        assert_eq!(number("a.%04d.exr", "a.0007.exr"), Some(7));
        assert_eq!(number("a.%d.exr", "a.12.exr"), Some(12));
        assert_eq!(number("a.####.exr", "a.12345.exr"), Some(12345));
        for other in ["a.007.exr", "a.00007.exr", "a.x007.exr", "b.0007.exr", "a.0007.png", "a.exr"] {
            assert_eq!(number("a.####.exr", other), None, "{other}");
        }
        assert!(Pattern::parse("plain.exr").is_none() && Pattern::parse("100%.exr").is_none());
    }

    #[test]
    fn companions_take_the_inputs_number() {
        let input = |name: &str| FrameFile { path: name.into(), number: own_number(Path::new(name)) };
        let albedo = Path::new("aux/alb_####.exr");
        assert_eq!(companion(albedo, &input("v2/shot.0012.exr")), Ok("aux/alb_0012.exr".into()));
        assert_eq!(companion(Path::new("one.exr"), &input("shot.0012.exr")), Ok("one.exr".into()));
        assert!(companion(albedo, &input("shot.exr")).is_err());
        assert_eq!(own_number(Path::new("é12.exr")), Some(12));
    }
}
