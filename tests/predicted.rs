//! The kernels of the head of predicted kernels against their f64 twins: random shapes, channel ranges, rectangles and
//! lists of tiles, frames down to one tile.

mod common;

use common::case::{Cases, DENSE_FORMS, KERNEL_LIMIT, MATRIX_LIMIT, PREPROCESSING};
use common::dense::size;
use vkdenoise::kernels::energy::{BLOCK, EnergyGains};
use vkdenoise::kernels::predicted::{ApplyKernels, Halve, KernelInputs, MixLevels, PredictKernels};
use vkdenoise::kernels::{Arithmetic, Call, Storage, View};
use vkdenoise::net::{Arch, Head, Weights};
use vkdenoise::plan::pack::Pack;

fn cases(head: Head) -> Cases {
    Cases::new(11, Weights::hashed(&Arch { head, ..Arch::hybrid() }, PREPROCESSING, 3).unwrap())
}

/// A map in 32-bit floats whatever others are stored as.
fn full(cases: &mut Cases, make: impl FnOnce(&mut Cases) -> View) -> View {
    let storage = std::mem::take(&mut cases.storage);
    let view = make(cases);
    cases.storage = storage;
    view
}

fn pack(levels: u32, arithmetic: Arithmetic) -> Pack {
    let head = "head".into();
    match arithmetic {
        Arithmetic::Floats => Pack::Kernels { head, levels },
        Arithmetic::Matrices => Pack::KernelsMatrix { head, levels },
    }
}

#[test]
fn kernel_inputs() {
    for (storage, arithmetic, limit) in DENSE_FORMS {
        for (levels, head) in [(3, Head::gated()), (5, Head::pure())] {
            let mut cases = cases(head);
            (cases.storage, cases.arithmetic) = (storage, arithmetic);
            for case in 0..10 {
                let tokens = size(&mut cases, 8);
                let pixels = (2 * tokens.0, 2 * tokens.1);
                // Hidden numbers of some tens have reliabilities beyond what a float holds.
                let scale = if case == 0 { 60.0 } else { 2.0 };
                let call = KernelInputs {
                    early: cases.map(pixels, 32, scale),
                    tokens: cases.map(tokens, 32, 2.0),
                    albedo: cases.map(pixels, 4, 1.2),
                    color: full(&mut cases, |cases| cases.map_between(pixels, 4, 0.0, 0.7)),
                    residual: full(&mut cases, |cases| cases.map(pixels, 4, 0.5)),
                    weights: cases.pack(pack(levels, arithmetic)),
                    dst: cases.target(pixels, 32),
                    taps: full(&mut cases, |cases| cases.target(pixels, 4)),
                    tiles: cases.tiles(tokens),
                    arithmetic,
                };
                let (dst, taps) = (call.dst.buffer, call.taps.buffer);
                cases.add(Call::KernelInputs(call.clone()), dst);
                cases.add(Call::KernelInputs(call), taps);
            }
            cases.check(&format!("kernel_inputs of {levels} levels, {storage:?}, {arithmetic:?}"), limit);
        }
    }
}

/// Weights of what taps read that are negative do not count, as those of zero.
#[test]
fn predict_kernels() {
    for (storage, arithmetic, limit) in [
        (Storage::F32, Arithmetic::Floats, KERNEL_LIMIT),
        (Storage::F16, Arithmetic::Floats, KERNEL_LIMIT),
        (Storage::F16, Arithmetic::Matrices, MATRIX_LIMIT),
    ] {
        for (levels, head, gloss) in [(3, Head::gated(), false), (5, Head::pure(), false), (5, Head::gloss(), true)] {
            let mut cases = cases(head);
            (cases.storage, cases.arithmetic) = (storage, arithmetic);
            for case in 0..10 {
                let pixels = size(&mut cases, 8);
                let least = if case % 2 == 0 { 0.01 } else { -0.1 };
                let call = PredictKernels {
                    hidden: cases.map(pixels, 32, 2.0),
                    taps: full(&mut cases, |cases| cases.map_between(pixels, 4, least, 1.0)),
                    albedo: cases.map(pixels, 4, 1.2),
                    weights: cases.pack(pack(levels, arithmetic)),
                    gloss,
                    of_signal: false,
                    dst: full(&mut cases, |cases| cases.target(pixels, 12)),
                    tiles: cases.tiles(pixels),
                    arithmetic,
                };
                let dst = call.dst.buffer;
                cases.add(Call::PredictKernels(call), dst);
            }
            let what = format!("predict_kernels of {levels} levels, gloss {gloss}, {storage:?}, {arithmetic:?}");
            cases.check(&what, limit);
        }
    }
}

