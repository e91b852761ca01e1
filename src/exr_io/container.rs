//! The file as a container: headers, and where each compressed block of pixels (a chunk) lies.
//!
//! The bytes of the file are kept as they are, so that what the denoiser does not touch (header, other parts, block
//! order) is written back bit for bit. Everything declared is checked against the file's real size before any memory
//! is allocated for it.

use super::error::ExrError;
use exr::block::chunk::TileCoordinates;
use exr::math::Vec2;
use exr::meta::attribute::LevelMode;
use exr::meta::header::Header;
use exr::meta::{BlockDescription, MetaData};
use std::fs::File;
use std::io::Read;
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

/// An OpenEXR file in memory, its pixels still compressed.
pub(super) struct Container {
    pub path: PathBuf,
    pub bytes: Vec<u8>,
    pub meta: MetaData,
    /// Length of everything before the offset tables.
    pub header_len: usize,
    /// All chunks, part by part, in the order of the offset tables.
    pub chunks: Vec<Chunk>,
    /// For each part, its range in `chunks`.
    pub parts: Vec<Range<usize>>,
}

/// One compressed block of pixels.
pub(super) struct Chunk {
    pub part: usize,
    /// Which block of its part: position in the part's offset table.
    pub index: usize,
    /// Bytes before the size field: part number and coordinates.
    pub prefix: Range<usize>,
    /// The compressed pixels.
    pub data: Range<usize>,
}

impl Container {
    /// Reads a whole file and finds its chunks. No pixel is decoded.
    pub fn open(path: &Path) -> Result<Self, ExrError> {
        let bytes = read_exr(path).map_err(|source| ExrError::Read { path: path.into(), source })?;
        let bytes = bytes.ok_or_else(|| ExrError::NotExr { path: path.into() })?;
        let (meta, header_len) = read_headers(path, &bytes)?;
        check_headers(path, &meta)?;
        let (chunks, parts) = find_chunks(path, &bytes, &meta, header_len)?;
        Ok(Self { path: path.into(), bytes, meta, header_len, chunks, parts })
    }

    pub fn header(&self, part: usize) -> &Header {
        &self.meta.headers[part]
    }

    /// Whether the part holds smaller copies of the image beside the full one (a mip or rip map).
    pub fn has_levels(&self, part: usize) -> bool {
        matches!(self.header(part).blocks, BlockDescription::Tiles(t) if t.level_mode != LevelMode::Singular)
    }

    /// The part's chunks of full resolution, with the tile coordinates that each must have.
    /// The offset table lists them first, row by row.
    pub fn full_size_chunks(&self, part: usize) -> Vec<(&Chunk, TileCoordinates)> {
        let header = self.header(part);
        let (columns, rows) = grid(header);
        let chunks = &self.chunks[self.parts[part].clone()];
        let full = chunks.iter().take(columns.saturating_mul(rows));
        full.map(|chunk| {
            let tile_index = Vec2(chunk.index % columns, chunk.index / columns);
            (chunk, TileCoordinates { tile_index, level_index: Vec2(0, 0) })
        })
        .collect()
    }

    /// Checks that a chunk says of itself that it lies where the offset table says.
    pub fn check_place(&self, chunk: &Chunk, tile: TileCoordinates) -> Result<(), ExrError> {
        let header = self.header(chunk.part);
        let coordinates = &self.bytes[chunk.prefix.clone()];
        let at = |i: usize| coordinates.len().checked_sub(4 * i).and_then(|start| read_i32(coordinates, start));
        let (x, y) = (tile.tile_index.x() as i64, tile.tile_index.y() as i64);
        let fits = match header.blocks {
            BlockDescription::ScanLines => {
                let lines = header.compression.scan_lines_per_block() as i64;
                at(1).map(i64::from) == Some(i64::from(header.own_attributes.layer_position.y()) + y * lines)
            }
            BlockDescription::Tiles(_) => {
                [at(4), at(3), at(2), at(1)].map(|v| v.map(i64::from)) == [Some(x), Some(y), Some(0), Some(0)]
            }
        };
        if fits {
            return Ok(());
        }
        Err(ExrError::damaged(&self.path, format!("block {} lies where another belongs", chunk.index)))
    }
}

/// All of a file, or `None` where its first bytes are no EXR file's: what never ends, as some devices, is not read on.
fn read_exr(path: &Path) -> std::io::Result<Option<Vec<u8>>> {
    let mut file = File::open(path)?;
    let mut bytes = Vec::new();
    file.by_ref().take(8).read_to_end(&mut bytes)?;
    if bytes.len() < 8 || !bytes.starts_with(&exr::meta::magic_number::BYTES) {
        return Ok(None);
    }
    file.read_to_end(&mut bytes)?;
    Ok(Some(bytes))
}

/// Columns and rows of blocks of the full-resolution image.
fn grid(header: &Header) -> (usize, usize) {
    let block = header.max_block_pixel_size();
    let count = |size: usize, block: usize| size.div_ceil(block.max(1));
    (count(header.layer_size.x(), block.x()), count(header.layer_size.y(), block.y()))
}

/// Counts what the header parser consumes: it does not say where the headers end.
struct Counted<'a> {
    rest: &'a [u8],
    taken: usize,
}

impl Read for Counted<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let count = self.rest.read(buffer)?;
        self.taken += count;
        Ok(count)
    }
}

