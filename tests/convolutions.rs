//! The dense 3x3 convolutions, two of them as one kernel, and FFNs around a depthwise one, against their f64 twins,
//! over random shapes, strides, channel ranges and lists of tiles.

mod common;

use common::case::{Cases, KERNEL_LIMIT, MATRIX_LIMIT, STORAGES, small_hybrid, small_net, worth_compiling};
use common::dense::{dense_cases, ending, size};
use vkdenoise::kernels::dense::Conv3x3;
use vkdenoise::kernels::embedding::{Early, Embedding, Pixels};
use vkdenoise::kernels::ffn::Ffn;
use vkdenoise::kernels::maps::LayerNorm;
use vkdenoise::kernels::normed_conv::NormedConv3x3;
use vkdenoise::kernels::winograd::{Winograd3x3, WinogradTile};
use vkdenoise::kernels::{Activation, Arithmetic, Call, Shuffle, Storage, Tiles};
use vkdenoise::net::{Block, ConvWeight, Convolution, Head, LinearPart, LinearWeight};
use vkdenoise::plan::pack::Pack;

fn add_conv(cases: &mut Cases, (inputs, outputs): (u32, u32), stride: u32, shuffle: Shuffle) {
    add_conv_by(cases, (inputs, outputs), stride, shuffle, None);
}

fn add_conv_by(
    cases: &mut Cases,
    (inputs, outputs): (u32, u32),
    stride: u32,
    shuffle: Shuffle,
    tile: Option<WinogradTile>,
) {
    let unit = if shuffle == Shuffle::Unshuffle { 16 } else { 8 };
    let (width, height) = size(cases, unit);
    let channels = outputs.next_multiple_of(4);
    let bias = cases.random.coin();
    let (weight, phases) = (ConvWeight::Tensor("bottleneck.0.ffn.expand".into()), shuffle == Shuffle::Shuffle);
    let pack = match tile {
        None => Pack::Conv3x3 { weight, bias, inputs, outputs, shuffle: phases },
        Some(tile) => Pack::Winograd3x3 { weight, bias, inputs, outputs, shuffle: phases, tile },
    };
    let storage = cases.storage;
    // The network's input are 32-bit floats.
    cases.storage = if cases.arithmetic == Arithmetic::Matrices && inputs < 8 { Storage::F32 } else { storage };
    let src = cases.map((width * stride, height * stride), inputs, 3.0);
    cases.storage = storage;
    let dst = match shuffle {
        Shuffle::None => cases.target((width, height), outputs),
        Shuffle::Unshuffle => cases.target((width / 2, height / 2), 4 * outputs),
        Shuffle::Shuffle => cases.target((2 * width, 2 * height), outputs / 4),
    };
    // The engine has no FiLM before a shuffle, and no residual before one that makes maps smaller.
    let plain = shuffle == Shuffle::None;
    let ending = ending(cases, channels);
    let residual = (shuffle != Shuffle::Unshuffle && ending.residual).then(|| match plain {
        true => cases.map((width, height), outputs, 1.0),
        false => cases.map((2 * width, 2 * height), outputs / 4, 1.0),
    });
    let call = Conv3x3 {
        src,
        dst,
        channels,
        weights: cases.dense_pack(pack),
        film: ending.film.filter(|_| plain),
        residual,
        stride,
        activation: ending.activation,
        shuffle,
        tiles: cases.tiles((width, height)),
        arithmetic: cases.arithmetic,
    };
    match tile {
        None => cases.add(Call::Conv3x3(call), dst.buffer),
        Some(tile) => cases.add(Call::Winograd3x3(Winograd3x3 { conv: call, tile }), dst.buffer),
    }
}

#[test]
fn conv3x3() {
    for (storage, limit) in STORAGES {
        let mut cases = dense_cases(1);
        cases.storage = storage;
        for _ in 0..4 {
            for outputs in [1, 3, 4, 8, 20, 32, 36, 64, 100] {
                let inputs = cases.random.pick(&[3, 4, 7, 12, 32, 40]);
                add_conv(&mut cases, (inputs, outputs), 1, Shuffle::None);
            }
        }
        cases.check("conv3x3", limit);
    }
}

#[test]
fn conv3x3_of_stride_2() {
    for (storage, limit) in STORAGES {
        let mut cases = dense_cases(2);
        cases.storage = storage;
        for _ in 0..3 {
            for outputs in [12, 32, 44, 64] {
                let inputs = cases.random.pick(&[3, 4, 12, 32, 36]);
                add_conv(&mut cases, (inputs, outputs), 2, Shuffle::None);
            }
        }
        cases.check("conv3x3 of stride 2", limit);
    }
}

