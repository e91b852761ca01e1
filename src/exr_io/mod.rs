//! OpenEXR files: a [`Frame`] out of a file's layers, and the file again with new colour.
//!
//! [`ExrFrame::read`] finds colour, albedo, normal and depth by the names that renderers write, and
//! [`ExrFrame::selection`] says which it took. [`ExrFrame::write_with_color`] writes the same file with the colour
//! replaced: header (attributes, windows, compression, channel types), block order, alpha, other layers and other parts
//! stay as they were. Blocks that hold no colour are copied bit for bit; those that do are compressed anew, which with
//! a lossy compression (B44, DWA, PXR24) rounds the other channels of that part a second time.
//! [`ExrFrame::write_region`] writes a part of the pixels as a file of its own.
//!
//! Names, compared without case, spaces and punctuation, best first:
//!
//! * **Colour**: plain R, G, B or grey Y; Blender's `ViewLayer.Noisy Image` and `ViewLayer.Combined`; beauty, rgba, rgb,
//!   color, C, Ci, image, main, final, default; in a file of several parts the first; the only RGB layer.
//! * **Albedo**: Denoising Albedo, denoise_albedo, albedo, GuideAlbedo, diffuse albedo, VisibleDiffuseAlbedo,
//!   VisibleDiffuse, DiffuseFilter, VRayDiffuseFilter, BaseColor, DiffuseColor, DiffCol.
//! * **Normal**: Denoising Normal, denoise_normal, sh_normal, AVG_SHADING_NORMAL, shading_normal(s), Ns, nn,
//!   GuideNormal(W), BumpNormals, VRayBumpNormals, N, normal(s), WorldNormal, VRayNormals; then the geometric ones:
//!   geo_normal, geometric_normal, geometry_normal, Ng. Also as channels `Nx`, `Ny`, `Nz`.
//! * **Depth**: Denoising Depth, denoise_depth, depth, Z, ZDepth, VRayZDepth, dd, distance, camera depth, linear depth,
//!   t; any layer with the one channel T (Mitsuba). As a layer (`Depth.Z`) or as a channel (`Z`).
//!
//! * **Variance** of a pixel's luminance, and **samples** of a pixel, for leaving out what has converged: variance, color
//!   variance, noise variance, luminance variance; sample count(s), samples, samples per pixel, spp, num samples.
//!
//! Features come from the colour's own view layer (`ViewLayer.` before the name) or from layers without one. Positions
//! are not taken for depth: a file does not say whose space they are in. Blender's Composite is passed over where there
//! is a view layer, and two view layers are an error that asks for a name.
//!
//! Not supported: deep data, subsampled (luminance-chroma) channels, mip maps as colour, HTJ2K compression, integer
//! colour, more than [`MAX_PIXELS`] pixels.

mod assemble;
mod codec;
mod container;
mod crop;
mod error;
mod layers;
mod replace;
mod select;

pub use codec::MAX_PIXELS;
pub use error::ExrError;
pub use replace::replace_file;

use crate::frame::{Extent, Features, Frame, Layout, Noise, Plane, Region, widen_half_depths};
use crate::kernels::quiet::NoiseKind;
use container::Container;
use exr::meta::attribute::SampleType;
use layers::Layer;
use select::Pick;
use std::fmt;
use std::path::{Path, PathBuf};

/// What a layer is used for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Role {
    Albedo,
    Normal,
    Depth,
    Variance,
    Samples,
}

impl Role {
    /// Whether its plane has one channel.
    fn is_scalar(self) -> bool {
        matches!(self, Self::Depth | Self::Variance | Self::Samples)
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Albedo => "albedo",
            Self::Normal => "normal",
            Self::Depth => "depth",
            Self::Variance => "variance",
            Self::Samples => "samples",
        })
    }
}

/// Where a feature comes from.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum FeatureSource {
    /// The colour's file, if it has a layer of a known name.
    #[default]
    SameFile,
    /// A file of its own with the same data window. Its layer may have any name if it is the only one.
    File(PathBuf),
    /// Nowhere: the feature is not used even if it is there.
    Unused,
}

/// Which layers to read.
#[derive(Clone, Debug, Default)]
pub struct LayerOptions {
    /// The colour layer: its full name, its part's name, its view layer's name or the last section of its name.
    /// `None`: by the usual names.
    pub layer: Option<String>,
    /// Where the albedo comes from.
    pub albedo: FeatureSource,
    /// Where the normal comes from.
    pub normal: FeatureSource,
    /// Where the depth comes from.
    pub depth: FeatureSource,
    /// Where the variance comes from.
    pub variance: FeatureSource,
    /// Where the sample counts come from. Where there is a variance, that counts.
    pub samples: FeatureSource,
}

