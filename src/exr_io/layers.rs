//! The channels of a file, grouped into layers by their names.

use super::coding::Coding;
use super::container::Container;
use super::names::without_prefix;
use super::views::Views;
use exr::math::Vec2;
use exr::meta::attribute::{ChannelDescription, SampleType, Text};

/// A channel of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Place {
    /// Which part of the file (header) it is in.
    pub part: usize,
    /// Which of the part's channels it is.
    pub channel: usize,
}

/// Channels that belong together: `ViewLayer.Combined` with R, G, B, A.
pub(super) struct Layer {
    /// Which part of the file it is in, or begins in.
    pub part: usize,
    /// The name without the channel and without the view: `ViewLayer.Combined`, the part's name where channels have no
    /// prefix of their own in a file of several parts, or empty.
    pub path: String,
    /// The same as it stands in the file, with the view.
    pub written: String,
    /// Whose picture it is of; `None` where the file does not say.
    pub view: Option<String>,
    /// Whether the channels had no prefix in the file, but for a view.
    pub bare: bool,
    /// Last section of each channel's name, and where it is.
    pub channels: Vec<(String, Place)>,
    /// Whether it has a channel of colour at less than full resolution, which is not among `channels`.
    pub subsampled: bool,
}

impl Layer {
    /// The part of the path before the last dot: Blender's view layer.
    pub fn group(&self) -> &str {
        self.path.rsplit_once('.').map_or("", |(group, _)| group)
    }

    /// What the layer is, as renderers name it, in small letters and digits only: `denoisingalbedo`.
    pub fn kind(&self) -> String {
        without_prefix(simplify(self.path.rsplit_once('.').map_or(self.path.as_str(), |(_, kind)| kind)))
    }

    /// The channel of this name, whatever its case.
    pub fn channel(&self, name: &str) -> Option<Place> {
        self.channels.iter().find(|(n, _)| n.eq_ignore_ascii_case(name)).map(|&(_, place)| place)
    }

    /// The three channels of a colour.
    pub fn rgb(&self) -> Option<Vec<Place>> {
        self.triple(["R", "G", "B"]).or_else(|| self.triple(["red", "green", "blue"]))
    }

    /// The three channels of a vector.
    pub fn xyz(&self) -> Option<Vec<Place>> {
        self.triple(["X", "Y", "Z"])
    }

    /// The channels of a whole picture and what they are: RGB, luminance with chroma, or grey.
    pub fn picture(&self, luminance: [f32; 3]) -> Option<(Vec<Place>, Coding)> {
        if self.subsampled {
            return None;
        }
        if let Some(channels) = self.rgb() {
            return Some((channels, Coding::Rgb));
        }
        if let Some(channels) = self.triple(["Y", "RY", "BY"]) {
            return Some((channels, Coding::LumaChroma(luminance)));
        }
        // Blender writes a grey picture as V; with a U beside it, it is a coordinate.
        let value = || self.channel("V").filter(|_| self.channel("U").is_none());
        let gray = self.channel("Y").or_else(value)?;
        self.xyz().is_none().then(|| (vec![gray], Coding::Gray))
    }

    /// One or two of red, green and blue, where there are no others.
    pub fn some_of_rgb(&self) -> Option<(Vec<Place>, Coding)> {
        if self.subsampled {
            return None;
        }
        let found: Vec<(usize, Place)> =
            ["R", "G", "B"].iter().enumerate().filter_map(|(i, name)| Some((i, self.channel(name)?))).collect();
        match found[..] {
            [(_, one)] => Some((vec![one], Coding::Gray)),
            [(i, one), (j, two)] => Some((vec![one, two], Coding::Two([i, j]))),
            _ => None,
        }
    }

    fn triple(&self, names: [&str; 3]) -> Option<Vec<Place>> {
        names.iter().map(|name| self.channel(name)).collect()
    }
}

