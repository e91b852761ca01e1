//! Which form each convolution of a network takes, where that was measured.

use super::choices::ConvAlgorithm;
use super::{Call, Plan, View};
use crate::kernels::dense::NARROW_CHANNELS;
use serde::{Deserialize, Serialize};

/// Dense 3x3 convolutions that cost the same: stride 1, to more than four channels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct ConvShape {
    /// Channels in, whole vectors of four.
    pub inputs: u32,
    /// Channels out, before any shuffle, whole vectors of four.
    pub outputs: u32,
    /// The side of a token of the input in pixels.
    pub token: u32,
}

impl ConvShape {
    /// Of a convolution from `src` to so many channels, in a frame that is padded to so many columns. `None` for those that
    /// have one form alone.
    pub(super) fn new(src: &View, outputs: u32, stride: u32, columns: u32) -> Option<Self> {
        let has_forms = stride == 1 && outputs > NARROW_CHANNELS;
        has_forms.then(|| Self {
            inputs: src.channels,
            outputs: outputs.next_multiple_of(4),
            token: columns / src.width.max(1),
        })
    }

    /// Of a call in a plan, whatever form it has there.
    pub fn of(call: &Call, plan: &Plan) -> Option<Self> {
        let conv = match call {
            Call::Conv3x3(conv) => conv,
            Call::Winograd3x3(winograd) => &winograd.conv,
            _ => return None,
        };
        // A band is as wide as the frame.
        Self::new(&conv.src, conv.channels, conv.stride, plan.padded.width)
    }
}

/// Shapes that a table holds. The networks of the family have at most a dozen.
const MOST: usize = 16;

/// The form of each shape that was measured. Equal tables give equal bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ConvTable {
    rows: [Option<(ConvShape, ConvAlgorithm)>; MOST],
}

impl ConvTable {
    /// The form of a shape; `None`: it was not measured.
    pub fn get(&self, shape: ConvShape) -> Option<ConvAlgorithm> {
        self.iter().find(|(known, _)| *known == shape).map(|(_, form)| form)
    }

    /// All rows, in the order in which they came.
    pub fn iter(&self) -> impl Iterator<Item = (ConvShape, ConvAlgorithm)> {
        self.rows.iter().copied().flatten()
    }
}

impl FromIterator<(ConvShape, ConvAlgorithm)> for ConvTable {
    /// Shapes beyond the sixteenth are left out: they take the form of all others.
    fn from_iter<I: IntoIterator<Item = (ConvShape, ConvAlgorithm)>>(rows: I) -> Self {
        let mut table = Self::default();
        table.rows.iter_mut().zip(rows).for_each(|(place, row)| *place = Some(row));
        table
    }
}
