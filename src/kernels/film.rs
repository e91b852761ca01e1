//! The FiLM vectors: the mean of a map's tokens, and a matrix applied to it.
//!
//! The mean is summed in two levels of fixed order, so that every run gives the same bits.

use super::contract::Contract;
use super::contracts::{self, halves};
use super::pushes::{FilmVectorPush, TokenSumPush};
use super::{Addresses, BufferId, Kernel, PushBytes, Traffic, Variants, View, by_storage, groups};

/// Most partial sums of a frame.
const MAX_SUMS: u64 = 4096;
/// Fewest tokens worth a partial sum.
const MIN_TOKENS_PER_SUM: u64 = 64;

/// Level one: sums of consecutive tokens, row by row, of the part of a map that holds pixels of the unpadded frame.
#[derive(Clone, Debug, PartialEq)]
pub struct TokenSum {
    /// Input.
    pub src: View,
    /// Columns that are real.
    pub real_width: u32,
    /// Rows that are real.
    pub real_height: u32,
    /// The partial sums, `[sums][channels]`.
    pub dst: BufferId,
}

impl TokenSum {
    /// Tokens averaged.
    pub fn real_tokens(&self) -> u64 {
        u64::from(self.real_width) * u64::from(self.real_height)
    }

    /// Tokens of one partial sum.
    pub fn tokens_per_sum(&self) -> u64 {
        self.real_tokens().div_ceil(MAX_SUMS).max(MIN_TOKENS_PER_SUM)
    }

    /// Partial sums.
    pub fn sums(&self) -> u64 {
        self.real_tokens().div_ceil(self.tokens_per_sum())
    }
}

impl Kernel for TokenSum {
    fn contract(&self, _: Variants) -> &'static Contract {
        by_storage(self.src.storage, &contracts::TOKEN_SUM, &halves::TOKEN_SUM)
    }

    fn groups(&self, _: Variants) -> [u32; 3] {
        groups((self.sums() as u32 * self.src.channels / 4).div_ceil(64), 1)
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        PushBytes::new(&TokenSumPush {
            src: at.view(&self.src),
            dst: at.of(self.dst),
            width: self.src.width,
            real_width: self.real_width,
            real_tokens: self.real_tokens() as u32,
            src_stride: self.src.stride / 4,
            channels: self.src.channels / 4,
            tokens_per_sum: self.tokens_per_sum() as u32,
            sums: self.sums() as u32,
            unused: 0,
        })
    }

    fn traffic(&self) -> Traffic {
        let channels = u64::from(self.src.channels);
        Traffic {
            reads: vec![(self.src.buffer, self.real_tokens() * channels * self.src.storage.bytes())],
            writes: vec![(self.dst, self.sums() * channels * 4)],
        }
    }
}

/// Level two: `W (sum of partials / tokens) + bias`.
#[derive(Clone, Debug, PartialEq)]
pub struct FilmVector {
    /// The partial sums.
    pub partials: BufferId,
    /// Number of partial sums.
    pub sums: u64,
    /// Tokens that were summed.
    pub tokens: u64,
    /// Channels of the mean, at most 512.
    pub channels: u32,
    /// Packed `[bias | W]`, W row by row.
    pub weights: BufferId,
    /// The vector `[gamma | beta]`, 32-bit.
    pub dst: BufferId,
    /// Its length.
    pub outputs: u32,
}

impl Kernel for FilmVector {
    fn contract(&self, _: Variants) -> &'static Contract {
        &contracts::FILM_VECTOR
    }

    fn groups(&self, _: Variants) -> [u32; 3] {
        [1, 1, 1]
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        PushBytes::new(&FilmVectorPush {
            partials: at.of(self.partials),
            weights: at.of(self.weights),
            dst: at.of(self.dst),
            channels: self.channels,
            outputs: self.outputs,
            sums: self.sums as u32,
            inverse_tokens: (1.0 / self.tokens as f64) as f32,
        })
    }

    fn traffic(&self) -> Traffic {
        let (channels, outputs) = (u64::from(self.channels), u64::from(self.outputs));
        Traffic {
            reads: vec![(self.partials, self.sums * channels * 4), (self.weights, (channels + 1) * outputs * 4)],
            writes: vec![(self.dst, outputs * 4)],
        }
    }
}
