//! Kernels at the ends of their range: huge logits, vectors without variance, means of very many tokens.

mod common;

use common::case::{KERNEL_LIMIT, PREPROCESSING, make_buffers, small_net, targets};
use common::compare::nmse;
use common::device::{assert_no_validation_messages, device};
use common::network::wide;
use common::planes::TestFrame;
use common::random::Random;
use std::collections::BTreeMap;
use vkdenoise::frame::{Extent, Layout, PlaneMut};
use vkdenoise::kernels::film::{FilmVector, TokenSum};
use vkdenoise::kernels::maps::LayerNorm;
use vkdenoise::kernels::window_attention::WindowAttention;
use vkdenoise::kernels::{Arithmetic, BufferId, Call, Storage, Tiles, View};
use vkdenoise::net::{Arch, Block, Convolution, Graph, Weights};
use vkdenoise::plan::pack::Pack;
use vkdenoise::plan::{Buffer, Place};
use vkdenoise::reference::Reference;
use vkdenoise::testing::Bench;
use vkdenoise::{Denoiser, Options};

const TOKENS: usize = 64;
const TABLE: &str = "bottleneck.0.bias_table";

/// One window of one head: Q, K and V, Qf and Kf, `[token][channel]`.
struct Window {
    keys: usize,
    values: usize,
    x: Vec<f32>,
    f: Vec<f32>,
    /// The bias table's first head.
    bias: Vec<f64>,
}

impl Window {
    /// Random values whose scores of either map reach `logit`; the last channel of V is 1, so that it sums the row.
    fn new(random: &mut Random, weights: &Weights, (keys, values): (usize, usize), logit: f64) -> Self {
        let table = weights.tensor(TABLE).unwrap();
        let heads = table.shape[1] as usize;
        let bias = table.data.iter().step_by(heads).map(|&b| b.into()).collect();
        let (wide_x, wide_f) = (2 * keys + values, 2 * keys);
        let (x, f) = (random.values(TOKENS * wide_x, -1.0, 1.0), random.values(TOKENS * wide_f, -1.0, 1.0));
        let mut window = Self { keys, values, x, f, bias };
        let scale = |map: &mut [f32], width: usize, top: f64| {
            let factor = (logit / top).sqrt() as f32;
            map.chunks_exact_mut(width).for_each(|token| token[..2 * keys].iter_mut().for_each(|v| *v *= factor));
        };
        let top = |scores: Vec<f64>| scores.into_iter().fold(0.0, |top: f64, s| top.max(s.abs()));
        let [of_x, of_f] =
            [(&window.x, wide_x), (&window.f, wide_f)].map(|(map, width)| top(window.products(map, width)));
        scale(&mut window.x, wide_x, of_x);
        scale(&mut window.f, wide_f, of_f);
        window.x.chunks_exact_mut(wide_x).for_each(|token| token[wide_x - 1] = 1.0);
        window
    }

    /// `Q K^T / sqrt(d)`, row by row.
    fn products(&self, map: &[f32], width: usize) -> Vec<f64> {
        let part = |token: usize, first: usize| &map[token * width + first..][..self.keys];
        let dot = |q: &[f32], k: &[f32]| q.iter().zip(k).map(|(q, k)| f64::from(*q) * f64::from(*k)).sum::<f64>();
        let scale = (self.keys as f64).sqrt();
        (0..TOKENS * TOKENS).map(|i| dot(part(i / TOKENS, 0), part(i % TOKENS, self.keys)) / scale).collect()
    }

    /// The joint scores, row by row.
    fn joint(&self) -> Vec<f64> {
        let scores = [(&self.x, 2 * self.keys + self.values), (&self.f, 2 * self.keys)];
        let [x, f] = scores.map(|(map, width)| self.products(map, width));
        let bias = |i: usize| {
            let (from, to) = (i / TOKENS, i % TOKENS);
            self.bias[(from / 8 + 7 - to / 8) * 15 + from % 8 + 7 - to % 8]
        };
        x.iter().zip(&f).enumerate().map(|(i, (x, f))| (x + bias(i)) * (f + bias(i))).collect()
    }

