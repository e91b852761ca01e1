//! Which layers to denoise and to guide with: the names that renderers write, and their precedence.
//!
//! Names are compared without case, spaces and punctuation, so `Denoising Albedo` is `denoisingalbedo`. Each table runs
//! from the best choice to the last: layers made for a denoiser first, the shading normal before the geometric one.

use super::error::ExrError;
use super::layers::{Layer, describe, part_name, simplify};
use super::{Role, container::Container};

/// Colour of layers with a name; plain R, G, B come before all of these.
/// Blender's `Noisy Image` comes before its `Combined`, which is already denoised where both are there.
const COLOR: &[&str] = &[
    "noisyimage",
    "combined",
    "beauty",
    "rgba",
    "rgb",
    "color",
    "colour",
    "c",
    "ci",
    "image",
    "main",
    "final",
    "default",
];

/// Blender, Arnold; Mitsuba, pbrt, RenderMan, Karma, LuxCore; Arnold; Redshift and V-Ray; Blender's diffuse colour.
const ALBEDO: &[&str] = &[
    "denoisingalbedo",
    "denoisealbedo",
    "albedo",
    "guidealbedo",
    "diffusealbedo",
    "visiblediffusealbedo",
    "visiblediffuse",
    "diffusefilter",
    "vraydiffusefilter",
    "basecolor",
    "diffusecolor",
    "diffcol",
];

/// Mitsuba: sh_normal, nn; pbrt: Ns; LuxCore: AVG_SHADING_NORMAL; Arnold, Karma: N; Redshift, V-Ray: bump normals.
/// pbrt's N is geometric, which is why Ns stands before it.
const NORMAL: &[&str] = &[
    "denoisingnormal",
    "denoisenormal",
    "shnormal",
    "avgshadingnormal",
    "shadingnormal",
    "shadingnormals",
    "ns",
    "nn",
    "guidenormal",
    "guidenormalw",
    "bumpnormals",
    "vraybumpnormals",
    "n",
    "normal",
    "normals",
    "worldnormal",
    "normalworld",
    "vraynormals",
    "geonormal",
    "geometricnormal",
    "geometrynormal",
    "ng",
];

const DEPTH: &[&str] = &[
    "denoisingdepth",
    "denoisedepth",
    "depth",
    "z",
    "zdepth",
    "vrayzdepth",
    "dd",
    "distance",
    "cameradepth",
    "lineardepth",
    "t",
];

const VARIANCE: &[&str] = &["variance", "colorvariance", "colourvariance", "noisevariance", "luminancevariance"];

const SAMPLES: &[&str] = &["samplecount", "samples", "samplecounts", "samplesperpixel", "spp", "numsamples"];

/// The channel of a depth layer, where it has several.
const DEPTH_CHANNELS: &[&str] = &["Z", "V", "T", "Y", "D", "R", "X"];

/// The same of other planes of one channel; of three colours, green is most of the luminance.
const SCALAR_CHANNELS: &[&str] = &["Y", "V", "Z", "X", "G", "R"];

/// The channels chosen for a role: three, or one for depth, variance and samples. Grey colour has the same channel three times.
#[derive(Clone)]
pub(super) struct Pick {
    pub part: usize,
    pub group: String,
    pub channels: Vec<usize>,
}

fn place(table: &[&str], kind: &str) -> Option<usize> {
    table.iter().position(|name| *name == kind)
}

fn is_feature(kind: &str) -> bool {
    [ALBEDO, NORMAL, DEPTH, VARIANCE, SAMPLES].into_iter().any(|table| place(table, kind).is_some())
}

fn color_channels(layer: &Layer) -> Option<Vec<usize>> {
    layer.rgb().or_else(|| layer.gray())
}

/// How good a colour layer is; less is better. None for layers that are something else.
fn color_rank(layer: &Layer) -> Option<usize> {
    color_channels(layer)?;
    if layer.path.is_empty() {
        return Some(0);
    }
    let kind = layer.kind();
    // The first part of a file of parts is its main image, whatever its name.
    let main_part = || (layer.part == 0 && layer.bare && !is_feature(&kind)).then_some(COLOR.len() + 1);
    place(COLOR, &kind).map(|at| at + 1).or_else(main_part)
}

