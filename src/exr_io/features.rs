//! Which layers guide the denoising of a picture, and what their samples mean.

use super::Role;
use super::container::Container;
use super::error::ExrError;
use super::layers::{Layer, Place, describe, simplify, text};
use super::names::{self, DEPTH, DEPTH_CHANNELS, NORMAL, SAMPLE_SHARE, SCALAR_CHANNELS, place};
use crate::frame::widen_half_depths;
use exr::meta::attribute::{AttributeValue, SampleType};

/// The channels chosen for a feature: three, or one for depth, variance and samples.
pub(super) struct Feature {
    pub channels: Vec<Place>,
    /// Its simplified name in the table of its role; empty where it was taken whatever its name.
    kind: String,
    group: String,
}

/// A layer that could serve as a feature: its place in the role's table, and its channels.
struct Candidate {
    place: usize,
    feature: Feature,
}

impl Candidate {
    fn new(place: usize, kind: String, group: &str, channels: Vec<Place>) -> Self {
        Self { place, feature: Feature { channels, kind, group: group.into() } }
    }
}

fn vector_candidate(role: Role, layer: &Layer) -> Option<Candidate> {
    let channels = match role {
        Role::Normal => layer.xyz().or_else(|| layer.rgb()),
        _ => layer.rgb().or_else(|| layer.xyz()),
    };
    let kind = layer.kind();
    Some(Candidate::new(place(names::table(role), &kind)?, kind, layer.group(), channels?))
}

fn scalar_candidates(role: Role, layer: &Layer) -> Vec<Candidate> {
    let table = names::table(role);
    let kind = layer.kind();
    if let Some(at) = place(table, &kind) {
        let channel = scalar_channel(role, layer);
        return channel.map(|c| Candidate::new(at, kind, layer.group(), vec![c])).into_iter().collect();
    }
    // The T of Mitsuba's depth, whose layer has any name.
    if let [(name, channel)] = layer.channels.as_slice()
        && role == Role::Depth
        && name == "T"
        && !layer.bare
    {
        return vec![Candidate::new(DEPTH.len(), kind, layer.group(), vec![*channel])];
    }
    if layer.xyz().is_some() || place(NORMAL, &kind).is_some() {
        return Vec::new();
    }
    // A channel named for itself: plain Z, or ViewLayer.Depth without a component. A single letter after another name
    // is no more than a component: `mist.Z` is no depth.
    let pictured = layer.bare || layer.rgb().is_some();
    let group = if pictured { layer.group() } else { layer.path.as_str() };
    let named = layer.channels.iter().filter_map(|(name, c)| {
        let name = simplify(name);
        let at = place(table, &name).filter(|_| pictured || name.len() > 1)?;
        Some(Candidate::new(at, name, group, vec![*c]))
    });
    named.collect()
}

fn scalar_channel(role: Role, layer: &Layer) -> Option<Place> {
    let names = if role == Role::Depth { DEPTH_CHANNELS } else { SCALAR_CHANNELS };
    let by_name = names.iter().find_map(|name| layer.channel(name));
    by_name.or_else(|| layer.channels.first().map(|&(_, place)| place))
}

fn candidates<'a>(role: Role, layers: impl Iterator<Item = &'a Layer>) -> Vec<Candidate> {
    match role {
        _ if role.is_scalar() => layers.flat_map(|layer| scalar_candidates(role, layer)).collect(),
        _ => layers.filter_map(|layer| vector_candidate(role, layer)).collect(),
    }
}

/// Finds a feature for the chosen colour, of its view alone: in its own view layer first, then among layers without
/// one. A colour without a view layer takes those of another group, if there is only one.
pub(super) fn pick_feature(role: Role, layers: &[Layer], color: &Layer) -> Option<Feature> {
    let mut found = candidates(role, layers.iter().filter(|layer| layer.view == color.view));
    let group = color.group();
    let near = |c: &Candidate| c.feature.group == group || c.feature.group.is_empty();
    if found.iter().any(near) {
        found.retain(near);
    } else if !group.is_empty() || found.iter().any(|c| c.feature.group != found[0].feature.group) {
        return None;
    }
    // A stable order: of equals, the first in the file.
    let best = found.into_iter().min_by_key(|c| (c.feature.group != group, c.place))?;
    Some(best.feature)
}

