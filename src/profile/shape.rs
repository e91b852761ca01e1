//! What a dispatch works on, in words that all kernels share.

use crate::kernels::{Access, Call};
use std::fmt;

/// Size of a dispatch's grid, and its channels there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Shape {
    /// Tokens (or pixels) in x; 1 for kernels without a grid.
    pub width: u32,
    /// Tokens (or pixels) in y.
    pub height: u32,
    /// Channels that it reads for a token of the grid, of all its maps together; residuals are left out.
    pub inputs: u32,
    /// Channels that it writes for a token of the grid.
    pub outputs: u32,
}

impl fmt::Display for Shape {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(&format!("{}x{} {}>{}", self.width, self.height, self.inputs, self.outputs))
    }
}

impl Shape {
    /// The shape of a call.
    #[cfg_attr(not(feature = "internals"), doc(hidden))]
    pub fn of(call: &Call) -> Self {
        let (width, height) = call.grid().map_or((1, 1), |grid| (grid.width, grid.height));
        let tokens = u64::from(width) * u64::from(height);
        let mut shape = Self { width, height, ..Self::default() };
        for (view, access) in call.maps() {
            match access {
                Access::Read(_) => shape.inputs += view.channels,
                Access::Residual(_) => {}
                Access::Write(_) => shape.outputs += (view.elements() / tokens.max(1)) as u32,
            }
        }
        shape
    }
}
