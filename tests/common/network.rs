//! Whole networks: the plan of a size, its buffers side by side on a bench, and the share of every branch.

use super::case::make_buffers;
use super::compare::rms;
use super::device::device;
use vkdenoise::frame::Extent;
use vkdenoise::kernels::winograd::Winograd3x3;
use vkdenoise::kernels::{BufferId, Call, View};
use vkdenoise::net::{Folds, Graph, Weights};
use vkdenoise::plan::pack::Pack;
use vkdenoise::plan::{Place, Plan, plan};
use vkdenoise::reference::Reference;
use vkdenoise::target::Target;
use vkdenoise::testing::Bench;

/// The plan of these weights' network, everything folded.
pub fn plan_of(weights: &Weights, extent: Extent) -> Plan {
    plan_with(weights, extent, Folds::ALL)
}

/// The same with these folds. The dispatches keep the network's order.
pub fn plan_with(weights: &Weights, extent: Extent, folds: Folds) -> Plan {
    let graph = Graph::new(weights.arch()).unwrap();
    plan(&graph, extent, &Target { keep_all: true, overlap_bytes: 0, folds, ..Target::default() }).unwrap()
}

/// Where the dispatches of the network proper lie in a plan: after the inputs, before what is given back and the
/// output.
pub fn network_range(plan: &Plan) -> std::ops::Range<usize> {
    let inputs = plan.dispatches.iter().rposition(|d| matches!(d.call, Call::InputColor(_) | Call::InputAux(_)));
    let is_after = |call: &Call| matches!(call, Call::EnergyGains(_) | Call::Output(_));
    let last = plan.dispatches.iter().rposition(|d| !is_after(&d.call));
    inputs.unwrap() + 1..last.unwrap() + 1
}

/// Every buffer of a plan in memory of its own, so that all can be read after a run.
pub fn bench_of(plan: &Plan, weights: &Weights) -> Bench {
    let mut bench = Bench::new(device(), Bench::default_target(device())).unwrap();
    make_buffers(&mut bench, &plan.buffers, weights);
    bench
}

/// All of a plan's buffer.
pub fn download(bench: &Bench, plan: &Plan, id: BufferId) -> Vec<f32> {
    bench.download(id, plan.buffer(id).bytes as usize / 4)
}

/// The values as f64.
pub fn wide(values: &[f32]) -> Vec<f64> {
    values.iter().map(|&value| value.into()).collect()
}

/// The real channels of a residual, `[pixel][3]`, from `[token][4]`; of the unpadded frame only.
pub fn crop<T: Copy>(values: &[T], padded: Extent, extent: Extent) -> Vec<T> {
    let rows = values.chunks_exact(4 * padded.width as usize).take(extent.height as usize);
    rows.flat_map(|row| row.chunks_exact(4).take(extent.width as usize).flat_map(|pixel| &pixel[..3]))
        .copied()
        .collect()
}

/// An image padded as the network wants it: mirrored to the right and below, channels filled up with zeros.
pub fn mirrored(image: &[f32], extent: Extent, view: &View) -> Vec<f32> {
    let mirror = |at: u32, size: u32| {
        let m = at % (2 * (size - 1)).max(1);
        (if m < size { m } else { 2 * (size - 1) - m }) as usize
    };
    let channels = image.len() / extent.pixels() as usize;
    let mut out = Vec::new();
    for y in 0..view.height {
        for x in 0..view.width {
            let pixel = mirror(y, extent.height) * extent.width as usize + mirror(x, extent.width);
            out.extend_from_slice(&image[pixel * channels..][..channels]);
            out.resize(out.len() + view.channels as usize - channels, 0.0);
        }
    }
    out
}

