//! A picture and its features out of a file.

use super::codec;
use super::container::Container;
use super::error::ExrError;
use super::features::{Feature, pick_feature, pick_from_own_file, understand};
use super::layers::{Layer, Place, layers, part_name, text};
use super::lossy::rounded_again;
use super::select::{Chooser, Pick};
use super::signals::{ExrSignal, Signals};
use super::{FeatureSource, LayerOptions, Role, Selection, UsedLayer};
use crate::frame::{Extent, Features, Frame, Layout, Noise, NoiseKind, Plane};
use std::path::Path;
use std::sync::Arc;

/// What light groups are off their colour by before that is said: half floats of them are off by less.
const GROUPS_OFF: f64 = 0.005;

/// A picture of an OpenEXR file that was read for denoising: one view of it, with its features.
///
/// Holds the file's compressed bytes, which the views of a file share, and the selected planes as f32: 12 bytes a pixel
/// of colour, and up to 36 of the rest.
pub struct ExrFrame {
    pub(super) container: Arc<Container>,
    /// Where the result goes.
    pub(super) target: Pick,
    selection: Selection,
    extent: Extent,
    color: Vec<f32>,
    /// The planes of the roles, in their order.
    planes: [Option<Vec<f32>>; 5],
    /// What is denoised beside the colour.
    pub(super) signals: Vec<ExrSignal>,
    /// The pixels whose colour and alpha are exactly 0, if there is any; where alpha is denoised, those in the midst
    /// of such.
    pub(super) empty: Option<Vec<bool>>,
}

impl ExrFrame {
    /// Reads the picture of a file, and the features' own files if the options name some. Of several views, the first
    /// ([`ExrFrame::read_views`] has all).
    ///
    /// # Errors
    /// [`ExrError`]: a file that is missing, not OpenEXR, truncated, damaged, too large or of a kind that is not
    /// supported; no or several colour layers that fit; no view of the name; a feature's file of another data window.
    pub fn read(path: impl AsRef<Path>, options: &LayerOptions) -> Result<Self, ExrError> {
        let file = Opened::new(path.as_ref())?;
        let picks = file.pictures(options)?;
        let first = picks.into_iter().next();
        first.map_or_else(|| Err(file.nothing()), |pick| file.frame(pick, options))
    }

    /// Reads the pictures of all views of a file, each with its own features, or of the view that the options name. A
    /// file without views has one.
    ///
    /// # Errors
    /// As [`ExrFrame::read`].
    pub fn read_views(path: impl AsRef<Path>, options: &LayerOptions) -> Result<Vec<Self>, ExrError> {
        let file = Opened::new(path.as_ref())?;
        let picks = file.pictures(options)?;
        let frames = picks.into_iter().map(|pick| file.frame(pick, options));
        let mut frames: Vec<Self> = frames.collect::<Result<_, _>>()?;
        let signals =
            |frame: &Self| frame.signals.iter().flat_map(|signal| signal.channels.clone()).collect::<Vec<_>>();
        let written: Vec<Place> =
            frames.iter().flat_map(|frame| [frame.target.channels.clone(), signals(frame)].concat()).collect();
        if let Some(first) = frames.first_mut() {
            first.selection.notes.extend(rounded_again(&file.container, &written));
        }
        Ok(frames)
    }

    /// The size of the colour's data window.
    pub fn extent(&self) -> Extent {
        self.extent
    }

    /// The colour: interleaved RGB, linear radiance as it stands in the file.
    pub fn color(&self) -> &[f32] {
        &self.color
    }

    /// Makes a new colour (interleaved RGB) exactly 0 where the file's colour and alpha are exactly 0: outside the
    /// border of a border render and around a cut-out, which have no noise. A file without alpha has no such pixels.
    /// Where alpha is denoised too, only pixels count that have 5x5 such pixels around: a few samples leave holes in
    /// coverage.
    pub fn keep_empty(&self, color: &mut [f32]) {
        let Some(empty) = &self.empty else { return };
        let pixels = color.chunks_exact_mut(3).zip(empty);
        pixels.filter(|(_, empty)| **empty).for_each(|(pixel, _)| pixel.fill(0.0));
    }

    /// Which layers were taken.
    pub fn selection(&self) -> &Selection {
        &self.selection
    }

