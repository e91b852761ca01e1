//! Twin of the fused separable convolution ([`crate::kernels::separable`]).

use super::Reference;
use crate::kernels::separable::Separable3x3;

/// `pointwise(depthwise(src))`.
pub fn separable3x3(reference: &mut Reference, call: &Separable3x3) {
    let inner = reference.depthwise(&call.depthwise);
    reference.pointwise(&inner, &call.pointwise);
}
