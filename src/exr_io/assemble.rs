//! A file again, with new colour in its place.

use super::codec::{NewColor, batch_len, encode_colors};
use super::container::Container;
use super::error::ExrError;
use crate::parallel;
use exr::block::chunk::TileCoordinates;
use std::collections::HashMap;
use std::io::{Seek, SeekFrom, Write};

/// Writes the file with new colours.
///
/// The header and all parts without any are copied bit for bit, and so is the order of the blocks.
pub(super) fn assemble(
    container: &Container,
    colors: &[NewColor],
    out: &mut (impl Write + Seek),
) -> std::io::Result<()> {
    let header = &container.bytes[..container.header_len];
    out.write_all(header)?;
    let mut offsets = vec![0u64; container.chunks.len()];
    write_offsets(out, &offsets)?;
    let mut position = (header.len() + 8 * offsets.len()) as u64;

    let colored: Vec<usize> =
        (0..container.meta.headers.len()).filter(|&part| colors.iter().any(|color| color.is_in(part))).collect();
    let tiles: HashMap<(usize, usize), TileCoordinates> = colored
        .iter()
        .flat_map(|&part| container.full_size_chunks(part))
        .map(|(chunk, tile)| ((chunk.part, chunk.index), tile))
        .collect();
    let batch = colored.iter().map(|&part| batch_len(container, part)).min().unwrap_or(1);
    let mut order: Vec<usize> = (0..container.chunks.len()).collect();
    order.sort_by_key(|&i| container.chunks[i].prefix.start);
    for batch in order.chunks(batch) {
        let encoded = parallel::map(batch, |&i| -> Result<Option<Vec<u8>>, ExrError> {
            let chunk = &container.chunks[i];
            let tile = tiles.get(&(chunk.part, chunk.index));
            tile.map(|&tile| encode_colors(container, chunk, tile, colors)).transpose()
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
