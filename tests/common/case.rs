//! Kernel cases: calls over buffers that exist twice, on the device and in the f64 reference.

use super::compare::nmse;
use super::device::{assert_no_validation_messages, device};
use super::random::Random;
use half::f16;
use vkdenoise::DeviceKind;
use vkdenoise::frame::Extent;
use vkdenoise::kernels::{Arithmetic, BufferId, Call, HALF_TILE, KernelTarget, Storage, TILE, TileRect, Tiles, View};
use vkdenoise::net::{
    Arch, Block, Bottleneck, Convolution, Decoder, DepthRule, ExposureRule, Head, Preprocessing, StageSpec, Weights,
};
use vkdenoise::plan::pack::Pack;
use vkdenoise::plan::{Buffer, Place};
use vkdenoise::reference::Reference;
use vkdenoise::testing::{Bench, SENTINEL};

/// What every preprocessing is in tests.
pub const PREPROCESSING: Preprocessing =
    Preprocessing { exposure: ExposureRule::Auto, depth: DepthRule::Percentile, version: Preprocessing::VERSION };

/// What a kernel may be wrong by: NMSE of its result, without residual.
pub const KERNEL_LIMIT: f64 = 1e-10;

/// The same where the result is stored in halves and rounded to the nearest: the error is uniform within half a unit in
/// the last place, 2^-11 of a power of two, so its mean square is at most 2^-20 / 12.
pub const HALF_LIMIT: f64 = 8e-8;

/// Both storages and their limits, without matrices.
pub const STORAGES: [(Storage, f64); 2] = [(Storage::F32, KERNEL_LIMIT), (Storage::F16, HALF_LIMIT)];

/// Random weights of a network of two FiLM stages, of `channels` (a standard convolution) and twice as many (a
/// separable one), and a bottleneck of four times as many.
pub fn small_net(channels: u32, bottleneck: Block) -> Weights {
    let stage = |conv| StageSpec { encoder_blocks: 1, decoder_blocks: 1, heads: 1, block: Block::FilmCnn { conv } };
    let arch = Arch {
        name: "cases".into(),
        channels,
        window: 8,
        patch: 2,
        decoder: Decoder::Symmetric,
        stages: vec![stage(Convolution::Standard), stage(Convolution::Separable)],
        bottleneck: Bottleneck { blocks: 1, heads: 8, block: bottleneck },
        head: Head::Residual,
    };
    Weights::hashed(&arch, PREPROCESSING, 3).unwrap()
}

/// Random weights of the Hybrid with this head, one block in each place.
pub fn small_hybrid(head: Head) -> Weights {
    small(Arch { head, ..Arch::hybrid() }, 4)
}

/// A network with one block where it has more, random.
pub fn small(mut arch: Arch, seed: u64) -> Weights {
    arch.stages.iter_mut().for_each(|stage| (stage.encoder_blocks, stage.decoder_blocks) = (1, 1));
    arch.bottleneck.blocks = 1;
    Weights::hashed(&arch, PREPROCESSING, seed).unwrap()
}

/// Storage, arithmetic and limit of every form of a dense kernel.
pub const DENSE_FORMS: [(Storage, Arithmetic, f64); 3] = [
    (Storage::F32, Arithmetic::Floats, KERNEL_LIMIT),
    (Storage::F16, Arithmetic::Floats, HALF_LIMIT),
    (Storage::F16, Arithmetic::Matrices, MATRIX_LIMIT),
];

/// What a kernel on matrices of halves may be wrong by. Rounding to a half changes a factor by at most 2^-11 of itself,
/// in the mean square over all of them by 2^-11 / sqrt(6); errors of two independent factors add up to a third of
/// 2^-22, and cancel in a sum as its terms do.
pub const MATRIX_LIMIT: f64 = 1.0 / (1u64 << 22) as f64;

/// Cases on matrices: all of them, or on a CPU driver, which takes ten seconds and more to compile a pipeline, the
/// first of them.
pub fn worth_compiling<T: Copy>(cases: &[T], on_cpu: usize) -> Vec<T> {
    let count = if device().info().kind == DeviceKind::Cpu { on_cpu } else { cases.len() };
    cases[..count].to_vec()
}

/// The portable kernels.
pub const PORTABLE: KernelTarget = KernelTarget { cpu: false, images: false, output_half: false };

