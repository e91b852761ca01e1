//! Stereo files: each view with its own features, both written back.

use super::*;

const LEFT: [f32; 3] = [0.9, 0.1, 0.1];
const RIGHT: [f32; 3] = [0.1, 0.1, 0.9];

/// One part with `multiView`: what names no view is of the first.
#[test]
fn views_of_one_part_have_their_own_features() {
    let frames = ExrFrame::read_views(case("01_stereo_one_part"), &LayerOptions::default()).unwrap();
    let views: Vec<_> = frames.iter().map(|frame| frame.selection().view.clone().unwrap()).collect();
    assert_eq!(views, ["left", "right"]);
    assert_eq!(found(&frames[0]), ["R/G/B", "albedo.R/G/B", "-", "Z"]);
    assert_eq!(found(&frames[1]), ["right.R/G/B", "albedo.right.R/G/B", "-", "right.Z"]);
    for (frame, color, z) in [(&frames[0], LEFT, 5.0), (&frames[1], RIGHT, 20.0)] {
        assert!(all(albedo(frame), &color) && all(depth(frame), &[z]));
    }
    // The right eye is three times as bright.
    let mean = |frame: &ExrFrame| frame.color().iter().sum::<f32>() / frame.color().len() as f32;
    assert!((mean(&frames[0]) - 0.349).abs() < 1e-3 && (mean(&frames[1]) - 1.052).abs() < 1e-3);

    for options in [layer("right"), LayerOptions { view: Some("Right".into()), ..LayerOptions::default() }] {
        let right = ExrFrame::read(case("01_stereo_one_part"), &options).unwrap();
        assert_eq!(right.selection(), frames[1].selection());
        assert!(all(albedo(&right), &RIGHT) && all(depth(&right), &[20.0]));
    }
    let unknown = LayerOptions { view: Some("center".into()), ..LayerOptions::default() };
    let refused = failure(ExrFrame::read(case("01_stereo_one_part"), &unknown));
    assert!(refused.contains("no view 'center'; it has: left, right"), "{refused}");
}

/// Blender's `ViewLayer.Combined.left`, as made after it and as Blender 4.5 wrote it.
#[test]
fn views_of_blender_are_found() {
    let features = |view: &str, depth: &str| {
        let name = |layer: &str, channels: &str| format!("ViewLayer.{layer}.{view}.{channels}");
        let (albedo, normal) = (name("Denoising Albedo", "R/G/B"), name("Denoising Normal", "X/Y/Z"));
        [name("Combined", "R/G/B"), albedo, normal, name(depth, "Z")]
    };
    for (file, depth_layer) in [("04_blender_stereo", "Depth"), ("blender45_stereo_multilayer", "Denoising Depth")] {
        let frames = ExrFrame::read_views(case(file), &LayerOptions::default()).unwrap();
        assert_eq!(frames.len(), 2, "{file}");
        for (frame, view) in frames.iter().zip(["left", "right"]) {
            assert_eq!(frame.selection().view.as_deref(), Some(view));
            assert_eq!(found(frame), features(view, depth_layer), "{file}");
            frame.frame().check().unwrap();
        }
        if file == "04_blender_stereo" {
            assert!(all(albedo(&frames[0]), &LEFT) && all(albedo(&frames[1]), &RIGHT));
            assert!(all(depth(&frames[0]), &[5.0]) && all(depth(&frames[1]), &[20.0]));
        } else {
            assert_ne!(albedo(&frames[0]), albedo(&frames[1]));
            assert_ne!(frames[0].color(), frames[1].color());
        }
        // By the view layer, by the layer with its view and without.
        assert_eq!(ExrFrame::read_views(case(file), &layer("ViewLayer")).unwrap().len(), 2);
        assert_eq!(ExrFrame::read_views(case(file), &layer("ViewLayer.Combined")).unwrap().len(), 2);
        let right = ExrFrame::read_views(case(file), &layer("ViewLayer.Combined.right")).unwrap();
        assert_eq!(right.len(), 1);
        assert_eq!(right[0].selection(), frames[1].selection());
    }
}

/// Every view is written into its own channels, and nothing else changes.
#[test]
fn all_views_are_written_back() {
    let folder = folder();
    let out = folder.path().join("out.exr");
    let file = case("01_stereo_one_part");
    let frames = ExrFrame::read_views(&file, &LayerOptions::default()).unwrap();
    let colors = [1.5f32, 2.5].map(|value| vec![value; frames[0].color().len()]);
    let both = [(&frames[0], colors[0].as_slice()), (&frames[1], colors[1].as_slice())];
    ExrOutput::new(&both, None).unwrap().write(&out).unwrap();
    for ((name, before), (_, after)) in channels(&file).into_iter().zip(channels(&out)) {
        match name.as_str() {
            "0:R" | "0:G" | "0:B" => assert!(all(&after, &[1.5]), "{name}"),
            "0:right.R" | "0:right.G" | "0:right.B" => assert!(all(&after, &[2.5]), "{name}"),
            _ => assert_eq!(before, after, "{name}"),
        }
    }
    // One alone leaves the other as it was.
    ExrOutput::new(&both[1..], None).unwrap().write(&out).unwrap();
    let again = ExrFrame::read_views(&out, &LayerOptions::default()).unwrap();
    assert_eq!(again[0].color(), frames[0].color());
    assert!(all(again[1].color(), &[2.5]));
    // A region of both.
    let region = vkdenoise::Region { x: 5, y: 7, width: 20, height: 10 };
    ExrOutput::new(&both, Some(region)).unwrap().write(&out).unwrap();
    let cut = ExrFrame::read_views(&out, &LayerOptions::default()).unwrap();
    assert_eq!(cut[1].extent(), vkdenoise::Extent::new(20, 10));
    assert!(all(cut[0].color(), &[1.5]) && all(cut[1].color(), &[2.5]));

    let other = ExrFrame::read(&file, &LayerOptions::default()).unwrap();
    let mixed = ExrOutput::new(&[both[0], (&other, &colors[1])], None);
    assert!(matches!(mixed.err(), Some(ExrError::Mixed)));
    assert!(matches!(ExrOutput::new(&[], None).err(), Some(ExrError::Mixed)));
}