/// Small letters and digits of a name: renderers differ in case, spaces and underscores.
pub(super) fn simplify(name: &str) -> String {
    name.chars().filter(|c| c.is_alphanumeric()).flat_map(char::to_lowercase).collect()
}

/// Whether two names are the same but for case.
pub(super) fn same(one: &str, other: &str) -> bool {
    one.to_lowercase() == other.to_lowercase()
}

/// A name as it stands in the file: OpenEXR's text is UTF-8.
pub(super) fn text(text: &Text) -> String {
    String::from_utf8_lossy(text.as_slice()).into_owned()
}

/// All layers of a file that can be read as floats, in the order of the file.
///
/// Left out are integer channels (object and material ids) and subsampled channels.
pub(super) fn layers(container: &Container) -> Vec<Layer> {
    let views = Views::of(&container.meta);
    let mut layers: Vec<Layer> = Vec::new();
    for (part, header) in container.meta.headers.iter().enumerate() {
        let names: Vec<String> = header.channels.list.iter().map(|c| text(&c.name)).collect();
        let part_name = part_name(container, part).unwrap_or_default();
        let (part_path, part_view) = views.split(&part_name);
        for (index, channel) in header.channels.list.iter().enumerate() {
            if channel.sample_type == SampleType::U32 {
                continue;
            }
            let (prefix, last) = split_channel(&names[index], &names);
            let (path, view) = views.split(&prefix);
            let bare = path.is_empty();
            let view = views.of_part(header).or(view).or_else(|| part_view.clone()).or_else(|| views.usual(header));
            let (path, written) = match bare {
                true => (part_path.clone(), if prefix.is_empty() { part_name.clone() } else { prefix }),
                false => (path, prefix),
            };
            let same = |l: &&mut Layer| l.part == part && l.path == path && l.bare == bare && l.view == view;
            let place = Place { part, channel: index };
            let subsampled = channel.sampling != Vec2(1, 1);
            let (subsampled, channels) = match subsampled {
                true if !is_of_color(&last) => continue,
                true => (true, Vec::new()),
                false => (false, vec![(last, place)]),
            };
            match layers.iter_mut().rev().find(same) {
                Some(layer) => {
                    layer.channels.extend(channels);
                    layer.subsampled |= subsampled;
                }
                None => layers.push(Layer { part, path, written, view, bare, channels, subsampled }),
            }
        }
    }
    // A file of the one view `main` means all of its layers.
    if layers.iter().flat_map(|layer| &layer.view).all(|view| same(view, "main")) {
        layers.iter_mut().for_each(|layer| layer.view = None);
    }
    join_parts(container, layers)
}

fn is_of_color(channel: &str) -> bool {
    ["R", "G", "B", "Y", "RY", "BY"].iter().any(|name| channel.eq_ignore_ascii_case(name))
}

/// Joins layers that are spread over parts of one size: the same layer with other channels, and a channel a part.
fn join_parts(container: &Container, mut layers: Vec<Layer>) -> Vec<Layer> {
    name_channel_parts(&mut layers);
    let window = |layer: &Layer| container.header(layer.part).data_window();
    let mut joined: Vec<Layer> = Vec::with_capacity(layers.len());
    for mut layer in layers {
        let fits = |other: &&mut Layer| {
            other.part != layer.part
                && (&other.path, &other.view, other.bare) == (&layer.path, &layer.view, layer.bare)
                && window(other) == window(&layer)
                && layer.channels.iter().all(|(name, _)| other.channel(name).is_none())
        };
        match joined.iter_mut().find(fits) {
            Some(other) => {
                other.channels.append(&mut layer.channels);
                other.subsampled |= layer.subsampled;
            }
            None => joined.push(layer),
        }
    }
    joined
}