#[test]
fn conv3x3_with_shuffles() {
    for (storage, limit) in STORAGES {
        let mut cases = dense_cases(3);
        cases.storage = storage;
        for _ in 0..3 {
            for outputs in [4, 8, 16, 20, 32, 48] {
                let inputs = cases.random.pick(&[4, 8, 12, 32, 36]);
                add_conv(&mut cases, (inputs, outputs), 1, Shuffle::Unshuffle);
            }
            for outputs in [16, 32, 48, 64, 112, 128] {
                let inputs = cases.random.pick(&[4, 8, 12, 32, 36]);
                add_conv(&mut cases, (inputs, outputs), 1, Shuffle::Shuffle);
            }
        }
        cases.check("conv3x3 with shuffles", limit);
    }
}

/// Channels in and out: the networks' own, and such as leave subgroups and columns over.
#[test]
fn conv3x3_on_matrices() {
    let mut cases = dense_cases(4);
    (cases.storage, cases.arithmetic) = (Storage::F16, Arithmetic::Matrices);
    let plain = [(3, 32), (32, 64), (32, 32), (4, 20), (3, 100), (16, 8), (64, 36), (48, 128), (80, 100)];
    for channels in worth_compiling(&plain, 2).repeat(3) {
        add_conv(&mut cases, channels, 1, Shuffle::None);
    }
    for channels in worth_compiling(&[(32, 32), (16, 12), (32, 64), (64, 44), (48, 160)], 1).repeat(2) {
        add_conv(&mut cases, channels, 2, Shuffle::None);
    }
    for channels in worth_compiling(&[(32, 16), (64, 32), (128, 64), (32, 8), (16, 20)], 1).repeat(2) {
        add_conv(&mut cases, channels, 1, Shuffle::Unshuffle);
    }
    for channels in worth_compiling(&[(64, 128), (32, 64), (64, 256), (48, 48), (16, 16)], 1).repeat(2) {
        add_conv(&mut cases, channels, 1, Shuffle::Shuffle);
    }
    cases.check("conv3x3", MATRIX_LIMIT);
}

/// Convolutions that norm what they stage, of all channels that they can at once.
#[test]
fn normed_conv3x3_on_matrices() {
    for (inputs, all) in worth_compiling(&[(32, [32, 64, 100]), (16, [8, 40, 128])], 1) {
        let mut cases = Cases::new(5, small_net(inputs, Block::Jsa));
        (cases.storage, cases.arithmetic) = (Storage::F16, Arithmetic::Matrices);
        for outputs in worth_compiling(&all, 1).repeat(4) {
            let size = size(&mut cases, 8);
            let src = cases.map(size, inputs, 3.0);
            let dst = cases.target(size, outputs);
            let (weight, bias) = (ConvWeight::Tensor("bottleneck.0.ffn.expand".into()), cases.random.coin());
            let ending = ending(&mut cases, outputs);
            let residual = ending.residual.then(|| cases.map(size, outputs, 1.0));
            let norm = Pack::Norm { norm: "enc.0.0.norm1".into(), channels: inputs };
            let norm = LayerNorm { src, dst: src, weights: cases.pack(norm), tiles: Tiles::All };
            let conv = Conv3x3 {
                src,
                dst,
                channels: outputs,
                weights: cases.dense_pack(Pack::Conv3x3 { weight, bias, inputs, outputs, shuffle: false }),
                film: ending.film,
                residual,
                stride: 1,
                activation: ending.activation,
                shuffle: Shuffle::None,
                tiles: cases.tiles(size),
                arithmetic: cases.arithmetic,
            };
            cases.add(Call::NormedConv3x3(NormedConv3x3::joined(norm, conv).unwrap()), dst.buffer);
        }
        cases.check("conv3x3 of normed tokens", MATRIX_LIMIT);
    }
}

/// Every form of convolution by Winograd's filtering.
fn winograd(seed: u64, tile: WinogradTile) -> Cases {
    let mut cases = dense_cases(seed);
    for _ in 0..3 {
        for outputs in [8, 16, 20, 32, 36, 64] {
            let inputs = cases.random.pick(&[3, 4, 7, 12, 32, 40]);
            add_conv_by(&mut cases, (inputs, outputs), 1, Shuffle::None, Some(tile));
        }
    }
    for outputs in [8, 16, 20, 48] {
        add_conv_by(&mut cases, (12, outputs), 1, Shuffle::Unshuffle, Some(tile));
    }
    for outputs in [16, 48, 64] {
        add_conv_by(&mut cases, (20, outputs), 1, Shuffle::Shuffle, Some(tile));
    }
    cases
}

