//! Small sound files for the loaders, to be damaged by tests and fuzzers.

use exr::image::Blocks;
use exr::prelude::*;
use vkdenoise::net::{Arch, Block, Convolution, DepthRule, ExposureRule, Graph, Preprocessing};

/// The Hybrid with 16 channels and one stage.
pub fn one_stage() -> Arch {
    let mut arch = Arch::hybrid();
    arch.channels = 16;
    arch.stages.truncate(1);
    arch
}

/// A weights file, without the safetensors crate's help: a header of every tensor, and zeros.
pub fn weights(arch: &Arch) -> Vec<u8> {
    let preprocessing =
        Preprocessing { exposure: ExposureRule::Auto, depth: DepthRule::Percentile, version: Preprocessing::VERSION };
    let (mut header, mut at) = (serde_json::Map::new(), 0);
    for spec in Graph::new(arch).unwrap().tensors() {
        let end = at + 4 * spec.elements();
        let entry = serde_json::json!({ "dtype": "F32", "shape": spec.shape, "data_offsets": [at, end] });
        header.insert(spec.name, entry);
        at = end;
    }
    let metadata = serde_json::json!({
        "format": "vkdenoise-1",
        "architecture": serde_json::to_string(arch).unwrap(),
        "preprocessing": serde_json::to_string(&preprocessing).unwrap(),
    });
    header.insert("__metadata__".into(), metadata);
    let header = serde_json::to_vec(&header).unwrap();
    let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
    bytes.extend(header);
    bytes.resize(bytes.len() + at as usize, 0);
    bytes
}

/// An EXR file of two parts: halves, floats and integers.
pub fn exr(compression: Compression, blocks: Blocks) -> Vec<u8> {
    let size = Vec2(40, 23);
    let samples = |i: usize| FlatSamples::F32((0..40 * 23).map(|p| (p * (i + 3) % 17) as f32 / 8.0).collect());
    let layer = |name: &str, channels: &[&str], compression| {
        let list = channels.iter().enumerate().map(|(i, c)| match *c {
            "id" => AnyChannel::new(*c, FlatSamples::U32(vec![7; 40 * 23])),
            "A" => AnyChannel::new(*c, FlatSamples::F16(vec![f16::ONE; 40 * 23])),
            c => AnyChannel::new(c, samples(i)),
        });
        let encoding = Encoding { compression, blocks, line_order: LineOrder::Increasing };
        Layer::new(size, LayerAttributes::named(name), encoding, AnyChannels::sort(list.collect()))
    };
    let layers =
        vec![layer("rgba", &["R", "G", "B", "A", "id"], compression), layer("N", &["X", "Y", "Z"], Compression::PIZ)];
    let image = Image::from_layers(ImageAttributes::new(IntegerBounds::from_dimensions(size)), layers);
    let mut bytes = std::io::Cursor::new(Vec::new());
    image.write().non_parallel().to_buffered(&mut bytes).unwrap();
    bytes.into_inner()
}

/// Weights of networks with every kind of block, by name.
pub fn all_weights() -> Vec<(String, Vec<u8>)> {
    let smallest = |stage| {
        let mut arch = one_stage();
        arch.channels = 8;
        arch.stages[0].block = stage;
        arch.bottleneck.block = Block::ShJsa { ratio: 0.5 };
        arch
    };
    let named = |name: &str, arch: &Arch| (name.to_owned(), weights(arch));
    vec![
        named("dense", &smallest(Block::FilmCnn { conv: Convolution::Standard })),
        named("separable", &smallest(Block::FilmCnn { conv: Convolution::Separable })),
        named("attention", &smallest(Block::Jsa)),
    ]
}

/// EXR files of every compression and arrangement of blocks that can be written, by number.
pub fn all_exr() -> Vec<(String, Vec<u8>)> {
    let compressions = [
        Compression::Uncompressed,
        Compression::RLE,
        Compression::ZIP1,
        Compression::ZIP16,
        Compression::PIZ,
        Compression::PXR24,
        Compression::B44,
        Compression::B44A,
    ];
    let blocks = [Blocks::ScanLines, Blocks::Tiles(Vec2(16, 8))];
    let all = compressions.iter().flat_map(|c| blocks.map(|b| (*c, b)));
    all.enumerate().map(|(i, (c, b))| (format!("{i:02}.exr"), exr(c, b))).collect()
}