/// Where every part has one channel of a colour, its path is that of the layer: `albedo` of a part `albedo.R`, and of
/// R, G and B in parts of any names that of the picture.
fn name_channel_parts(layers: &mut [Layer]) {
    for layer in layers.iter_mut().filter(|layer| lone_component(layer).is_some()) {
        let (stem, last) = layer.path.rsplit_once('.').unwrap_or(("", &layer.path));
        if lone_component(layer).is_some_and(|channel| same(last, channel)) {
            layer.path = stem.to_owned();
        }
    }
    let views: Vec<Option<String>> = layers.iter().map(|layer| layer.view.clone()).collect();
    for view in views {
        let of_view = |layer: &&mut Layer| layer.view == view && layer.bare && !layer.path.is_empty();
        let count = |layers: &mut [Layer], channel: &str| {
            let named = |layer: &Layer| lone_component(layer).is_some_and(|name| name.eq_ignore_ascii_case(channel));
            layers.iter_mut().filter(of_view).filter(|layer| named(layer)).count()
        };
        if ["R", "G", "B"].iter().all(|channel| count(layers, channel) == 1) {
            let lone = layers.iter_mut().filter(of_view).filter(|layer| lone_component(layer).is_some());
            lone.for_each(|layer| layer.path.clear());
        }
    }
}

/// The only channel of a part, where it is one of a colour.
fn lone_component(layer: &Layer) -> Option<&str> {
    let [(channel, _)] = layer.channels.as_slice() else { return None };
    (layer.bare && is_component(channel)).then_some(channel)
}

fn is_component(channel: &str) -> bool {
    ["R", "G", "B", "A"].iter().any(|name| channel.eq_ignore_ascii_case(name))
}

/// Whether a channel is stored at less than full resolution.
pub(super) fn is_subsampled(channel: &ChannelDescription) -> bool {
    channel.sampling != Vec2(1, 1)
}

/// A part's name, which counts only where there are several parts: elsewhere writers put anything there.
pub(super) fn part_name(container: &Container, part: usize) -> Option<String> {
    let name = text(container.header(part).own_attributes.layer_name.as_ref()?);
    (container.meta.headers.len() > 1 && !name.is_empty()).then_some(name)
}

/// Splits `ViewLayer.Combined.R` into `ViewLayer.Combined` and `R`, and `Nx`, where Ny and Nz are there too, into `N`
/// and `x`.
fn split_channel(name: &str, all: &[String]) -> (String, String) {
    let (prefix, last) = name.rsplit_once('.').unwrap_or(("", name));
    if let Some((at, component)) = last.char_indices().last().filter(|&(at, _)| at > 0) {
        let whole_stem = &name[..name.len() - component.len_utf8()];
        let has = |c: char| all.iter().any(|n| n.strip_prefix(whole_stem) == Some(c.encode_utf8(&mut [0; 4])));
        let of_three = |set: [char; 3]| set.contains(&component) && set.into_iter().all(has);
        if [['x', 'y', 'z'], ['X', 'Y', 'Z'], ['r', 'g', 'b'], ['R', 'G', 'B']].into_iter().any(of_three) {
            let dot = if prefix.is_empty() { "" } else { "." };
            return (format!("{prefix}{dot}{}", &last[..at]), component.to_string());
        }
    }
    (prefix.to_string(), last.to_string())
}

/// The layers and their channels in words, for messages.
pub(super) fn describe<'a>(layers: impl Iterator<Item = &'a Layer>) -> String {
    const SHOWN: usize = 24;
    let mut names: Vec<String> = layers
        .filter(|layer| !layer.channels.is_empty())
        .map(|layer| {
            let channels: Vec<&str> = layer.channels.iter().take(8).map(|(n, _)| n.as_str()).collect();
            let dot = if layer.written.is_empty() { "" } else { "." };
            format!("{}{dot}{}", layer.written, channels.join("/"))
        })
        .collect();
    if names.is_empty() {
        return "no channels of half or float".into();
    }
    let more = names.len().saturating_sub(SHOWN);
    names.truncate(SHOWN);
    let mut text = names.join(", ");
    if more > 0 {
        text.push_str(&format!(" and {more} more"));
    }
    text
}