impl LayerOptions {
    /// Colour alone, without features.
    pub fn color_only(layer: Option<String>) -> Self {
        use FeatureSource::Unused;
        Self { layer, albedo: Unused, normal: Unused, depth: Unused, variance: Unused, samples: Unused }
    }
}

/// The channels that were taken for a role.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UsedLayer {
    /// The feature's own file; `None` for the colour's file.
    pub file: Option<PathBuf>,
    /// The part's name, in files of several parts.
    pub part: Option<String>,
    /// The channels' full names as they stand in the file: three, or one for depth and for grey colour.
    pub channels: Vec<String>,
}

impl fmt::Display for UsedLayer {
    /// `ViewLayer.Combined.R/G/B`, `Z`, `part diffuse: R/G/B`, `Ns.X/Y/Z in normals.exr`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(part) = &self.part {
            write!(f, "part {part}: ")?;
        }
        let prefix = self.channels.first().and_then(|c| c.rfind('.').map(|dot| &c[..=dot])).unwrap_or("");
        for (i, channel) in self.channels.iter().enumerate() {
            let shared = if i == 0 { None } else { channel.strip_prefix(prefix) };
            write!(f, "{}{}", if i == 0 { "" } else { "/" }, shared.unwrap_or(channel))?;
        }
        self.file.as_ref().map_or(Ok(()), |file| write!(f, " in {}", file.display()))
    }
}

/// The layers that were taken.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Selection {
    /// Colour: three channels, or one that is grey.
    pub color: UsedLayer,
    /// Albedo, if there is one.
    pub albedo: Option<UsedLayer>,
    /// Normal, if there is one.
    pub normal: Option<UsedLayer>,
    /// Depth, if there is one.
    pub depth: Option<UsedLayer>,
    /// Variance, if there is one.
    pub variance: Option<UsedLayer>,
    /// Sample counts, if there are.
    pub samples: Option<UsedLayer>,
    /// What the user should know: layers that were there but could not be used, and why.
    pub notes: Vec<String>,
}

/// An OpenEXR file that was read for denoising.
///
/// Holds the file's compressed bytes and the selected planes as f32: 12 bytes a pixel of colour, and up to 36 of
/// the rest.
pub struct ExrFrame {
    container: Container,
    pick: Pick,
    selection: Selection,
    extent: Extent,
    color: Vec<f32>,
    albedo: Option<Vec<f32>>,
    normal: Option<Vec<f32>>,
    depth: Option<Vec<f32>>,
    variance: Option<Vec<f32>>,
    samples: Option<Vec<f32>>,
}

impl ExrFrame {
    /// Reads a file, and the features' own files if the options name some.
    ///
    /// # Errors
    /// [`ExrError`]: a file that is missing, not OpenEXR, truncated, damaged, too large or of a kind that is not
    /// supported; no or several colour layers that fit; a feature's file of another data window.
    pub fn read(path: impl AsRef<Path>, options: &LayerOptions) -> Result<Self, ExrError> {
        let container = Container::open(path.as_ref())?;
        let layers = layers::layers(&container);
        let pick =
            select::pick_color(&container, &layers, options.layer.as_deref()).map_err(|e| explain(&container, e))?;
        if container.has_levels(pick.part) {
            let reason = "its colour is a mip map; keep the full resolution only";
            return Err(ExrError::unsupported(&container.path, reason));
        }
        codec::check_size(&container, pick.part)?;
        let size = container.header(pick.part).layer_size;
        let mut frame = Self {
            selection: Selection {
                color: used_layer(&container, &pick, None),
                albedo: None,
                normal: None,
                depth: None,
                variance: None,
                samples: None,
                notes: Vec::new(),
            },
            extent: Extent::new(size.x() as u32, size.y() as u32),
            container,
            pick,
            color: Vec::new(),
            albedo: None,
            normal: None,
            depth: None,
            variance: None,
            samples: None,
        };
        frame.read_own_layers(&layers, options)?;
        for (role, source) in options.features() {
            if let FeatureSource::File(path) = source {
                frame.read_feature_file(role, path)?;
            }
        }
        Ok(frame)
    }

