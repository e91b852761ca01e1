//! Twins of the kernels that take several operations: these, one after the other.

use super::dense::activate;
use super::map::Map;
use super::maps::normalise;
use super::tiles::doubled;
use super::{Reference, Twin};
use crate::kernels::attention_block::AttentionBlock;
use crate::kernels::aux_projection::{AuxProjection, CHANNELS};
use crate::kernels::embedding::{Embedding, Pixels};
use crate::kernels::ffn::Ffn;
use crate::kernels::normed_conv::NormedConv3x3;
use crate::kernels::separable::Separable3x3;
use crate::kernels::{Activation, BufferId, View};

impl Twin for Separable3x3 {
    /// `pointwise(depthwise(src))`.
    fn compute(&self, reference: &mut Reference) {
        let inner = reference.depthwise(&self.depthwise);
        reference.pointwise(&inner, &self.pointwise);
    }
}

impl Twin for NormedConv3x3 {
    /// `conv(norm(src))`.
    fn compute(&self, reference: &mut Reference) {
        let normed = reference.normed(&self.conv.src, self.norm);
        reference.convolution(&normed, &self.conv);
    }
}

impl Twin for Embedding {
    /// `embedding(pixels)`, and a Linear of the pixels, added to a map or not.
    fn compute(&self, reference: &mut Reference) {
        let channels = self.dst.channels as usize;
        let (mut pixels, mut before) = (reference.map(&self.src), None);
        let early = match &self.pixels {
            Pixels::Projected { weights, early, .. } => {
                pixels = reference.matrix(*weights).apply(&pixels, 1, channels);
                pixels.values.iter_mut().for_each(|value| *value = activate(Activation::LeakyRelu, *value));
                before = early.as_ref().map(|(_, before)| reference.map(before));
                early.as_ref().map(|(early, _)| early)
            }
            Pixels::Stored { early } => early.as_ref(),
        };
        let tokens = reference.matrix(self.embedding).apply(&pixels, 2, channels);
        let tiles = reference.tiles(&self.tiles, self.dst.width, self.dst.height);
        reference.store(&tokens, &self.dst, &tiles, |x, y, channel| (x, y, channel));
        let Some(early) = early else { return };
        let mut result = reference.matrix(early.weights).apply(&pixels, 1, channels);
        for (value, before) in result.values.iter_mut().zip(before.iter().flat_map(|before| &before.values)) {
            *value += before;
        }
        let tiles: Vec<_> = tiles.iter().flat_map(|tile| doubled(*tile)).collect();
        reference.store(&result, &early.dst, &tiles, |x, y, channel| (x, y, channel));
    }
}

impl Twin for Ffn {
    /// `x + W act(depthwise(V norm(x) + b)) + c`.
    fn compute(&self, reference: &mut Reference) {
        let hidden = projected(reference, &self.x, self.expand, self.hidden as usize);
        let convolved = reference.depthwise_of(&hidden, self.depthwise, self.activation);
        let mut result = reference.matrix(self.contract).apply(&convolved, 1, self.dst.channels as usize);
        let residual = reference.map(&self.x).values;
        result.values.iter_mut().zip(residual).for_each(|(value, residual)| *value += residual);
        let tiles = reference.tiles(&self.tiles, self.dst.width, self.dst.height);
        reference.store(&result, &self.dst, &tiles, |x, y, channel| (x, y, channel));
    }
}

impl Twin for AuxProjection {
    /// Step by step, what each adds to the result.
    fn compute(&self, reference: &mut Reference) {
        let (mut step, mut sums) = (reference.map(&self.src), None);
        for i in 0..self.out.len() {
            let mixed = reference.matrix(self.pointwise[i]).apply(&step, 1, CHANNELS as usize);
            step = reference.depthwise_of(&mixed, self.depthwise[i], Activation::LeakyRelu);
            let part = reference.matrix(self.out[i]).apply(&step, 1, CHANNELS as usize);
            sums = Some(match sums {
                None => part,
                Some(mut sums) => {
                    let Map { values, .. } = &mut sums;
                    values.iter_mut().zip(part.values).for_each(|(sum, value)| *sum += value);
                    sums
                }
            });
        }
        let Some(mut result) = sums else { return };
        result.values.iter_mut().for_each(|value| *value = activate(Activation::LeakyRelu, *value));
        let tiles = reference.tiles(&self.tiles, self.dst.width, self.dst.height);
        reference.store(&result, &self.dst, &tiles, |x, y, channel| (x, y, channel));
    }
}

impl Twin for AttentionBlock {
    /// `x + W [attended | rest of x] + bias`.
    fn compute(&self, reference: &mut Reference) {
        let attending = View { channels: self.value_width, ..self.x };
        let (keys, values) = (self.key_width as usize, self.value_width as usize);
        let x = projected(reference, &attending, self.qkv, 2 * keys + values);
        let f = projected(reference, &self.f, self.qkf, 2 * keys);
        let mut inputs = reference.attended(&x, &f, self.table, (keys, values));
        let rest =
            View { first: self.x.first + self.value_width, channels: self.x.channels - self.value_width, ..self.x };
        if rest.channels > 0 {
            inputs = inputs.beside(&reference.map(&rest));
        }
        let mut result = reference.matrix(self.projection).apply(&inputs, 1, self.dst.channels as usize);
        let residual = reference.map(&self.x).values;
        result.values.iter_mut().zip(residual).for_each(|(value, residual)| *value += residual);
        let tiles = reference.tiles(&self.tiles, self.dst.width, self.dst.height);
        reference.store(&result, &self.dst, &tiles, |x, y, channel| (x, y, channel));
    }
}

/// A Linear of normed tokens.
fn projected(reference: &Reference, view: &View, weights: BufferId, outputs: usize) -> Map {
    let mut tokens = reference.map(view);
    tokens.values.chunks_exact_mut(tokens.channels).for_each(normalise);
    reference.matrix(weights).apply(&tokens, 1, outputs)
}
