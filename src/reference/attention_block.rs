//! Twin of a block's attention in one ([`crate::kernels::attention_block`]).

use super::Reference;
use super::map::Map;
use super::maps::normalise;
use crate::kernels::attention_block::AttentionBlock;
use crate::kernels::{BufferId, View};

/// `x + W [attended | rest of x] + bias`.
pub fn attention_block(reference: &mut Reference, call: &AttentionBlock) {
    let attending = View { channels: call.value_width, ..call.x };
    let (keys, values) = (call.key_width as usize, call.value_width as usize);
    let x = projected(reference, &attending, call.qkv, 2 * keys + values);
    let f = projected(reference, &call.f, call.qkf, 2 * keys);
    let mut inputs = reference.attended(&x, &f, call.table, (keys, values));
    let rest = View { first: call.x.first + call.value_width, channels: call.x.channels - call.value_width, ..call.x };
    if rest.channels > 0 {
        inputs = inputs.beside(&reference.map(&rest));
    }
    let mut result = reference.matrix(call.projection).apply(&inputs, 1, call.dst.channels as usize);
    let residual = reference.map(&call.x).values;
    result.values.iter_mut().zip(residual).for_each(|(value, residual)| *value += residual);
    let tiles = reference.tiles(&call.tiles, call.dst.width, call.dst.height);
    reference.store(&result, &call.dst, &tiles, |x, y, channel| (x, y, channel));
}

/// A Linear of normed tokens.
fn projected(reference: &Reference, view: &View, weights: BufferId, outputs: usize) -> Map {
    let mut tokens = reference.map(view);
    tokens.values.chunks_exact_mut(tokens.channels).for_each(normalise);
    reference.matrix(weights).apply(&tokens, 1, outputs)
}