/// Finds a feature in a file of its own, where it may have any name: by the usual names first, then the layer that is
/// the file's picture, then the only one that has the channels. A scalar is never a channel of a colour: but for the
/// usual names it is the file's only channel or a grey picture.
pub(super) fn pick_from_own_file(
    role: Role,
    container: &Container,
    layers: &[Layer],
    view: Option<&String>,
) -> Result<Feature, ExrError> {
    let one_view = layers.iter().all(|layer| layer.view == layers[0].view);
    let of_view: Vec<&Layer> = layers.iter().filter(|layer| one_view || layer.view.as_ref() == view).collect();
    if let Some(best) = candidates(role, of_view.iter().copied()).into_iter().min_by_key(|c| c.place) {
        return Ok(best.feature);
    }
    let channels = |layer: &Layer| match role {
        _ if role.is_scalar() => match layer.channels.as_slice() {
            &[(_, only)] => Some(vec![only]),
            _ => layer.channel("Y").filter(|_| layer.xyz().is_none() && layer.rgb().is_none()).map(|y| vec![y]),
        },
        _ => layer.rgb().or_else(|| layer.xyz()),
    };
    let fits: Vec<Vec<Place>> = of_view.iter().filter_map(|layer| channels(layer)).collect();
    let plain = of_view.iter().filter(|layer| layer.path.is_empty()).find_map(|layer| channels(layer));
    let only = match <[_; 1]>::try_from(fits) {
        Ok([only]) => Some(only),
        Err(_) => plain,
    };
    let channels = only.ok_or_else(|| {
        let found = describe(of_view.into_iter());
        ExrError::NoLayer { path: container.path.clone(), wanted: role.to_string(), found }
    })?;
    Ok(Feature { channels, kind: String::new(), group: String::new() })
}

/// What was found out about a feature's samples.
pub(super) struct Understood {
    /// Whether they can be used.
    pub usable: bool,
    /// What the user should know.
    pub note: Option<String>,
}

/// Makes a plane's samples what the denoiser takes them for: normals in [-1, 1], depths that grow with the distance,
/// counts of samples.
pub(super) fn understand(role: Role, container: &Container, feature: &Feature, plane: &mut [f32]) -> Understood {
    let note = match role {
        Role::Depth => mend_depth(container, feature, plane),
        Role::Normal => decode_normals(plane).then(|| "stored as n * 0.5 + 0.5, decoded".into()),
        Role::Samples if feature.kind == SAMPLE_SHARE => {
            let Some(most) = most_samples(container, &feature.group) else {
                let note = "not used: shares of a largest number of samples that the file does not say".into();
                return Understood { usable: false, note: Some(note) };
            };
            plane.iter_mut().for_each(|share| *share *= most);
            Some(format!("shares of {most} samples, as the header says"))
        }
        _ => None,
    };
    Understood { usable: true, note }
}

/// Depths that are all negative, as along the z axis of a camera that looks down it, are taken without their sign; the
/// background of halves is that of floats, which halves cannot hold.
fn mend_depth(container: &Container, feature: &Feature, plane: &mut [f32]) -> Option<String> {
    let finite = || plane.iter().filter(|depth| depth.is_finite());
    let negative = finite().any(|depth| *depth < 0.0);
    let along_axis = names::ALONG_AXIS.contains(&feature.kind.as_str());
    let mirrored = negative && (along_axis || !finite().any(|depth| *depth > 0.0));
    if mirrored {
        plane.iter_mut().for_each(|depth| *depth = depth.abs());
    }
    let channel = |place: &Place| &container.header(place.part).channels.list[place.channel];
    if feature.channels.iter().all(|place| channel(place).sample_type == SampleType::F16) {
        widen_half_depths(plane);
    }
    mirrored.then(|| "negative before the camera, taken without its sign".into())
}

/// Of all normals, those that must look encoded, or else as they should.
const MOST: f64 = 0.9;
/// How far a length may be from 1, for what filtering and halves do to it.
const NEAR: f32 = 0.1;