    /// Reads the colour and the features of the colour's file, each part once.
    fn read_own_layers(&mut self, layers: &[Layer], options: &LayerOptions) -> Result<(), ExrError> {
        let window = self.container.header(self.pick.part).data_window();
        let mut features: Vec<(Role, Pick)> = Vec::new();
        for (role, source) in options.features() {
            if *source != FeatureSource::SameFile {
                continue;
            }
            let Some(pick) = select::pick_feature(role, layers, &self.pick) else { continue };
            let used = used_layer(&self.container, &pick, None);
            let its_window = self.container.header(pick.part).data_window();
            if its_window != window {
                let (its, colors) = (window_text(its_window), window_text(window));
                self.selection
                    .notes
                    .push(format!("{role} layer {used} not used: it covers {its}, the colour {colors}"));
                continue;
            }
            *self.used_mut(role) = Some(used);
            features.push((role, pick));
        }
        let mut parts: Vec<usize> = features.iter().map(|(_, pick)| pick.part).collect();
        parts.push(self.pick.part);
        parts.sort_unstable();
        parts.dedup();
        for part in parts {
            codec::check_size(&self.container, part)?;
            let here: Vec<&(Role, Pick)> = features.iter().filter(|(_, pick)| pick.part == part).collect();
            let mut wanted: Vec<&[usize]> = here.iter().map(|(_, pick)| pick.channels.as_slice()).collect();
            if part == self.pick.part {
                wanted.push(&self.pick.channels);
            }
            let mut planes = codec::decode_planes(&self.container, part, &wanted)?;
            if part == self.pick.part {
                self.color = planes.pop().unwrap_or_default();
            }
            for ((role, pick), mut plane) in here.into_iter().zip(planes) {
                widen_depth(*role, &self.container, pick, &mut plane);
                *self.plane_mut(*role) = Some(plane);
            }
        }
        Ok(())
    }

    fn read_feature_file(&mut self, role: Role, path: &Path) -> Result<(), ExrError> {
        let container = Container::open(path)?;
        let layers = layers::layers(&container);
        let pick = select::pick_from_own_file(role, &container, &layers).map_err(|e| explain(&container, e))?;
        let (found, wanted) =
            (container.header(pick.part).data_window(), self.container.header(self.pick.part).data_window());
        if found != wanted {
            let (found, wanted) = (window_text(found), window_text(wanted));
            return Err(ExrError::WindowMismatch { path: path.into(), found, wanted });
        }
        codec::check_size(&container, pick.part)?;
        let mut planes = codec::decode_planes(&container, pick.part, &[pick.channels.as_slice()])?;
        planes.iter_mut().for_each(|plane| widen_depth(role, &container, &pick, plane));
        *self.plane_mut(role) = planes.pop();
        *self.used_mut(role) = Some(used_layer(&container, &pick, Some(path)));
        Ok(())
    }

    fn plane_mut(&mut self, role: Role) -> &mut Option<Vec<f32>> {
        match role {
            Role::Albedo => &mut self.albedo,
            Role::Normal => &mut self.normal,
            Role::Depth => &mut self.depth,
            Role::Variance => &mut self.variance,
            Role::Samples => &mut self.samples,
        }
    }

    fn used_mut(&mut self, role: Role) -> &mut Option<UsedLayer> {
        match role {
            Role::Albedo => &mut self.selection.albedo,
            Role::Normal => &mut self.selection.normal,
            Role::Depth => &mut self.selection.depth,
            Role::Variance => &mut self.selection.variance,
            Role::Samples => &mut self.selection.samples,
        }
    }

    /// The size of the colour's data window.
    pub fn extent(&self) -> Extent {
        self.extent
    }

    /// The colour: interleaved RGB, linear radiance as it stands in the file.
    pub fn color(&self) -> &[f32] {
        &self.color
    }

    /// Which layers were taken.
    pub fn selection(&self) -> &Selection {
        &self.selection
    }