    /// The planes, to hand to a denoiser.
    pub fn frame(&self) -> Frame<'_> {
        let three = Layout::interleaved(self.extent, 3);
        let one = Layout::interleaved(self.extent, 1);
        let plane = |role: Role| self.planes[role as usize].as_deref();
        let (noise, kind) = match plane(Role::Variance) {
            Some(variance) => (Some(variance), NoiseKind::Variance),
            None => (plane(Role::Samples), NoiseKind::Samples),
        };
        Frame {
            extent: self.extent,
            color: Plane::f32(&self.color, three),
            features: Features {
                albedo: plane(Role::Albedo).map(|s| Plane::f32(s, three)),
                normal: plane(Role::Normal).map(|s| Plane::f32(s, three)),
                depth: plane(Role::Depth).map(|s| Plane::f32(s, one)),
                noise: noise.map(|samples| Noise { plane: Plane::f32(samples, one), kind }),
            },
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

    /// Takes a feature's samples, unless they turn out to mean nothing.
    fn take(&mut self, role: Role, container: &Container, feature: &Feature, mut plane: Vec<f32>, used: UsedLayer) {
        let understood = understand(role, container, feature, &mut plane);
        if let Some(note) = understood.note {
            self.selection.notes.push(format!("{role} {used}: {note}"));
        }
        if understood.usable {
            *self.used_mut(role) = Some(used);
            self.planes[role as usize] = Some(plane);
        }
    }

    fn read_feature_file(&mut self, role: Role, path: &Path, view: Option<&String>) -> Result<(), ExrError> {
        let file = Opened::new(path)?;
        let feature = pick_from_own_file(role, &file.container, &file.layers, view)?;
        let window = |container: &Container, channels: &[Place]| container.header(channels[0].part).data_window();
        let (found, wanted) =
            (window(&file.container, &feature.channels), window(&self.container, &self.target.channels));
        if found != wanted {
            let (found, wanted) = (window_text(found), window_text(wanted));
            return Err(ExrError::WindowMismatch { path: path.into(), found, wanted });
        }
        for place in &feature.channels {
            codec::check_size(&file.container, place.part)?;
        }
        let planes = codec::decode_planes(&file.container, &[feature.channels.as_slice()])?;
        let used = used_layer(&file.container, &feature.channels, Some(path));
        planes.into_iter().for_each(|plane| self.take(role, &file.container, &feature, plane, used.clone()));
        Ok(())
    }
}

/// A file whose layers are known.
struct Opened {
    container: Arc<Container>,
    layers: Vec<Layer>,
}

impl Opened {
    fn new(path: &Path) -> Result<Self, ExrError> {
        let container = Container::open(path)?;
        let layers = layers(&container);
        Ok(Self { container: Arc::new(container), layers })
    }

    fn pictures(&self, options: &LayerOptions) -> Result<Vec<Pick>, ExrError> {
        Chooser::new(&self.container, &self.layers).pictures(options.layer.as_deref(), options.view.as_deref())
    }

    fn nothing(&self) -> ExrError {
        let path = self.container.path.clone();
        ExrError::NoLayer { path, wanted: "colour".into(), found: super::layers::describe(self.layers.iter()) }
    }

    /// Reads a picture and its features, each part once.
    fn frame(&self, pick: Pick, options: &LayerOptions) -> Result<ExrFrame, ExrError> {
        let container = &self.container;
        let chooser = Chooser::new(container, &self.layers);
        let layer = &self.layers[pick.layer];
        let target = options.into.as_deref().map(|name| chooser.target(&pick, name)).transpose()?;
        let target = target.unwrap_or_else(|| pick.clone());
        check_parts(container, &pick.channels)?;
        check_parts(container, &target.channels)?;
        let elsewhere = target.layer != pick.layer;
        let mut notes = Vec::new();
        self.note_others(&chooser, &pick, &target, &mut notes);

        let window = container.header(layer.part).data_window();
        let mut features: Vec<(Role, Feature, UsedLayer)> = Vec::new();
        for (role, source) in options.features() {
            if *source != FeatureSource::SameFile {
                continue;
            }
            let Some(feature) = pick_feature(role, &self.layers, layer) else { continue };
            let used = used_layer(container, &feature.channels, None);
            let its_window = container.header(feature.channels[0].part).data_window();
            if its_window != window {
                let (its, colors) = (window_text(its_window), window_text(window));
                notes.push(format!("{role} layer {used} not used: it covers {its}, the colour {colors}"));
                continue;
            }
            for place in &feature.channels {
                codec::check_size(container, place.part)?;
            }
            features.push((role, feature, used));
        }
        let signals =
            Signals { container, layers: &self.layers, picture: &pick, target: &target }.pick(&options.signals)?;
        for signal in &signals {
            check_parts(container, &signal.channels)?;
        }
        let alpha: Vec<Place> = layer.channel("A").into_iter().collect();
        let wanted: Vec<&[Place]> = [pick.channels.as_slice(), &alpha]
            .into_iter()
            .chain(features.iter().map(|(_, feature, _)| feature.channels.as_slice()))
            .chain(signals.iter().map(|signal| signal.channels.as_slice()))
            .collect();
        let mut planes = codec::decode_planes(container, &wanted)?.into_iter();
        let color = pick.coding.colors(planes.next().unwrap_or_default());
        let size = container.header(layer.part).layer_size;
        let empty = empty_pixels(&color, &planes.next().unwrap_or_default());
        let empty = if options.signals.alpha { empty.map(|empty| in_the_midst(&empty, size.x())) } else { empty };
        let mut frame = ExrFrame {
            selection: Selection {
                view: pick.view.clone(),
                color: used_layer(container, &pick.channels, None),
                into: elsewhere.then(|| used_layer(container, &target.channels, None)),
                albedo: None,
                normal: None,
                depth: None,
                variance: None,
                samples: None,
                signals: Vec::new(),
                notes,
            },
            extent: Extent::new(size.x() as u32, size.y() as u32),
            container: Arc::clone(container),
            target,
            color,
            planes: Default::default(),
            signals: Vec::new(),
            empty,
        };
        for ((role, feature, used), plane) in features.into_iter().zip(planes.by_ref()) {
            frame.take(role, container, &feature, plane, used);
        }
        let groups: Vec<usize> = (0..signals.len()).filter(|i| signals[*i].group).collect();
        frame.take_signals(container, signals, planes.collect());
        frame.selection.signals = frame.signals.iter().map(|signal| signal.layer().clone()).collect();
        let off = frame.off_color(&groups).filter(|off| !groups.is_empty() && *off > GROUPS_OFF);
        frame.selection.notes.extend(off.map(|off| {
            format!(
                "the light groups are {:.1} % off the colour: what is not in the groups is not in their sum either",
                100.0 * off
            )
        }));
        for (role, source) in options.features() {
            if let FeatureSource::File(path) = source {
                frame.read_feature_file(role, path, layer.view.as_ref())?;
            }
        }
        Ok(frame)
    }

