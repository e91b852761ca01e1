//! The pixels of a rectangle as a file of their own: every part and channel of the file that was read, cropped.

use super::codec::{self, NewColor, cut_out, guarded, put_colors};
use super::container::Container;
use super::error::ExrError;
use super::layers::{is_subsampled, part_name};
use super::samples::{Rectangle, copy_samples};
use crate::frame::Region;
use crate::parallel;
use exr::block::chunk::Chunk;
use exr::block::writer::ChunksWriter;
use exr::block::{BlockIndex, UncompressedBlock, enumerate_ordered_header_block_indices};
use exr::math::Vec2;
use exr::meta::attribute::IntegerBounds;
use exr::meta::header::Header;
use std::io::{Error, Seek, Write};

/// Blocks that are compressed at a time.
const BATCH: usize = 64;

/// What is left of a part.
struct Part {
    /// Its number in the file that was read.
    part: usize,
    /// Of what was the data window.
    rectangle: Rectangle,
    /// The new header.
    header: Header,
}

/// A region of the colour's data window, in the coordinates of the file.
pub(super) fn window_of(container: &Container, part: usize, region: Region) -> IntegerBounds {
    let start = container.header(part).data_window().position;
    let position = Vec2(start.x() + region.x as i32, start.y() + region.y as i32);
    IntegerBounds::new(position, Vec2(region.width as usize, region.height as usize))
}

/// Checks that every part that meets the window can be cropped.
pub(super) fn check(container: &Container, window: IntegerBounds) -> Result<(), ExrError> {
    parts(container, window).map(|_| ())
}

/// Writes the file's pixels within `window`, with new colours. Parts that do not meet the window are left out: OpenEXR
/// has no empty images.
pub(super) fn write(
    container: &Container,
    colors: &[NewColor],
    window: IntegerBounds,
    out: &mut (impl Write + Seek),
) -> std::io::Result<()> {
    let parts = parts(container, window).map_err(Error::other)?;
    let mut samples = Vec::with_capacity(parts.len());
    for part in &parts {
        let mut bytes = cut_out(container, part.part, part.rectangle).map_err(Error::other)?;
        put_colors(container.header(part.part), part.part, colors, part.rectangle, &mut bytes);
        samples.push(bytes);
    }
    let headers = parts.into_iter().map(|part| part.header).collect();
    let written = exr::block::write(out, headers, false, |meta, writer| {
        let blocks: Vec<(usize, BlockIndex)> = enumerate_ordered_header_block_indices(&meta.headers).collect();
        for batch in blocks.chunks(BATCH) {
            let chunks = parallel::map(batch, |&(at, block)| {
                compress(container, &meta.headers, at, block, &samples[block.layer])
            });
            for (&(at, _), chunk) in batch.iter().zip(chunks) {
                writer.write_chunk(at, chunk.map_err(|error| exr::error::Error::Io(Error::other(error)))?)?;
            }
        }
        Ok(())
    });
    written.map_err(|error| match error {
        exr::error::Error::Io(error) => error,
        error => Error::other(error),
    })
}

fn parts(container: &Container, window: IntegerBounds) -> Result<Vec<Part>, ExrError> {
    let mut found = Vec::new();
    for (part, header) in container.meta.headers.iter().enumerate() {
        let Some((bounds, rectangle)) = overlap(header.data_window(), window) else { continue };
        let name = part_name(container, part).map_or("it".into(), |name| format!("part {name}"));
        let refuse = |what| Err(ExrError::unsupported(&container.path, format!("{name} {what} and cannot be cropped")));
        if container.has_levels(part) {
            return refuse("is a mip map");
        }
        if header.channels.list.iter().any(is_subsampled) {
            return refuse("has subsampled channels");
        }
        codec::check_size(container, part)?;
        let mut header = header.clone();
        header.layer_size = bounds.size;
        header.own_attributes.layer_position = bounds.position;
        let (compression, blocks, order) = (header.compression, header.blocks, header.line_order);
        found.push(Part { part, rectangle, header: header.with_encoding(compression, blocks, order) });
    }
    Ok(found)
}

/// What both cover, in the coordinates of the file and in those of the first.
fn overlap(of: IntegerBounds, window: IntegerBounds) -> Option<(IntegerBounds, Rectangle)> {
    let axis = |start: i32, size: usize, other: i32, other_size: usize| {
        let (start, other) = (i64::from(start), i64::from(other));
        let first = start.max(other);
        let end = (start + size as i64).min(other + other_size as i64);
        (first < end).then_some((first as i32, (first - start) as usize, (end - first) as usize))
    };
    let (left, x, width) = axis(of.position.x(), of.size.x(), window.position.x(), window.size.x())?;
    let (top, y, height) = axis(of.position.y(), of.size.y(), window.position.y(), window.size.y())?;
    Some((IntegerBounds::new(Vec2(left, top), Vec2(width, height)), Rectangle { x, y, width, height }))
}

/// One block of the new file; `samples` are those of its whole part.
fn compress(
    container: &Container,
    headers: &[Header],
    at: usize,
    block: BlockIndex,
    samples: &[u8],
) -> Result<Chunk, ExrError> {
    let header = &headers[block.layer];
    let whole = Rectangle { x: 0, y: 0, width: header.layer_size.x(), height: header.layer_size.y() };
    let (position, size) = (block.pixel_position, block.pixel_size);
    let rectangle = Rectangle { x: position.x(), y: position.y(), width: size.x(), height: size.y() };
    let mut data = vec![0; size.area() * header.channels.bytes_per_pixel];
    copy_samples(header, (whole, samples), (rectangle, &mut data));
    guarded(container, at, || UncompressedBlock { index: block, data }.compress_to_chunk(headers))
}
