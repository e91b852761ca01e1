//! OpenEXR files: which layers are found by which names, what a rewritten file keeps, and what bad files do.
#![cfg(feature = "exr")]

#[path = "exr_layers/damaged.rs"]
mod damaged;
#[path = "exr_layers/region.rs"]
mod region;
#[path = "exr_layers/rewriting.rs"]
mod rewriting;

use exr::prelude::*;
use std::path::{Path, PathBuf};
use vkdenoise::exr_io::{ExrError, ExrFrame, FeatureSource, LayerOptions};

type Outcome = std::result::Result<ExrFrame, ExrError>;

const SIZE: (usize, usize) = (13, 37);

/// A part: its name (empty for none), its position and its channels. A channel that ends in `:u` is integer, in `:f`
/// float, else half.
struct Part<'a> {
    name: &'a str,
    position: (i32, i32),
    channels: &'a str,
    encoding: Encoding,
}

impl<'a> Part<'a> {
    fn new(name: &'a str, channels: &'a str) -> Self {
        let encoding = Encoding { compression: Compression::ZIP16, ..Encoding::UNCOMPRESSED };
        Self { name, position: (0, 0), channels, encoding }
    }

    fn layer(&self) -> Layer<AnyChannels<FlatSamples>> {
        let channel = |(index, text): (usize, &str)| {
            let value = |i: usize| ((i * 7 + index * 131 + self.name.len()) % 64) as f32 / 32.0;
            let all = (0..SIZE.0 * SIZE.1).map(value);
            match text.split_once(':') {
                Some((name, "u")) => AnyChannel::new(name, FlatSamples::U32(all.map(|v| (v * 1e9) as u32).collect())),
                Some((name, _)) => AnyChannel::new(name, FlatSamples::F32(all.collect())),
                None => AnyChannel::new(text, FlatSamples::F16(all.map(f16::from_f32).collect())),
            }
        };
        let list = self.channels.split_whitespace().enumerate().map(|(i, c)| {
            let mut channel = channel((i, &c.replace('_', " ")));
            channel.quantize_linearly = i % 2 == 1;
            channel
        });
        let mut attributes = LayerAttributes::default().with_position(Vec2(self.position.0, self.position.1));
        attributes.layer_name = (!self.name.is_empty()).then(|| Text::from(self.name));
        attributes.owner = Some(Text::from("the tests"));
        attributes.other.insert(Text::from("renderTime"), AttributeValue::F32(12.5));
        Layer::new(SIZE, attributes, self.encoding, AnyChannels::sort(list.collect()))
    }
}

fn write(path: &Path, parts: &[Part]) {
    let display = ImageAttributes::new(IntegerBounds::new((-3, 2), (100, 50)));
    let layers: Vec<_> = parts.iter().map(Part::layer).collect();
    Image::from_layers(display, layers).write().non_parallel().to_file(path).unwrap();
}

struct Directory(tempfile::TempDir);

impl Directory {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn file(&self, name: &str, parts: &[Part]) -> PathBuf {
        let path = self.0.path().join(name);
        write(&path, parts);
        path
    }

    fn bytes(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.0.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    }
}

fn read(path: &Path) -> Outcome {
    ExrFrame::read(path, &LayerOptions::default())
}

fn named(path: &Path, layer: &str) -> Outcome {
    ExrFrame::read(path, &LayerOptions { layer: Some(layer.into()), ..LayerOptions::default() })
}

fn failure(result: Outcome) -> ExrError {
    result.err().expect("the file should have been refused")
}

/// Colour, albedo, normal and depth in words, `-` for what is missing.
fn found(frame: &ExrFrame) -> [String; 4] {
    let s = frame.selection();
    let text = |l: &Option<vkdenoise::exr_io::UsedLayer>| l.as_ref().map_or("-".into(), |l| l.to_string());
    [s.color.to_string(), text(&s.albedo), text(&s.normal), text(&s.depth)]
}

