//! The names that renderers write, best first, as `docs/files.md` lists them with where they are documented.
//!
//! Names are compared without case, spaces and punctuation ([`super::layers::simplify`]), so `Denoising Albedo` is
//! `denoisingalbedo`. Layers made for a denoiser come first, the shading normal before the geometric one.

use super::Role;

/// Colour of layers with a name; plain R, G, B come before all of these.
/// Blender's `Noisy Image` comes before its `Combined`, which is already denoised where both are there.
pub(super) const COLOR: &[&str] = &[
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
    "img",
    "finalimage",
    "main",
    "final",
    "default",
];

/// Blender, Arnold; Mitsuba, pbrt, RenderMan, Karma, LuxCore; Arnold; Redshift and V-Ray; Blender's diffuse colour.
pub(super) const ALBEDO: &[&str] = &[
    "denoisingalbedo",
    "denoisealbedo",
    "albedo",
    "guidealbedo",
    "diffusealbedonoice",
    "diffusealbedo",
    "visiblediffusealbedo",
    "visiblediffuse",
    "diffusefilter",
    "vraydiffusefilter",
    "octdifffilterinfo",
    "cshadingalbedo",
    "cshadingsourcecolor",
    "basecolor",
    "diffusecolor",
    "diffcol",
    "alb",
];

/// Mitsuba: sh_normal, nn; pbrt: Ns; LuxCore: AVG_SHADING_NORMAL; Arnold, Karma: N; Redshift, V-Ray: bump normals.
/// pbrt's N is geometric, which is why Ns stands before it.
pub(super) const NORMAL: &[&str] = &[
    "denoisingnormal",
    "denoisenormal",
    "nnoice",
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
    "octshadingnormal",
    "cgeometrynormalsshading",
    "hitn",
    "n",
    "normal",
    "normals",
    "worldnormal",
    "normalworld",
    "vraynormals",
    "octsmoothnormal",
    "octgeonormal",
    "geonormal",
    "geometricnormal",
    "geometrynormal",
    "ng",
];

/// RenderMan writes a filtered depth; V-Ray, Octane, Corona, Unreal name theirs after themselves.
pub(super) const DEPTH: &[&str] = &[
    "denoisingdepth",
    "denoisedepth",
    "znoice",
    "zfiltered",
    "depth",
    "z",
    "zdepth",
    "vrayzdepth",
    "dd",
    "distance",
    "cameradepth",
    "lineardepth",
    "worlddepth",
    "octzdepth",
    "cgeometryzdepth",
    "hitpz",
    "pz",
];

/// Depths along an axis of the camera, which may be negative before it (Karma, Mantra).
pub(super) const ALONG_AXIS: &[&str] = &["hitpz", "pz"];

pub(super) const VARIANCE: &[&str] =
    &["variance", "colorvariance", "colourvariance", "noisevariance", "luminancevariance"];

pub(super) const SAMPLES: &[&str] =
    &["samplecount", "samples", "samplecounts", "samplesperpixel", "spp", "numsamples", SAMPLE_SHARE];

/// Cycles' samples of a pixel, over the most that any pixel may have.
pub(super) const SAMPLE_SHARE: &str = "debugsamplecount";

/// The channel of a depth layer, where it has several.
pub(super) const DEPTH_CHANNELS: &[&str] = &["Z", "V", "T", "Y", "D", "R", "X"];

/// The same of other planes of one channel; of three colours, green is most of the luminance.
pub(super) const SCALAR_CHANNELS: &[&str] = &["Y", "V", "Z", "X", "G", "R"];

/// The names of a role.
pub(super) fn table(role: Role) -> &'static [&'static str] {
    match role {
        Role::Albedo => ALBEDO,
        Role::Normal => NORMAL,
        Role::Depth => DEPTH,
        Role::Variance => VARIANCE,
        Role::Samples => SAMPLES,
    }
}

/// The place of a simplified name in a table; less is better.
pub(super) fn place(table: &[&str], kind: &str) -> Option<usize> {
    table.iter().position(|name| *name == kind)
}

/// Whether a simplified name is that of a feature.
pub(super) fn is_feature(kind: &str) -> bool {
    [ALBEDO, NORMAL, DEPTH, VARIANCE, SAMPLES].into_iter().any(|table| place(table, kind).is_some())
}

/// Whether a simplified name says that the picture has been denoised: `..._denoised`, V-Ray's `effectsResult`, Octane's
/// `OctDenoiserBeauty`.
pub(super) fn says_denoised(kind: &str) -> bool {
    kind.contains("denoised") || kind.contains("denoiserbeauty") || kind == "effectsresult"
}

/// What Unreal's movie pipelines put before the names of their layers.
const UNREAL: [&str; 2] = ["finalimagemovierenderqueue", "finalimagepw"];

/// A simplified name without what a program puts before all of its names.
pub(super) fn without_prefix(kind: String) -> String {
    let rest = UNREAL.iter().find_map(|prefix| kind.strip_prefix(prefix)).filter(|rest| !rest.is_empty());
    rest.map(str::to_owned).unwrap_or(kind)
}
