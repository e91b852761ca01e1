//! Samples out of compressed blocks, and colour back into them.

use super::coding::Coding;
use super::container::{Chunk, Container};
use super::error::ExrError;
use super::layers::{Place, is_subsampled, text};
use super::samples::{Block, Rectangle, copy_samples, declared_bytes, read_line, write_line};
use crate::parallel;
use exr::block::chunk::TileCoordinates;
use exr::math::Vec2;
use exr::meta::BlockDescription;
use exr::meta::attribute::{ChannelDescription, Compression, IntegerBounds, SampleType, Text};
use exr::meta::header::Header;
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

/// New colours for the channels of a picture.
pub(super) struct NewColor<'a> {
    pub channels: &'a [Place],
    pub coding: Coding,
    /// Interleaved RGB of the whole data window.
    pub color: &'a [f32],
}

impl NewColor<'_> {
    /// Whether it has channels in a part.
    pub fn is_in(&self, part: usize) -> bool {
        self.channels.iter().any(|place| place.part == part)
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
    let declared = declared_bytes(header);
    let stored: u64 = container.full_size_chunks(part).iter().map(|(c, _)| c.data.len() as u64).sum();
    if declared > stored.saturating_mul(largest_ratio(header.compression)) {
        return too_large(format!("more than its {stored} bytes of pixel data can hold"));
    }
    check_sampling(container, part)
}

/// Decodes several planes: for each, the given channels interleaved as f32, those of each part at once.
/// The caller has called [`check_size`] for the parts, which have one data window.
pub(super) fn decode_planes(container: &Container, planes: &[&[Place]]) -> Result<Vec<Vec<f32>>, ExrError> {
    let mut parts: Vec<usize> = planes.iter().flat_map(|plane| plane.iter().map(|place| place.part)).collect();
    parts.sort_unstable();
    parts.dedup();
    let pixels = parts.first().map_or(0, |&part| container.header(part).layer_size.area());
    let mut out: Vec<Vec<f32>> = planes.iter().map(|channels| vec![0.0; pixels * channels.len()]).collect();
    for part in parts {
        decode_part(container, part, planes, &mut out)?;
    }
    Ok(out)
}

fn decode_part(container: &Container, part: usize, planes: &[&[Place]], out: &mut [Vec<f32>]) -> Result<(), ExrError> {
    let header = container.header(part);
    let width = header.layer_size.x();
    let chunks = container.full_size_chunks(part);
    for batch in chunks.chunks(batch_len(container, part)) {
        let decoded = parallel::map(batch, |(chunk, tile)| decompress(container, chunk, *tile));
        for decoded in decoded {
            let (rectangle, bytes) = decoded?;
            let block = Block::new(header, rectangle);
            for (channels, plane) in planes.iter().zip(&mut *out) {
                for (component, place) in channels.iter().enumerate().filter(|(_, place)| place.part == part) {
                    let sample_type = header.channels.list[place.channel].sample_type;
                    for row in 0..rectangle.height {
                        let line = &bytes[block.line(row, place.channel)];
                        let first = ((rectangle.y + row) * width + rectangle.x) * channels.len() + component;
                        read_line(line, sample_type, &mut plane[first..], channels.len());
                    }
                }
            }
        }
    }
    Ok(())
}

/// How many blocks of a part to work on at a time.
pub(super) fn batch_len(container: &Container, part: usize) -> usize {
    let header = container.header(part);
    let (block, size) = (header.max_block_pixel_size(), header.layer_size);
    let pixels = block.x().min(size.x()) * block.y().min(size.y());
    (BATCH_BYTES / (pixels * header.channels.bytes_per_pixel).max(1)).clamp(parallel::workers(), 4096)
}

/// Compresses one block anew, with new colours in their channels.
pub(super) fn encode_colors(
    container: &Container,
    chunk: &Chunk,
    tile: TileCoordinates,
    colors: &[NewColor],
) -> Result<Vec<u8>, ExrError> {
    let header = container.header(chunk.part);
    let (rectangle, mut bytes) = decompress(container, chunk, tile)?;
    put_colors(header, chunk.part, colors, rectangle, &mut bytes);
    if let Some((flat, window)) = flat_header(header, bytes.len()) {
        return guarded(container, chunk.index, || {
            header.compression.compress_image_section_to_le(&flat, bytes, window)
        });
    }
    guarded(container, chunk.index, || {
        let window = header.get_absolute_block_pixel_coordinates(tile)?;
        header.compression.compress_image_section_to_le(header, bytes, window)
    })
}

/// Writes new colours into the samples of a rectangle of a part.
pub(super) fn put_colors(header: &Header, part: usize, colors: &[NewColor], rectangle: Rectangle, bytes: &mut [u8]) {
    let block = Block::new(header, rectangle);
    for NewColor { channels, coding, color } in colors {
        for (component, place) in channels.iter().enumerate().filter(|(_, place)| place.part == part) {
            let sample_type = header.channels.list[place.channel].sample_type;
            for row in 0..rectangle.height {
                let first = 3 * ((rectangle.y + row) * header.layer_size.x() + rectangle.x);
                let pixels = color[first..first + 3 * rectangle.width].chunks_exact(3);
                let values = pixels.map(|p| coding.samples([p[0], p[1], p[2]])[component]);
                write_line(&mut bytes[block.line(row, place.channel)], sample_type, values);
            }
        }
    }
}

/// The samples of a rectangle of a part, all channels, in the order of a block. The caller has called [`check_size`],
/// and the part has no subsampled channels.
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
            copy_samples(header, (from, &bytes), (rectangle, &mut out));
        }
    }
    Ok(out)
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
        if let Some((flat, window)) = flat_header(header, Block::new(header, rectangle).bytes()) {
            return Ok((rectangle, header.compression.decompress_image_section_from_le(&flat, data, window, false)?));
        }
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

/// For a part with subsampled channels, which the codec does not know: as many bytes as one line of halves. The codecs
/// of such parts ([`check_sampling`]) see bytes alone (on machines that store numbers as the file does, low byte
/// first).
fn flat_header(header: &Header, bytes: usize) -> Option<(Header, IntegerBounds)> {
    header.channels.list.iter().any(is_subsampled).then_some(())?;
    let size = Vec2(bytes / SampleType::F16.bytes_per_sample(), 1);
    let channel = ChannelDescription::new(Text::from("Y"), SampleType::F16, false);
    let flat = Header::new(Text::from(""), size, std::iter::once(channel).collect());
    let (compression, order) = (header.compression, header.line_order);
    let flat = flat.with_encoding(compression, BlockDescription::ScanLines, order);
    Some((flat, IntegerBounds::new(Vec2(0, 0), size)))
}

/// Checks that a part with subsampled channels can be read: by codecs that do not look at what the bytes are.
fn check_sampling(container: &Container, part: usize) -> Result<(), ExrError> {
    let header = container.header(part);
    let Some(channel) = header.channels.list.iter().find(|channel| is_subsampled(channel)) else { return Ok(()) };
    let plain = matches!(
        header.compression,
        Compression::Uncompressed | Compression::RLE | Compression::ZIP1 | Compression::ZIP16
    );
    if plain && cfg!(target_endian = "little") {
        return Ok(());
    }
    let (name, compression) = (text(&channel.name), header.compression);
    let reason = format!("its subsampled channel {name} cannot be read with {compression}; write it with ZIP");
    Err(ExrError::unsupported(&container.path, reason))
}
