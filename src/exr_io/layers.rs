//! The channels of a file, grouped into layers by their names.

use super::container::Container;
use exr::math::Vec2;
use exr::meta::attribute::SampleType;

/// Channels that belong together: `ViewLayer.Combined` with R, G, B, A.
pub(super) struct Layer {
    /// Which part of the file (header) the channels are in.
    pub part: usize,
    /// The name without the channel: `ViewLayer.Combined`, the part's name where channels have no prefix of their own
    /// in a file of several parts, or empty.
    pub path: String,
    /// Whether the channels had no prefix in the file.
    pub bare: bool,
    /// Last section of each channel's name, and its index in the part.
    pub channels: Vec<(String, usize)>,
}

impl Layer {
    /// The part of the path before the last dot: Blender's view layer.
    pub fn group(&self) -> &str {
        self.path.rsplit_once('.').map_or("", |(group, _)| group)
    }

    /// What the layer is, as renderers name it, in small letters and digits only: `denoisingalbedo`.
    pub fn kind(&self) -> String {
        simplify(self.path.rsplit_once('.').map_or(self.path.as_str(), |(_, kind)| kind))
    }

    /// Index of the channel of this name, whatever its case.
    pub fn channel(&self, name: &str) -> Option<usize> {
        self.channels.iter().find(|(n, _)| n.eq_ignore_ascii_case(name)).map(|&(_, index)| index)
    }

    /// The three channels of a colour.
    pub fn rgb(&self) -> Option<Vec<usize>> {
        self.triple(["R", "G", "B"]).or_else(|| self.triple(["red", "green", "blue"]))
    }

    /// The three channels of a vector.
    pub fn xyz(&self) -> Option<Vec<usize>> {
        self.triple(["X", "Y", "Z"])
    }

    /// The one channel of a grey image, to be used for all three colours.
    pub fn gray(&self) -> Option<Vec<usize>> {
        let y = self.channel("Y").or_else(|| if self.bare { None } else { self.channel("V") })?;
        (self.xyz().is_none()).then(|| vec![y; 3])
    }

    fn triple(&self, names: [&str; 3]) -> Option<Vec<usize>> {
        names.iter().map(|name| self.channel(name)).collect()
    }
}

/// Small letters and digits of a name: renderers differ in case, spaces and underscores.
pub(super) fn simplify(name: &str) -> String {
    name.chars().filter(|c| c.is_alphanumeric()).flat_map(char::to_lowercase).collect()
}

/// All layers of a file that can be read as floats, in the order of the file.
///
/// Left out are integer channels (object and material ids) and parts with subsampled channels.
pub(super) fn layers(container: &Container) -> Vec<Layer> {
    let mut layers: Vec<Layer> = Vec::new();
    for (part, header) in container.meta.headers.iter().enumerate() {
        if is_subsampled(container, part) {
            continue;
        }
        let names: Vec<String> = header.channels.list.iter().map(|c| c.name.to_string()).collect();
        for (index, channel) in header.channels.list.iter().enumerate() {
            if channel.sample_type == SampleType::U32 {
                continue;
            }
            let (prefix, last) = split_channel(&names[index], &names);
            let bare = prefix.is_empty();
            let path = if bare { part_name(container, part).unwrap_or_default() } else { prefix };
            match layers.iter_mut().find(|l| l.part == part && l.path == path && l.bare == bare) {
                Some(layer) => layer.channels.push((last, index)),
                None => layers.push(Layer { part, path, bare, channels: vec![(last, index)] }),
            }
        }
    }
    layers
}

/// Whether the part stores some channel at less than full resolution.
pub(super) fn is_subsampled(container: &Container, part: usize) -> bool {
    container.header(part).channels.list.iter().any(|c| c.sampling != Vec2(1, 1))
}

/// A part's name, which counts only where there are several parts: elsewhere writers put anything there.
pub(super) fn part_name(container: &Container, part: usize) -> Option<String> {
    let name = container.header(part).own_attributes.layer_name.as_ref()?.to_string();
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
        .map(|layer| {
            let channels: Vec<&str> = layer.channels.iter().take(8).map(|(n, _)| n.as_str()).collect();
            let dot = if layer.path.is_empty() { "" } else { "." };
            format!("{}{dot}{}", layer.path, channels.join("/"))
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