/// Runs the network part of a plan and asserts that no branch of a block is below a tenth of the block's output, and
/// that joint scores span about +-5: an error in any of them must show.
pub fn run_and_assert_shares(reference: &mut Reference, plan: &Plan, weights: &Weights) {
    let mut shares: Vec<(String, f64)> = Vec::new();
    for i in network_range(plan) {
        reference.run_dispatch(i);
        let dispatch = &plan.dispatches[i];
        let name = &dispatch.name;
        let (src, dst, film, residual) = match &dispatch.call {
            Call::Conv3x3(k) | Call::Winograd3x3(Winograd3x3 { conv: k, .. }) => (k.src, k.dst, k.film, k.residual),
            Call::Separable3x3(k) => (k.depthwise.src, k.pointwise.dst, k.pointwise.film, k.pointwise.residual),
            Call::Linear(k) => (k.src, k.dst, k.film, k.residual),
            Call::WindowAttention(attention) => {
                let Place::Weights { pack: Pack::BiasTable { table, .. }, .. } = &plan.buffer(attention.bias).place
                else {
                    panic!("{name} has no bias table");
                };
                let table = &weights.tensor(table).unwrap().data;
                let (x, f) = (reference.view(&attention.x), reference.view(&attention.f));
                let scores = joint_scores(&x, &f, attention, table);
                let span = scores[scores.len() * 99 / 100] - scores[scores.len() / 100];
                assert!((5.0..=40.0).contains(&span), "{name}: joint scores span {span:.1}");
                continue;
            }
            _ => continue,
        };
        if residual.is_none() || name.starts_with("aux_proj") || name.starts_with("up.") {
            continue;
        }
        shares.push((name.clone(), change_without(reference, i, &src, &dst)));
        if let Some(film) = film {
            let (vector, full) = (reference.buffer(film).to_vec(), reference.view(&dst));
            let (gamma, beta) = vector.split_at(vector.len() / 2);
            reference.set_buffer(film, &[gamma, &vec![0.0; beta.len()]].concat());
            shares.push((format!("{name} beta"), change(reference, i, &dst, &full)));
            reference.set_buffer(film, &vector);
        }
        if name.ends_with("ffn.contract") {
            let whole = rms(&reference.view(&dst));
            for (branch, size) in shares.drain(..) {
                assert!(size >= 0.1 * whole, "{branch}: {size:.3} of a block's {whole:.3}");
            }
        }
    }
    assert!(shares.is_empty(), "a block without an end: {shares:?}");
}

/// How much a dispatch's result changes when its source is zero.
fn change_without(reference: &mut Reference, dispatch: usize, src: &View, dst: &View) -> f64 {
    let (source, full) = (reference.view(src), reference.view(dst));
    reference.set_view(src, &vec![0.0; source.len()]);
    let size = change(reference, dispatch, dst, &full);
    reference.set_view(src, &source);
    size
}

/// How much a dispatch's result differs from `full`, which is put back.
fn change(reference: &mut Reference, dispatch: usize, dst: &View, full: &[f64]) -> f64 {
    reference.run_dispatch(dispatch);
    let without = reference.view(dst);
    reference.set_view(dst, full);
    rms(&full.iter().zip(&without).map(|(a, b)| a - b).collect::<Vec<_>>())
}

/// The joint scores of the first window and head, sorted.
fn joint_scores(
    x: &[f64],
    f: &[f64],
    k: &vkdenoise::kernels::window_attention::WindowAttention,
    table: &[f32],
) -> Vec<f64> {
    let (heads, keys) = (k.heads as usize, k.key_width as usize);
    let token = |map: &[f64], view: &View, i: usize, first: usize| {
        let start = (i / 8 * view.width as usize + i % 8) * view.channels as usize + first;
        map[start..start + keys].to_vec()
    };
    let score = |map: &[f64], view: &View, i: usize, j: usize| {
        let (q, k) = (token(map, view, i, 0), token(map, view, j, heads * keys));
        let bias = table[((i / 8 + 7 - j / 8) * 15 + i % 8 + 7 - j % 8) * heads];
        q.iter().zip(&k).map(|(a, b)| a * b).sum::<f64>() / (keys as f64).sqrt() + f64::from(bias)
    };
    let pairs = (0..64 * 64).map(|n| (n / 64, n % 64));
    let mut scores: Vec<f64> = pairs.map(|(i, j)| score(x, &k.x, i, j) * score(f, &k.f, i, j)).collect();
    scores.sort_by(f64::total_cmp);
    scores
}
