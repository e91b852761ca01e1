//! Samples out of compressed blocks, and colour back into them.

use super::container::{Chunk, Container};
use super::error::ExrError;
use crate::parallel;
use exr::block::chunk::TileCoordinates;
use exr::math::Vec2;
use exr::meta::attribute::{ChannelDescription, ChannelList, Compression, SampleType};
use exr::meta::header::Header;
use half::f16;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// The most pixels that a data window may have: 16384 x 16384.
pub const MAX_PIXELS: u64 = 1 << 28;

/// Uncompressed bytes that are worked on at a time; bounds the memory beside the planes.
const BATCH_BYTES: usize = 32 << 20;

/// The most that each byte of a file can stand for. Deflate reaches 1032; PXR24 adds a third to that; DWA deflates what
/// it has already shortened.
fn largest_ratio(compression: Compression) -> u64 {
    match compression {
        Compression::Uncompressed => 1,
        Compression::DWAA(_) | Compression::DWAB(_) => 140_000,
        _ => 1500,
    }
}

/// A rectangle of pixels; a block's lies within its data window.
#[derive(Clone, Copy)]
pub(super) struct Rectangle {
    pub x: usize,
    pub y: usize,
    pub width: usize,
    pub height: usize,
}

impl Rectangle {
    /// What both cover, if anything.
    fn overlap(self, other: Self) -> Option<Self> {
        let (x, y) = (self.x.max(other.x), self.y.max(other.y));
        let right = (self.x + self.width).min(other.x + other.width);
        let bottom = (self.y + self.height).min(other.y + other.height);
        (x < right && y < bottom).then(|| Self { x, y, width: right - x, height: bottom - y })
    }
}

/// Checks a part's size against the limits before memory is allocated for its pixels.
pub(super) fn check_size(container: &Container, part: usize) -> Result<(), ExrError> {
    let header = container.header(part);
    let (width, height) = (header.layer_size.x() as u64, header.layer_size.y() as u64);
    let too_large = |reason| Err(ExrError::TooLarge { path: container.path.clone(), width, height, reason });
    let pixels = width.saturating_mul(height);
    if pixels > MAX_PIXELS {
        return too_large(format!("more than the limit of {MAX_PIXELS} pixels"));
    }
    let declared = pixels.saturating_mul(header.channels.bytes_per_pixel as u64);
    let stored: u64 = container.full_size_chunks(part).iter().map(|(c, _)| c.data.len() as u64).sum();
    if declared > stored.saturating_mul(largest_ratio(header.compression)) {
        return too_large(format!("more than its {stored} bytes of pixel data can hold"));
    }
    Ok(())
}

/// Decodes several planes of one part: for each, the given channels interleaved as f32.
/// The caller has called [`check_size`], and the part has no subsampled channels.
pub(super) fn decode_planes(
    container: &Container,
    part: usize,
    planes: &[&[usize]],
) -> Result<Vec<Vec<f32>>, ExrError> {
    let header = container.header(part);
    let (width, height) = (header.layer_size.x(), header.layer_size.y());
    let mut out: Vec<Vec<f32>> = planes.iter().map(|p| vec![0.0; width * height * p.len()]).collect();
    let places = channel_places(&header.channels);
    let chunks = container.full_size_chunks(part);
    for batch in chunks.chunks(batch_len(container, part)) {
        let decoded = parallel::map(batch, |(chunk, tile)| decompress(container, chunk, *tile));
        for block in decoded {
            let (rectangle, bytes) = block?;
            for (channels, plane) in planes.iter().zip(&mut out) {
                for (component, &channel) in channels.iter().enumerate() {
                    let (start, sample_type) = places[channel];
                    for row in 0..rectangle.height {
                        let line = line_of(&bytes, rectangle, row, start, header.channels.bytes_per_pixel, sample_type);
                        let first = ((rectangle.y + row) * width + rectangle.x) * channels.len() + component;
                        read_line(line, sample_type, &mut plane[first..], channels.len());
                    }
                }
            }
        }
    }
    Ok(out)
}

/// How many blocks of a part to work on at a time.
pub(super) fn batch_len(container: &Container, part: usize) -> usize {
    let header = container.header(part);
    let (block, size) = (header.max_block_pixel_size(), header.layer_size);
    let pixels = block.x().min(size.x()) * block.y().min(size.y());
    (BATCH_BYTES / (pixels * header.channels.bytes_per_pixel).max(1)).clamp(parallel::workers(), 4096)
}