    /// Whether 32-bit scores decide a row: its products stay small, or its best key stands out.
    fn is_decided(row: &[f64]) -> bool {
        let largest = row.iter().fold(0.0, |most: f64, s| most.max(s.abs()));
        let mut sorted = row.to_vec();
        sorted.sort_by(f64::total_cmp);
        largest < 1e3 || sorted[TOKENS - 1] - sorted[TOKENS - 2] > 1e-5 * largest
    }
}

/// Both scores reach 100, 1000 and 30,000: rows that are decided are those of f64 to 1e-3, every row's shares sum to 1
/// within 1e-3, nothing is NaN.
#[test]
fn attention_of_large_logits() {
    let weights = small_net(64, Block::Jsa);
    let mut random = Random::new(1);
    for (form, logit) in
        [(4, 8), (16, 32), (32, 64), (64, 64)].into_iter().flat_map(|f| [10.0, 100.0, 1e3, 3e4].map(|l| (f, l)))
    {
        let window = Window::new(&mut random, &weights, form, logit);
        let (keys, values) = (form.0 as u32, form.1 as u32);
        let tokens = TOKENS as u64;
        let sizes = [
            ("x", tokens * u64::from(2 * keys + values)),
            ("f", tokens * u64::from(2 * keys)),
            ("dst", tokens * u64::from(values)),
        ];
        let mut buffers: Vec<Buffer> = sizes.map(|(name, len)| arena(name, len)).into();
        let pack = Pack::BiasTable { table: TABLE.into(), heads: 1 };
        let bytes = 4 * pack.len() as u64;
        buffers.push(Buffer {
            name: "bias".into(),
            bytes,
            storage: Storage::F32,
            place: Place::Weights { pack, offset: 0, turned: false },
        });
        let view = |id, channels| View {
            buffer: BufferId(id),
            first: 0,
            channels,
            stride: channels,
            width: 8,
            height: 8,
            top: 0,
            storage: Storage::F32,
        };
        let call = Call::WindowAttention(WindowAttention {
            x: view(0, 2 * keys + values),
            f: view(1, 2 * keys),
            bias: BufferId(3),
            dst: view(2, values),
            heads: 1,
            key_width: keys,
            value_width: values,
            tiles: Tiles::All,
            arithmetic: Arithmetic::Floats,
        });
        let mut reference = Reference::for_calls(Extent::new(1, 1), &buffers, &weights).unwrap();
        reference.set_buffer(BufferId(0), &wide(&window.x));
        reference.set_buffer(BufferId(1), &wide(&window.f));
        reference.run_call(&call);
        let expected = reference.buffer(BufferId(2));
        let joint = window.joint();
        let reached = joint.iter().fold(0.0, |most: f64, s| most.max(s.abs()));
        for target in targets() {
            let mut bench = Bench::new(device(), target).unwrap();
            make_buffers(&mut bench, &buffers, &weights);
            bench.upload(BufferId(0), &window.x);
            bench.upload(BufferId(1), &window.f);
            bench.run(std::slice::from_ref(&call)).unwrap();
            let found = bench.download(BufferId(2), TOKENS * form.1);
            let (mut worst, mut decided) = (0.0f64, 0);
            let rows = found.chunks_exact(form.1).zip(expected.chunks_exact(form.1)).zip(joint.chunks_exact(TOKENS));
            for (i, ((found, expected), scores)) in rows.enumerate() {
                assert!(found.iter().all(|v| v.is_finite()), "{form:?} {logit} {target:?}: row {i}");
                let sum = found[form.1 - 1];
                assert!((sum - 1.0).abs() <= 1e-3, "{form:?} {logit} {target:?}: row {i} sums to {sum}");
                if Window::is_decided(scores) {
                    decided += 1;
                    let errors = found.iter().zip(expected).map(|(f, e)| (f64::from(*f) - e).abs());
                    worst = errors.fold(worst, f64::max);
                }
            }
            println!(
                "{form:?}, logits of {logit}, CPU kernels {}: products to {reached:.1e}, {decided} rows decided, error {worst:.1e}",
                target.cpu
            );
            assert!(worst <= 1e-3 && decided > 0, "{form:?} {logit} {target:?}: error {worst:.1e} of {decided} rows");
        }
    }
    assert_no_validation_messages();
}

