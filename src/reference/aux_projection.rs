//! Twin of the projection of features ([`crate::kernels::aux_projection`]).

use super::Reference;
use super::dense::activate;
use crate::kernels::Activation;
use crate::kernels::aux_projection::{AuxProjection, CHANNELS};

/// Step by step, what each adds to the result.
pub fn aux_projection(reference: &mut Reference, call: &AuxProjection) {
    let (mut step, mut sums) = (reference.map(&call.src), None);
    for i in 0..call.out.len() {
        let mixed = reference.matrix(call.pointwise[i]).apply(&step, 1, CHANNELS as usize);
        step = reference.depthwise_of(&mixed, call.depthwise[i], Activation::LeakyRelu);
        let part = reference.matrix(call.out[i]).apply(&step, 1, CHANNELS as usize);
        sums = Some(match sums {
            None => part,
            Some(mut sums) => {
                let super::map::Map { values, .. } = &mut sums;
                values.iter_mut().zip(part.values).for_each(|(sum, value)| *sum += value);
                sums
            }
        });
    }
    let Some(mut result) = sums else { return };
    result.values.iter_mut().for_each(|value| *value = activate(Activation::LeakyRelu, *value));
    let tiles = reference.tiles(&call.tiles, call.dst.width, call.dst.height);
    reference.store(&result, &call.dst, &tiles, |x, y, channel| (x, y, channel));
}
