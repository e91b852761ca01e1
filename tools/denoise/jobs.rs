//! What to do, checked as far as it can be without reading an image: which input goes where, with which other files.

use crate::Failure;
use crate::args::Args;
use crate::frames::{FrameFile, companion, expand, is_pattern};
use std::collections::HashMap;
use std::fmt;
use std::path::{Path, PathBuf};
use vkdenoise::exr_io::{FeatureSource, LayerOptions};

/// One image to denoise.
#[derive(Debug)]
pub struct Job {
    pub input: PathBuf,
    pub output: Output,
    pub layers: LayerOptions,
    pub reference: Option<PathBuf>,
    pub png: Option<PathBuf>,
}

/// Where an image goes.
#[derive(Debug)]
pub enum Output {
    File(PathBuf),
    /// Standard output.
    Standard,
}

impl Output {
    /// The file, if it is one.
    pub fn file(&self) -> Option<&Path> {
        match self {
            Self::File(path) => Some(path),
            Self::Standard => None,
        }
    }
}

impl fmt::Display for Output {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(path) => path.display().fmt(f),
            Self::Standard => f.write_str("-"),
        }
    }
}

/// All images, and what there is to say of them beforehand.
pub struct Plan {
    pub jobs: Vec<Job>,
    pub notes: Vec<String>,
}

/// Expands the patterns, names the outputs and makes sure that none would overwrite a file that is needed.
pub fn plan(args: &Args) -> Result<Plan, Failure> {
    let (mut inputs, mut notes) = (Vec::new(), Vec::new());
    for argument in &args.inputs {
        let expanded = expand(argument, args.frames.as_ref()).map_err(Failure::Failed)?;
        inputs.extend(expanded.files);
        notes.extend(expanded.gaps);
    }
    if inputs.is_empty() {
        return Err(Failure::Failed("--frames: no input has one of these frames".into()));
    }
    let output = args.output.as_deref().unwrap_or(Path::new(""));
    let several = inputs.len() > 1;
    let outputs = Target::new("-o", output, several)?;
    check_output(args, &outputs)?;
    let previews = args.png.as_deref().map(|png| Target::new("--png", png, several)).transpose()?;
    let with = |source: &Option<FeatureSource>, input: &FrameFile| match source {
        Some(FeatureSource::File(file)) => companion(file, input).map(FeatureSource::File),
        other => Ok(other.clone().unwrap_or_default()),
    };
    // Layers that nobody asks for are not read.
    let noise = |source: &Option<FeatureSource>, input: &FrameFile| match args.converged() {
        Some(_) => with(source, input),
        None => Ok(FeatureSource::Unused),
    };
    let job = |input: FrameFile| -> Result<Job, String> {
        Ok(Job {
            output: match outputs {
                Target::Standard => Output::Standard,
                _ => Output::File(outputs.path(&input, "exr")?),
            },
            layers: LayerOptions {
                layer: args.layer.clone(),
                into: args.into.clone(),
                view: args.view.clone(),
                albedo: with(&args.albedo, &input)?,
                normal: with(&args.normal, &input)?,
                depth: with(&args.depth, &input)?,
                variance: noise(&args.variance, &input)?,
                samples: noise(&args.samples, &input)?,
                signals: args.signals(),
            },
            reference: args.reference.as_deref().map(|file| companion(file, &input)).transpose()?,
            png: previews.as_ref().map(|target| target.path(&input, "png")).transpose()?,
            input: input.path,
        })
    };
    let jobs: Vec<Job> = inputs.into_iter().map(job).collect::<Result<_, _>>().map_err(Failure::Failed)?;
    check_overwrites(&jobs, matches!(outputs, Target::File(_)))?;
    let own = |job: &&Job| job.output.file().is_some_and(|output| identity(output) == identity(&job.input));
    if let Some(job) = jobs.iter().find(own).filter(|_| args.skip_existing) {
        return Err(Failure::Usage(format!("--skip-existing: {} is its own output, and there", job.input.display())));
    }
    Ok(Plan { jobs, notes })
}

