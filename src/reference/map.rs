//! Packed feature maps: every token's channels side by side, without the strides of the device's buffers.

use super::tiles::{self, Tile};
use crate::kernels::View;

/// Where an element goes: x, y, channel.
pub type Place = (usize, usize, usize);

/// A feature map, `[token][channel]`.
#[derive(Clone, Debug)]
pub struct Map {
    /// Tokens in x.
    pub width: usize,
    /// Tokens in y.
    pub height: usize,
    /// Channels of a token.
    pub channels: usize,
    /// The elements.
    pub values: Vec<f64>,
}

impl Map {
    /// A map of these values.
    pub fn new(width: u32, height: u32, channels: u32, values: Vec<f64>) -> Self {
        Self { width: width as usize, height: height as usize, channels: channels as usize, values }
    }

    /// A map of zeros.
    pub fn zeros(width: usize, height: usize, channels: usize) -> Self {
        Self { width, height, channels, values: vec![0.0; width * height * channels] }
    }

    /// What a view covers of a buffer; NaN if nothing was ever written to that.
    pub fn read(buffer: &[f64], view: &View) -> Self {
        let (first, stride, channels) = (view.first as usize, view.stride as usize, view.channels as usize);
        let values = if buffer.is_empty() {
            vec![f64::NAN; view.elements() as usize]
        } else {
            let above = (view.top * view.width) as usize;
            let tokens = buffer.chunks_exact(stride).skip(above).take(view.tokens() as usize);
            tokens.flat_map(|token| &token[first..first + channels]).copied().collect()
        };
        Self::new(view.width, view.height, view.channels, values)
    }

    /// Writes the listed tiles (of this map's own grid) to a view of a buffer, every element where `place` says. What
    /// has no place among the view's channels (a shuffle's padding) is left out.
    pub fn write(&self, buffer: &mut [f64], view: &View, tiles: &[Tile], place: impl Fn(usize, usize, usize) -> Place) {
        let (width, stride, first) = (view.width as usize, view.stride as usize, view.first as usize);
        for (x, y) in tiles::tokens(tiles, self.width, self.height) {
            for (channel, value) in self.token(x, y).iter().enumerate() {
                let (to_x, to_y, to_channel) = place(x, y, channel);
                if to_channel < view.channels as usize {
                    buffer[((view.top as usize + to_y) * width + to_x) * stride + first + to_channel] = *value;
                }
            }
        }
    }

    /// The channels of a token.
    pub fn token(&self, x: usize, y: usize) -> &[f64] {
        &self.values[(y * self.width + x) * self.channels..][..self.channels]
    }

    /// Length of a row of tokens.
    pub fn row_len(&self) -> usize {
        self.width * self.channels
    }

    /// This map with one token of zeros around it.
    pub fn bordered(&self) -> Self {
        let mut out = Self::zeros(self.width + 2, self.height + 2, self.channels);
        let (from, to) = (self.row_len(), out.row_len());
        for y in 0..self.height {
            let start = (y + 1) * to + self.channels;
            out.values[start..start + from].copy_from_slice(&self.values[y * from..][..from]);
        }
        out
    }

    /// The map of half the size whose pixel shuffle this one is: channel `4 c + 2 dy + dx` is `c` of pixel `(dx, dy)`.
    pub fn unshuffled(&self) -> Self {
        let (width, height, channels) = (self.width / 2, self.height / 2, 4 * self.channels);
        let tokens = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let of = |x: usize, y: usize, c: usize| self.token(2 * x + c % 2, 2 * y + c % 4 / 2)[c / 4];
        let values = tokens.flat_map(|(x, y)| (0..channels).map(move |c| of(x, y, c))).collect();
        Self { width, height, channels, values }
    }

    /// The channels of both maps side by side.
    pub fn beside(&self, other: &Self) -> Self {
        let tokens = self.values.chunks_exact(self.channels).zip(other.values.chunks_exact(other.channels));
        let values = tokens.flat_map(|(a, b)| a.iter().chain(b)).copied().collect();
        Self { width: self.width, height: self.height, channels: self.channels + other.channels, values }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::{BufferId, Storage};

    #[test]
    fn views_are_cut_out_and_put_back() {
        let storage = Storage::F32;
        let view =
            View { buffer: BufferId(0), first: 4, channels: 4, stride: 12, width: 8, height: 8, top: 8, storage };
        let buffer: Vec<f64> = (0..8 * 16 * 12).map(f64::from).collect();
        let map = Map::read(&buffer, &view);
        assert_eq!(map.token(3, 2), [1000.0, 1001.0, 1002.0, 1003.0], "token (3, 10) of the map");

        let mut copy = vec![f64::NAN; buffer.len()];
        map.write(&mut copy, &view, &tiles::all(8, 8), |x, y, c| (x, y, c));
        for (i, (a, b)) in copy.iter().zip(&buffer).enumerate() {
            let inside = i >= 8 * 8 * 12 && (4..8).contains(&(i % 12));
            assert!(if inside { a == b } else { a.is_nan() }, "element {i}");
        }
    }

    #[test]
    fn a_border_is_zeros_all_round() {
        let map = Map::new(2, 1, 1, vec![1.0, 2.0]);
        assert_eq!(map.bordered().values, [0., 0., 0., 0., 0., 1., 2., 0., 0., 0., 0., 0.]);
    }

    #[test]
    fn an_unshuffled_map_has_the_pixels_of_a_token_side_by_side() {
        let map = Map::new(4, 2, 2, (0..16).map(f64::from).collect());
        let unshuffled = map.unshuffled();
        assert_eq!((unshuffled.width, unshuffled.height, unshuffled.channels), (2, 1, 8));
        assert_eq!(unshuffled.token(1, 0), [4., 6., 12., 14., 5., 7., 13., 15.]);
    }

    #[test]
    fn maps_stand_side_by_side() {
        let (a, b) = (Map::new(2, 1, 1, vec![1., 2.]), Map::new(2, 1, 2, vec![3., 4., 5., 6.]));
        assert_eq!(a.beside(&b).values, [1., 3., 4., 2., 5., 6.]);
    }
}
