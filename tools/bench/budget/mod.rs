//! Where precision goes: every dispatch of a pass on the device beside the same pass in f64.

#![allow(dead_code, reason = "the tests and the benchmark each use a part")]

pub mod table;

use vkdenoise::kernels::planes::{PlaneArgs, Role};
use vkdenoise::kernels::window_attention::WindowAttention;
use vkdenoise::kernels::{Call, KernelTarget, Storage, TILE, View};
use vkdenoise::net::{Graph, Weights};
use vkdenoise::plan::pack::Pack;
use vkdenoise::plan::{Dispatch, Place, Plan, plan};
use vkdenoise::reference::Reference;
use vkdenoise::target::Target;
use vkdenoise::testing::Bench;
use vkdenoise::{Device, Frame, Plane, Samples};

/// What goes wrong beside the figures.
pub type Result<T, E = Box<dyn std::error::Error + Send + Sync>> = std::result::Result<T, E>;

/// The largest half, and the smallest one of full precision.
const HALF_MAX: f64 = 65504.0;
const HALF_MIN_NORMAL: f64 = 6.103515625e-5;

/// What a dispatch wrote, beside f64.
#[derive(Clone, Debug)]
pub struct Line {
    /// The dispatch.
    pub name: String,
    /// Its kernel variant.
    pub kernel: &'static str,
    /// NMSE of all that it wrote, errors of the dispatches before included.
    pub nmse: f64,
    /// Largest absolute value.
    pub largest: f64,
    /// The same as a share of the largest half.
    pub half_range: f64,
    /// Share of the values, zeros left out, that halves hold with fewer bits or not at all: below 2^-14.
    pub below_normal: f64,
    /// NMSE of rounding the f64 values to halves and nothing else.
    pub rounded_to_half: f64,
    /// The 8x8 window of the largest error, in tokens, and that error over the mean window's energy.
    pub worst_window: Option<((u32, u32), f64)>,
    /// Of attention: the largest score of either map and the largest product of both.
    pub scores: Option<(f64, f64)>,
}

/// Runs a frame on the device, in the forms of `forms`, every buffer in memory of its own, and in f64. One line for
/// each dispatch of the network and of its inputs.
///
/// # Errors
/// Those of the library: memory, planes that do not fit, a lost device.
pub fn measure(device: &Device, weights: &Weights, frame: &Frame, target: &Target) -> Result<Vec<Line>> {
    let graph = Graph::new(weights.arch())?;
    let plan = plan(&graph, frame.extent, &Target { keep_all: true, ..*target })?;
    let is_after = |call: &Call| matches!(call, Call::EnergyGains(_) | Call::Output(_));
    let end = plan.dispatches.iter().position(|d| is_after(&d.call)).ok_or("a plan without an output")?;
    let bench = run_on_device(device, weights, frame, target.kernels, &plan, end)?;
    let mut reference = Reference::new(&plan, weights)?;
    reference.set_frame(frame, None, 0.0)?;
    let mut lines = Vec::new();
    for (i, dispatch) in plan.dispatches[..end].iter().enumerate() {
        reference.run_dispatch(i);
        if let Some(view) = dispatch.call.result() {
            let found =
                elements(bench.download(view.buffer, plan.buffer(view.buffer).bytes as usize / 4), view.storage);
            let mut line = compare(dispatch, &view, &found, &reference.view(&view));
            if let Call::WindowAttention(attention) = &dispatch.call {
                line.scores = Some(scores(&reference, &plan, attention, weights)?);
            }
            lines.push(line);
        } else if let Call::FilmVector(film) = &dispatch.call {
            let found = bench.download(film.dst, film.outputs as usize);
            let expected = &reference.buffer(film.dst)[..found.len()];
            let pairs = found.iter().zip(expected).map(|(f, e)| (f64::from(*f), *e));
            lines.push(line(dispatch, pairs));
        }
    }
    Ok(lines)
}

fn run_on_device(
    device: &Device,
    weights: &Weights,
    frame: &Frame,
    target: KernelTarget,
    plan: &Plan,
    end: usize,
) -> Result<Bench> {
    let mut bench = Bench::new(device, target)?;
    for buffer in &plan.buffers {
        let id = bench.buffer(&buffer.name, buffer.bytes)?;
        if let Place::Weights { pack, .. } = &buffer.place {
            bench.upload(id, bytemuck::cast_slice(&pack.words(weights)?));
        }
    }
    let features = frame.features;
    bench.planes[Role::Color] = upload(&mut bench, Some(&frame.color))?;
    bench.planes[Role::Albedo] = upload(&mut bench, features.albedo.as_ref())?;
    bench.planes[Role::Normal] = upload(&mut bench, features.normal.as_ref())?;
    bench.planes[Role::Depth] = upload(&mut bench, features.depth.as_ref())?;
    let calls: Vec<Call> = plan.dispatches[..end].iter().map(|dispatch| dispatch.call.clone()).collect();
    bench.run(&calls)?;
    Ok(bench)
}

/// The elements in a buffer's words.
fn elements(words: Vec<f32>, storage: Storage) -> Vec<f32> {
    let halves = |word: &f32| {
        let bits = word.to_bits();
        [bits, bits >> 16].map(|half| half::f16::from_bits(half as u16).to_f32())
    };
    match storage {
        Storage::F32 => words,
        Storage::F16 => words.iter().flat_map(halves).collect(),
    }
}