/// Refuses outputs that are no OpenEXR files, and more than one thing on standard output.
fn check_output(args: &Args, target: &Target) -> Result<(), Failure> {
    const OTHERS: &[&str] = &[
        "png", "jpg", "jpeg", "jpe", "tif", "tiff", "tga", "bmp", "gif", "webp", "hdr", "pic", "pfm", "dpx", "cin",
        "psd", "jxl", "avif", "heic", "svg", "mp4", "mov",
    ];
    match target {
        Target::File(path) | Target::Pattern(path) => {
            let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_lowercase();
            if OTHERS.contains(&extension.as_str()) {
                let shown = path.display();
                return Err(Failure::Usage(format!(
                    "-o {shown}: what is written is OpenEXR; for a picture as a screen shows it give --png FILE as well"
                )));
            }
            Ok(())
        }
        Target::Standard if args.json || args.reference.is_some() => Err(Failure::Usage(
            "-o -: the image has standard output to itself: leave out --json and --reference".into(),
        )),
        Target::Standard if args.skip_existing => Err(Failure::Usage("-o -: there is nothing to skip".into())),
        Target::Standard | Target::Directory(_) => Ok(()),
    }
}

/// Where outputs go.
enum Target<'a> {
    File(&'a Path),
    /// A file name with a place for the frame number.
    Pattern(&'a Path),
    Directory(&'a Path),
    Standard,
}

impl<'a> Target<'a> {
    fn new(option: &str, path: &'a Path, several: bool) -> Result<Self, Failure> {
        if option == "-o" && path.as_os_str() == "-" {
            if several {
                return Err(Failure::Usage("-o -: standard output takes one image".into()));
            }
            return Ok(Self::Standard);
        }
        if path.is_dir() {
            return Ok(Self::Directory(path));
        }
        let shown = path.display();
        let pattern = is_pattern(path);
        if several && !pattern {
            let hint = "for several inputs give a directory that exists, or a name with #### for the frame";
            return Err(Failure::Usage(format!("{option} {shown}: {hint}")));
        }
        if path.file_name().is_none() || path.to_string_lossy().ends_with(std::path::is_separator) {
            return Err(Failure::Failed(format!("{option} {shown}: there is no such directory")));
        }
        match path.parent() {
            Some(parent) if !parent.as_os_str().is_empty() && !parent.is_dir() => {
                Err(Failure::Failed(format!("{option} {shown}: there is no directory {}", parent.display())))
            }
            _ if pattern => Ok(Self::Pattern(path)),
            _ => Ok(Self::File(path)),
        }
    }

    fn path(&self, input: &FrameFile, extension: &str) -> Result<PathBuf, String> {
        match self {
            Self::File(path) => Ok(path.to_path_buf()),
            Self::Pattern(path) => companion(path, input),
            Self::Directory(directory) => {
                let path = &input.path;
                let name = path.file_name().ok_or_else(|| format!("{} names no file", path.display()))?;
                Ok(directory.join(name).with_extension(extension))
            }
            Self::Standard => Ok(PathBuf::new()),
        }
    }
}

/// Refuses outputs that meet each other or a file that is read. One exception: `-o` may name its own input.
fn check_overwrites(jobs: &[Job], named: bool) -> Result<(), Failure> {
    let mut read: HashMap<PathBuf, &Path> = HashMap::new();
    for job in jobs {
        let layers = &job.layers;
        let features = [&layers.albedo, &layers.normal, &layers.depth, &layers.variance, &layers.samples];
        let features = features.into_iter().filter_map(|source| match source {
            FeatureSource::File(file) => Some(file.as_path()),
            _ => None,
        });
        for file in features.chain(job.reference.as_deref()).chain((!named).then_some(job.input.as_path())) {
            read.insert(identity(file), file);
        }
    }
    let mut written: HashMap<PathBuf, &Path> = HashMap::new();
    for job in jobs {
        for output in job.output.file().into_iter().chain(job.png.as_deref()) {
            let (id, shown) = (identity(output), output.display());
            if let Some(file) = read.get(&id) {
                let hint = "name another output, or with -o the one file to denoise in place";
                return Err(Failure::Usage(format!("writing {shown} would overwrite {}: {hint}", file.display())));
            }
            if let Some(other) = written.insert(id, &job.input) {
                let (one, two) = (other.display(), job.input.display());
                return Err(Failure::Usage(format!("{one} and {two} would both be written to {shown}")));
            }
        }
        if job.png.as_ref().is_some_and(|png| identity(png) == identity(&job.input)) {
            return Err(Failure::Usage(format!("--png would overwrite {}", job.input.display())));
        }
    }
    Ok(())
}

/// One name for each file, whether it is there yet or not.
fn identity(path: &Path) -> PathBuf {
    path.canonicalize().unwrap_or_else(|_| {
        let directory = match path.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent,
            _ => Path::new("."),
        };
        let directory = directory.canonicalize().unwrap_or_else(|_| directory.to_path_buf());
        path.file_name().map_or(directory.clone(), |name| directory.join(name))
    })
}
