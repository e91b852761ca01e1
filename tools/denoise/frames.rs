//! Frame patterns: `shot.####.exr`, `shot.%04d.exr` and globs.

use crate::ranges::Frames;
use std::path::{Path, PathBuf};

/// A file and the number of its frame, if its name has one.
#[derive(Debug, PartialEq, Eq)]
pub struct FrameFile {
    pub path: PathBuf,
    pub number: Option<u64>,
}

/// The files that an argument names.
#[derive(Debug)]
pub struct Expanded {
    pub files: Vec<FrameFile>,
    /// Frames that a sequence leaves out, in words.
    pub gaps: Option<String>,
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

/// Whether a path's file name has a place for a frame number. A file of that very name is none.
pub fn is_pattern(path: &Path) -> bool {
    Pattern::parse(file_name(path)).is_some() && !path.exists()
}

fn file_name(path: &Path) -> &str {
    path.file_name().and_then(|name| name.to_str()).unwrap_or_default()
}

/// The last number in a file's name, before the extension.
fn own_number(path: &Path) -> Option<u64> {
    let stem = path.file_stem()?.to_str()?;
    stem.split(|c: char| !c.is_ascii_digit()).rfind(|run| !run.is_empty())?.parse().ok()
}

/// Finds the files that an argument names, of these frames if there are any given. A file of that very name comes
/// before any meaning as a pattern. A pattern with frames names a file for each, whether it is there or not.
pub fn expand(argument: &Path, frames: Option<&Frames>) -> Result<Expanded, String> {
    let text = argument.to_string_lossy();
    let single = |path: &Path| FrameFile { path: path.into(), number: own_number(path) };
    let mut gaps = None;
    let mut files = if argument.exists() {
        vec![single(argument)]
    } else if let Some(pattern) = Pattern::parse(file_name(argument)) {
        match frames {
            Some(frames) => {
                let file =
                    |number| FrameFile { path: argument.with_file_name(pattern.name(number)), number: Some(number) };
                frames.numbers().map(file).collect()
            }
            None => {
                let found = sorted(matches(argument, &pattern)?);
                gaps = missing(&text, &found);
                found
            }
        }
    } else if text.contains(['*', '?', '[']) {
        let paths = glob::glob(&text).map_err(|error| format!("bad pattern '{text}': {error}"))?;
        sorted(paths.filter_map(Result::ok).map(|path| single(&path)).collect())
    } else {
        // A missing file is reported when its turn comes, so that the others are done.
        vec![single(argument)]
    };
    if let Some(frames) = frames {
        if let Some(file) = files.iter().find(|file| file.number.is_none()) {
            return Err(format!("--frames: {} has no frame number", file.path.display()));
        }
        files.retain(|file| file.number.is_some_and(|number| frames.contains(number)));
    }
    if files.is_empty() && frames.is_none() {
        return Err(format!("no file matches '{text}'"));
    }
    Ok(Expanded { files, gaps })
}

fn sorted(mut files: Vec<FrameFile>) -> Vec<FrameFile> {
    files.sort_by(|a, b| (a.number, &a.path).cmp(&(b.number, &b.path)));
    files
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

/// The frames that a sorted sequence leaves out, by its smallest step.
fn missing(text: &str, found: &[FrameFile]) -> Option<String> {
    let numbers: Vec<u64> = found.iter().filter_map(|file| file.number).collect();
    let step = numbers.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 0).min()?;
    let between = |pair: &[u64]| {
        let (first, last) = (pair[0] + step, pair[1].saturating_sub(step));
        match pair[1] - pair[0] > step {
            true if first >= last => Some(first.to_string()),
            true => Some(format!("{first}-{last}")),
            false => None,
        }
    };
    let gaps: Vec<String> = numbers.windows(2).filter_map(between).collect();
    let (first, last) = (numbers.first()?, numbers.last()?);
    (!gaps.is_empty()).then(|| format!("{text}: of {first}-{last}, frames {} are missing", gaps.join(", ")))
}

/// The file that goes with an input: the pattern with the input's frame number, or the file itself for every frame.
pub fn companion(argument: &Path, input: &FrameFile) -> Result<PathBuf, String> {
    let Some(pattern) = Pattern::parse(file_name(argument)).filter(|_| !argument.exists()) else {
        return Ok(argument.into());
    };
    let number = input
        .number
        .ok_or_else(|| format!("{} has no frame number to put into '{}'", input.path.display(), argument.display()))?;
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

    #[test]
    fn gaps_are_those_of_the_smallest_step() {
        let files = |numbers: &[u64]| -> Vec<FrameFile> {
            numbers.iter().map(|n| FrameFile { path: "x".into(), number: Some(*n) }).collect()
        };
        let gaps = |numbers: &[u64]| missing("a", &files(numbers));
        for whole in [&[][..], &[4], &[4, 5, 6], &[1, 3, 5, 7], &[10, 20]] {
            assert_eq!(gaps(whole), None, "{whole:?}");
        }
        assert_eq!(gaps(&[1, 2, 3, 5, 6, 10]).unwrap(), "a: of 1-10, frames 4, 7-9 are missing");
        assert_eq!(gaps(&[1, 3, 7, 9, 11]).unwrap(), "a: of 1-11, frames 5 are missing");
    }
}
