//! Files as renderers write them (`tests/data/cases`): which pictures and features are found, with their values, and
//! what is written back.
#![cfg(feature = "exr")]

#[path = "exr_cases/names.rs"]
mod names;
#[path = "exr_cases/planes.rs"]
mod planes;
#[path = "exr_cases/views.rs"]
mod views;

use exr::prelude::{AnyChannel, AnyChannels, Encoding, FlatImage, FlatSamples, Image, WritableImage};
use std::path::{Path, PathBuf};
use vkdenoise::exr_io::{ExrError, ExrFrame, ExrOutput, FeatureSource, LayerOptions, UsedLayer};
use vkdenoise::{Plane, Samples};

fn case(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/cases").join(name).with_extension("exr")
}

fn read(path: &Path) -> ExrFrame {
    ExrFrame::read(path, &LayerOptions::default()).unwrap()
}

fn layer(name: &str) -> LayerOptions {
    LayerOptions { layer: Some(name.into()), ..LayerOptions::default() }
}

fn failure<T>(result: Result<T, ExrError>) -> String {
    result.err().expect("it should have been refused").to_string()
}

/// Colour, albedo, normal and depth in words, `-` for what is missing.
fn found(frame: &ExrFrame) -> [String; 4] {
    let s = frame.selection();
    let text = |l: &Option<UsedLayer>| l.as_ref().map_or("-".into(), ToString::to_string);
    [s.color.to_string(), text(&s.albedo), text(&s.normal), text(&s.depth)]
}

fn samples<'a>(plane: Option<Plane<'a>>) -> &'a [f32] {
    match plane.expect("there should be a plane").samples {
        Samples::F32(samples) => samples,
        Samples::F16(_) => panic!("planes of files are floats"),
    }
}

fn albedo(frame: &ExrFrame) -> &[f32] {
    samples(frame.frame().features.albedo)
}

fn normal(frame: &ExrFrame) -> &[f32] {
    samples(frame.frame().features.normal)
}

fn depth(frame: &ExrFrame) -> &[f32] {
    samples(frame.frame().features.depth)
}

/// Whether every pixel has the same samples, to the precision of halves.
fn all(plane: &[f32], pixel: &[f32]) -> bool {
    plane.chunks_exact(pixel.len()).all(|p| p.iter().zip(pixel).all(|(a, b)| (a - b).abs() < 1e-3 * b.abs().max(0.1)))
}

/// All channels of a file by their full names.
fn channels(path: &Path) -> Vec<(String, Vec<f32>)> {
    let image: FlatImage = exr::prelude::read_all_flat_layers_from_file(path).unwrap();
    let parts = image.layer_data.iter().enumerate().flat_map(|(part, layer)| {
        let list = layer.channel_data.list.iter();
        list.map(move |c| (format!("{part}:{}", c.name), c.sample_data.values_as_f32().collect()))
    });
    parts.collect()
}

/// Writes a file of float channels, `_` for spaces, with values by channel and pixel.
fn write(path: &Path, names: &str, value: impl Fn(usize, usize) -> f32) {
    let (width, height) = (16, 8);
    let channel = |(index, name): (usize, &str)| {
        let samples = (0..width * height).map(|i| value(index, i)).collect();
        AnyChannel::new(&*name.replace('_', " "), FlatSamples::F32(samples))
    };
    let list: Vec<AnyChannel<FlatSamples>> = names.split_whitespace().enumerate().map(channel).collect();
    let list = AnyChannels::sort(list.into());
    let image = Image::from_encoded_channels((width, height), Encoding::SMALL_LOSSLESS, list);
    image.write().non_parallel().to_file(path).unwrap();
}

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().unwrap()
}
