//! Every kernel of the network but its convolutions against its f64 twin, over random shapes, strides, channel ranges
//! and lists of tiles.

mod common;

use common::case::{Cases, DENSE_FORMS, KERNEL_LIMIT, MATRIX_LIMIT, STORAGES, small_net, worth_compiling};
use common::dense::{ACTIVATIONS, dense_cases, ending, size};
use half::f16;
use vkdenoise::kernels::aux_projection::AuxProjection;
use vkdenoise::kernels::dense::Linear;
use vkdenoise::kernels::expand::Expand;
use vkdenoise::kernels::film::{FilmVector, TokenSum};
use vkdenoise::kernels::maps::{Depthwise3x3, LayerNorm};
use vkdenoise::kernels::separable::Separable3x3;
use vkdenoise::kernels::unembed::Unembed;
use vkdenoise::kernels::{Activation, Arithmetic, Call, KernelTarget, Storage, TILE, Tiles, View};
use vkdenoise::net::{Block, Convolution, LinearPart, LinearWeight};
use vkdenoise::plan::pack::Pack;
use vkdenoise::testing::Bench;

/// Down to maps of one tile, every token of which but those in the middle is near a border.
#[test]
fn unembed() {
    for (storage, arithmetic, limit) in [
        (Storage::F32, Arithmetic::Floats, KERNEL_LIMIT),
        (Storage::F16, Arithmetic::Floats, KERNEL_LIMIT),
        (Storage::F16, Arithmetic::Matrices, MATRIX_LIMIT),
    ] {
        let on_matrices = worth_compiling(&[32, 16, 48], 1);
        for base in if arithmetic == Arithmetic::Matrices { on_matrices } else { vec![8, 24, 32] } {
            let mut cases = map_cases(base);
            cases.arithmetic = arithmetic;
            for _ in 0..8 {
                let size = size(&mut cases, 8);
                cases.storage = storage;
                let src = cases.map(size, base, 3.0);
                cases.storage = Storage::F32;
                let dst = cases.target((2 * size.0, 2 * size.1), 3);
                let (spread, gather, inputs) = ("patch_unembed".into(), "output".into(), base);
                let pack = match arithmetic {
                    Arithmetic::Floats => Pack::Unembed { spread, gather, inputs },
                    Arithmetic::Matrices => Pack::UnembedMatrix { spread, gather, inputs },
                };
                let (weights, tiles) = (cases.pack(pack), cases.tiles(size));
                let call = Unembed { src, dst, weights, tiles, arithmetic };
                cases.add(Call::Unembed(call), dst.buffer);
            }
            cases.check(&format!("unembed of {base} channels"), limit);
        }
    }
}

#[test]
fn separable3x3() {
    for (storage, arithmetic, limit) in DENSE_FORMS {
        let on_matrices = worth_compiling(&[8, 24, 40], 1);
        for base in if arithmetic == Arithmetic::Matrices { on_matrices } else { vec![8, 24, 40] } {
            let mut cases = map_cases(base);
            (cases.storage, cases.arithmetic) = (storage, arithmetic);
            let tensors =
                [("enc.0.0.ffn", "depthwise", "contract", 4, 1), ("enc.1.0.ffn", "depthwise", "contract", 8, 2)];
            let conv = ("enc.1.0.conv", "depthwise", "pointwise", 2, 2);
            for (owner, first, second, inputs, outputs) in [&tensors[..], &[conv]].concat().repeat(3) {
                let (size, inputs, outputs) = (size(&mut cases, 8), inputs * base, outputs * base);
                let (src, dst) = (cases.map(size, inputs, 3.0), cases.target(size, outputs));
                let pack = Pack::Depthwise { weight: format!("{owner}.{first}"), channels: inputs };
                let tiles = cases.tiles(size);
                let ending = ending(&mut cases, outputs);
                let activation = match ending.activation {
                    Activation::None => Activation::Relu,
                    Activation::Relu => Activation::LeakyRelu,
                    Activation::LeakyRelu => Activation::None,
                };
                // Never stored.
                let between = View { buffer: src.buffer, first: 0, stride: inputs, channels: inputs, ..dst };
                let depthwise = Depthwise3x3 { src, dst: between, weights: cases.pack(pack), activation, tiles };
                let parts = vec![LinearPart { prefix: format!("{owner}.{second}"), outputs }];
                let pointwise = Linear {
                    src: between,
                    src_b: None,
                    norm: false,
                    dst,
                    weights: cases.dense_pack(Pack::Linear(LinearWeight {
                        parts,
                        inputs,
                        columns: 0..inputs,
                        bias: true,
                        norm: None,
                    })),
                    film: ending.film,
                    residual: ending.residual.then(|| cases.map(size, outputs, 1.0)),
                    activation: ending.activation,
                    tiles,
                    arithmetic,
                };
                cases.add(Call::Separable3x3(Separable3x3 { depthwise, pointwise }), dst.buffer);
            }
            cases.check(&format!("separable3x3 of multiples of {base}"), limit);
        }
    }
}