/// What to choose kernels for: the portable ones; with weights handed round in the subgroup, if the device can.
pub fn targets() -> Vec<KernelTarget> {
    let all = [PORTABLE, KernelTarget { cpu: true, ..PORTABLE }];
    all.into_iter().filter(|target| !target.cpu || Bench::can_run_cpu_kernels(device())).collect()
}

/// Makes the buffers on a bench, in order, and fills those of weights.
pub fn make_buffers(bench: &mut Bench, buffers: &[Buffer], weights: &Weights) {
    for (i, buffer) in buffers.iter().enumerate() {
        let id = bench.buffer(&buffer.name, buffer.bytes).unwrap();
        assert_eq!(id, BufferId(i));
        if let Place::Weights { pack, .. } = &buffer.place {
            bench.upload(id, bytemuck::cast_slice(&pack.words(weights).unwrap()));
        }
    }
}

/// The bits of a tile list, as the device reads them.
pub fn tile_bits(tiles: &[(u32, u32)]) -> Vec<f32> {
    let entries = tiles.iter().map(|(x, y)| x | y << 16);
    std::iter::once(tiles.len() as u32).chain(entries).map(f32::from_bits).collect()
}

enum Content {
    Nothing,
    Floats(Vec<f32>),
    Tiles(Vec<(u32, u32)>),
}

/// A list of cases, run together.
pub struct Cases {
    /// Where shapes and values come from.
    pub random: Random,
    /// How maps are stored from now on.
    pub storage: Storage,
    /// What dense kernels compute with from now on. On matrices maps are whole vectors of halves.
    pub arithmetic: Arithmetic,
    weights: Weights,
    buffers: Vec<Buffer>,
    contents: Vec<Content>,
    cases: Vec<(Call, BufferId)>,
}

impl Cases {
    /// No cases yet. Packs are made from `weights`; those of dense kernels may ask for less than a tensor holds.
    pub fn new(seed: u64, weights: Weights) -> Self {
        let storage = Storage::F32;
        Self {
            random: Random::new(seed),
            storage,
            arithmetic: Arithmetic::Floats,
            weights,
            buffers: Vec::new(),
            contents: Vec::new(),
            cases: Vec::new(),
        }
    }

    fn push(&mut self, name: &str, bytes: u64, place: Place, content: Content) -> BufferId {
        let name = format!("{name} {}", self.buffers.len());
        self.buffers.push(Buffer { name, bytes, storage: Storage::F32, place });
        self.contents.push(content);
        BufferId(self.buffers.len() - 1)
    }

    fn in_arena(&mut self, name: &str, bytes: usize, content: Content) -> BufferId {
        self.push(name, bytes as u64, Place::Arena { block: 0, offset: 0 }, content)
    }

    /// A buffer that the kernel reads.
    pub fn filled(&mut self, name: &str, values: Vec<f32>) -> BufferId {
        self.in_arena(name, 4 * values.len(), Content::Floats(values))
    }

    /// A buffer that the kernel writes.
    pub fn empty(&mut self, name: &str, elements: usize) -> BufferId {
        self.in_arena(name, 4 * elements, Content::Nothing)
    }

    /// Packed weights of a dense kernel, as it computes.
    pub fn dense_pack(&mut self, pack: Pack) -> BufferId {
        match self.arithmetic {
            Arithmetic::Floats => self.pack(pack),
            Arithmetic::Matrices => self.pack(Pack::Halves(Box::new(pack))),
        }
    }

    /// Packed weights.
    pub fn pack(&mut self, pack: Pack) -> BufferId {
        let bytes = 4 * pack.len() as u64;
        self.push("weights", bytes, Place::Weights { pack, offset: 0, turned: false }, Content::Nothing)
    }

    /// A map of random values in -`scale`..`scale`, somewhere in the channels and rows of a larger one.
    pub fn map(&mut self, size: (u32, u32), channels: u32, scale: f32) -> View {
        self.map_between(size, channels, -scale, scale)
    }

    /// The same of values in `low`..`high`.
    pub fn map_between(&mut self, size: (u32, u32), channels: u32, low: f32, high: f32) -> View {
        let view = self.target(size, channels);
        let Buffer { bytes, storage, .. } = &self.buffers[view.buffer.0];
        let mut values = self.random.values((bytes / storage.bytes()) as usize, low, high);
        if *storage == Storage::F16 {
            values.iter_mut().for_each(|value| *value = f16::from_f32(*value).to_f32());
        }
        self.contents[view.buffer.0] = Content::Floats(values);
        view
    }