fn pick_color_of(layer: &Layer) -> Option<Pick> {
    Some(Pick { part: layer.part, group: layer.group().into(), channels: color_channels(layer)? })
}

/// The best of several colour layers, or an error that lists those which are equally good.
fn best_color(container: &Container, fits: Vec<&Layer>, wanted: &str) -> Result<Option<Pick>, ExrError> {
    let rank = |layer: &Layer| color_rank(layer).unwrap_or(usize::MAX);
    let Some(best) = fits.iter().map(|l| rank(l)).min() else { return Ok(None) };
    let mut fits: Vec<&Layer> = fits.into_iter().filter(|l| rank(l) == best).collect();
    // Blender's Composite has been through the compositor; the view layers are what the renderer made.
    if fits.iter().any(|l| simplify(l.group()) != "composite") {
        fits.retain(|l| simplify(l.group()) != "composite");
    }
    if fits.len() > 1 {
        let names: Vec<String> = fits.iter().map(|l| full_name(container, l)).collect();
        let (path, found) = (container.path.clone(), names.join(", "));
        return Err(ExrError::Ambiguous { path, wanted: wanted.into(), found });
    }
    Ok(fits.first().and_then(|layer| pick_color_of(layer)))
}

fn full_name(container: &Container, layer: &Layer) -> String {
    match part_name(container, layer.part) {
        Some(part) if part != layer.path => format!("{} in part {part}", layer.path),
        _ => layer.path.clone(),
    }
}

/// Finds the colour by the usual names.
fn usual_color(container: &Container, layers: &[Layer]) -> Result<Option<Pick>, ExrError> {
    let ranked: Vec<&Layer> = layers.iter().filter(|l| color_rank(l).is_some()).collect();
    if !ranked.is_empty() {
        return best_color(container, ranked, "colour");
    }
    let mut others = layers.iter().filter(|l| l.rgb().is_some() && !is_feature(&l.kind()));
    match (others.next(), others.next()) {
        (Some(only), None) => Ok(pick_color_of(only)),
        _ => Ok(None),
    }
}

/// Finds the colour layer: the one of the given name, or else by the usual names.
///
/// A name is, in this order: a layer's full name (`ViewLayer.Combined`), a part's name, a view layer's name
/// (`ViewLayer`), or the last section of a layer's name (`Combined`).
pub(super) fn pick_color(container: &Container, layers: &[Layer], name: Option<&str>) -> Result<Pick, ExrError> {
    let missing = |wanted: String| {
        let found = describe(layers.iter());
        ExrError::NoLayer { path: container.path.clone(), wanted, found }
    };
    let Some(name) = name else {
        return usual_color(container, layers)?.ok_or_else(|| missing("colour (R, G, B or Y)".into()));
    };
    let named = |test: &dyn Fn(&Layer) -> bool| -> Vec<&Layer> {
        layers.iter().filter(|l| color_channels(l).is_some() && test(l)).collect()
    };
    let simple = simplify(name);
    let steps = [
        named(&|l| l.path.eq_ignore_ascii_case(name)),
        named(&|l| part_name(container, l.part).is_some_and(|p| p.eq_ignore_ascii_case(name))),
        named(&|l| l.group().eq_ignore_ascii_case(name) && color_rank(l).is_some()),
        named(&|l| !simple.is_empty() && l.kind() == simple),
    ];
    let fits = steps.into_iter().find(|fits| !fits.is_empty()).unwrap_or_default();
    best_color(container, fits, &format!("'{name}'"))?.ok_or_else(|| missing(format!("colour '{name}'")))
}

/// A layer that could serve as a feature: its place in the role's table, its group and its channels.
struct Candidate {
    place: usize,
    group: String,
    part: usize,
    channels: Vec<usize>,
}

fn vector_candidate(role: Role, layer: &Layer) -> Option<Candidate> {
    let (table, channels) = match role {
        Role::Normal => (NORMAL, layer.xyz().or_else(|| layer.rgb())),
        _ => (ALBEDO, layer.rgb().or_else(|| layer.xyz())),
    };
    Some(Candidate {
        place: place(table, &layer.kind())?,
        group: layer.group().into(),
        part: layer.part,
        channels: channels?,
    })
}