/// Channels of both inputs and whether they are normed, of the Linears that hold their inputs on CPU drivers.
const HELD_INPUTS: [(u32, u32, bool); 10] = [
    (8, 0, false),
    (16, 0, false),
    (16, 0, true),
    (32, 0, false),
    (32, 0, true),
    (64, 0, false),
    (64, 0, true),
    (16, 48, false),
    (60, 4, false),
    (128, 0, true),
];

#[test]
fn linear() {
    for (storage, limit) in STORAGES {
        let mut cases = dense_cases(4);
        cases.storage = storage;
        for case in 0..50 {
            let size = size(&mut cases, 8);
            let first: u32 = cases.random.pick(&[4, 7, 8, 12, 32, 36, 64, 256]);
            // A second input follows the first's own channels, which then are a multiple of four.
            let second = cases.random.pick(&[0, 0, 4, 12, 32, 64]) * u32::from(first.is_multiple_of(4));
            let normed = second == 0 && first.is_multiple_of(4) && cases.random.coin();
            let (first, second, normed) = HELD_INPUTS.get(case).copied().unwrap_or((first, second, normed));
            let mut parts = vec![];
            let names = [vec!["q"], vec!["q", "k"], vec!["q", "k", "v"], vec!["v"]];
            let chosen = cases.random.integer(0, 3) as usize;
            for name in &names[chosen] {
                let outputs = cases.random.pick(&[4, 8, 16, 20, 32, 68]);
                parts.push(LinearPart { prefix: format!("bottleneck.0.{name}"), outputs });
            }
            let outputs = parts.iter().map(|part| part.outputs).sum();
            let column = if normed { 0 } else { cases.random.pick(&[0, 0, 3, 40]) };
            let columns = column..column + first + second;
            let inputs = columns.end + cases.random.pick(&[0, 0, 5]);
            let norm = normed.then(|| "bottleneck.0.norm2".to_owned());
            let weight = LinearWeight { parts, inputs, columns, bias: cases.random.coin(), norm };
            let (src, dst) = (cases.map(size, first, 3.0), cases.target(size, outputs));
            let ending = ending(&mut cases, outputs);
            let call = Linear {
                src,
                src_b: (second > 0).then(|| cases.map(size, second, 3.0)),
                norm: normed,
                dst,
                weights: cases.pack(Pack::Linear(weight)),
                film: ending.film,
                residual: ending.residual.then(|| cases.map(size, outputs, 1.0)),
                activation: ending.activation,
                tiles: cases.tiles(size),
                arithmetic: Arithmetic::Floats,
            };
            cases.add(Call::Linear(call), dst.buffer);
        }
        cases.check("linear", limit);
    }
}

/// Channels of both inputs and of the result, and whether the inputs are normed: every way to cut the work, the
/// networks' own and such as leave subgroups and columns over.
const MATRIX_SHAPES: [(u32, u32, u32, bool); 18] = [
    (32, 0, 32, false),
    (64, 192, 256, false),
    (40, 8, 68, false),
    (16, 0, 32, true),
    (128, 0, 512, true),
    (8, 0, 32, false),
    (16, 48, 64, false),
    (32, 96, 128, false),
    (128, 0, 32, false),
    (256, 0, 64, false),
    (24, 0, 20, false),
    (8, 16, 100, false),
    (16, 0, 16, true),
    (32, 0, 128, true),
    (64, 0, 256, true),
    (64, 0, 36, true),
    (128, 0, 4, true),
    (32, 0, 160, true),
];

#[test]
fn linear_on_matrices() {
    let mut cases = dense_cases(9);
    (cases.storage, cases.arithmetic) = (Storage::F16, Arithmetic::Matrices);
    for (first, second, outputs, normed) in worth_compiling(&MATRIX_SHAPES, 5).repeat(2) {
        let size = size(&mut cases, 8);
        let parts = vec![LinearPart { prefix: "bottleneck.0.ffn.expand".into(), outputs }];
        let columns = 0..first + second;
        let norm = normed.then(|| "bottleneck.0.norm2".to_owned());
        let weight = LinearWeight { parts, inputs: columns.end, columns, bias: cases.random.coin(), norm };
        let (src, dst) = (cases.map(size, first, 3.0), cases.target(size, outputs));
        let ending = ending(&mut cases, outputs);
        let call = Linear {
            src,
            src_b: (second > 0).then(|| cases.map(size, second, 3.0)),
            norm: normed,
            dst,
            weights: cases.dense_pack(Pack::Linear(weight)),
            film: ending.film,
            residual: ending.residual.then(|| cases.map(size, outputs, 1.0)),
            activation: ending.activation,
            tiles: cases.tiles(size),
            arithmetic: Arithmetic::Matrices,
        };
        cases.add(Call::Linear(call), dst.buffer);
    }
    cases.check("linear", MATRIX_LIMIT);
}