    /// A map to write, somewhere in the channels and rows of a larger one.
    pub fn target(&mut self, (width, height): (u32, u32), channels: u32) -> View {
        let channels = channels.next_multiple_of(4);
        let vector = if self.arithmetic == Arithmetic::Matrices { 8 } else { 4 };
        let first = vector * self.random.pick(&[0, 0, 1, 3, 8]);
        let stride = (first + channels).next_multiple_of(vector) + vector * self.random.pick(&[0, 0, 1, 5]);
        let (top, below) = (8 * self.random.pick(&[0, 0, 1, 2]), 8 * self.random.pick(&[0, 0, 1]));
        let storage = self.storage;
        // An even number of halves fills whole words.
        let elements = u64::from(width * (top + height + below) * stride);
        let buffer = self.in_arena("map", (elements * storage.bytes()) as usize, Content::Nothing);
        self.buffers[buffer.0].storage = storage;
        View { buffer, first, channels, stride, width, height, top, storage }
    }

    /// Every tile of a map, a rectangle, or some of them in any order.
    pub fn tiles(&mut self, size: (u32, u32)) -> Tiles {
        self.tiles_from(size, HALF_TILE)
    }

    /// The same for kernels that work on windows, whose rectangles begin with a window.
    pub fn windows(&mut self, size: (u32, u32)) -> Tiles {
        self.tiles_from(size, TILE)
    }

    fn tiles_from(&mut self, (width, height): (u32, u32), grain: u32) -> Tiles {
        let mut list: Vec<_> = (0..height / 8).flat_map(|y| (0..width / 8).map(move |x| (x, y))).collect();
        match self.random.integer(0, 3) {
            0 | 1 => return Tiles::All,
            2 => {
                let mut axis = |size: u32| {
                    let tiles = self.random.integer(1, size / TILE);
                    (grain * self.random.integer(0, (size - tiles * TILE) / grain), tiles)
                };
                let ((x, columns), (y, rows)) = (axis(width), axis(height));
                return Tiles::Rect(TileRect { x, y, columns, rows });
            }
            _ => {}
        }
        for i in (1..list.len()).rev() {
            list.swap(i, self.random.integer(0, i as u32) as usize);
        }
        list.truncate(self.random.integer(0, list.len() as u32) as usize);
        // The host need not know how many they are.
        let at_most = list.len() as u32 + self.random.pick(&[0, 0, 1, 20]);
        let buffer = self.in_arena("tiles", 4 * (1 + list.len()), Content::Tiles(list));
        Tiles::List { buffer, at_most }
    }

    /// Adds a call that writes `result`.
    pub fn add(&mut self, call: Call, result: BufferId) {
        self.cases.push((call, result));
    }

    /// Runs all calls with all variants, twice, and compares: results within `limit`, elements that are not to be
    /// written, inputs and surroundings untouched, both runs equal in every bit. Prints the worst NMSE.
    pub fn check(&self, name: &str, limit: f64) {
        let in_halves = self.buffers.iter().any(|buffer| buffer.storage == Storage::F16);
        if in_halves && !Bench::can_store_halves(device()) {
            return println!("{name}: the device cannot store halves, maps of them are not tested");
        }
        let on_matrices = self.cases.iter().filter(|(call, _)| call.kernel().choose(PORTABLE).is_on_matrices()).count();
        // One form alone, or the other two.
        assert!(on_matrices == 0 || on_matrices == self.cases.len(), "{name}: {on_matrices} cases are on matrices");
        if on_matrices > 0 && !device().has_matrices() {
            return println!("{name}: the device has no cooperative matrices, their kernels are not tested");
        }
        let forms = if on_matrices > 0 { vec![PORTABLE] } else { targets() };
        let expected = self.reference();
        for target in forms {
            let mut bench = Bench::new(device(), target).unwrap();
            make_buffers(&mut bench, &self.buffers, &self.weights);
            let calls: Vec<Call> = self.cases.iter().map(|(call, _)| call.clone()).collect();
            let mut before = Vec::new();
            for (i, content) in self.contents.iter().enumerate() {
                match content {
                    Content::Nothing => {}
                    Content::Floats(values) => bench.upload(BufferId(i), &self.stored(i, values)),
                    Content::Tiles(tiles) => bench.upload(BufferId(i), &tile_bits(tiles)),
                }
                before.push(self.bits(&bench, BufferId(i)));
            }
            bench.run(&calls).unwrap();
            let used: Vec<u64> = self.buffers.iter().map(|buffer| buffer.bytes).collect();
            bench.check_guards(&used).unwrap();
            let after: Vec<_> = (0..before.len()).map(|i| self.bits(&bench, BufferId(i))).collect();

            let mut worst = 0.0f64;
            for (case, (call, result)) in self.cases.iter().enumerate() {
                let nmse = compare(&self.elements(*result, &after[result.0], &expected[case]), &expected[case])
                    .unwrap_or_else(|wrong| panic!("{name} {target:?}: {wrong} in {call:?}"));
                assert!(nmse <= limit, "{name} {target:?}: NMSE {nmse:.1e} in {call:?}");
                worst = worst.max(nmse);
            }
            for (i, (before, after)) in before.iter().zip(&after).enumerate() {
                let is_result = self.cases.iter().any(|(_, result)| result.0 == i);
                assert!(is_result || before == after, "{name}: {} was overwritten", self.buffers[i].name);
            }
            bench.run(&calls).unwrap();
            for (_, result) in &self.cases {
                assert!(self.bits(&bench, *result) == after[result.0], "{name}: another run, other bits");
            }
            let kind = match target.cpu {
                _ if on_matrices > 0 => "on matrices",
                true => "for CPU drivers",
                false => "portable",
            };
            println!("{name}, {kind}: {} cases, NMSE {worst:.1e}", self.cases.len());
        }
        assert_no_validation_messages();
    }

