//! Names of features, and what their samples mean.

use super::*;

#[test]
fn arnolds_noice_layers_are_found() {
    let frame = read(&case("15_arnold_noice"));
    assert_eq!(found(&frame), ["R/G/B", "diffuse_albedo.R/G/B", "N_noice.X/Y/Z", "Z_noice"]);
    assert!(
        all(albedo(&frame), &[0.9, 0.1, 0.1]) && all(normal(&frame), &[0.0, 0.0, 1.0]) && all(depth(&frame), &[5.0])
    );
    let variance = frame.frame().features.noise.expect("the variance");
    assert_eq!(frame.selection().variance.as_ref().unwrap().to_string(), "variance.G");
    assert!(all(samples(Some(variance.plane)), &[0.03]));
    assert!(frame.selection().notes.is_empty(), "{:?}", frame.selection().notes);
}

#[test]
fn encoded_normals_are_decoded_and_said() {
    let frame = read(&case("16_normals_encoded"));
    let stored = channels(&case("16_normals_encoded"));
    let normals = normal(&frame);
    for component in 0..3 {
        let (_, values) =
            stored.iter().find(|(name, _)| *name == format!("0:N.{}", ["X", "Y", "Z"][component])).unwrap();
        let decoded = normals.iter().skip(component).step_by(3).zip(values);
        decoded.for_each(|(n, v)| assert!((n - (2.0 * v - 1.0)).abs() < 1e-6));
    }
    assert!(normals.iter().any(|c| *c < -0.5));
    let notes = &frame.selection().notes;
    assert!(notes.iter().any(|note| note == "normal N.X/Y/Z: stored as n * 0.5 + 0.5, decoded"), "{notes:?}");
    // True normals are left alone.
    assert!(read(&case("15_arnold_noice")).selection().notes.is_empty());
}

#[test]
fn depths_lose_their_sign_where_all_are_negative() {
    let frame = read(&case("18_pz"));
    assert_eq!(found(&frame)[3], "Pz");
    assert!(all(depth(&frame), &[5.0]));
    assert!(frame.selection().notes[0].contains("depth Pz: negative before the camera"));

    let folder = folder();
    let path = folder.path().join("depth.exr");
    // Background is 0 or infinite; one depth above 0 means that the sign says something.
    let infinite = |_: usize, i: usize| [f32::INFINITY, -3.0, 0.0, -4.0][i % 4];
    write(&path, "R G B Z", infinite);
    assert_eq!(depth(&read(&path))[..4], [f32::INFINITY, 3.0, 0.0, 4.0]);
    write(&path, "R G B Z", |_, i| [2.0, -3.0, 0.0, -4.0][i % 4]);
    assert_eq!(depth(&read(&path))[..4], [2.0, -3.0, 0.0, -4.0]);
    assert!(read(&path).selection().notes.is_empty());
    // A position is not taken for its third coordinate.
    write(&path, "R G B Px Py Pz", |_, _| -1.0);
    assert_eq!(found(&read(&path))[3], "-");
}

#[test]
fn what_is_no_depth_is_not_taken_for_it() {
    assert_eq!(found(&read(&case("19_mist"))), ["R/G/B", "-", "-", "-"]);
    let folder = folder();
    let path = folder.path().join("depth.exr");
    for other in ["disparity.Z", "T", "t", "id.Z", "objectid", "mist", "L.Mist.Z", "uv.Z", "motion.X motion.Z"] {
        write(&path, &format!("R G B {other}"), |_, _| 0.5);
        assert_eq!(found(&read(&path))[3], "-", "{other}");
    }
    for depth in ["Z", "depth.T", "depth", "dd.y.T", "Z noice", "Z_noice.R", "L.Depth", "zdepth.V"] {
        write(&path, &format!("R G B {}", depth.replace(' ', "_")), |_, _| 0.5);
        assert_eq!(found(&read(&path))[3], depth.replace('_', " "));
    }
}