/// Cases for the kernels whose packs take whole tensors: of C, 2C and 4C channels.
fn map_cases(channels: u32) -> Cases {
    Cases::new(5, small_net(channels, Block::FilmCnn { conv: Convolution::Separable }))
}

/// From any half tile on, also an odd number of tiles, of which two side by side are a workgroup's.
#[test]
fn aux_projection_on_matrices() {
    let mut cases = map_cases(32);
    (cases.storage, cases.arithmetic) = (Storage::F16, Arithmetic::Matrices);
    for _ in 0..12 {
        let size = size(&mut cases, 8);
        let (src, dst) = (cases.map(size, 8, 3.0), cases.target(size, 32));
        let linear = |prefix: String, columns: std::ops::Range<u32>, inputs, bias| {
            let parts = vec![LinearPart { prefix, outputs: 32 }];
            Pack::Linear(LinearWeight { parts, inputs, columns, bias, norm: None })
        };
        let each = [0, 1, 2];
        let pointwise = each.map(|i| {
            let inputs = if i == 0 { 7 } else { 32 };
            cases.dense_pack(linear(format!("aux_proj.{i}.pointwise"), 0..inputs, inputs, true))
        });
        let depthwise =
            each.map(|i| cases.pack(Pack::Depthwise { weight: format!("aux_proj.{i}.depthwise"), channels: 32 }));
        let out = each.map(|i| cases.dense_pack(linear("aux_proj.out".into(), 32 * i..32 * i + 32, 96, i == 2)));
        // It takes no lists.
        let tiles = loop {
            match cases.tiles(size) {
                Tiles::List { .. } => {}
                tiles => break tiles,
            }
        };
        cases.add(Call::AuxProjection(AuxProjection { src, dst, pointwise, depthwise, out, tiles }), dst.buffer);
    }
    cases.check("aux_projection", MATRIX_LIMIT);
}

#[test]
fn depthwise3x3() {
    for (storage, limit) in STORAGES {
        for base in [8, 24, 40] {
            let mut cases = map_cases(base);
            cases.storage = storage;
            let tensors = [("enc.0.0.ffn", 4), ("enc.1.0.conv", 2), ("enc.1.0.ffn", 8), ("bottleneck.0.conv", 4)];
            for (owner, times) in tensors.repeat(3) {
                let (size, channels) = (size(&mut cases, 8), times * base);
                let (src, dst) = (cases.map(size, channels, 3.0), cases.target(size, channels));
                let weights = cases.pack(Pack::Depthwise { weight: format!("{owner}.depthwise"), channels });
                let activation = cases.random.pick(&ACTIVATIONS);
                let tiles = cases.tiles(size);
                cases.add(Call::Depthwise3x3(Depthwise3x3 { src, dst, weights, activation, tiles }), dst.buffer);
            }
            cases.check(&format!("depthwise3x3 of multiples of {base}"), limit);
        }
    }
}

#[test]
fn layer_norm() {
    for (storage, limit) in STORAGES {
        for base in [8, 24, 40, 128] {
            let mut cases = map_cases(base);
            cases.storage = storage;
            for (block, times) in [("enc.0.0", 1), ("enc.1.0", 2), ("bottleneck.0", 4)].repeat(3) {
                let (size, channels) = (size(&mut cases, 8), times * base);
                let scale = cases.random.pick(&[0.01, 1.0, 1000.0]);
                let (src, dst) = (cases.map(size, channels, scale), cases.target(size, channels));
                let weights = cases.pack(Pack::Norm { norm: format!("{block}.norm1"), channels });
                let tiles = cases.tiles(size);
                cases.add(Call::LayerNorm(LayerNorm { src, dst, weights, tiles }), dst.buffer);
            }
            // A large common value: squares without the mean would lose everything.
            let weights = cases.pack(Pack::Norm { norm: "enc.0.0.norm2".into(), channels: base });
            let dst = cases.target((16, 8), base);
            let far = cases.random.values(16 * 8 * base as usize, 100.0, 110.0);
            let src = View { buffer: cases.filled("far", far), first: 0, stride: base, top: 0, ..dst };
            // Halves have few digits left there.
            if storage == Storage::F32 {
                cases.add(Call::LayerNorm(LayerNorm { src, dst, weights, tiles: Tiles::All }), dst.buffer);
            }
            cases.check(&format!("layer_norm of multiples of {base}"), limit);
        }
    }
}

