//! Window attention by itself and with its Linears against its f64 twins, over random shapes and lists of windows.

mod common;

use common::case::{Cases, DENSE_FORMS, MATRIX_LIMIT, STORAGES, small_net, worth_compiling};
use common::dense::{dense_cases, size};
use vkdenoise::kernels::attention_block::AttentionBlock;
use vkdenoise::kernels::window_attention::WindowAttention;
use vkdenoise::kernels::{Arithmetic, Call, Storage};
use vkdenoise::net::{Block, LinearPart, LinearWeight};
use vkdenoise::plan::pack::Pack;

/// Adds window attention whose inputs are in -`scale`..`scale`.
fn add_attention(cases: &mut Cases, (heads, keys, values): (u32, u32, u32), scale: f32) {
    let size = size(cases, 8);
    let table = "bottleneck.0.bias_table".into();
    let pack = match cases.arithmetic {
        Arithmetic::Floats => Pack::BiasTable { table, heads },
        Arithmetic::Matrices => Pack::BiasMatrix { table, heads },
    };
    let x = cases.map(size, heads * (2 * keys + values), scale);
    let f = cases.map(size, heads * 2 * keys, scale);
    let dst = cases.target(size, heads * values);
    let call = WindowAttention {
        x,
        f,
        bias: cases.pack(pack),
        dst,
        heads,
        key_width: keys,
        value_width: values,
        tiles: cases.windows(size),
        arithmetic: cases.arithmetic,
    };
    cases.add(Call::WindowAttention(call), dst.buffer);
}

#[test]
fn window_attention() {
    for (storage, limit) in STORAGES {
        let mut cases = dense_cases(7);
        cases.storage = storage;
        let forms = [
            (1, 4, 8),
            (1, 8, 16),
            (2, 8, 16),
            (1, 16, 32),
            (3, 16, 32),
            (1, 32, 64),
            (2, 16, 16),
            (4, 32, 32),
            (8, 8, 12),
            (1, 64, 64),
            (3, 12, 4),
        ];
        for form in forms.repeat(2) {
            add_attention(&mut cases, form, 1.8);
        }
        // The widest of the family: one head on all of 512 channels.
        add_attention(&mut cases, (1, 256, 512), 1.8);
        cases.check("window_attention", limit);
    }
}

#[test]
fn window_attention_on_matrices() {
    let mut cases = dense_cases(10);
    (cases.storage, cases.arithmetic) = (Storage::F16, Arithmetic::Matrices);
    let forms = [(1, 8, 16), (2, 32, 32), (1, 32, 64), (1, 16, 32), (1, 24, 48), (4, 32, 32), (8, 16, 16)];
    for form in worth_compiling(&forms, 2).repeat(3) {
        add_attention(&mut cases, form, 1.8);
    }
    cases.check("window_attention", MATRIX_LIMIT);
}

/// Products of scores in the millions, far beyond what halves or an unshifted exponential hold: each query attends to
/// its best key alone.
#[test]
fn attention_of_huge_scores_picks_the_best_key() {
    for (storage, arithmetic, _) in DENSE_FORMS {
        let mut cases = dense_cases(8);
        (cases.storage, cases.arithmetic) = (storage, arithmetic);
        for form in [(1, 8, 16), (2, 32, 32)] {
            add_attention(&mut cases, form, 60.0);
        }
        // Where two keys are nearly even, the rounding of their scores decides; few are.
        cases.check("window_attention of huge scores", 1e-2);
    }
}

/// Channels of x, of queries and of values: those of the Hybrid's stages, some with more or with nothing beside what
/// attends, and such as leave subgroups without outputs.
const BLOCKS: [(u32, u32, u32); 6] =
    [(64, 8, 16), (256, 32, 64), (128, 16, 32), (32, 16, 32), (160, 8, 64), (48, 8, 16)];

#[test]
fn attention_block() {
    let mut cases = Cases::new(11, small_net(128, Block::Jsa));
    (cases.storage, cases.arithmetic) = (Storage::F16, Arithmetic::Matrices);
    for (channels, keys, values) in worth_compiling(&BLOCKS, 2).repeat(3) {
        let size = size(&mut cases, 8);
        let part = |name: &str, outputs| LinearPart { prefix: format!("bottleneck.0.{name}"), outputs };
        let linear = |parts, inputs, norm: Option<&str>| LinearWeight {
            parts,
            inputs,
            columns: 0..inputs,
            bias: true,
            norm: norm.map(|norm| format!("bottleneck.0.{norm}")),
        };
        let qkv = linear(vec![part("q", keys), part("k", keys), part("v", values)], values, Some("norm1"));
        let qkf = linear(vec![part("qf", keys), part("kf", keys)], values, Some("norm1_f"));
        let projection = Pack::Linear(linear(vec![part("proj", channels)], channels, None));
        let (x, f) = (cases.map(size, channels, 3.0), cases.map(size, values, 3.0));
        let dst = cases.target(size, channels);
        let biases = [&qkv, &qkf].map(|weight| cases.pack(Pack::BiasRows(Box::new(Pack::Linear(weight.clone())))));
        let block = AttentionBlock {
            x,
            f,
            dst,
            qkv: cases.dense_pack(Pack::Linear(qkv)),
            qkf: cases.dense_pack(Pack::Linear(qkf)),
            biases,
            table: cases.pack(Pack::BiasMatrix { table: "bottleneck.0.bias_table".into(), heads: 1 }),
            projection: cases.dense_pack(projection),
            key_width: keys,
            value_width: values,
            tiles: cases.windows(size),
        };
        cases.add(Call::AttentionBlock(block), dst.buffer);
    }
    cases.check("attention_block", MATRIX_LIMIT);
}