fn arena(name: &str, elements: u64) -> Buffer {
    Buffer {
        name: name.into(),
        bytes: 4 * elements,
        storage: Storage::F32,
        place: Place::Arena { block: 0, offset: 0 },
    }
}

/// The whole network with logits as large as floats allow: whatever wins a row, the picture is sound.
#[test]
fn networks_of_large_logits_give_sound_pictures() {
    let arch = Arch::named("hybrid").unwrap();
    let hashed = Weights::hashed(&arch, PREPROCESSING, 4).unwrap();
    let frame = TestFrame::random(Extent::new(45, 70), 2);
    for factor in [1e2, 1e3, 3e4, 1e12] {
        let tensors: BTreeMap<_, _> = Graph::new(&arch)
            .unwrap()
            .tensors()
            .into_iter()
            .map(|spec| {
                let mut tensor = hashed.tensor(&spec.name).unwrap().clone();
                if [".q.weight", ".qf.weight"].iter().any(|end| spec.name.ends_with(end)) {
                    tensor.data.iter_mut().for_each(|v| *v *= factor);
                }
                (spec.name, tensor)
            })
            .collect();
        let weights = Weights::from_parts(arch.clone(), PREPROCESSING, tensors).unwrap();
        let mut denoiser = Denoiser::new(device(), &weights, &Options::default()).unwrap();
        let mut output = vec![f32::NAN; 3 * 45 * 70];
        denoiser.denoise(&frame.frame(), PlaneMut::f32(&mut output, Layout::interleaved(frame.extent, 3))).unwrap();
        assert!(output.iter().all(|v| v.is_finite() && *v >= 0.0), "logits times {factor:e}");
    }
    assert_no_validation_messages();
}

/// Vectors all of one value have no variance: what remains is the bias. Nearly constant ones are as exact as their
/// mean.
#[test]
fn layer_norm_without_variance() {
    let base = 32;
    let weights = small_net(base, Block::FilmCnn { conv: Convolution::Standard });
    let pack = Pack::Norm { norm: "enc.0.0.norm1".into(), channels: base };
    let bytes = 4 * pack.len() as u64;
    let len = TOKENS * base as usize;
    let buffers = [
        arena("src", len as u64),
        arena("dst", len as u64),
        Buffer {
            name: "norm".into(),
            bytes,
            storage: Storage::F32,
            place: Place::Weights { pack, offset: 0, turned: false },
        },
    ];
    let view = |id| View {
        buffer: BufferId(id),
        first: 0,
        channels: base,
        stride: base,
        width: 8,
        height: 8,
        top: 0,
        storage: Storage::F32,
    };
    let call = Call::LayerNorm(LayerNorm { src: view(0), dst: view(1), weights: BufferId(2), tiles: Tiles::All });
    // By token: the common value and what differs from it.
    let common = [0.0, 1e-30, -1.0, 1.0, 1000.0, -65504.0, 1e10, 1e18];
    let spread = [0.0, 1e-6, 1e-3, 1e-1, 1.0, 0.0, 10.0, 100.0];
    let mut random = Random::new(6);
    let mut src = Vec::new();
    for token in 0..TOKENS {
        let noise = random.values(base as usize, -1.0, 1.0);
        src.extend(noise.into_iter().map(|n| common[token % 8] + spread[token / 8] * n));
    }
    let mut reference = Reference::for_calls(Extent::new(1, 1), &buffers, &weights).unwrap();
    reference.set_buffer(BufferId(0), &wide(&src));
    reference.run_call(&call);
    let expected = reference.buffer(BufferId(1));
    let gain = weights.tensor("enc.0.0.norm1.weight").unwrap();
    for target in targets() {
        let mut bench = Bench::new(device(), target).unwrap();
        make_buffers(&mut bench, &buffers, &weights);
        bench.upload(BufferId(0), &src);
        bench.run(std::slice::from_ref(&call)).unwrap();
        let found = bench.download(BufferId(1), len);
        for (i, (&found, &expected)) in found.iter().zip(expected).enumerate() {
            let token = &src[i / base as usize * base as usize..][..base as usize];
            let mean = token.iter().map(|&v| f64::from(v)).sum::<f64>() / f64::from(base);
            let variance = token.iter().map(|&v| (f64::from(v) - mean).powi(2)).sum::<f64>() / f64::from(base);
            // The mean is rounded to a few ulp; everything else is relative.
            let lost = 4.0 * f64::from(f32::EPSILON) * mean.abs() / (variance + 1e-5).sqrt();
            let gain = f64::from(gain.data[i % base as usize]);
            let bound = 1e-5 + lost.min(2.0 * f64::from(base).sqrt()) * gain.abs();
            let error = (f64::from(found) - expected).abs();
            assert!(error <= bound, "{target:?}: element {i} is {found}, not {expected}, limit {bound:.1e}");
        }
    }
    assert_no_validation_messages();
}

