//! The weights of a network as the kernels chosen for it read them: what is packed, and where it lies. It is the same
//! at every size.

use super::pack::Pack;
use crate::net::weights::{Weights, WeightsError};

/// Every pack lies at a multiple of so many bytes.
const ALIGNMENT: u64 = 256;

/// Everything that is packed for a network and a target, one after the other, from the start of the weights or after
/// what is packed for another network.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Packing {
    /// Each with the bytes from the start of the weights.
    packs: Vec<(Pack, u64)>,
    /// Where the next one goes.
    bytes: u64,
}

impl Packing {
    /// Nothing yet, after all that another holds.
    pub(super) fn after(other: &Self) -> Self {
        Self { packs: Vec::new(), bytes: other.bytes }
    }

    /// Where a pack lies; it is added, where there is none like it.
    pub(super) fn place(&mut self, pack: Pack) -> u64 {
        if let Some((_, offset)) = self.packs.iter().find(|(known, _)| *known == pack) {
            return *offset;
        }
        let offset = self.bytes;
        self.bytes += pack.bytes().next_multiple_of(ALIGNMENT);
        self.packs.push((pack, offset));
        offset
    }

    /// What is packed, with the bytes from the start of the weights.
    pub fn packs(&self) -> &[(Pack, u64)] {
        &self.packs
    }

    /// Bytes of all of it, and of what is before it.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Writes the weights, packed, to where they lie in [`Packing::bytes`] bytes of zeros.
    ///
    /// # Errors
    /// A tensor that the weights lack.
    pub fn write(&self, weights: &Weights, to: &mut [u8]) -> Result<(), WeightsError> {
        for (pack, offset) in &self.packs {
            let words = pack.words(weights)?;
            let start = *offset as usize;
            to[start..start + 4 * words.len()].copy_from_slice(bytemuck::cast_slice(&words));
        }
        Ok(())
    }
}