    /// The planes, to hand to a denoiser.
    pub fn frame(&self) -> Frame<'_> {
        let three = Layout::interleaved(self.extent, 3);
        let one = Layout::interleaved(self.extent, 1);
        let (plane, kind) = match &self.variance {
            Some(variance) => (Some(variance), NoiseKind::Variance),
            None => (self.samples.as_ref(), NoiseKind::Samples),
        };
        Frame {
            extent: self.extent,
            color: Plane::f32(&self.color, three),
            features: Features {
                albedo: self.albedo.as_deref().map(|s| Plane::f32(s, three)),
                normal: self.normal.as_deref().map(|s| Plane::f32(s, three)),
                depth: self.depth.as_deref().map(|s| Plane::f32(s, one)),
                noise: plane.map(|samples| Noise { plane: Plane::f32(samples, one), kind }),
            },
        }
    }

    /// Writes the file that was read with `color` (interleaved RGB of the whole data window) in place of its colour.
    ///
    /// The samples keep their type; halfs are clamped to +-65504. Grey colour takes the mean of the three. The file is
    /// written beside and renamed (see [`replace_file`]), so `path` may be the file that was read.
    ///
    /// # Errors
    /// [`ExrError::ColorLength`], [`ExrError::Write`].
    pub fn write_with_color(&self, path: impl AsRef<Path>, color: &[f32]) -> Result<(), ExrError> {
        let path = path.as_ref();
        self.check_color(path, color)?;
        let Pick { part, channels, .. } = &self.pick;
        replace_file(path, |out| assemble::assemble(&self.container, *part, channels, color, out))
    }

    /// Checks that a region of the colour's data window, counted in pixels from its upper left corner, can be written as a
    /// file of its own.
    ///
    /// # Errors
    /// [`ExrError::Region`] where it is empty or leaves the data window; [`ExrError::Unsupported`] where a part that it
    /// meets is a mip map or has subsampled channels.
    pub fn check_region(&self, region: Region) -> Result<(), ExrError> {
        region
            .check(self.extent)
            .map_err(|error| ExrError::Region { path: self.container.path.clone(), reason: error.to_string() })?;
        crop::check(&self.container, crop::window_of(&self.container, self.pick.part, region))
    }

    /// The same as [`ExrFrame::write_with_color`], cropped: the data window of the file that is written is that of the
    /// region, and every channel of every part keeps its samples there. Parts that lie outside are left out. The display
    /// window and all other attributes stay.
    ///
    /// `color` is still that of the whole data window; what lies outside the region is not looked at.
    ///
    /// # Errors
    /// As [`ExrFrame::check_region`]; [`ExrError::ColorLength`], [`ExrError::Write`].
    pub fn write_region(&self, path: impl AsRef<Path>, color: &[f32], region: Region) -> Result<(), ExrError> {
        let path = path.as_ref();
        self.check_color(path, color)?;
        self.check_region(region)?;
        let Pick { part, channels, .. } = &self.pick;
        let window = crop::window_of(&self.container, *part, region);
        replace_file(path, |out| crop::write(&self.container, (*part, channels), color, window, out))
    }

    fn check_color(&self, path: &Path, color: &[f32]) -> Result<(), ExrError> {
        if color.len() != self.color.len() {
            return Err(ExrError::ColorLength { path: path.into(), wanted: self.color.len(), found: color.len() });
        }
        Ok(())
    }
}

impl LayerOptions {
    fn features(&self) -> [(Role, &FeatureSource); 5] {
        [
            (Role::Albedo, &self.albedo),
            (Role::Normal, &self.normal),
            (Role::Depth, &self.depth),
            (Role::Variance, &self.variance),
            (Role::Samples, &self.samples),
        ]
    }
}

/// Where no layer was found because some could not be looked at, says that instead.
fn explain(container: &Container, error: ExrError) -> ExrError {
    let skipped = (0..container.meta.headers.len()).any(|part| layers::is_subsampled(container, part));
    match error {
        ExrError::NoLayer { path, .. } if skipped => {
            let reason = "its channels are subsampled (luminance and chroma); write it as R, G, B";
            ExrError::unsupported(&path, reason)
        }
        error => error,
    }
}

fn used_layer(container: &Container, pick: &Pick, file: Option<&Path>) -> UsedLayer {
    let list = &container.header(pick.part).channels.list;
    let mut channels: Vec<String> = pick.channels.iter().map(|&c| list[c].name.to_string()).collect();
    channels.dedup();
    UsedLayer { file: file.map(Path::to_path_buf), part: layers::part_name(container, pick.part), channels }
}

fn window_text(window: exr::meta::attribute::IntegerBounds) -> String {
    let (start, size) = (window.position, window.size);
    format!("{} x {} pixels from ({}, {})", size.x(), size.y(), start.x(), start.y())
}

/// A depth channel of halves cannot hold the background of floats.
fn widen_depth(role: Role, container: &Container, pick: &Pick, plane: &mut [f32]) {
    let channels = &container.header(pick.part).channels.list;
    let halves = |&channel: &usize| channels[channel].sample_type == SampleType::F16;
    if role == Role::Depth && pick.channels.iter().all(halves) {
        widen_half_depths(plane);
    }
}