/// Cycles writes shares of the most samples; the header says how many that are.
#[test]
fn sample_shares_become_counts() {
    let file = case("blender45_adaptive_samplecount");
    let frame = read(&file);
    let layer = "ViewLayer.Debug Sample Count.X";
    assert_eq!(frame.selection().samples.as_ref().unwrap().to_string(), layer);
    let counts = samples(frame.frame().features.noise.map(|noise| noise.plane));
    let (least, most) = counts.iter().fold((f32::MAX, 0.0f32), |(a, b), c| (a.min(*c), b.max(*c)));
    assert!((least - 16.0).abs() < 1e-3 && most == 48.0, "{least} to {most}");
    assert!(frame.selection().notes[0].contains("shares of 48 samples"), "{:?}", frame.selection().notes);
    // The same from a file of its own, and not where nobody says what the share is of.
    let own = LayerOptions { samples: FeatureSource::File(file.clone()), ..LayerOptions::default() };
    let from_file = ExrFrame::read(&file, &own).unwrap();
    assert_eq!(samples(from_file.frame().features.noise.map(|noise| noise.plane)), counts);
    let folder = folder();
    let path = folder.path().join("counts.exr");
    write(&path, "R G B L.Debug_Sample_Count.X", |_, _| 0.5);
    let frame = read(&path);
    assert!(frame.frame().features.noise.is_none() && frame.selection().samples.is_none());
    assert!(frame.selection().notes[0].contains("not used"), "{:?}", frame.selection().notes);
}

/// A plane of one channel is never taken from a picture in colour.
#[test]
fn scalars_do_not_fall_back_to_a_colour() {
    let folder = folder();
    let (path, scalar) = (folder.path().join("color.exr"), folder.path().join("scalar.exr"));
    write(&path, "R G B", |_, _| 0.5);
    let with = |role: &str| {
        let file = FeatureSource::File(scalar.clone());
        let options = LayerOptions::default();
        let options = match role {
            "depth" => LayerOptions { depth: file, ..options },
            "samples" => LayerOptions { samples: file, ..options },
            _ => LayerOptions { variance: file, ..options },
        };
        ExrFrame::read(&path, &options)
    };
    for names in ["R G B", "L.Combined.R L.Combined.G L.Combined.B L.Combined.A", "R G B A IndexOB.X other.Y"] {
        write(&scalar, names, |_, _| 0.5);
        for role in ["depth", "samples", "variance"] {
            // The last has layers that could be anything, and says so.
            let refused = failure(with(role));
            assert!(refused.contains(&format!("scalar.exr has no {role} layer; it has:")), "{names}: {refused}");
        }
    }
    for names in ["any.V", "Y", "R", "A B G R depth.Z samples.Y variance.Y"] {
        write(&scalar, names, |_, _| 0.5);
        for role in ["depth", "samples", "variance"] {
            with(role).unwrap();
        }
    }
}

/// Blender's raw picture beside the one that it has denoised itself.
#[test]
fn the_raw_picture_is_denoised_and_goes_where_it_is_wanted() {
    let folder = folder();
    let (path, out) = (folder.path().join("both.exr"), folder.path().join("out.exr"));
    let names = "L.Noisy_Image.R L.Noisy_Image.G L.Noisy_Image.B L.Combined.R L.Combined.G L.Combined.B L.Combined.A";
    write(&path, names, |channel, _| if channel < 3 { 0.75 } else { 0.25 });
    let frame = read(&path);
    assert_eq!(frame.selection().color.to_string(), "L.Noisy Image.R/G/B");
    let notes = &frame.selection().notes;
    assert!(notes[0].starts_with("L.Noisy Image is denoised; L.Combined") && notes[0].contains("--into"), "{notes:?}");

    let into = LayerOptions { into: Some("Combined".into()), ..LayerOptions::default() };
    let frame = ExrFrame::read(&path, &into).unwrap();
    assert!(all(frame.color(), &[0.75; 3]));
    assert_eq!(frame.selection().into.as_ref().unwrap().to_string(), "L.Combined.R/G/B");
    assert!(frame.selection().notes[0].contains("goes into L.Combined; L.Noisy Image stays"));
    frame.write_with_color(&out, &vec![0.5; frame.color().len()]).unwrap();
    for (name, values) in channels(&out) {
        let wanted = match name.as_str() {
            "0:L.Combined.A" => 0.25,
            name if name.contains("Noisy") => 0.75,
            _ => 0.5,
        };
        assert!(all(&values, &[wanted]), "{name}");
    }
    let again = ExrFrame::read(&path, &layer("L.Combined")).unwrap();
    assert!(again.selection().notes[0].contains("denoised again; raw is L.Noisy Image"));
    let nowhere = LayerOptions { into: Some("beauty".into()), ..LayerOptions::default() };
    assert!(failure(ExrFrame::read(&path, &nowhere)).contains("no colour 'beauty'"));
    // Other renderers' names of what they have denoised.
    write(&path, "R G B effectsResult.R effectsResult.G effectsResult.B", |_, _| 0.5);
    assert!(read(&path).selection().notes[0].contains("effectsResult, which the renderer has denoised"));
}