fn read_headers(path: &Path, bytes: &[u8]) -> Result<(MetaData, usize), ExrError> {
    let mut counted = Counted { rest: bytes, taken: 0 };
    // The parser is another's code on unchecked bytes: should it panic, that is a damaged file, not our caller's end.
    let parsed = catch_unwind(AssertUnwindSafe(|| MetaData::read_from_buffered(&mut counted, false)));
    match parsed {
        Ok(Ok(meta)) => Ok((meta, counted.taken)),
        Ok(Err(exr::error::Error::Invalid(reason))) if reason.contains("compression attribute") => {
            Err(ExrError::unsupported(path, "its compression is not known; write it with ZIP or PIZ"))
        }
        Ok(Err(_)) if counted.rest.is_empty() => Err(ExrError::incomplete(path, "it ends within its header")),
        Ok(Err(error)) => Err(ExrError::decoder(path, error)),
        Err(_) => Err(ExrError::damaged(path, "its header cannot be parsed")),
    }
}

fn check_headers(path: &Path, meta: &MetaData) -> Result<(), ExrError> {
    if meta.headers.is_empty() {
        return Err(ExrError::damaged(path, "it has no image"));
    }
    if meta.requirements.has_deep_data || meta.headers.iter().any(|h| h.deep) {
        return Err(ExrError::unsupported(path, "it holds deep data; flatten it first"));
    }
    for header in &meta.headers {
        header.data_window().validate(None).map_err(|e| ExrError::decoder(path, e))?;
        if header.layer_size.x() == 0 || header.layer_size.y() == 0 {
            return Err(ExrError::damaged(path, "its data window is empty"));
        }
        if header.channels.list.is_empty() {
            return Err(ExrError::damaged(path, "an image has no channels"));
        }
    }
    Ok(())
}

type Chunks = (Vec<Chunk>, Vec<Range<usize>>);

fn find_chunks(path: &Path, bytes: &[u8], meta: &MetaData, header_len: usize) -> Result<Chunks, ExrError> {
    // Every chunk has 8 bytes in the offset table and at least 8 of its own, so the file's size bounds their number.
    let room = bytes.len().saturating_sub(header_len) / 16;
    let total = meta.headers.iter().try_fold(0usize, |sum, h| sum.checked_add(h.chunk_count));
    let total = match total {
        Some(total) if total <= room => total,
        _ => {
            let size = meta.headers.iter().map(|h| h.layer_size).max_by_key(|s| s.x() * s.y());
            let (width, height) = size.map_or((0, 0), |s| (s.x(), s.y()));
            let reason = format!("{width} x {height} pixels do not fit a file of {} bytes", bytes.len());
            return Err(ExrError::incomplete(path, reason));
        }
    };
    let first_chunk = header_len + 8 * total;
    let mut chunks = Vec::with_capacity(total);
    let mut parts = Vec::with_capacity(meta.headers.len());
    for (part, header) in meta.headers.iter().enumerate() {
        let start = chunks.len();
        for index in 0..header.chunk_count {
            let offset = read_u64(bytes, header_len + 8 * chunks.len()).unwrap_or(0);
            let offset = usize::try_from(offset).unwrap_or(usize::MAX);
            if offset == 0 {
                return Err(ExrError::incomplete(path, format!("block {index} was never written")));
            }
            if offset < first_chunk {
                return Err(ExrError::damaged(path, format!("block {index} lies within the header")));
            }
            chunks.push(frame_chunk(path, bytes, meta, part, index, offset)?);
        }
        parts.push(start..chunks.len());
    }
    Ok((chunks, parts))
}

/// Finds the borders of the chunk that begins at `offset`.
fn frame_chunk(
    path: &Path,
    bytes: &[u8],
    meta: &MetaData,
    part: usize,
    index: usize,
    offset: usize,
) -> Result<Chunk, ExrError> {
    let beyond = || ExrError::incomplete(path, format!("block {index} lies beyond the end of the file"));
    let part_field = if meta.requirements.has_multiple_layers { 4 } else { 0 };
    let coordinates = match meta.headers[part].blocks {
        BlockDescription::ScanLines => 4,
        BlockDescription::Tiles(_) => 16,
    };
    let prefix_end = offset.checked_add(part_field + coordinates).ok_or_else(beyond)?;
    let size = read_i32(bytes, prefix_end).ok_or_else(beyond)?;
    let size = usize::try_from(size).map_err(|_| ExrError::damaged(path, format!("block {index} has no size")))?;
    let data = prefix_end + 4..(prefix_end + 4).checked_add(size).ok_or_else(beyond)?;
    if data.end > bytes.len() {
        return Err(beyond());
    }
    if part_field > 0 && read_i32(bytes, offset).map(i64::from) != Some(part as i64) {
        return Err(ExrError::damaged(path, format!("block {index} belongs to another part")));
    }
    Ok(Chunk { part, index, prefix: offset..prefix_end, data })
}

fn read_i32(bytes: &[u8], at: usize) -> Option<i32> {
    let field = bytes.get(at..at.checked_add(4)?)?;
    Some(i32::from_le_bytes(field.try_into().ok()?))
}

fn read_u64(bytes: &[u8], at: usize) -> Option<u64> {
    let field = bytes.get(at..at.checked_add(8)?)?;
    Some(u64::from_le_bytes(field.try_into().ok()?))
}