/// Compresses one block of the colour's part anew, with `color` (interleaved RGB of the whole data window) in its
/// colour channels. Where the three are one grey channel, it takes their mean. Halfs are clamped to their range.
pub(super) fn encode_color(
    container: &Container,
    chunk: &Chunk,
    tile: TileCoordinates,
    channels: &[usize],
    color: &[f32],
) -> Result<Vec<u8>, ExrError> {
    let header = container.header(chunk.part);
    let (rectangle, mut bytes) = decompress(container, chunk, tile)?;
    put_color(header, channels, color, rectangle, &mut bytes);
    guarded(container, chunk.index, || {
        let window = header.get_absolute_block_pixel_coordinates(tile)?;
        header.compression.compress_image_section_to_le(header, bytes, window)
    })
}

/// Writes `color` (interleaved RGB of the whole data window) into the colour channels of the samples of a rectangle.
pub(super) fn put_color(header: &Header, channels: &[usize], color: &[f32], rectangle: Rectangle, bytes: &mut [u8]) {
    let places = channel_places(&header.channels);
    let gray = channels.iter().all(|c| *c == channels[0]);
    let components = if gray { 1 } else { channels.len() };
    for (component, &channel) in channels.iter().enumerate().take(components) {
        let (start, sample_type) = places[channel];
        for row in 0..rectangle.height {
            let range = line_range(rectangle, row, start, header.channels.bytes_per_pixel, sample_type);
            let first = 3 * ((rectangle.y + row) * header.layer_size.x() + rectangle.x);
            let pixels = color[first..first + 3 * rectangle.width].chunks_exact(3);
            let values = pixels.map(|p| if gray { (p[0] + p[1] + p[2]) / 3.0 } else { p[component] });
            write_line(&mut bytes[range], sample_type, values);
        }
    }
}

/// The samples of a rectangle of a part, all channels, in the order of a block. The caller has called [`check_size`], and
/// the part has no subsampled channels.
pub(super) fn cut_out(container: &Container, part: usize, rectangle: Rectangle) -> Result<Vec<u8>, ExrError> {
    let header = container.header(part);
    let mut out = vec![0; rectangle.width * rectangle.height * header.channels.bytes_per_pixel];
    let mut chunks = container.full_size_chunks(part);
    chunks.retain(|(_, tile)| {
        let (block, at) = (header.max_block_pixel_size(), tile.tile_index);
        let (x, y) = (at.x() * block.x(), at.y() * block.y());
        rectangle.overlap(Rectangle { x, y, width: block.x(), height: block.y() }).is_some()
    });
    for batch in chunks.chunks(batch_len(container, part)) {
        for block in parallel::map(batch, |(chunk, tile)| decompress(container, chunk, *tile)) {
            let (from, bytes) = block?;
            copy_samples(&header.channels, (from, &bytes), (rectangle, &mut out));
        }
    }
    Ok(out)
}

/// Copies what two rectangles of samples have in common from one to the other.
pub(super) fn copy_samples(
    channels: &ChannelList,
    (from, source): (Rectangle, &[u8]),
    (to, target): (Rectangle, &mut [u8]),
) {
    let Some(both) = from.overlap(to) else { return };
    for (start, sample_type) in channel_places(channels) {
        let size = sample_type.bytes_per_sample();
        for y in both.y..both.y + both.height {
            let range = |of: Rectangle| {
                let line = line_range(of, y - of.y, start, channels.bytes_per_pixel, sample_type);
                let first = line.start + (both.x - of.x) * size;
                first..first + both.width * size
            };
            target[range(to)].copy_from_slice(&source[range(from)]);
        }
    }
}

fn decompress(container: &Container, chunk: &Chunk, tile: TileCoordinates) -> Result<(Rectangle, Vec<u8>), ExrError> {
    container.check_place(chunk, tile)?;
    let header = container.header(chunk.part);
    guarded(container, chunk.index, || {
        let window = header.get_absolute_block_pixel_coordinates(tile)?;
        let position = window.position.to_usize("block position")?;
        let size = window.size;
        let rectangle = Rectangle { x: position.x(), y: position.y(), width: size.x(), height: size.y() };
        let data = container.bytes[chunk.data.clone()].to_vec();
        check_dwa_sizes(header, &data, size)?;
        Ok((rectangle, header.compression.decompress_image_section_from_le(header, data, window, false)?))
    })
}

