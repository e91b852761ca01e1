//! The FiLM vectors: the mean of a map's tokens, and a matrix applied to it.
//!
//! The mean is summed in two levels of fixed order, so that every run gives the same bits. Where converged squares are
//! left out ([`super::converged`]), it is estimated: a sample of them stands for all.

use super::accesses::Accesses;
use super::contracts::{self, halves};
use super::converged::{MAP_TILE, Sample};
use super::pushes::{FilmVectorPush, TokenSumPush};
use super::{
    Access, Addresses, BufferId, Footprint, Kernel, KernelTarget, PushBytes, TokenRect, Traffic, Variant, View,
    by_storage, groups,
};

/// Most partial sums of a frame.
const MAX_SUMS: u64 = 512;
/// Fewest tokens worth a partial sum.
const MIN_TOKENS_PER_SUM: u64 = 64;
/// Invocations of a partial sum's workgroup.
const SUM_INVOCATIONS: u32 = 256;

/// Level one: sums of consecutive tokens, row by row, of the part of a map that holds pixels of the unpadded frame.
/// Every token is brought to mean 0 and variance 1 over its channels first (eps 1e-5); gain and bias are in the weights
/// of level two.
#[derive(Clone, Debug, PartialEq)]
pub struct TokenSum {
    /// Input.
    pub src: View,
    /// Columns that are real.
    pub real_width: u32,
    /// Rows that are real.
    pub real_height: u32,
    /// The partial sums, `[sums][channels]`; with `computed` twice, of denoised squares and of sampled ones.
    pub dst: BufferId,
    /// Which tokens there are; `None`: all.
    pub computed: Option<Computed>,
}

/// Which tokens of a map were computed: those of denoised squares and of a sample of the converged ones.
#[derive(Clone, Debug, PartialEq)]
pub struct Computed {
    /// 1 or 0 for every square ([`super::converged::ConvergedMap::map`]).
    pub map: BufferId,
    /// Squares in a row of it.
    pub columns: u32,
    /// Pixels of a token, on a side: it belongs to the square in which it begins.
    pub token_pixels: u32,
    /// The sample.
    pub sample: Sample,
    /// Written: tokens of denoised squares and of sampled ones, for every partial sum.
    pub counts: BufferId,
}

impl TokenSum {
    /// Tokens averaged.
    pub fn real_tokens(&self) -> u64 {
        u64::from(self.real_width) * u64::from(self.real_height)
    }

    /// Has it sum a rectangle of the map that it was planned for.
    pub(crate) fn restrict_to(&mut self, tokens: TokenRect) {
        let TokenRect { left, top, right, bottom } = tokens;
        let src = &mut self.src;
        (src.first, src.top) = (src.first + left * src.stride, src.top + top);
        (src.height, self.real_width, self.real_height) = (src.height - top, right - left, bottom - top);
    }

    /// The map whose tokens are summed, from its first column on.
    pub(crate) fn whole(&self) -> View {
        View { first: self.src.first % self.src.stride, ..self.src }
    }

    /// The tokens of [`TokenSum::whole`] that are summed.
    pub(crate) fn tokens(&self) -> TokenRect {
        let left = self.src.first / self.src.stride;
        TokenRect { left, top: 0, right: left + self.real_width, bottom: self.real_height }
    }

    /// Bytes that the partial sums of any rectangle of a map fit into.
    pub(crate) fn most_bytes(channels: u32) -> u64 {
        MAX_SUMS * u64::from(channels) * 4
    }

    /// Tokens of one partial sum.
    pub fn tokens_per_sum(&self) -> u64 {
        self.real_tokens().div_ceil(MAX_SUMS).max(MIN_TOKENS_PER_SUM)
    }

    /// Partial sums.
    pub fn sums(&self) -> u64 {
        self.real_tokens().div_ceil(self.tokens_per_sum())
    }

    /// Bytes of the partial sums.
    pub fn sums_bytes(&self) -> u64 {
        let kinds = if self.computed.is_some() { 2 } else { 1 };
        kinds * self.sums() * u64::from(self.src.channels) * 4
    }

    /// Bytes of the counts.
    pub fn counts_bytes(&self) -> u64 {
        8 * self.sums()
    }
}

impl Kernel for TokenSum {
    fn choose(&self, _: KernelTarget) -> Variant {
        Variant::plain(by_storage(self.src.storage, &contracts::TOKEN_SUM, &halves::TOKEN_SUM))
    }