/// Mitsuba with a film in XYZ: the nested picture is the colour.
#[test]
fn the_nested_picture_of_mitsuba_is_the_colour() {
    let frame = read(&case("mitsuba39_xyz_nested_aov"));
    assert_eq!(found(&frame), ["img.R/G/B", "my.alb.R/G/B", "N.X/Y/Z", "Z.T"]);
    let [red, z] = [frame.color(), depth(&frame)].map(|plane| plane.iter().fold(0.0f32, |a, b| a.max(*b)));
    assert!((red - 18.0257).abs() < 1e-3 && (z - 5.07675).abs() < 1e-4, "{red} {z}");
}

/// Of layers with any name, the one with an alpha is the picture; of several, none is guessed, and the message says
/// why.
#[test]
fn several_candidates_are_named_with_the_reason() {
    let folder = folder();
    let path = folder.path().join("several.exr");
    write(&path, "shot.R shot.G shot.B shot.A other.R other.G other.B", |_, _| 0.5);
    assert_eq!(read(&path).selection().color.to_string(), "shot.R/G/B");
    write(&path, "shot.R shot.G shot.B other.R other.G other.B", |_, _| 0.5);
    let refused = failure(ExrFrame::read(&path, &LayerOptions::default()));
    assert!(refused.contains("(other, shot; each has a colour's channels, and none a colour's name)"), "{refused}");
    write(&path, "A.Combined.R A.Combined.G A.Combined.B B.Combined.R B.Combined.G B.Combined.B", |_, _| 0.5);
    let refused = failure(ExrFrame::read(&path, &LayerOptions::default()));
    assert!(refused.contains("(A.Combined, B.Combined; each is named Combined)"), "{refused}");
}

/// Names are UTF-8.
#[test]
fn names_of_other_scripts_are_shown_and_found() {
    let folder = folder();
    let path = folder.path().join("names.exr");
    let list = ["R", "G", "B"].map(|c| {
        let name: Vec<u8> = format!("Überblendung 場面.{c}").into_bytes();
        let mut channel = AnyChannel::new("x", FlatSamples::F32(vec![0.5; 128]));
        channel.name = exr::prelude::Text::from_bytes_unchecked(name.into_iter().collect());
        channel
    });
    let list = AnyChannels::sort(list.into_iter().collect());
    let image = Image::from_encoded_channels((16, 8), Encoding::SMALL_LOSSLESS, list);
    image.write().non_parallel().to_file(&path).unwrap();
    assert_eq!(read(&path).selection().color.to_string(), "Überblendung 場面.R/G/B");
    let named = ExrFrame::read(&path, &layer("überblendung 場面")).unwrap();
    assert_eq!(named.color().len(), 3 * 128);
}

/// What a lossy compression does to other layers of the same part is said; other parts are copied.
#[test]
fn what_is_rounded_once_more_is_said() {
    use exr::prelude::Compression;
    let folder = folder();
    let path = folder.path().join("lossy.exr");
    let notes = |compression, names: &str| {
        let channel = |name: &str| AnyChannel::new(name, FlatSamples::F32(vec![0.5; 128]));
        let list = AnyChannels::sort(names.split_whitespace().map(channel).collect());
        let encoding = Encoding { compression, ..Encoding::SMALL_LOSSLESS };
        let image = Image::from_encoded_channels((16, 8), encoding, list);
        image.write().non_parallel().to_file(&path).unwrap();
        ExrFrame::read_views(&path, &LayerOptions::default()).unwrap()[0].selection().notes.clone()
    };
    let names = "R G B A Z albedo.R albedo.G albedo.B N.X N.Y N.Z";
    let said = notes(Compression::DWAA(None), names);
    assert_eq!(said.len(), 1, "{said:?}");
    assert!(said[0].contains("dwaa compression is lossy: N.Y, albedo.B, albedo.G, albedo.R, in blocks"), "{said:?}");
    assert!(notes(Compression::PXR24, names)[0].contains("A, N.X, N.Y, N.Z, Z, albedo.B"));
    assert!(notes(Compression::ZIP16, names).is_empty() && notes(Compression::DWAA(None), "R G B A Z").is_empty());
}