/// A DWA block begins with the sizes of its sections, which the decoder allocates without asking.
fn check_dwa_sizes(header: &Header, data: &[u8], size: Vec2<usize>) -> exr::error::Result<()> {
    let dwa = matches!(header.compression, Compression::DWAA(_) | Compression::DWAB(_));
    let stored_raw = data.len() == size.area() * header.channels.bytes_per_pixel;
    if !dwa || stored_raw {
        return Ok(());
    }
    // Eleven counters; those of what is allocated: unknown bytes, RLE bytes twice, AC and DC coefficients. None can
    // be more than the samples of the block, padded to 8 x 8 pixels, with room for what RLE adds.
    let pixels = size.x().next_multiple_of(8) * size.y().next_multiple_of(8);
    let limit = 2 * (pixels * header.channels.bytes_per_pixel) as u64;
    let counters = data.chunks_exact(8).take(11);
    let counters = counters.map(|b| u64::from_le_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]]));
    if counters.enumerate().any(|(i, n)| [1, 6, 7, 8, 9].contains(&i) && n > limit) {
        return Err(exr::error::Error::Invalid("it declares impossible sizes".into()));
    }
    Ok(())
}

/// Runs the codec on one block. It is another's code on unchecked bytes: a panic in it is a damaged file.
pub(super) fn guarded<R>(
    container: &Container,
    block: usize,
    work: impl FnOnce() -> exr::error::Result<R>,
) -> Result<R, ExrError> {
    match catch_unwind(AssertUnwindSafe(work)) {
        Ok(Ok(value)) => Ok(value),
        Ok(Err(exr::error::Error::NotSupported(reason))) => {
            Err(ExrError::unsupported(&container.path, format!("{reason}; write it with ZIP or PIZ")))
        }
        Ok(Err(error)) => Err(ExrError::damaged(&container.path, format!("block {block}: {error}"))),
        Err(_) => Err(ExrError::damaged(&container.path, format!("block {block} cannot be decoded"))),
    }
}

/// For each channel, the bytes of the channels before it in a pixel, and its type.
fn channel_places(channels: &ChannelList) -> Vec<(usize, SampleType)> {
    let mut start = 0;
    let place = |channel: &ChannelDescription| {
        let place = (start, channel.sample_type);
        start += channel.sample_type.bytes_per_sample();
        place
    };
    channels.list.iter().map(place).collect()
}

/// A block holds its rows one after another, and each row its channels one after another.
fn line_range(
    rectangle: Rectangle,
    row: usize,
    start: usize,
    pixel_bytes: usize,
    sample_type: SampleType,
) -> std::ops::Range<usize> {
    let first = rectangle.width * (row * pixel_bytes + start);
    first..first + rectangle.width * sample_type.bytes_per_sample()
}

fn line_of(
    bytes: &[u8],
    rectangle: Rectangle,
    row: usize,
    start: usize,
    pixel_bytes: usize,
    sample_type: SampleType,
) -> &[u8] {
    &bytes[line_range(rectangle, row, start, pixel_bytes, sample_type)]
}

fn read_line(line: &[u8], sample_type: SampleType, out: &mut [f32], step: usize) {
    let out = out.iter_mut().step_by(step);
    match sample_type {
        SampleType::F16 => {
            for (value, b) in out.zip(line.chunks_exact(2)) {
                *value = f16::from_ne_bytes([b[0], b[1]]).to_f32();
            }
        }
        SampleType::F32 => {
            for (value, b) in out.zip(line.chunks_exact(4)) {
                *value = f32::from_ne_bytes([b[0], b[1], b[2], b[3]]);
            }
        }
        // Integer channels are never chosen for a plane.
        SampleType::U32 => {}
    }
}

fn write_line(line: &mut [u8], sample_type: SampleType, values: impl Iterator<Item = f32>) {
    let largest = f16::MAX.to_f32();
    match sample_type {
        SampleType::F16 => {
            for (b, value) in line.chunks_exact_mut(2).zip(values) {
                b.copy_from_slice(&f16::from_f32(value.clamp(-largest, largest)).to_ne_bytes());
            }
        }
        SampleType::F32 => {
            for (b, value) in line.chunks_exact_mut(4).zip(values) {
                b.copy_from_slice(&value.to_ne_bytes());
            }
        }
        // Integer channels are never chosen for the colour.
        SampleType::U32 => {}
    }
}