    /// Says which of several versions of the picture is denoised, which is written and which stays.
    fn note_others(&self, chooser: &Chooser, pick: &Pick, target: &Pick, notes: &mut Vec<String>) {
        let own = &self.layers[pick.layer].written;
        if target.layer != pick.layer {
            notes.push(format!("the result goes into {}; {own} stays as it is", self.layers[target.layer].written));
            return;
        }
        for (layer, raw) in chooser.beside(pick) {
            let other = &layer.written;
            notes.push(match raw {
                true => format!("{own}, which the renderer has denoised already, is denoised again; raw is {other}"),
                false => format!(
                    "{own} is denoised; {other}, which the renderer has denoised already, stays as it is (--into {other:?} \
                     writes the result there)"
                ),
            });
        }
    }
}

/// Checks that the parts of a picture's channels can be read and written.
fn check_parts(container: &Container, channels: &[Place]) -> Result<(), ExrError> {
    for place in channels {
        if container.has_levels(place.part) {
            let reason = "its colour is a mip map; keep the full resolution only";
            return Err(ExrError::unsupported(&container.path, reason));
        }
        codec::check_size(container, place.part)?;
    }
    Ok(())
}

fn empty_pixels(color: &[f32], alpha: &[f32]) -> Option<Vec<bool>> {
    let pixels = color.chunks_exact(3).zip(alpha);
    let empty: Vec<bool> = pixels.map(|(color, alpha)| *alpha == 0.0 && color.iter().all(|c| *c == 0.0)).collect();
    empty.contains(&true).then_some(empty)
}

pub(super) fn used_layer(container: &Container, channels: &[Place], file: Option<&Path>) -> UsedLayer {
    let mut parts: Vec<String> = channels.iter().filter_map(|place| part_name(container, place.part)).collect();
    parts.dedup();
    let name = |place: &Place| text(&container.header(place.part).channels.list[place.channel].name);
    UsedLayer {
        file: file.map(Path::to_path_buf),
        part: (!parts.is_empty()).then(|| parts.join(", ")),
        channels: channels.iter().map(name).collect(),
    }
}

/// The marked pixels of rows of `width` that have marked ones for two pixels around, as far as the picture goes.
fn in_the_midst(marked: &[bool], width: usize) -> Vec<bool> {
    const REACH: usize = 2;
    let height = marked.len() / width.max(1);
    let near = |at: usize, end: usize| at.saturating_sub(REACH)..(at + REACH + 1).min(end);
    let whole = |x: usize, y: usize| near(y, height).all(|y| near(x, width).all(|x| marked[y * width + x]));
    (0..marked.len()).map(|i| marked[i] && whole(i % width, i / width)).collect()
}

fn window_text(window: exr::meta::attribute::IntegerBounds) -> String {
    let (start, size) = (window.position, window.size);
    format!("{} x {} pixels from ({}, {})", size.x(), size.y(), start.x(), start.y())
}