/// In the channel lists `_` stands for a space.
#[test]
fn names_of_common_renderers() {
    let cases: &[(&str, [&str; 4])] = &[
        ("R G B", ["R/G/B", "-", "-", "-"]),
        ("r g b a", ["r/g/b", "-", "-", "-"]),
        ("Y", ["Y", "-", "-", "-"]),
        ("Y A albedo.R albedo.G albedo.B", ["Y", "albedo.R/G/B", "-", "-"]),
        // Mitsuba 3, with the default and with other names of its AOVs.
        (
            "R G B A albedo.R albedo.G albedo.B sh_normal.X sh_normal.Y sh_normal.Z depth.T geo_normal.X geo_normal.Y geo_normal.Z",
            ["R/G/B", "albedo.R/G/B", "sh normal.X/Y/Z", "depth.T"],
        ),
        ("R G B nn.X nn.Y nn.Z dd.y.T pos.X pos.Y pos.Z", ["R/G/B", "-", "nn.X/Y/Z", "dd.y.T"]),
        ("R G B dd.y uv.U uv.V", ["R/G/B", "-", "-", "dd.y"]),
        // pbrt-v4: N is geometric, P is not depth.
        (
            "R G B Albedo.R Albedo.G Albedo.B N.X N.Y N.Z Ns.X Ns.Y Ns.Z P.X P.Y P.Z Variance.R Variance.G Variance.B u v dzdx dzdy",
            ["R/G/B", "Albedo.R/G/B", "Ns.X/Y/Z", "-"],
        ),
        // Blender: the denoising passes before the others.
        (
            "View_Layer.Combined.R View_Layer.Combined.G View_Layer.Combined.B View_Layer.Combined.A View_Layer.Depth.Z:f \
             View_Layer.Denoising_Albedo.R View_Layer.Denoising_Albedo.G View_Layer.Denoising_Albedo.B \
             View_Layer.DiffCol.R View_Layer.DiffCol.G View_Layer.DiffCol.B \
             View_Layer.Denoising_Normal.X View_Layer.Denoising_Normal.Y View_Layer.Denoising_Normal.Z \
             View_Layer.Normal.X View_Layer.Normal.Y View_Layer.Normal.Z View_Layer.Denoising_Depth.Z:f \
             View_Layer.IndexOB.X:u Composite.Combined.R Composite.Combined.G Composite.Combined.B",
            [
                "View Layer.Combined.R/G/B",
                "View Layer.Denoising Albedo.R/G/B",
                "View Layer.Denoising Normal.X/Y/Z",
                "View Layer.Denoising Depth.Z",
            ],
        ),
        (
            "L.Combined.R L.Combined.G L.Combined.B L.Depth.V L.DiffCol.R L.DiffCol.G L.DiffCol.B",
            ["L.Combined.R/G/B", "L.DiffCol.R/G/B", "-", "L.Depth.V"],
        ),
        (
            "L.Combined.R L.Combined.G L.Combined.B L.Noisy_Image.R L.Noisy_Image.G L.Noisy_Image.B",
            ["L.Noisy Image.R/G/B", "-", "-", "-"],
        ),
        ("Composite.Combined.R Composite.Combined.G Composite.Combined.B", ["Composite.Combined.R/G/B", "-", "-", "-"]),
        // Arnold, Karma; V-Ray; Redshift; LuxCore; RenderMan.
        (
            "R G B diffuse_albedo.R diffuse_albedo.G diffuse_albedo.B N.R N.G N.B Z",
            ["R/G/B", "diffuse albedo.R/G/B", "N.R/G/B", "Z"],
        ),
        (
            "R G B denoise_albedo.r denoise_albedo.g denoise_albedo.b albedo.r albedo.g albedo.b",
            ["R/G/B", "denoise albedo.r/g/b", "-", "-"],
        ),
        (
            "R G B VRayDiffuseFilter.R VRayDiffuseFilter.G VRayDiffuseFilter.B VRayNormals.X VRayNormals.Y VRayNormals.Z VRayZDepth.R",
            ["R/G/B", "VRayDiffuseFilter.R/G/B", "VRayNormals.X/Y/Z", "VRayZDepth.R"],
        ),
        (
            "R G B DiffuseFilter.R DiffuseFilter.G DiffuseFilter.B BumpNormals.R BumpNormals.G BumpNormals.B Depth.Y",
            ["R/G/B", "DiffuseFilter.R/G/B", "BumpNormals.R/G/B", "Depth.Y"],
        ),
        (
            "R G B ALBEDO.R ALBEDO.G ALBEDO.B AVG_SHADING_NORMAL.X AVG_SHADING_NORMAL.Y AVG_SHADING_NORMAL.Z SHADING_NORMAL.X SHADING_NORMAL.Y SHADING_NORMAL.Z DEPTH",
            ["R/G/B", "ALBEDO.R/G/B", "AVG SHADING NORMAL.X/Y/Z", "DEPTH"],
        ),
        ("Ci.r Ci.g Ci.b normal.X normal.Y normal.Z z", ["Ci.r/g/b", "-", "normal.X/Y/Z", "z"]),
        (
            "R G B VisibleDiffuse.R VisibleDiffuse.G VisibleDiffuse.B Normals.X Normals.Y Normals.Z Ng.X Ng.Y Ng.Z zDepth",
            ["R/G/B", "VisibleDiffuse.R/G/B", "Normals.X/Y/Z", "zDepth"],
        ),
        // RenderMan's layers for its denoiser; Karma's; Unreal; Octane in Blender; Corona.
        (
            "Ci.r Ci.g Ci.b a albedo.r albedo.g albedo.b albedo_mse.r albedo_mse.g albedo_mse.b normal.X normal.Y normal.Z zfiltered \
             normal_var.X normal_var.Y normal_var.Z sampleCount mse.r mse.g mse.b",
            ["Ci.r/g/b", "albedo.r/g/b", "normal.X/Y/Z", "zfiltered"],
        ),
        (
            "C.R C.G C.B C.A albedo.R albedo.G albedo.B hitN.X hitN.Y hitN.Z hitP.X hitP.Y hitP.Z hitPz",
            ["C.R/G/B", "albedo.R/G/B", "hitN.X/Y/Z", "hitPz"],
        ),
        (
            "R G B A FinalImageMovieRenderQueue_WorldDepth.R FinalImageMovieRenderQueue_WorldDepth.G \
             FinalImageMovieRenderQueue_WorldDepth.B FinalImageMovieRenderQueue_WorldNormal.R \
             FinalImageMovieRenderQueue_WorldNormal.G FinalImageMovieRenderQueue_WorldNormal.B \
             FinalImageMovieRenderQueue_BaseColor.R FinalImageMovieRenderQueue_BaseColor.G \
             FinalImageMovieRenderQueue_BaseColor.B",
            [
                "R/G/B",
                "FinalImageMovieRenderQueue BaseColor.R/G/B",
                "FinalImageMovieRenderQueue WorldNormal.R/G/B",
                "FinalImageMovieRenderQueue WorldDepth.R",
            ],
        ),
        (
            "L.Combined.R L.Combined.G L.Combined.B L.OctDenoiserBeauty.R L.OctDenoiserBeauty.G L.OctDenoiserBeauty.B \
             L.OctShadingNormal.R L.OctShadingNormal.G L.OctShadingNormal.B L.OctZDepth.R L.OctZDepth.G L.OctZDepth.B",
            ["L.Combined.R/G/B", "-", "L.OctShadingNormal.R/G/B", "L.OctZDepth.R"],
        ),
        (
            "R G B CShading_Albedo.R CShading_Albedo.G CShading_Albedo.B CGeometry_NormalsShading.R \
             CGeometry_NormalsShading.G CGeometry_NormalsShading.B CGeometry_ZDepth.R",
            ["R/G/B", "CShading Albedo.R/G/B", "CGeometry NormalsShading.R/G/B", "CGeometry ZDepth.R"],
        ),
        // Components joined to the name; the only RGB layer; integers and half a triple are passed over.
        ("R G B Nx Ny Nz albedoR albedoG albedoB", ["R/G/B", "albedoR/albedoG/albedoB", "Nx/Ny/Nz", "-"]),
        ("shot7.R shot7.G shot7.B albedo.R albedo.G albedo.B", ["shot7.R/G/B", "albedo.R/G/B", "-", "-"]),
        ("R G B albedo.R albedo.G N.X:u N.Y:u N.Z:u Z:u", ["R/G/B", "-", "-", "-"]),
    ];
    let directory = Directory::new();
    for (channels, expected) in cases {
        let frame = read(&directory.file("names.exr", &[Part::new("", channels)])).unwrap();
        assert_eq!(found(&frame), *expected, "{channels}");
        frame.frame().check().unwrap();
    }
}