    /// Every result as it should be; NaN where nothing is to be written.
    fn reference(&self) -> Vec<Vec<f64>> {
        let mut reference = Reference::for_calls(Extent::new(1, 1), &self.buffers, &self.weights).unwrap();
        for (i, content) in self.contents.iter().enumerate() {
            match content {
                Content::Nothing => {}
                Content::Floats(values) => {
                    let wide: Vec<f64> = values.iter().map(|&v| v.into()).collect();
                    reference.set_buffer(BufferId(i), &wide);
                }
                Content::Tiles(tiles) => reference.set_tiles(BufferId(i), tiles),
            }
        }
        let mut results = Vec::new();
        for (call, result) in &self.cases {
            reference.run_call(call);
            results.push(reference.buffer(*result).to_vec());
        }
        results
    }

    /// Values as a buffer stores them, in words.
    fn stored(&self, buffer: usize, values: &[f32]) -> Vec<f32> {
        match self.buffers[buffer].storage {
            Storage::F32 => values.to_vec(),
            Storage::F16 => {
                let halves = |pair: &[f32]| {
                    pair.iter().rev().fold(0, |word, v| word << 16 | u32::from(f16::from_f32(*v).to_bits()))
                };
                values.chunks(2).map(|pair| f32::from_bits(halves(pair))).collect()
            }
        }
    }

    /// The elements in a buffer's words, as the bits of 32-bit floats; where nothing is expected, the sentinel's are
    /// the sentinel (elsewhere they may be a value).
    fn elements(&self, id: BufferId, words: &[u32], expected: &[f64]) -> Vec<u32> {
        if self.buffers[id.0].storage == Storage::F32 {
            return words.to_vec();
        }
        let unwritten = [SENTINEL & 0xffff, SENTINEL >> 16];
        let halves = words.iter().flat_map(|word| [word & 0xffff, word >> 16]).zip(expected).enumerate();
        let element = |(i, (half, expected)): (usize, (u32, &f64))| match expected.is_nan() && half == unwritten[i % 2]
        {
            true => SENTINEL,
            false => f16::from_bits(half as u16).to_f32().to_bits(),
        };
        halves.map(element).collect()
    }

    fn bits(&self, bench: &Bench, id: BufferId) -> Vec<u32> {
        let values = bench.download(id, self.buffers[id.0].bytes as usize / 4);
        values.into_iter().map(f32::to_bits).collect()
    }
}

/// NMSE of what was to be written; an error where something else was.
pub fn compare(found: &[u32], expected: &[f64]) -> Result<f64, String> {
    let (mut written, mut wanted) = (Vec::new(), Vec::new());
    for (i, (&bits, &value)) in found.iter().zip(expected).enumerate() {
        if !value.is_nan() {
            written.push(f32::from_bits(bits));
            wanted.push(value);
        } else if bits != SENTINEL {
            return Err(format!("element {i} was written"));
        }
    }
    Ok(nmse(&written, &wanted))
}
