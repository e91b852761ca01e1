//! What to do, checked as far as it can be without reading an image: which input goes where, with which other files.

use crate::Failure;
use crate::args::Args;
use crate::frames::{FrameFile, companion, expand};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use vkdenoise::exr_io::{FeatureSource, LayerOptions};

/// One image to denoise.
#[derive(Debug)]
pub struct Job {
    pub input: PathBuf,
    pub output: PathBuf,
    pub layers: LayerOptions,
    pub reference: Option<PathBuf>,
    pub png: Option<PathBuf>,
}

/// Expands the patterns, names the outputs and makes sure that none would overwrite a file that is needed.
pub fn plan(args: &Args) -> Result<Vec<Job>, Failure> {
    let mut inputs = Vec::new();
    for argument in &args.inputs {
        inputs.extend(expand(argument).map_err(Failure::Failed)?);
    }
    let output = args.output.as_deref().unwrap_or(Path::new(""));
    let several = inputs.len() > 1;
    let outputs = Target::new("-o", output, several)?;
    let previews = args.png.as_deref().map(|png| Target::new("--png", png, several)).transpose()?;
    let with = |source: &Option<FeatureSource>, input: &FrameFile| match source {
        Some(FeatureSource::File(file)) => companion(file, input).map(FeatureSource::File),
        other => Ok(other.clone().unwrap_or_default()),
    };
    // Layers that nobody asks for are not read.
    let noise = |source: &Option<FeatureSource>, input: &FrameFile| match args.quiet() {
        Some(_) => with(source, input),
        None => Ok(FeatureSource::Unused),
    };
    let job = |input: FrameFile| -> Result<Job, String> {
        Ok(Job {
            output: outputs.path(&input.path, "exr")?,
            layers: LayerOptions {
                layer: args.layer.clone(),
                albedo: with(&args.albedo, &input)?,
                normal: with(&args.normal, &input)?,
                depth: with(&args.depth, &input)?,
                variance: noise(&args.variance, &input)?,
                samples: noise(&args.samples, &input)?,
            },
            reference: args.reference.as_deref().map(|file| companion(file, &input)).transpose()?,
            png: previews.as_ref().map(|target| target.path(&input.path, "png")).transpose()?,
            input: input.path,
        })
    };
    let jobs: Vec<Job> = inputs.into_iter().map(job).collect::<Result<_, _>>().map_err(Failure::Failed)?;
    check_overwrites(&jobs, matches!(outputs, Target::File(_)))?;
    Ok(jobs)
}

/// Where outputs go.
enum Target<'a> {
    File(&'a Path),
    Directory(&'a Path),
}

impl<'a> Target<'a> {
    fn new(option: &str, path: &'a Path, several: bool) -> Result<Self, Failure> {
        if path.is_dir() {
            return Ok(Self::Directory(path));
        }
        let shown = path.display();
        if several {
            return Err(Failure::Usage(format!("{option} {shown}: for several inputs give a directory that exists")));
        }
        if path.file_name().is_none() || path.to_string_lossy().ends_with(std::path::is_separator) {
            return Err(Failure::Failed(format!("{option} {shown}: there is no such directory")));
        }
        match path.parent() {
            Some(parent) if !parent.as_os_str().is_empty() && !parent.is_dir() => {
                Err(Failure::Failed(format!("{option} {shown}: there is no directory {}", parent.display())))
            }
            _ => Ok(Self::File(path)),
        }
    }

    fn path(&self, input: &Path, extension: &str) -> Result<PathBuf, String> {
        match self {
            Self::File(path) => Ok(path.to_path_buf()),
            Self::Directory(directory) => {
                let name = input.file_name().ok_or_else(|| format!("{} names no file", input.display()))?;
                Ok(directory.join(name).with_extension(extension))
            }
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
        for output in [Some(&job.output), job.png.as_ref()].into_iter().flatten() {
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