#[test]
fn winograd3x3_of_2x2() {
    winograd(11, WinogradTile::F2).check("winograd3x3 of F(2x2)", KERNEL_LIMIT);
}

/// The transforms of six points grow rounding errors: by theory some tens of times in size where those of four do a
/// few.
#[test]
fn winograd3x3_of_4x4() {
    winograd(12, WinogradTile::F4).check("winograd3x3 of F(4x4)", KERNEL_LIMIT);
}

/// Down to maps of one tile, every token of which but those in the middle is near a border.
#[test]
fn ffn() {
    for (channels, activation) in worth_compiling(&[(64, Activation::Relu), (32, Activation::LeakyRelu)], 2) {
        let mut cases = Cases::new(12, small_net(channels, Block::FilmCnn { conv: Convolution::Standard }));
        (cases.storage, cases.arithmetic) = (Storage::F16, Arithmetic::Matrices);
        for _ in 0..6 {
            let (size, hidden) = (size(&mut cases, 8), 4 * channels);
            let linear = |name: &str, inputs, outputs, norm: Option<&str>| LinearWeight {
                parts: vec![LinearPart { prefix: format!("enc.0.0.{name}"), outputs }],
                inputs,
                columns: 0..inputs,
                bias: true,
                norm: norm.map(|norm| format!("enc.0.0.{norm}")),
            };
            let expand = linear("ffn.expand", channels, hidden, Some("norm2"));
            let back = linear("ffn.contract", hidden, channels, None);
            let (x, dst) = (cases.map(size, channels, 3.0), cases.target(size, channels));
            let call = Ffn {
                x,
                dst,
                biases: cases.pack(Pack::BiasRows(Box::new(Pack::Linear(expand.clone())))),
                expand: cases.dense_pack(Pack::Linear(expand)),
                depthwise: cases.pack(Pack::Depthwise { weight: "enc.0.0.ffn.depthwise".into(), channels: hidden }),
                activation,
                contract: cases.dense_pack(Pack::Linear(back)),
                hidden,
                tiles: cases.tiles(size),
            };
            cases.add(Call::Ffn(call), dst.buffer);
        }
        cases.check(&format!("ffn of {channels} channels"), MATRIX_LIMIT);
    }
}

/// Down to frames of one tile: projected pixels and pixels that are there, with and without what a head takes of them.
#[test]
fn embedding() {
    for (projected, with_early) in worth_compiling(&[(true, true), (true, false), (false, true), (false, false)], 4) {
        let mut cases = Cases::new(13, small_hybrid(Head::pure()));
        (cases.storage, cases.arithmetic) = (Storage::F16, Arithmetic::Matrices);
        for _ in 0..6 {
            let tokens = size(&mut cases, 8);
            let pixels = (2 * tokens.0, 2 * tokens.1);
            let conv = |name: &str, inputs| Pack::Conv3x3 {
                weight: ConvWeight::Tensor(name.into()),
                bias: true,
                inputs,
                outputs: 32,
                shuffle: false,
            };
            let linear = Pack::Linear(LinearWeight {
                parts: vec![LinearPart { prefix: "head.x0".into(), outputs: 32 }],
                inputs: 32,
                columns: 0..32,
                bias: true,
                norm: None,
            });
            let early = Early { weights: cases.dense_pack(linear), dst: cases.target(pixels, 32) };
            let (src, of_pixels) = if projected {
                let before = cases.map(pixels, 32, 2.0);
                cases.storage = Storage::F32;
                let color = cases.map(pixels, 4, 3.0);
                cases.storage = Storage::F16;
                let biases = cases.pack(Pack::BiasRows(Box::new(conv("color_proj", 3))));
                let weights = cases.dense_pack(conv("color_proj", 3));
                (color, Pixels::Projected { weights, biases, early: with_early.then_some((early, before)) })
            } else {
                (cases.map(pixels, 32, 3.0), Pixels::Stored { early: with_early.then_some(early) })
            };
            let dst = cases.target(tokens, 32);
            let embedding = cases.dense_pack(conv("patch_embed_x", 32));
            let tiles = cases.tiles(tokens);
            let call = Embedding { src, pixels: of_pixels, dst, embedding, tiles };
            cases.add(Call::Embedding(call.clone()), dst.buffer);
            if with_early {
                cases.add(Call::Embedding(call), early.dst.buffer);
            }
        }
        cases.check(&format!("embedding, projected {projected}, early {with_early}"), MATRIX_LIMIT);
    }
}
