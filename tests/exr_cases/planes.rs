//! Pictures in other channels than red, green and blue of one part.

use super::*;

/// Writes a colour, reads it again and returns the file's channels.
fn rewritten(frame: &ExrFrame, color: &[f32], folder: &tempfile::TempDir) -> (ExrFrame, Vec<(String, Vec<f32>)>) {
    let out = folder.path().join("out.exr");
    frame.write_with_color(&out, color).unwrap();
    (read(&out), channels(&out))
}

fn ramp(len: usize) -> Vec<f32> {
    (0..len).map(|i| 0.25 + (i % 61) as f32 / 64.0).collect()
}

#[test]
fn a_channel_a_part_is_one_picture() {
    let frame = read(&case("08_channel_parts"));
    assert_eq!(frame.selection().color.to_string(), "part part0, part1, part2: R/G/B");
    let parts = channels(&case("08_channel_parts"));
    for (i, pixel) in frame.color().chunks_exact(3).enumerate() {
        assert_eq!(pixel, [parts[0].1[i], parts[1].1[i], parts[2].1[i]]);
    }
    let (again, _) = rewritten(&frame, &ramp(frame.color().len()), &folder());
    assert!(again.color().iter().zip(ramp(frame.color().len())).all(|(a, b)| (a - b).abs() < 1e-3));
}

#[test]
fn parts_of_full_channel_names_are_found() {
    let frame = read(&case("06_blender5_parts_full"));
    let expected = [
        "part ViewLayer.Combined: ViewLayer.Combined.R/G/B",
        "part ViewLayer.Denoising Albedo: ViewLayer.Denoising Albedo.R/G/B",
        "part ViewLayer.Denoising Normal: ViewLayer.Denoising Normal.X/Y/Z",
        "part ViewLayer.Depth: ViewLayer.Depth.Z",
    ];
    assert_eq!(found(&frame), expected);
    assert!(
        all(albedo(&frame), &[0.9, 0.1, 0.1]) && all(normal(&frame), &[0.0, 0.0, 1.0]) && all(depth(&frame), &[5.0])
    );
}

/// Y, (R-Y)/Y and (B-Y)/Y of full resolution are a colour picture, and stay so.
#[test]
fn luminance_and_chroma_are_converted() {
    let frame = read(&case("10_yc_full"));
    assert_eq!(frame.selection().color.to_string(), "Y/RY/BY");
    let stored = channels(&case("10_yc_full"));
    let [by, ry, y] = [0, 1, 2].map(|i| &stored[i].1);
    for (i, pixel) in frame.color().chunks_exact(3).enumerate() {
        let near = |a: f32, b: f32| (a - b).abs() <= 1e-5 * b.abs().max(1.0);
        assert!(near(pixel[0], (ry[i] + 1.0) * y[i]) && near(pixel[2], (by[i] + 1.0) * y[i]));
        assert!(near(0.2126 * pixel[0] + 0.7152 * pixel[1] + 0.0722 * pixel[2], y[i]), "{i}");
    }
    let (again, _) = rewritten(&frame, frame.color(), &folder());
    let error = |(a, b): (&f32, &f32)| (a - b).abs() / b.abs().max(0.1);
    let worst = again.color().iter().zip(frame.color()).map(error).fold(0.0, f32::max);
    assert!(worst < 0.02, "{worst}: halves of chroma round the darkest colour");
    let wanted = ramp(frame.color().len());
    let (again, _) = rewritten(&frame, &wanted, &folder());
    assert!(again.color().iter().zip(&wanted).all(|(a, b)| (a - b).abs() < 5e-3));
}

/// A subsampled channel beside the picture is kept, bit for bit.
#[test]
fn an_unrelated_subsampled_channel_is_kept() {
    let file = case("11_rgb_and_subsampled");
    let frame = read(&file);
    assert_eq!(found(&frame), ["R/G/B", "-", "-", "-"]);
    let mean = frame.color().iter().step_by(3).sum::<f32>() / frame.extent().pixels() as f32;
    assert!((mean - 0.5072).abs() < 1e-3, "{mean}");
    let folder = folder();
    let out = folder.path().join("out.exr");
    let color = ramp(frame.color().len());
    frame.write_with_color(&out, &color).unwrap();
    let (before, after) = (std::fs::read(&file).unwrap(), std::fs::read(&out).unwrap());
    assert_eq!(before.len(), after.len());
    // Even lines end in 32 halves of 0.5; odd lines have none.
    let uv = [0u8, 0x38].repeat(32);
    let lines = |bytes: &[u8]| bytes.windows(uv.len()).filter(|window| **window == uv).count();
    assert_eq!((lines(&before), lines(&after)), (24, 24));
    assert!(read(&out).color().iter().zip(&color).all(|(a, b)| (a - b).abs() < 1e-3));
    let region = vkdenoise::Region { x: 0, y: 0, width: 8, height: 8 };
    let refused = failure(frame.write_region(&out, &color, region));
    assert!(refused.contains("subsampled"), "{refused}");
}

/// One channel or two are denoised as what they are.
#[test]
fn single_channels_are_pictures() {
    let folder = folder();
    let path = folder.path().join("few.exr");
    for (names, text, pixel) in [
        ("R", "R", [0.1; 3]),
        ("V", "V", [0.1; 3]),
        ("Y", "Y", [0.1; 3]),
        ("R G", "R/G", [0.1, 0.2, 0.15]),
        ("G B Z", "G/B", [0.15, 0.1, 0.2]),
        ("beauty.R", "beauty.R", [0.1; 3]),
    ] {
        write(&path, names, |channel, _| 0.1 * (channel + 1) as f32);
        let frame = read(&path);
        assert_eq!(frame.selection().color.to_string(), text, "{names}");
        assert!(all(frame.color(), &pixel), "{names}: {:?}", &frame.color()[..3]);
        let color: Vec<f32> = frame.color().iter().map(|c| 2.0 * c).collect();
        let (again, stored) = rewritten(&frame, &color, &folder);
        assert!(all(again.color(), &pixel.map(|c| 2.0 * c)), "{names}");
        assert_eq!(stored.len(), names.split_whitespace().count());
    }
    // A whole picture comes before a part of one, and a coordinate is none.
    write(&path, "R beauty.R beauty.G beauty.B", |_, _| 0.5);
    assert_eq!(read(&path).selection().color.to_string(), "beauty.R/G/B");
    write(&path, "U V", |_, _| 0.5);
    assert!(failure(ExrFrame::read(&path, &LayerOptions::default())).contains("no colour"));
}

#[test]
fn a_tiled_file_without_its_last_row_is_refused() {
    let refused = failure(ExrFrame::read(case("24_partial_tiled"), &LayerOptions::default()));
    assert!(refused.contains("24_partial_tiled.exr is incomplete"), "{refused}");
}
