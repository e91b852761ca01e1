//! What a rewritten file keeps.

use super::*;

pub fn everything(path: &Path) -> FlatImage {
    let reader = exr::prelude::read().no_deep_data().largest_resolution_level().all_channels().all_layers();
    reader.all_attributes().from_file(path).unwrap()
}

/// Rewrites a file and checks that nothing but the given channels of part 0 changed, and those as they should.
fn check_rewrite(path: &Path, color_channels: &[&str], tolerance: f32) {
    let frame = read(path).unwrap();
    let color: Vec<f32> = (0..frame.color().len()).map(|i| 0.25 + (i % 256) as f32 / 64.0).collect();
    let out = path.with_extension("out.exr");
    frame.write_with_color(&out, &color).unwrap();
    let (before, after) = (std::fs::read(path).unwrap(), std::fs::read(&out).unwrap());
    let meta = MetaData::read_from_buffered(before.as_slice(), true).unwrap();
    assert_eq!(meta, MetaData::read_from_buffered(after.as_slice(), true).unwrap());
    let (before, after) = (everything(path), everything(&out));
    assert_eq!(before.attributes, after.attributes);
    for (part, (b, a)) in before.layer_data.iter().zip(&after.layer_data).enumerate() {
        assert_eq!((&b.attributes, b.size, b.encoding), (&a.attributes, a.size, a.encoding));
        for (b, a) in b.channel_data.list.iter().zip(&a.channel_data.list) {
            let name = b.name.to_string();
            let component = color_channels.iter().position(|c| part == 0 && *c == name);
            let Some(component) = component else {
                let pairs = b.sample_data.values_as_f32().zip(a.sample_data.values_as_f32());
                pairs.for_each(|(b, a)| assert!((b - a).abs() <= tolerance, "{name}: {b} {a}"));
                continue;
            };
            for (i, a) in a.sample_data.values_as_f32().enumerate() {
                let wanted = match color_channels {
                    [_] => color[3 * i..][..3].iter().sum::<f32>() / 3.0,
                    _ => color[3 * i + component],
                };
                assert!((a - wanted).abs() <= 2e-3 * wanted.max(1.0) + tolerance, "{name}: {a} {wanted}");
            }
        }
    }
    assert_eq!(read(&out).unwrap().selection(), frame.selection());
}

#[test]
fn rewriting_keeps_everything_else() {
    let directory = Directory::new();
    let blocks = [
        (Blocks::ScanLines, LineOrder::Increasing),
        (Blocks::ScanLines, LineOrder::Decreasing),
        (Blocks::Tiles(Vec2(8, 5)), LineOrder::Increasing),
        (Blocks::Tiles(Vec2(64, 64)), LineOrder::Unspecified),
    ];
    let channels = "A albedo.B albedo.G albedo.R B:f G:f R:f id:u N.X N.Y N.Z Z:f";
    use Compression::*;
    for compression in [Uncompressed, RLE, ZIP1, ZIP16, PIZ, PXR24, B44, B44A, DWAA(None)] {
        for (blocks, line_order) in blocks {
            let encoding = Encoding { compression, blocks, line_order };
            let other = Part { position: (7, -9), encoding, ..Part::new("other", "R G B mask:u") };
            let parts = [Part { position: (-4, -11), encoding, ..Part::new("rgba", channels) }, other];
            let tolerance = match compression {
                DWAA(_) => 0.25,
                lossy if lossy.may_loose_data() => 0.02,
                _ => 0.0,
            };
            check_rewrite(&directory.file("kept.exr", &parts), &["R", "G", "B"], tolerance);
        }
    }
    check_rewrite(&directory.file("half.exr", &[Part::new("", "A B G R")]), &["R", "G", "B"], 0.0);
    check_rewrite(&directory.file("gray.exr", &[Part::new("", "A Y Z:f")]), &["Y"], 0.0);
}

#[test]
fn parts_without_colour_are_copied_bit_for_bit() {
    let directory = Directory::new();
    let encoding = Encoding { compression: Compression::B44, ..Encoding::UNCOMPRESSED };
    let parts = [Part::new("rgba", "R G B"), Part { encoding, ..Part::new("other", "u v w") }];
    let path = directory.file("copied.exr", &parts);
    let frame = read(&path).unwrap();
    let out = path.with_extension("out.exr");
    frame.write_with_color(&out, frame.color()).unwrap();
    let block = |path: &Path| {
        let reader = exr::block::read(std::io::Cursor::new(std::fs::read(path).unwrap()), false).unwrap();
        let chunks = reader.all_chunks(false).unwrap().map(|chunk| format!("{:?}", chunk.unwrap()));
        chunks.filter(|c| c.contains("layer_index: 1")).collect::<Vec<_>>()
    };
    assert!(!block(&path).is_empty());
    assert_eq!(block(&path), block(&out));
}

#[test]
fn halfs_are_clamped_and_the_file_can_be_replaced_by_its_own_output() {
    let directory = Directory::new();
    let path = directory.file("own.exr", &[Part::new("", "B:f G R")]);
    let frame = read(&path).unwrap();
    let mut color = vec![1e9; frame.color().len()];
    color[0] = -1e9;
    frame.write_with_color(&path, &color).unwrap();
    let again = read(&path).unwrap();
    assert_eq!(again.color()[..6], [-65504.0, 65504.0, 1e9, 65504.0, 65504.0, 1e9]);
    assert!(matches!(frame.write_with_color(&path, &color[1..]), Err(ExrError::ColorLength { .. })));
    let nowhere = directory.0.path().join("nowhere/out.exr");
    assert!(matches!(frame.write_with_color(nowhere, &color), Err(ExrError::Write { .. })));
    assert!(matches!(frame.write_with_color(directory.0.path(), &color), Err(ExrError::Write { .. })));
    let left: Vec<_> = std::fs::read_dir(directory.0.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(left, ["own.exr"], "no temporary file is left");
}