#[test]
fn film_means_and_vectors() {
    for (storage, limit) in STORAGES {
        for base in [8, 24, 40, 128] {
            let mut cases = map_cases(base);
            cases.storage = storage;
            for (real_width, real_height) in [(1, 1), (7, 1), (64, 33), (70, 45), (9, 31), (256, 300)] {
                let padded = (u32::next_multiple_of(real_width, 8), u32::next_multiple_of(real_height, 8) + 8);
                let src = cases.map(padded, base, 3.0);
                let mut sum = TokenSum { src, real_width, real_height, dst: src.buffer, computed: None };
                sum.dst = cases.empty("partials", sum.sums() as usize * base as usize);
                let dst = sum.dst;
                cases.add(Call::TokenSum(sum), dst);
            }
            let blocks = [("enc.0.0", 1), ("enc.1.0", 2), ("bottleneck.0", 4)];
            for (sums, (block, times)) in [1, 3, 33, 70, 1000, 4096].into_iter().zip(blocks.repeat(2)) {
                let (channels, outputs) = (times * base, 2 * times * base);
                let (weight, norm) = (format!("{block}.film"), format!("{block}.norm1_f"));
                let partials = cases.random.values(sums as usize * channels as usize, -50.0, 60.0);
                let partials = cases.filled("partials", partials);
                let weights = cases.pack(Pack::FilmVector { weight, norm, inputs: channels, outputs });
                let dst = cases.empty("film", outputs as usize);
                let tokens = 64 * sums;
                let call = FilmVector { partials, sums, tokens, counts: None, channels, weights, dst, outputs };
                cases.add(Call::FilmVector(call), dst);
            }
            cases.check(&format!("film of multiples of {base}"), limit);
        }
    }
}

#[test]
fn expand() {
    for (storage, _) in STORAGES {
        let mut cases = map_cases(8);
        cases.storage = storage;
        for channels in [4, 8, 32, 20].repeat(5) {
            let mut side = || 8 * cases.random.integer(2, 4);
            let small = (side(), side());
            let mut more = |side: u32| side + 8 * cases.random.pick(&[0, 1, 2, 5]);
            let size = (more(small.0), more(small.1));
            let (src, dst) = (cases.map(small, channels, 3.0), cases.target(size, channels));
            let tiles = cases.tiles(size);
            cases.add(Call::Expand(Expand { src, dst, tiles }), dst.buffer);
        }
        cases.check("expand", 0.0);
    }
}

/// Every half, what lies midway to the next one and the floats beside that, of both signs, and what halves do not hold.
#[test]
fn halves_are_rounded_to_the_nearest_and_ties_to_even() {
    let device = common::device::device();
    if !Bench::can_store_halves(device) || !Bench::can_run_cpu_kernels(device) {
        return println!("the device does not run kernels for CPU drivers that store halves, they are not tested");
    }
    let half = |bits: u16| f16::from_bits(bits).to_f32();
    let mut values: Vec<f32> = (0..0x7bff)
        .flat_map(|bits| {
            let middle = 0.5 * (half(bits) + half(bits + 1));
            [half(bits), middle.next_down(), middle, middle.next_up()]
        })
        .chain([65504.0, 65520f32.next_down(), 65520.0, 65536.0, 1e5, f32::MAX, f32::INFINITY, f32::NAN])
        .chain([1e-45, f32::MIN_POSITIVE, 1e-9])
        .flat_map(|value| [value, -value])
        .collect();
    let (width, channels) = (128, 4);
    values.resize(values.len().next_multiple_of((width * TILE * channels) as usize), 0.0);
    let height = values.len() as u32 / (width * channels);

    let target = KernelTarget { cpu: true, ..Bench::default_target(device) };
    let mut bench = Bench::new(device, target).unwrap();
    let mut map = |name, storage: Storage| {
        let buffer = bench.buffer(name, values.len() as u64 * storage.bytes()).unwrap();
        View { buffer, first: 0, channels, stride: channels, width, height, top: 0, storage }
    };
    let (src, dst) = (map("floats", Storage::F32), map("halves", Storage::F16));
    bench.upload(src.buffer, &values);
    bench.run(&[Call::Expand(Expand { src, dst, tiles: Tiles::All })]).unwrap();
    let words = bench.download(dst.buffer, values.len() / 2);
    let found = words.iter().flat_map(|word| [word.to_bits() as u16, (word.to_bits() >> 16) as u16]);
    for (value, found) in values.iter().zip(found) {
        let wanted = f16::from_f32(*value);
        let found = f16::from_bits(found);
        let same = found.to_bits() == wanted.to_bits() || found.is_nan() && wanted.is_nan();
        assert!(same, "{value:e} ({:#x}): {found:?}, not {wanted:?}", value.to_bits());
    }
}