/// The mean of 2^25 tokens, 8192 x 8192: one row of tokens that is read again and again.
#[test]
fn film_mean_of_many_tokens() {
    let (base, width, height) = (8, 4096, 8192);
    let weights = small_net(base, Block::FilmCnn { conv: Convolution::Standard });
    // Of every token the last channels are the larger ones.
    let row = Random::new(7).values(width as usize * base as usize, 0.5, 3.0);
    let row: Vec<f32> = row.iter().enumerate().map(|(i, value)| value + (i % base as usize) as f32).collect();
    // Rows that are nothing apart.
    let src = View {
        buffer: BufferId(0),
        first: 0,
        channels: base,
        stride: base,
        width: 0,
        height,
        top: 0,
        storage: Storage::F32,
    };
    let sum = TokenSum { src, real_width: width, real_height: height, dst: BufferId(1), computed: None };
    assert_eq!(sum.real_tokens(), 1 << 25);
    let outputs = 2 * base;
    let pack =
        Pack::FilmVector { weight: "enc.0.0.film".into(), norm: "enc.0.0.norm1_f".into(), inputs: base, outputs };
    let bytes = 4 * pack.len() as u64;
    let buffers = [
        arena("row", row.len() as u64),
        arena("partials", sum.sums() * u64::from(base)),
        arena("film", outputs.into()),
        Buffer {
            name: "weights".into(),
            bytes,
            storage: Storage::F32,
            place: Place::Weights { pack, offset: 0, turned: false },
        },
    ];
    let vector = FilmVector {
        partials: BufferId(1),
        sums: sum.sums(),
        tokens: sum.real_tokens(),
        counts: None,
        channels: base,
        weights: BufferId(3),
        dst: BufferId(2),
        outputs,
    };
    let mut mean = vec![0.0; base as usize];
    for token in row.chunks_exact(base as usize) {
        let average = |of: &dyn Fn(f64) -> f64| token.iter().map(|&v| of(v.into())).sum::<f64>() / f64::from(base);
        let middle = average(&|v| v);
        let scale = 1.0 / (average(&|v| (v - middle).powi(2)) + 1e-5).sqrt();
        for (mean, &value) in mean.iter_mut().zip(token) {
            *mean += (f64::from(value) - middle) * scale / f64::from(width);
        }
    }
    // The reference's second step alone, of a single partial sum.
    let one = FilmVector { sums: 1, tokens: 1, ..vector.clone() };
    let mut reference = Reference::for_calls(Extent::new(1, 1), &buffers, &weights).unwrap();
    reference.set_buffer(BufferId(1), &mean);
    reference.run_call(&Call::FilmVector(one));
    let expected = reference.buffer(BufferId(2));
    for target in targets() {
        let mut bench = Bench::new(device(), target).unwrap();
        make_buffers(&mut bench, &buffers, &weights);
        bench.upload(BufferId(0), &row);
        bench.run(&[Call::TokenSum(sum.clone()), Call::FilmVector(vector.clone())]).unwrap();
        let error = nmse(&bench.download(BufferId(2), outputs as usize), expected);
        println!("mean of 2^25 tokens, CPU kernels {}: NMSE {error:.1e}", target.cpu);
        assert!(error <= KERNEL_LIMIT, "{target:?}: NMSE {error:.1e}");
    }
    assert_no_validation_messages();
}
