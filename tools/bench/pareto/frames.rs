//! Directories of rendered pairs: `<root>/<scene>/<view>/{spp####.exr, ref.exr}`.

use super::Result;
use crate::stress::scene::Scene;
use std::path::{Path, PathBuf};
use vkdenoise::exr_io::{ExrFrame, LayerOptions};
use vkdenoise::{Plane, Samples};

/// One noisy file and its reference.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Pair {
    /// The scene's folder.
    pub scene: String,
    /// The view's folder.
    pub view: String,
    /// Samples per pixel, from the file's name.
    pub spp: u32,
    folder: PathBuf,
}

/// The pairs below `root`, in order of their names; `wanted` picks scenes and sample counts, all where it is empty.
///
/// # Errors
/// Where a folder cannot be read, or where there is no pair.
pub fn find(root: &Path, scenes: &[String], spp: &[u32]) -> Result<Vec<Pair>> {
    let mut pairs = Vec::new();
    for scene in folders(root)? {
        if !scenes.is_empty() && !scenes.contains(&name(&scene)) {
            continue;
        }
        for view in folders(&scene)?.into_iter().filter(|view| view.join("ref.exr").is_file()) {
            for file in std::fs::read_dir(&view).map_err(|error| format!("{}: {error}", view.display()))? {
                let count = samples(&name(&file?.path()));
                if let Some(count) = count.filter(|count| spp.is_empty() || spp.contains(count)) {
                    pairs.push(Pair { scene: name(&scene), view: name(&view), spp: count, folder: view.clone() });
                }
            }
        }
    }
    if pairs.is_empty() {
        let wanted = "<scene>/<view>/spp####.exr beside a ref.exr";
        return Err(format!("{}: no {wanted} in it that --scenes and --spp ask for", root.display()).into());
    }
    pairs.sort();
    Ok(pairs)
}

impl Pair {
    /// Reads both files: the noisy planes, and the reference as the clean picture.
    ///
    /// # Errors
    /// Those of the loader; where the sizes differ.
    pub fn load(&self) -> Result<Scene> {
        let read = |file: String, layers: &LayerOptions| {
            let path = self.folder.join(file);
            ExrFrame::read(&path, layers).map_err(|error| format!("{}: {error}", path.display()))
        };
        let noisy = read(format!("spp{:04}.exr", self.spp), &LayerOptions::default())?;
        let reference = read("ref.exr".into(), &LayerOptions::color_only(None))?;
        let [a, b] = [&noisy, &reference].map(|file| file.frame().extent);
        if a != b {
            let sizes = format!("{} x {} and {} x {}", a.width, a.height, b.width, b.height);
            return Err(format!("{}: noisy frame and reference differ in size: {sizes}", self.folder.display()).into());
        }
        let features = noisy.frame().features;
        let samples = |plane: Option<Plane>| match plane?.samples {
            Samples::F32(samples) => Some(samples.to_vec()),
            Samples::F16(_) => None,
        };
        let [albedo, normal, depth] = [features.albedo, features.normal, features.depth].map(samples);
        let (clean, color) = (reference.color().to_vec(), noisy.color().to_vec());
        Ok(Scene { extent: a, clean, color, albedo, normal, depth, samples: None })
    }
}

/// The count in `spp####.exr`.
fn samples(name: &str) -> Option<u32> {
    name.strip_prefix("spp")?.strip_suffix(".exr")?.parse().ok()
}

fn name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

fn folders(root: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(root).map_err(|error| format!("{}: {error}", root.display()))?;
    let mut found = Vec::new();
    for entry in entries {
        let path = entry?.path();
        if path.is_dir() {
            found.push(path);
        }
    }
    found.sort();
    Ok(found)
}