/// A plane as it is, with its layout.
fn upload(bench: &mut Bench, plane: Option<&Plane>) -> Result<PlaneArgs> {
    let Some(plane) = plane else { return Ok(PlaneArgs::default()) };
    let Samples::F32(samples) = plane.samples else { return Err("planes of halves are not measured".into()) };
    let id = bench.buffer("plane", 4 * samples.len() as u64)?;
    bench.upload(id, samples);
    let layout = plane.layout;
    let [pixel, row, channel] = [layout.pixel_stride, layout.row_stride, layout.channel_stride].map(|s| s as u32);
    Ok(PlaneArgs { offset: layout.offset as u32, ..bench.plane(id, pixel, row, channel) })
}

fn compare(dispatch: &Dispatch, view: &View, buffer: &[f32], expected: &[f64]) -> Line {
    let (channels, stride) = (view.channels as usize, view.stride as usize);
    let found = buffer.chunks_exact(stride).flat_map(|token| &token[view.first as usize..][..channels]);
    let pairs: Vec<(f64, f64)> = found.zip(expected).map(|(f, e)| (f64::from(*f), *e)).collect();
    let mut windows = vec![0.0f64; (view.tokens() / u64::from(TILE * TILE)) as usize];
    let across = view.width / TILE;
    for (token, pairs) in pairs.chunks_exact(channels).enumerate() {
        let (x, y) = (token as u32 % view.width / TILE, token as u32 / view.width / TILE);
        windows[(y * across + x) as usize] += pairs.iter().map(|(f, e)| (f - e).powi(2)).sum::<f64>();
    }
    let energy = expected.iter().map(|e| e * e).sum::<f64>() / windows.len() as f64;
    let worst = windows.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1));
    let worst_window =
        worst.map(|(i, error)| ((i as u32 % across * TILE, i as u32 / across * TILE), ratio(*error, energy)));
    Line { worst_window, ..line(dispatch, pairs.into_iter()) }
}

fn line(dispatch: &Dispatch, pairs: impl Iterator<Item = (f64, f64)>) -> Line {
    let (mut error, mut rounding, mut energy, mut largest) = (0.0f64, 0.0, 0.0, 0.0f64);
    let (mut small, mut values) = (0u64, 0u64);
    for (found, expected) in pairs {
        error += (found - expected).powi(2);
        energy += expected * expected;
        largest = largest.max(expected.abs());
        rounding += (half::f16::from_f64(expected).to_f64() - expected).powi(2);
        values += u64::from(expected != 0.0);
        small += u64::from(expected != 0.0 && expected.abs() < HALF_MIN_NORMAL);
    }
    Line {
        name: dispatch.name.clone(),
        kernel: dispatch.variant.contract.name,
        nmse: ratio(error, energy),
        largest,
        half_range: largest / HALF_MAX,
        below_normal: small as f64 / values.max(1) as f64,
        rounded_to_half: ratio(rounding, energy),
        worst_window: None,
        scores: None,
    }
}

/// 0 where both are 0.
fn ratio(error: f64, energy: f64) -> f64 {
    if error == 0.0 { 0.0 } else { error / energy }
}

/// The largest absolute score of either map and the largest absolute product, over all windows and heads.
fn scores(reference: &Reference, plan: &Plan, k: &WindowAttention, weights: &Weights) -> Result<(f64, f64)> {
    let Place::Weights { pack: Pack::BiasTable { table, .. } | Pack::BiasMatrix { table, .. }, .. } =
        &plan.buffer(k.bias).place
    else {
        return Err("attention without a bias table".into());
    };
    let table = &weights.tensor(table)?.data;
    let (x, f) = (reference.view(&k.x), reference.view(&k.f));
    let (heads, keys) = (k.heads as usize, k.key_width as usize);
    let side = TILE as usize;
    let tokens = side * side;
    let (mut single, mut product) = (0.0f64, 0.0f64);
    for window in 0..(k.dst.tokens() as usize / tokens) {
        let across = k.dst.width as usize / side;
        let (left, top) = (window % across * side, window / across * side);
        let token = |i: usize| (top + i / side) * k.dst.width as usize + left + i % side;
        for (head, i, j) in (0..heads).flat_map(|h| (0..tokens * tokens).map(move |n| (h, n / tokens, n % tokens))) {
            let bias = f64::from(table[((i / side + 7 - j / side) * 15 + i % side + 7 - j % side) * heads + head]);
            let score = |map: &[f64], view: &View| {
                let part =
                    |i: usize, first: usize| &map[token(i) * view.channels as usize + first + head * keys..][..keys];
                let dot: f64 = part(i, 0).iter().zip(part(j, heads * keys)).map(|(q, k)| q * k).sum();
                dot / (keys as f64).sqrt() + bias
            };
            let (sx, sf) = (score(&x, &k.x), score(&f, &k.f));
            single = single.max(sx.abs()).max(sf.abs());
            product = product.max((sx * sf).abs());
        }
    }
    Ok((single, product))
}

/// The line of what the network makes in all: the last map that is written.
pub fn result(lines: &[Line]) -> Option<&Line> {
    lines.last()
}