/// Parts with a `view` attribute, parts named for their view, and names without any attribute.
#[test]
fn views_are_known_by_attributes_and_by_names() {
    use exr::prelude::{ImageAttributes, IntegerBounds, Layer, LayerAttributes, Text};
    let folder = folder();
    let path = folder.path().join("parts.exr");
    let part = |name: &str, view: Option<&str>, channels: &str, value: f32| {
        let list = channels.split_whitespace().map(|c| AnyChannel::new(c, FlatSamples::F32(vec![value; 128])));
        let mut attributes = LayerAttributes::named(name);
        attributes.view_name = view.map(Text::from);
        Layer::new((16, 8), attributes, Encoding::SMALL_LOSSLESS, AnyChannels::sort(list.collect()))
    };
    let write_parts = |parts: Vec<Layer<AnyChannels<FlatSamples>>>| {
        let display = ImageAttributes::new(IntegerBounds::from_dimensions((16, 8)));
        Image::from_layers(display, parts).write().non_parallel().to_file(&path).unwrap();
        ExrFrame::read_views(&path, &LayerOptions::default())
    };
    let four = |left: Option<&str>, right: Option<&str>, names: [&str; 4]| {
        vec![
            part(names[0], left, "R G B A", 1.0),
            part(names[1], left, "R G B", 0.25),
            part(names[2], right, "R G B A", 2.0),
            part(names[3], right, "R G B", 0.75),
        ]
    };
    let attributes = four(Some("near"), Some("far"), ["rgba.near", "albedo.near", "rgba.far", "albedo.far"]);
    let names = four(None, None, ["rgba.left", "albedo.left", "rgba.right", "albedo.right"]);
    let bare = four(None, None, ["left", "left.albedo", "right", "right.albedo"]);
    for (parts, views) in [(attributes, ["near", "far"]), (names, ["left", "right"]), (bare, ["left", "right"])] {
        let frames = write_parts(parts).unwrap();
        let found: Vec<_> = frames.iter().map(|frame| frame.selection().view.clone().unwrap()).collect();
        assert_eq!(found, views);
        assert!(all(frames[0].color(), &[1.0; 3]) && all(albedo(&frames[0]), &[0.25; 3]));
        assert!(all(frames[1].color(), &[2.0; 3]) && all(albedo(&frames[1]), &[0.75; 3]));
    }
    // A picture of one view alone, and the one view that some programs name `main`.
    let main = vec![part("rgba", Some("main"), "R G B", 1.0), part("albedo", None, "R G B", 0.25)];
    let frames = write_parts(main).unwrap();
    assert_eq!((frames.len(), &frames[0].selection().view), (1, &None));
    assert!(all(albedo(&frames[0]), &[0.25; 3]));

    // No attributes: what names no view is the other eye.
    let path = folder.path().join("names.exr");
    write(&path, "R G B right.R right.G right.B albedo.right.R albedo.right.G albedo.right.B", |c, _| c as f32 / 10.0);
    let frames = ExrFrame::read_views(&path, &LayerOptions::default()).unwrap();
    let views: Vec<_> = frames.iter().map(|frame| frame.selection().view.clone().unwrap()).collect();
    assert_eq!(views, ["left", "right"]);
    assert_eq!(found(&frames[0])[1], "-", "the other eye's albedo is not used");
    assert!(all(frames[0].color(), &[0.0, 0.1, 0.2]) && all(frames[1].color(), &[0.3, 0.4, 0.5]));
    let left = LayerOptions { view: Some("left".into()), ..LayerOptions::default() };
    assert_eq!(ExrFrame::read(&path, &left).unwrap().color(), frames[0].color());
    // A light group of that name is no view of the picture.
    write(&path, "R G B key.left.R key.left.G key.left.B Z", |c, _| c as f32 / 10.0);
    let frames = ExrFrame::read_views(&path, &LayerOptions::default()).unwrap();
    assert_eq!(frames.len(), 1);
    assert_eq!(found(&frames[0])[3], "Z");
}

/// A feature's own file of the same views gives each its own; one picture serves all.
#[test]
fn features_of_other_files_follow_the_view() {
    let stereo = case("04_blender_stereo");
    let with = |file: PathBuf| LayerOptions { albedo: FeatureSource::File(file), ..LayerOptions::default() };
    let frames = ExrFrame::read_views(case("01_stereo_one_part"), &with(stereo)).unwrap();
    assert!(all(albedo(&frames[0]), &LEFT) && all(albedo(&frames[1]), &RIGHT));
    assert!(found(&frames[1])[1].starts_with("ViewLayer.Denoising Albedo.right.R/G/B in "));
    let frames = ExrFrame::read_views(case("01_stereo_one_part"), &with(case("15_arnold_noice"))).unwrap();
    assert!(all(albedo(&frames[0]), &LEFT) && all(albedo(&frames[1]), &LEFT));
}