fn scalar_candidates(role: Role, layer: &Layer) -> Vec<Candidate> {
    let table = match role {
        Role::Variance => VARIANCE,
        Role::Samples => SAMPLES,
        _ => DEPTH,
    };
    let candidate = |place: usize, group: &str, channel: usize| Candidate {
        place,
        group: group.into(),
        part: layer.part,
        channels: vec![channel],
    };
    let kind = layer.kind();
    if let Some(at) = place(table, &kind) {
        return scalar_channel(role, layer).map(|c| candidate(at, layer.group(), c)).into_iter().collect();
    }
    // The T of Mitsuba's depth, whose layer has any name.
    if let [(name, channel)] = layer.channels.as_slice()
        && role == Role::Depth
        && name == "T"
        && !layer.bare
    {
        return vec![candidate(DEPTH.len(), layer.group(), *channel)];
    }
    if layer.xyz().is_some() || place(NORMAL, &kind).is_some() {
        return Vec::new();
    }
    // A channel named for itself: plain Z, or ViewLayer.Depth without a component.
    let group = if layer.bare || color_rank(layer).is_some() { layer.group() } else { layer.path.as_str() };
    let named = layer.channels.iter().filter_map(|(name, c)| Some((place(table, &simplify(name))?, *c)));
    named.map(|(at, c)| candidate(at, group, c)).collect()
}

fn scalar_channel(role: Role, layer: &Layer) -> Option<usize> {
    let names = if role == Role::Depth { DEPTH_CHANNELS } else { SCALAR_CHANNELS };
    let by_name = names.iter().find_map(|name| layer.channel(name));
    by_name.or_else(|| layer.channels.first().map(|&(_, index)| index))
}

fn candidates(role: Role, layers: &[Layer]) -> Vec<Candidate> {
    match role {
        _ if role.is_scalar() => layers.iter().flat_map(|layer| scalar_candidates(role, layer)).collect(),
        _ => layers.iter().filter_map(|layer| vector_candidate(role, layer)).collect(),
    }
}

/// Finds a feature for the chosen colour: in its own view layer first, then among layers without one. A colour without
/// a view layer takes those of another group, if there is only one.
pub(super) fn pick_feature(role: Role, layers: &[Layer], color: &Pick) -> Option<Pick> {
    let mut found = candidates(role, layers);
    let near = |c: &Candidate| c.group == color.group || c.group.is_empty();
    if found.iter().any(near) {
        found.retain(near);
    } else if !color.group.is_empty() || found.iter().any(|c| c.group != found[0].group) {
        return None;
    }
    // A stable order: of equals, the first in the file.
    let best = found.into_iter().min_by_key(|c| (c.group != color.group, c.place))?;
    Some(Pick { part: best.part, group: best.group, channels: best.channels })
}

/// Finds a feature in a file of its own, where it may have any name: by the usual names first, then whatever would be
/// the colour, then the only layer that has enough channels.
pub(super) fn pick_from_own_file(role: Role, container: &Container, layers: &[Layer]) -> Result<Pick, ExrError> {
    if let Some(best) = candidates(role, layers).into_iter().min_by_key(|c| c.place) {
        return Ok(Pick { part: best.part, group: best.group, channels: best.channels });
    }
    let wanted = if role.is_scalar() { 1 } else { 3 };
    let mut pick = usual_color(container, layers)?;
    if pick.is_none() {
        let channels = |layer: &Layer| match role {
            _ if role.is_scalar() => scalar_channel(role, layer).map(|c| vec![c]),
            _ => layer.rgb().or_else(|| layer.xyz()),
        };
        let mut fits = layers.iter().filter_map(|l| Some((l, channels(l)?)));
        if let (Some((layer, channels)), None) = (fits.next(), fits.next()) {
            pick = Some(Pick { part: layer.part, group: layer.group().into(), channels });
        }
    }
    let mut pick = pick.ok_or_else(|| {
        let found = describe(layers.iter());
        ExrError::NoLayer { path: container.path.clone(), wanted: role.to_string(), found }
    })?;
    pick.channels.truncate(wanted);
    Ok(pick)
}