#[test]
fn view_layers_are_chosen_by_name() {
    let channels = "A.Combined.R A.Combined.G A.Combined.B A.Normal.X A.Normal.Y A.Normal.Z \
                    B.Combined.R B.Combined.G B.Combined.B B.Depth.Z B.Diffuse.R B.Diffuse.G B.Diffuse.B";
    let directory = Directory::new();
    let path = directory.file("views.exr", &[Part::new("", channels)]);
    let error = failure(read(&path));
    assert!(matches!(error, ExrError::Ambiguous { .. }), "{error}");
    assert!(error.to_string().contains("A.Combined, B.Combined"), "{error}");
    assert_eq!(found(&named(&path, "A").unwrap()), ["A.Combined.R/G/B", "-", "A.Normal.X/Y/Z", "-"]);
    assert_eq!(found(&named(&path, "b.combined").unwrap()), ["B.Combined.R/G/B", "-", "-", "B.Depth.Z"]);
    assert_eq!(found(&named(&path, "Diffuse").unwrap()), ["B.Diffuse.R/G/B", "-", "-", "B.Depth.Z"]);
    assert!(matches!(failure(named(&path, "Combined")), ExrError::Ambiguous { .. }));
    let error = failure(named(&path, "C"));
    assert!(matches!(error, ExrError::NoLayer { .. }) && error.to_string().contains("B.Depth.Z"), "{error}");
    let error = failure(read(&directory.file("none.exr", &[Part::new("", "albedo.R albedo.G albedo.B id:u")])));
    assert!(matches!(error, ExrError::NoLayer { .. }), "{error}");
}

