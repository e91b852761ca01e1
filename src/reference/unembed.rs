//! Twin of the way from tokens to pixels ([`crate::kernels::unembed`]), as the two convolutions that it stands for.

use super::map::Map;
use super::parameters::Parameters;
use super::{Reference, Twin};
use crate::kernels::unembed::Unembed;

impl Twin for Unembed {
    /// `conv3x3(shuffle(conv3x3(src)))`.
    fn compute(&self, reference: &mut Reference) {
        let src = reference.map(&self.src);
        let [spread, gather] = match reference.parameters(self.weights) {
            Parameters::Unembed(matrices) => &**matrices,
            other => unreachable!("unembed is given {other:?}"),
        };
        let quarters = spread.apply(&src, 1, 4 * src.channels);
        let mut pixels = Map::zeros(2 * src.width, 2 * src.height, src.channels);
        for (y, x) in (0..pixels.height).flat_map(|y| (0..pixels.width).map(move |x| (y, x))) {
            let token = quarters.token(x / 2, y / 2);
            let at = (y * pixels.width + x) * pixels.channels;
            for channel in 0..pixels.channels {
                pixels.values[at + channel] = token[4 * channel + y % 2 * 2 + x % 2];
            }
        }
        let channels = self.dst.channels as usize;
        let result = gather.apply(&pixels, 1, channels);
        // Token by token, as the tiles are.
        let mut tokens = Map::zeros(src.width, src.height, 4 * channels);
        for (y, x) in (0..result.height).flat_map(|y| (0..result.width).map(move |x| (y, x))) {
            let at = (y / 2 * src.width + x / 2) * tokens.channels + (y % 2 * 2 + x % 2) * channels;
            tokens.values[at..at + channels].copy_from_slice(result.token(x, y));
        }
        let tiles = reference.tiles(&self.tiles, self.src.width, self.src.height);
        reference.store(&tokens, &self.dst, &tiles, |x, y, c| {
            (2 * x + c / channels % 2, 2 * y + c / channels / 2, c % channels)
        });
    }
}