#[test]
fn halve() {
    let mut cases = cases(Head::gated());
    for channels in [4, 8, 12].repeat(4) {
        let small = size(&mut cases, 8);
        let (src, dst) = (cases.map((2 * small.0, 2 * small.1), channels, 3.0), cases.target(small, channels));
        let tiles = cases.tiles(small);
        cases.add(Call::Halve(Halve { src, albedo: None, dst, tiles }), dst.buffer);
    }
    cases.check("halve", KERNEL_LIMIT);
    for storage in [Storage::F32, Storage::F16] {
        for _ in 0..6 {
            let small = size(&mut cases, 8);
            let large = (2 * small.0, 2 * small.1);
            cases.storage = storage;
            let albedo = Some(cases.map(large, 4, 1.2));
            cases.storage = Storage::F32;
            let (src, dst) = (cases.map(large, 4, 3.0), cases.target(small, 8));
            let tiles = cases.tiles(small);
            cases.add(Call::Halve(Halve { src, albedo, dst, tiles }), dst.buffer);
        }
        cases.check(&format!("halve to two images, albedo {storage:?}"), KERNEL_LIMIT);
    }
}

/// Weights of the sums that are negative do not count, as those of zero.
#[test]
fn apply_kernels() {
    for storage in [Storage::F32, Storage::F16] {
        let mut cases = cases(Head::gated());
        cases.storage = storage;
        for channels in [4, 8].repeat(5) {
            let size = size(&mut cases, 8);
            let logits = cases.map(size, 28, 4.0);
            let sums = full(&mut cases, |cases| cases.map_between(size, channels, -0.1, 1.0));
            let dst = full(&mut cases, |cases| cases.target(size, channels));
            let tiles = cases.tiles(size);
            cases.add(Call::ApplyKernels(ApplyKernels { logits, sums, dst, tiles }), dst.buffer);
        }
        // Where nothing counts there is nothing.
        let logits = cases.map((16, 8), 28, 4.0);
        let sums = full(&mut cases, |cases| cases.map_between((16, 8), 4, -1.0, 0.0));
        let dst = full(&mut cases, |cases| cases.target((16, 8), 4));
        let tiles = cases.tiles((16, 8));
        cases.add(Call::ApplyKernels(ApplyKernels { logits, sums, dst, tiles }), dst.buffer);
        cases.check(&format!("apply_kernels, {storage:?}"), KERNEL_LIMIT);
    }
}

#[test]
fn mix_levels() {
    let mut cases = cases(Head::pure());
    let forms = [(2, 4, true, false), (4, 4, false, false), (4, 8, true, false), (2, 12, false, false)];
    for (levels, channels, gated, gloss) in [&forms[..], &[(4, 4, false, true)]].concat().repeat(4) {
        let (width, height) = size(&mut cases, 8);
        // The coarsest level has tiles of its own.
        let grain = 1u32 << levels;
        let pixels = (width * grain, height * grain);
        let of_level = if gloss { 2 * channels } else { channels };
        let map =
            |cases: &mut Cases, side: u32| cases.map_between((pixels.0 / side, pixels.1 / side), of_level, 0.05, 1.0);
        let call = MixLevels {
            levels: (1..=levels).map(|level| map(&mut cases, 1 << level)).collect(),
            pixels: cases.map_between(pixels, channels + 8, 0.05, 1.0),
            gloss,
            direct: gated.then(|| (cases.map_between(pixels, 4, 0.0, 2.0), cases.map(pixels, 4, 0.5))),
            dst: cases.target(pixels, channels),
            tiles: cases.tiles(pixels),
        };
        let dst = call.dst.buffer;
        cases.add(Call::MixLevels(call), dst);
    }
    cases.check("mix_levels", KERNEL_LIMIT);
}

/// Squares that lack light and some that have too much, partly beyond the frame's end.
#[test]
fn energy_gains() {
    let mut cases = cases(Head::pure());
    for i in 0..12u32 {
        let blocks = (1 + i % 3, 1 + i / 4);
        let pixels = (blocks.0 * BLOCK, blocks.1 * BLOCK);
        // What was given from little noise to so much that nothing is known of the mean, and beyond the bound.
        let (low, high) = [(0.02, 0.7), (0.3, 0.35), (0.05, 0.1), (0.0, 3.0)][i as usize % 4];
        let call = EnergyGains {
            result: cases.map_between(pixels, 4, 0.3, 0.5),
            log_color: cases.map_between(pixels, 4, low, high),
            dst: cases.target(blocks, 4),
            width: pixels.0 - i % 5 * 7,
            height: pixels.1 - i % 4 * 11,
            tiles: cases.windows((pixels.0 / 8, pixels.1 / 8)),
            stats: full(&mut cases, |cases| cases.map_between((8, 8), 4, 0.6, 0.9)).buffer,
            converged: None,
        };
        let dst = call.dst.buffer;
        cases.add(Call::EnergyGains(call), dst);
    }
    cases.check("energy_gains", KERNEL_LIMIT);
}
