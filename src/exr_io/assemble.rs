//! A file again, with new colour in its place.

use super::codec::{batch_len, encode_color};
use super::container::Container;
use super::error::ExrError;
use crate::parallel;
use exr::block::chunk::TileCoordinates;
use std::collections::HashMap;
use std::io::{Seek, SeekFrom, Write};

/// Writes the file with `color` (interleaved RGB) in the given channels of one part.
///
/// The header and all other parts are copied bit for bit, and so is the order of the blocks.
pub(super) fn assemble(
    container: &Container,
    part: usize,
    channels: &[usize],
    color: &[f32],
    out: &mut (impl Write + Seek),
) -> std::io::Result<()> {
    let header = &container.bytes[..container.header_len];
    out.write_all(header)?;
    let mut offsets = vec![0u64; container.chunks.len()];
    write_offsets(out, &offsets)?;
    let mut position = (header.len() + 8 * offsets.len()) as u64;

    let tiles: HashMap<usize, TileCoordinates> =
        container.full_size_chunks(part).into_iter().map(|(chunk, tile)| (chunk.index, tile)).collect();
    let mut order: Vec<usize> = (0..container.chunks.len()).collect();
    order.sort_by_key(|&i| container.chunks[i].prefix.start);
    for batch in order.chunks(batch_len(container, part)) {
        let encoded = parallel::map(batch, |&i| -> Result<Option<Vec<u8>>, ExrError> {
            let chunk = &container.chunks[i];
            let tile = if chunk.part == part { tiles.get(&chunk.index) } else { None };
            tile.map(|&tile| encode_color(container, chunk, tile, channels, color)).transpose()
        });
        for (&i, encoded) in batch.iter().zip(encoded) {
            let chunk = &container.chunks[i];
            let encoded = encoded.map_err(std::io::Error::other)?;
            let data = encoded.as_deref().unwrap_or(&container.bytes[chunk.data.clone()]);
            let size = i32::try_from(data.len()).map_err(std::io::Error::other)?;
            out.write_all(&container.bytes[chunk.prefix.clone()])?;
            out.write_all(&size.to_le_bytes())?;
            out.write_all(data)?;
            offsets[i] = position;
            position += (chunk.prefix.len() + 4 + data.len()) as u64;
        }
    }
    out.seek(SeekFrom::Start(header.len() as u64))?;
    write_offsets(out, &offsets)
}

fn write_offsets(out: &mut impl Write, offsets: &[u64]) -> std::io::Result<()> {
    offsets.iter().try_for_each(|offset| out.write_all(&offset.to_le_bytes()))
}
