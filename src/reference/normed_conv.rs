//! Twin of the normed convolution ([`crate::kernels::normed_conv`]).

use super::Reference;
use crate::kernels::normed_conv::NormedConv3x3;

/// `conv(norm(src))`.
pub fn normed_conv3x3(reference: &mut Reference, call: &NormedConv3x3) {
    let normed = reference.normed(&call.norm);
    reference.convolution(&normed, &call.conv);
}
