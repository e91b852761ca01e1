//! Where the samples of a block lie, and what they are: row by row, in each row channel by channel.

use super::layers::is_subsampled;
use exr::math::Vec2;
use exr::meta::attribute::{ChannelDescription, ChannelList, SampleType};
use exr::meta::header::Header;
use half::f16;
use std::ops::Range;

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
    pub fn overlap(self, other: Self) -> Option<Self> {
        let (x, y) = (self.x.max(other.x), self.y.max(other.y));
        let right = (self.x + self.width).min(other.x + other.width);
        let bottom = (self.y + self.height).min(other.y + other.height);
        (x < right && y < bottom).then(|| Self { x, y, width: right - x, height: bottom - y })
    }
}

/// The samples of a rectangle of a part. A subsampled channel has some in every n-th row alone, and there in every n-th
/// column; the rectangle is then as wide as the data window.
pub(super) struct Block<'a> {
    channels: &'a ChannelList,
    rectangle: Rectangle,
    /// The first row, in the coordinates of the file.
    top: i64,
    /// The byte where each row begins, and where the last ends.
    rows: Vec<usize>,
}

impl<'a> Block<'a> {
    pub fn new(header: &'a Header, rectangle: Rectangle) -> Self {
        let top = i64::from(header.own_attributes.layer_position.y()) + rectangle.y as i64;
        let mut block = Self { channels: &header.channels, rectangle, top, rows: vec![0] };
        let subsampled = block.channels.list.iter().any(is_subsampled);
        let mut end = 0;
        for row in 0..rectangle.height {
            end += match subsampled {
                true => block.channels.list.iter().map(|channel| block.line_bytes(row, channel)).sum(),
                false => rectangle.width * block.channels.bytes_per_pixel,
            };
            block.rows.push(end);
        }
        block
    }

    /// Bytes of the whole block.
    pub fn bytes(&self) -> usize {
        self.rows.last().copied().unwrap_or(0)
    }

    /// The bytes of a channel in a row of the rectangle: none where the channel has no samples there.
    pub fn line(&self, row: usize, channel: usize) -> Range<usize> {
        let before = self.channels.list[..channel].iter().map(|before| self.line_bytes(row, before)).sum::<usize>();
        let start = self.rows[row] + before;
        start..start + self.line_bytes(row, &self.channels.list[channel])
    }

    fn line_bytes(&self, row: usize, channel: &ChannelDescription) -> usize {
        let Vec2(across, down) = channel.sampling;
        if (self.top + row as i64) % down.max(1) as i64 != 0 {
            return 0;
        }
        self.rectangle.width / across.max(1) * channel.sample_type.bytes_per_sample()
    }
}

/// The bytes that a part's samples take before compression.
pub(super) fn declared_bytes(header: &Header) -> u64 {
    let (width, height) = (header.layer_size.x() as u64, header.layer_size.y() as u64);
    let of = |channel: &ChannelDescription| {
        let samples = (width / channel.sampling.x().max(1) as u64) * (height / channel.sampling.y().max(1) as u64);
        samples.saturating_mul(channel.sample_type.bytes_per_sample() as u64)
    };
    header.channels.list.iter().map(of).fold(0, u64::saturating_add)
}

/// Copies what two rectangles of a part's samples have in common from one to the other. No channel is subsampled.
pub(super) fn copy_samples(header: &Header, (from, source): (Rectangle, &[u8]), (to, target): (Rectangle, &mut [u8])) {
    let Some(both) = from.overlap(to) else { return };
    let blocks = [Block::new(header, from), Block::new(header, to)];
    for (index, channel) in header.channels.list.iter().enumerate() {
        let size = channel.sample_type.bytes_per_sample();
        for y in both.y..both.y + both.height {
            let [source_range, target_range] = [&blocks[0], &blocks[1]].map(|block| {
                let start = block.line(y - block.rectangle.y, index).start + (both.x - block.rectangle.x) * size;
                start..start + both.width * size
            });
            target[target_range].copy_from_slice(&source[source_range]);
        }
    }
}

/// Reads a line of samples as floats into every `step`-th place of `out`.
pub(super) fn read_line(line: &[u8], sample_type: SampleType, out: &mut [f32], step: usize) {
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

/// Writes floats as a line of samples. Halfs are clamped to their range.
pub(super) fn write_line(line: &mut [u8], sample_type: SampleType, values: impl Iterator<Item = f32>) {
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