#[test]
fn parts_are_layers() {
    let directory = Directory::new();
    let parts = [
        Part::new("rgba", "R G B A"),
        Part::new("diffuse_albedo", "R G B"),
        Part::new("N", "X:f Y:f Z:f"),
        Part { position: (5, 5), ..Part::new("depth", "Z:f") },
    ];
    let frame = read(&directory.file("parts.exr", &parts)).unwrap();
    let expected = ["part rgba: R/G/B", "part diffuse_albedo: R/G/B", "part N: X/Y/Z", "-"];
    assert_eq!(found(&frame), expected);
    assert!(
        frame.selection().notes[0].contains("depth layer part depth: Z not used: it covers 13 x 37 pixels from (5, 5)")
    );
    let frame = named(&directory.file("parts.exr", &parts), "diffuse_albedo").unwrap();
    assert_eq!(frame.selection().color.to_string(), "part diffuse_albedo: R/G/B");

    // The first part is the image, whatever its name; prefixes in parts count as elsewhere.
    let parts = [Part::new("shot", "R G B"), Part::new("aux", "albedo.R albedo.G albedo.B Z")];
    assert_eq!(
        found(&read(&directory.file("shot.exr", &parts)).unwrap())[..2],
        ["part shot: R/G/B", "part aux: albedo.R/G/B"]
    );
    // Parts that are equally good are chosen by their names; left and right are views.
    let parts = |names: [&'static str; 2]| names.map(|name| Part::new(name, "image.R image.G image.B"));
    let path = directory.file("takes.exr", &parts(["one", "two"]));
    assert!(matches!(failure(read(&path)), ExrError::Ambiguous { .. }));
    assert_eq!(found(&named(&path, "two").unwrap())[0], "part two: image.R/G/B");
    let path = directory.file("eyes.exr", &parts(["left", "right"]));
    assert_eq!(found(&read(&path).unwrap())[0], "part left: image.R/G/B");
    assert_eq!(found(&named(&path, "right").unwrap())[0], "part right: image.R/G/B");
}

#[test]
fn planes_hold_the_samples() {
    let directory = Directory::new();
    let part = Part::new("", "B G R Z:f");
    let frame = read(&directory.file("planes.exr", &[part])).unwrap();
    let value = |index: usize, i: usize| ((i * 7 + index * 131) % 64) as f32 / 32.0;
    for (i, pixel) in frame.color().chunks_exact(3).enumerate() {
        assert_eq!(pixel, [value(2, i), value(1, i), value(0, i)]);
    }
    assert_eq!((frame.extent().width, frame.extent().height), (13, 37));
}

#[test]
fn features_from_their_own_files() {
    let directory = Directory::new();
    let color = directory.file("color.exr", &[Part::new("", "R G B albedo.R albedo.G albedo.B Z")]);
    let albedo = directory.file("albedo.exr", &[Part::new("", "R G B A")]);
    let normal = directory.file("normal.exr", &[Part::new("", "pass.X:f pass.Y:f pass.Z:f")]);
    let depth = directory.file("depth.exr", &[Part::new("", "Y:f")]);
    let options = LayerOptions {
        layer: None,
        albedo: FeatureSource::File(albedo.clone()),
        normal: FeatureSource::File(normal),
        depth: FeatureSource::File(depth),
        ..LayerOptions::default()
    };
    let frame = ExrFrame::read(&color, &options).unwrap();
    assert_eq!(found(&frame)[1], format!("R/G/B in {}", albedo.display()));
    assert!(found(&frame)[2].starts_with("pass.X/Y/Z in "));
    assert!(found(&frame)[3].starts_with("Y in "));
    frame.frame().check().unwrap();
    assert_eq!(found(&ExrFrame::read(&color, &LayerOptions::color_only(None)).unwrap()), ["R/G/B", "-", "-", "-"]);

    let with = |file: PathBuf| LayerOptions { albedo: FeatureSource::File(file), ..LayerOptions::default() };
    let moved = directory.file("moved.exr", &[Part { position: (1, 0), ..Part::new("", "R G B") }]);
    assert!(matches!(failure(ExrFrame::read(&color, &with(moved))), ExrError::WindowMismatch { .. }));
    let many = directory.file("many.exr", &[Part::new("", "a.R a.G a.B b.R b.G b.B")]);
    assert!(matches!(failure(ExrFrame::read(&color, &with(many))), ExrError::NoLayer { .. }));
    let missing = directory.0.path().join("missing.exr");
    assert!(matches!(failure(ExrFrame::read(&color, &with(missing))), ExrError::Read { .. }));
}