/// Decodes normals that are stored as n * 0.5 + 0.5: none has a component below 0, nearly all have a length near 1
/// after decoding, and they do not before. Pixels of no surface (0, or 0.5 in all three) become 0.
fn decode_normals(plane: &mut [f32]) -> bool {
    let is_surface = |n: &&[f32]| n.iter().all(|c| c.is_finite()) && n[0].max(n[1]).max(n[2]) > 0.0;
    let length = |n: [f32; 3]| n.iter().map(|c| c * c).sum::<f32>().sqrt();
    let decoded = |n: &[f32]| [0, 1, 2].map(|i| 2.0 * n[i] - 1.0);
    let near_one = |length: f32| (length - 1.0).abs() <= NEAR;
    let (mut surfaces, mut plain, mut encoded) = (0.0f64, 0.0f64, 0.0f64);
    for normal in plane.chunks_exact(3).filter(is_surface) {
        // Halves and filters may round a 0 to a little less.
        if normal.iter().any(|c| *c < -1e-3 || *c > 1.001) {
            return false;
        }
        // What is encoded from no surface says nothing of the others.
        if length(decoded(normal)) < 1e-2 {
            continue;
        }
        surfaces += 1.0;
        plain += f64::from(u8::from(near_one(length([normal[0], normal[1], normal[2]]))));
        encoded += f64::from(u8::from(near_one(length(decoded(normal)))));
    }
    if surfaces == 0.0 || encoded < MOST * surfaces || plain >= MOST * surfaces {
        return false;
    }
    for normal in plane.chunks_exact_mut(3) {
        let values = if is_surface(&&*normal) { decoded(normal) } else { [0.0; 3] };
        normal.copy_from_slice(&values);
    }
    true
}

/// The most samples that a pixel of a view layer may have, as Cycles writes it: `cycles.ViewLayer.samples`.
fn most_samples(container: &Container, view_layer: &str) -> Option<f32> {
    let attributes =
        container.meta.headers.iter().flat_map(|h| h.own_attributes.other.iter().chain(&h.shared_attributes.other));
    let wanted = format!("cycles.{view_layer}.samples");
    let mut values = attributes.filter(|(name, _)| text(name) == wanted).map(|(_, value)| value);
    let most = values.find_map(|value| match value {
        AttributeValue::Text(number) => text(number).trim().parse().ok(),
        AttributeValue::I32(number) => Some(*number as f32),
        AttributeValue::F32(number) => Some(*number),
        _ => None,
    })?;
    Some(most).filter(|most: &f32| most.is_finite() && *most >= 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn encoded_normals_are_known_by_their_lengths() {
        let encode = |n: [f32; 3]| n.map(|c| c * 0.5 + 0.5);
        let unit = |x: f32, y: f32| [x, y, (1.0 - x * x - y * y).sqrt()];
        let normals: Vec<[f32; 3]> =
            (0..100).map(|i| unit((i % 10) as f32 / 14.0 - 0.3, (i / 10) as f32 / 14.0 - 0.3)).collect();
        let flat = |n: &[[f32; 3]]| n.iter().flatten().copied().collect::<Vec<f32>>();

        let mut plane = flat(&normals.iter().map(|n| encode(*n)).chain([[0.0; 3], [0.5; 3]]).collect::<Vec<_>>());
        assert!(decode_normals(&mut plane));
        let wanted = flat(&[&normals[..], &[[0.0; 3], [0.0; 3]]].concat());
        assert!(plane.iter().zip(&wanted).all(|(a, b)| (a - b).abs() < 1e-6));

        // True normals, also where none has a component below 0, and what is neither, stay.
        let positive: Vec<[f32; 3]> = normals.iter().map(|n| n.map(f32::abs)).collect();
        let ring = vec![[0.166_666_7, 0.666_666_7, 0.666_666_7]; 50];
        let gray = vec![[0.3; 3]; 50];
        let one_below = [&normals.iter().map(|n| encode(*n)).collect::<Vec<_>>()[..], &[[0.0, -0.5, 0.5]]].concat();
        for normals in [normals, positive, ring, gray, one_below, vec![[0.5; 3]; 9], Vec::new()] {
            let mut plane = flat(&normals);
            assert!(!decode_normals(&mut plane), "{:?}", normals.first());
            assert_eq!(plane, flat(&normals));
        }
    }
}
