//! Files cropped to a region.

use super::rewriting::everything;
use super::*;
use exr::math::RoundingMode;
use vkdenoise::Region;

const REGION: Region = Region { x: 3, y: 6, width: 7, height: 21 };

/// Crops a file and compares every sample with those of the file it was made from.
fn check_crop(path: &Path, region: Region, tolerance: f32) {
    let frame = read(path).unwrap();
    let color: Vec<f32> = (0..frame.color().len()).map(|i| 0.25 + (i % 256) as f32 / 64.0).collect();
    let (whole, part) = (path.with_extension("whole.exr"), path.with_extension("part.exr"));
    frame.write_with_color(&whole, &color).unwrap();
    frame.write_region(&part, &color, region).unwrap();
    MetaData::read_from_file(&part, true).unwrap();
    let (whole, part) = (everything(&whole), everything(&part));
    assert_eq!(whole.attributes, part.attributes);
    assert_eq!(whole.layer_data.len(), part.layer_data.len());
    let first = whole.layer_data[0].attributes.layer_position;
    for (from, to) in whole.layer_data.iter().zip(&part.layer_data) {
        // The region in the coordinates of this part.
        let position = from.attributes.layer_position;
        let offset = [first.0 + region.x as i32 - position.0, first.1 + region.y as i32 - position.1];
        let end = [offset[0] + region.width as i32, offset[1] + region.height as i32];
        let [left, top] = offset.map(|o| o.max(0) as usize);
        let (right, bottom) = ((end[0] as usize).min(SIZE.0), (end[1] as usize).min(SIZE.1));
        assert_eq!(to.size, Vec2(right - left, bottom - top));
        let moved = LayerAttributes {
            layer_position: Vec2(position.0 + left as i32, position.1 + top as i32),
            ..from.attributes.clone()
        };
        assert_eq!((moved, from.encoding), (to.attributes.clone(), to.encoding));
        for (from, to) in from.channel_data.list.iter().zip(&to.channel_data.list) {
            let about = |channel: &AnyChannel<FlatSamples>| (channel.name.clone(), channel.quantize_linearly);
            assert_eq!(about(from), about(to));
            let samples: Vec<f32> = from.sample_data.values_as_f32().collect();
            for (i, sample) in to.sample_data.values_as_f32().enumerate() {
                let (x, y) = (left + i % (right - left), top + i / (right - left));
                let wanted = samples[y * SIZE.0 + x];
                assert!((sample - wanted).abs() <= tolerance, "{} at ({x}, {y}): {sample} for {wanted}", from.name);
            }
        }
    }
}

#[test]
fn a_region_keeps_its_samples_of_every_part() {
    let directory = Directory::new();
    let blocks = [
        (Blocks::ScanLines, LineOrder::Increasing),
        (Blocks::ScanLines, LineOrder::Decreasing),
        (Blocks::Tiles(Vec2(8, 5)), LineOrder::Increasing),
        (Blocks::Tiles(Vec2(64, 64)), LineOrder::Unspecified),
    ];
    let channels = "A albedo.B albedo.G albedo.R B:f G:f R:f id:u N.X N.Y N.Z Z:f";
    use Compression::*;
    for compression in [Uncompressed, ZIP16, PIZ, B44, DWAA(None)] {
        for (blocks, line_order) in blocks {
            let encoding = Encoding { compression, blocks, line_order };
            let other = Part { position: (1, -9), encoding, ..Part::new("other", "R G B mask:u") };
            let parts = [Part { position: (-4, -11), encoding, ..Part::new("rgba", channels) }, other];
            // A lossy codec sees other blocks of pixels than before.
            let tolerance = if compression.may_loose_data() { 0.25 } else { 0.0 };
            check_crop(&directory.file("cropped.exr", &parts), REGION, tolerance);
        }
    }
    let path = directory.file("gray.exr", &[Part::new("", "A Y Z:f")]);
    for region in [REGION, Region { x: 12, y: 36, width: 1, height: 1 }, Region { x: 0, y: 0, width: 13, height: 37 }] {
        check_crop(&path, region, 0.0);
    }
}

#[test]
fn a_part_outside_the_region_is_left_out() {
    let directory = Directory::new();
    let parts = [Part::new("rgba", "R G B A"), Part { position: (9, 0), ..Part::new("depth", "Z:f") }];
    let path = directory.file("beside.exr", &parts);
    let frame = read(&path).unwrap();
    let out = path.with_extension("out.exr");
    let parts_of = |region| {
        frame.write_region(&out, frame.color(), region).unwrap();
        everything(&out).layer_data.iter().map(|part| part.size).collect::<Vec<_>>()
    };
    assert_eq!(parts_of(Region { x: 5, y: 2, width: 4, height: 3 }), [Vec2(4, 3)]);
    assert_eq!(parts_of(Region { x: 5, y: 2, width: 6, height: 3 }), [Vec2(6, 3), Vec2(2, 3)]);
}

#[test]
fn what_cannot_be_cropped_is_refused() {
    let directory = Directory::new();
    let path = directory.file("whole.exr", &[Part::new("", "R G B")]);
    let frame = read(&path).unwrap();
    let out = path.with_extension("out.exr");
    for (x, y, width, height) in [(0, 0, 0, 1), (7, 0, 7, 1), (0, 30, 1, 8), (u32::MAX, u32::MAX, 2, 2)] {
        let region = Region { x, y, width, height };
        let refused = frame.write_region(&out, frame.color(), region).unwrap_err();
        assert!(matches!(refused, ExrError::Region { .. }), "{refused}");
        assert!(refused.to_string().contains("whole.exr") && refused.to_string().contains("13 x 37"), "{refused}");
        assert!(frame.check_region(region).is_err());
    }
    assert!(matches!(frame.write_region(&out, &[0.0], REGION), Err(ExrError::ColorLength { .. })));

    // Beside the colour a mip map, which is fine as long as the region does not meet it.
    let layer = |name: &str, left: i32, channels: &[&str], levels: Levels<FlatSamples>| {
        let list = channels.iter().map(|channel| AnyChannel::new(*channel, levels.clone())).collect();
        let encoding = Encoding { blocks: Blocks::Tiles(Vec2(8, 8)), ..Encoding::UNCOMPRESSED };
        let attributes = LayerAttributes::named(name).with_position(Vec2(left, 0));
        Layer::new((16, 16), attributes, encoding, AnyChannels::sort(list))
    };
    let level = |size: usize| FlatSamples::F32(vec![0.25; size * size]);
    let mip = Levels::Mip { rounding_mode: RoundingMode::Down, level_data: [16, 8, 4, 2, 1].map(level).into() };
    let parts = [layer("rgba", 0, &["R", "G", "B"], Levels::Singular(level(16))), layer("levels", 8, &["Z"], mip)];
    let path = directory.0.path().join("levels.exr");
    let display = ImageAttributes::new(IntegerBounds::new((0, 0), (24, 16)));
    Image::from_layers(display, parts.to_vec()).write().non_parallel().to_file(&path).unwrap();
    let frame = read(&path).unwrap();
    let refused = frame.check_region(Region { x: 3, y: 6, width: 7, height: 5 }).unwrap_err().to_string();
    assert!(refused.contains("part levels is a mip map"), "{refused}");
    frame.check_region(Region { x: 0, y: 0, width: 8, height: 5 }).unwrap();
}