    fn groups(&self, _: &Variant) -> [u32; 3] {
        groups(self.sums() as u32, 1)
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        let (dst, computed) = (at.of(self.dst), self.computed.as_ref());
        let sample = computed.map_or(Sample::default(), |computed| computed.sample);
        PushBytes::new(&TokenSumPush {
            src: at.view(&self.src),
            dst,
            map: computed.map_or(dst, |computed| at.of(computed.map)),
            counts: computed.map_or(dst, |computed| at.of(computed.counts)),
            width: self.src.width,
            real_width: self.real_width,
            real_tokens: self.real_tokens() as u32,
            src_stride: self.src.stride / 4,
            channels: self.src.channels / 4,
            tokens_per_sum: self.tokens_per_sum() as u32,
            sums: self.sums() as u32,
            map_columns: computed.map_or(0, |computed| computed.columns),
            token_pixels: computed.map_or(1, |computed| computed.token_pixels),
            pitch: sample.pitch,
            skew: sample.skew,
            unused: 0,
        })
    }

    fn maps(&mut self, visit: &mut dyn FnMut(&mut View, Access)) {
        visit(&mut self.src, Access::Read(Footprint::Whole));
    }

    fn others(&self) -> Traffic {
        let mut others = Traffic { reads: Vec::new(), writes: vec![(self.dst, self.sums_bytes())] };
        if let Some(computed) = &self.computed {
            let rows = (self.real_height * computed.token_pixels).div_ceil(MAP_TILE);
            others.reads.push((computed.map, u64::from(computed.columns) * u64::from(rows) * 4));
            others.writes.push((computed.counts, self.counts_bytes()));
        }
        others
    }

    fn accesses(&self, _: &Variant) -> Option<Accesses> {
        let vectors = u64::from(self.src.channels / 4);
        // Of its first way an invocation keeps its own.
        let (ways, sums) = (u64::from(SUM_INVOCATIONS) / vectors, self.sums());
        // Mean, variance and sum each load a token; norms lie in shared memory.
        Some(Accesses {
            global_loads: 3 * self.real_tokens() * vectors,
            global_stores: sums * vectors,
            shared_loads: 4 * sums * vectors * (ways - 1) + self.real_tokens() * vectors,
            shared_stores: 4 * sums * u64::from(SUM_INVOCATIONS) + self.real_tokens(),
        })
    }
}

/// Level two: `W (sum of partials / tokens) + bias`. With counts, tokens of sampled squares count as often as it takes
/// to stand for all that are not of denoised ones; where none was sampled, those of denoised squares stand for all.
#[derive(Clone, Debug, PartialEq)]
pub struct FilmVector {
    /// The partial sums.
    pub partials: BufferId,
    /// Number of partial sums.
    pub sums: u64,
    /// Tokens that the mean is of.
    pub tokens: u64,
    /// Tokens that were summed ([`Computed::counts`]); `None`: all.
    pub counts: Option<BufferId>,
    /// Channels of the mean, at most 512.
    pub channels: u32,
    /// Packed `[bias | W]`, W row by row ([`crate::plan::pack::Pack::FilmVector`]).
    pub weights: BufferId,
    /// The vector `[gamma | beta]`, 32-bit.
    pub dst: BufferId,
    /// Its length.
    pub outputs: u32,
}

impl Kernel for FilmVector {
    fn choose(&self, _: KernelTarget) -> Variant {
        Variant::plain(&contracts::FILM_VECTOR)
    }

    fn groups(&self, _: &Variant) -> [u32; 3] {
        [1, 1, 1]
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        let partials = at.of(self.partials);
        PushBytes::new(&FilmVectorPush {
            partials,
            weights: at.of(self.weights),
            dst: at.of(self.dst),
            counts: self.counts.map_or(partials, |counts| at.of(counts)),
            channels: self.channels,
            outputs: self.outputs,
            sums: self.sums as u32,
            tokens: self.tokens as u32,
            counted: u32::from(self.counts.is_some()),
            inverse_tokens: (1.0 / self.tokens as f64) as f32,
        })
    }

    fn others(&self) -> Traffic {
        let (channels, outputs) = (u64::from(self.channels), u64::from(self.outputs));
        let kinds = if self.counts.is_some() { 2 } else { 1 };
        let partials = (self.partials, kinds * self.sums * channels * 4);
        let mut reads = vec![partials, (self.weights, (channels + 1) * outputs * 4)];
        reads.extend(self.counts.map(|counts| (counts, 8 * self.sums)));
        Traffic { reads, writes: vec![(self.dst, outputs * 4)] }
    }

    fn accesses(&self, _: &Variant) -> Option<Accesses> {
        let (channels, outputs) = (u64::from(self.channels), u64::from(self.outputs));
        let ways = (256 / channels).max(1);
        Some(Accesses {
            global_loads: self.sums * channels + outputs * (channels + 1),
            global_stores: outputs,
            shared_loads: channels * ways + outputs * channels,
            shared_stores: channels * ways + channels,
        })
    }
}
