//! The frame's statistics, its way into the network and out of it, against the f64 twins.

mod common;

use common::case::{make_buffers, small_net, tile_bits};
use common::device::{assert_no_validation_messages, device};
use common::planes::{Samples, TestFrame, TestPlane, odd_layout};
use common::random::Random;
use half::f16;
use vkdenoise::frame::{Extent, Region};
use vkdenoise::kernels::frame_io::{InputAux, InputColor, Output};
use vkdenoise::kernels::stats::{self, Clear, Counted, Histogram, Key, Select, TileMeans};
use vkdenoise::kernels::{BufferId, Call, PlaneArgs, Storage, Tiles, Variants, View};
use vkdenoise::net::{Block, Convolution, Weights};
use vkdenoise::plan::{Buffer, Place};
use vkdenoise::reference::Reference;
use vkdenoise::testing::{Bench, SENTINEL};

const STATS: BufferId = BufferId(0);
const HISTOGRAM: BufferId = BufferId(1);
const TILE_LOGS: BufferId = BufferId(2);
const LOG_COLOR: BufferId = BufferId(3);
const AUX: BufferId = BufferId(4);
const RESIDUAL: BufferId = BufferId(5);
const TILE_LIST: BufferId = BufferId(6);
const DEPTH_SCALE: BufferId = BufferId(7);

const BUFFER_VARIANTS: Variants = Variants { cpu: false, matrix: false, images: false, output_half: false };

/// The grid that a frame is padded to: more than it needs, so that small ones are mirrored again and again.
fn padded(extent: Extent) -> (u32, u32) {
    (extent.width.next_multiple_of(32) + 8, extent.height.next_multiple_of(32))
}

fn view(extent: Extent, buffer: BufferId, first: u32, channels: u32, stride: u32) -> View {
    let (width, height) = padded(extent);
    View { buffer, first, channels, stride, width, height, top: 0, storage: Storage::F32 }
}

fn log_color(extent: Extent) -> View {
    view(extent, LOG_COLOR, 0, 4, 4)
}

fn aux(extent: Extent) -> View {
    view(extent, AUX, 0, 8, 8)
}

fn residual(extent: Extent) -> View {
    view(extent, RESIDUAL, 4, 4, 12)
}

fn tile_means(Extent { width, height }: Extent) -> TileMeans {
    TileMeans { stats: STATS, dst: TILE_LOGS, width, height }
}

fn buffers(extent: Extent) -> Vec<Buffer> {
    let tokens = padded(extent).0 as u64 * padded(extent).1 as u64;
    let tiles = u64::from(tile_means(extent).tiles());
    let sizes = [
        ("stats", 4 * stats::STATS_FLOATS),
        ("histogram", stats::HISTOGRAM_BYTES),
        ("tile logs", 4 * tiles),
        ("log color", 16 * tokens),
        ("aux", 32 * tokens),
        ("residual", 48 * tokens),
        ("tile list", tokens / 16),
        ("depth scale", 4),
    ];
    let place = Place::Arena { block: 0, offset: 0 };
    sizes.map(|(name, bytes)| Buffer { name: name.into(), bytes, storage: Storage::F32, place: place.clone() }).into()
}

/// No kernel of this file reads weights.
fn any_weights() -> Weights {
    small_net(8, Block::FilmCnn { conv: Convolution::Standard })
}

/// One frame on the device and in the reference.
struct Rig<'a> {
    name: &'a str,
    bench: Bench,
    reference: Reference<'a>,
    buffers: &'a [Buffer],
    used: Vec<u64>,
}

impl<'a> Rig<'a> {
    fn new(name: &'a str, frame: &TestFrame, buffers: &'a [Buffer], variants: Variants) -> Self {
        let weights = any_weights();
        let mut bench = Bench::new(device(), variants).unwrap();
        make_buffers(&mut bench, buffers, &weights);
        let mut used = buffers.iter().map(|buffer| buffer.bytes).collect();
        frame.upload(&mut bench, &mut used);
        let mut reference = Reference::for_calls(frame.extent, buffers, &weights).unwrap();
        reference.set_frame(&frame.frame(), None, 0.0).unwrap();
        Self { name, bench, reference, buffers, used }
    }

    fn run(&mut self, calls: &[Call]) {
        self.bench.run(calls).unwrap();
        calls.iter().for_each(|call| self.reference.run_call(call));
        self.bench.check_guards(&self.used).unwrap();
    }

    fn download(&self, id: BufferId) -> Vec<f32> {
        self.bench.download(id, self.buffers[id.0].bytes as usize / 4)
    }

    /// The same values on both sides.
    fn set(&mut self, id: BufferId, values: &[f32]) {
        self.bench.upload(id, values);
        self.reference.set_buffer(id, &values.iter().map(|&v| v.into()).collect::<Vec<_>>());
    }

    /// The reference's values on both sides, rounded to what the device holds.
    fn share(&mut self, id: BufferId) {
        let values: Vec<f32> = self.reference.buffer(id).iter().map(|&v| v as f32).collect();
        self.set(id, &values);
    }

    /// Compares a buffer: what is written differs by at most `limit` relative to what `scale` makes of its value, the
    /// rest holds what it held.
    fn compare(&self, id: BufferId, limit: f64, scale: impl Fn(f64) -> f64) {
        let what = format!("{}: {}", self.name, self.buffers[id.0].name);
        assert_close(&what, &self.download(id), self.reference.buffer(id), limit, scale);
    }
}

fn assert_close(what: &str, found: &[f32], expected: &[f64], limit: f64, scale: impl Fn(f64) -> f64) {
    assert_eq!(found.len(), expected.len(), "{what}");
    for (i, (&found, &expected)) in found.iter().zip(expected).enumerate() {
        if expected.is_nan() {
            assert_eq!(found.to_bits(), SENTINEL, "{what}: element {i} was written: {found:e}");
        } else {
            let error = (f64::from(found) - expected).abs();
            let bound = limit * scale(expected);
            assert!(error <= bound, "{what}: element {i} is {found:e}, not {expected:e}, limit {bound:.1e}");
        }
    }
}

fn with_pixels(mut frame: TestFrame, pixels: &[(usize, [f32; 3])]) -> TestFrame {
    if let Samples::F32(samples) = &mut frame.color.samples {
        for (pixel, color) in pixels {
            samples[3 * pixel..][..3].copy_from_slice(color);
        }
    }
    frame
}

fn with_depth(frame: TestFrame, depth: Vec<f32>) -> TestFrame {
    TestFrame { depth: Some(TestPlane::packed(frame.extent, 1, depth)), ..frame }
}

/// Frames whose statistics are easy to get wrong.
fn frames() -> Vec<(&'static str, TestFrame)> {
    let odd = Extent::new(70, 45);
    let random = || TestFrame::random(odd, 1);
    let flat = |extent: Extent, value| TestFrame::of_color(extent, vec![value; 3 * extent.pixels() as usize]);
    let scaled = |by: f32| {
        let mut frame = random();
        if let Samples::F32(samples) = &mut frame.color.samples {
            samples.iter_mut().for_each(|sample| *sample *= by);
        }
        frame
    };
    let (nan, inf) = (f32::NAN, f32::INFINITY);
    let bad = [
        (0, [nan, 1.0, 1.0]),
        (69, [1.0, -1e-20, 1.0]),
        (500, [inf; 3]),
        (571, [1.0, -inf, 1.0]),
        (1000, [1e30, 0.5, 0.5]),
        (1001, [1e30; 3]),
        (1070, [3e38; 3]),
        (3149, [nan; 3]),
    ];
    // Alone, in a corner, in pairs, in rows and in a square, beside a bad pixel and just not bright enough.
    let lit = [2835, 0, 150, 220, 1000, 1001, 1002, 1400, 1401, 1470, 1471, 2000];
    let mut fireflies: Vec<_> = lit.map(|at| (at, [100.0, 3e4, 5.0])).into();
    fireflies.extend([(2001, [nan; 3]), (2500, [190.0; 3])]);
    let black_tile: Vec<_> = (0..8).flat_map(|y| (0..8).map(move |x| (70 * y + 8 + x, [0.0; 3]))).collect();
    let mut depths = Random::new(5).values(70 * 45, 2.0, 9.0);
    for (i, depth) in [nan, inf, -inf, -1.0, 0.0, 1e9, 1e10, 9e8].into_iter().enumerate() {
        depths[100 * i] = depth;
    }
    vec![
        ("random", random()),
        ("random, spread out", random().spread(false)),
        ("random, spread out, halves", random().spread(true)),
        ("larger", TestFrame::random(Extent::new(333, 211), 2)),
        ("one pixel", TestFrame::random(Extent::new(1, 1), 3)),
        ("one row of seven", TestFrame::random(Extent::new(7, 1), 4)),
        ("one column of nine", TestFrame::random(Extent::new(1, 9), 4)),
        ("black", flat(odd, 0.0)),
        ("grey", flat(odd, 0.18)),
        ("all bad", flat(Extent::new(9, 9), nan)),
        ("bad pixels", with_pixels(random(), &bad)),
        ("isolated fireflies", with_pixels(random(), &fireflies)),
        ("a black tile", with_pixels(random(), &black_tile)),
        ("very dark", scaled(1e-30)),
        ("very bright", scaled(1e33)),
        ("background and bad depths", with_depth(random(), depths.clone())),
        ("bad depths in halves", with_depth(random(), depths).spread(true)),
        ("no valid depth", with_depth(random(), vec![-1.0; 70 * 45])),
        ("all one depth", with_depth(random(), vec![7.0; 70 * 45])),
    ]
}

#[test]
fn statistics() {
    for (name, frame) in frames() {
        let Extent { width, height } = frame.extent;
        let buffers = buffers(frame.extent);
        let mut rig = Rig::new(name, &frame, &buffers, BUFFER_VARIANTS);
        for (counted, dst) in [(Counted::Luminance, STATS), (Counted::Depth, DEPTH_SCALE)] {
            let histogram = HISTOGRAM;
            rig.run(&[
                Call::StatsClear(Clear { histogram }),
                Call::StatsHistogram(Histogram { histogram, counted, width, height }),
            ]);
            let counts: Vec<f64> = rig.download(HISTOGRAM).into_iter().map(|f| f.to_bits().into()).collect();
            let expected = rig.reference.buffer(HISTOGRAM);
            let moved: f64 = counts.iter().zip(expected).map(|(a, b)| (a - b).abs()).sum();
            assert_eq!(counts.iter().sum::<f64>(), expected.iter().sum::<f64>(), "{name}: {counted:?}");
            // Where a luminance lies on the edge of a bin, its rounding decides.
            let most = if counted == Counted::Luminance { 0.002 * f64::from(width * height) } else { 0.0 };
            assert!(moved <= most, "{name}: {moved} pixels are in other bins of {counted:?}");

            rig.bench.upload(HISTOGRAM, &expected_bits(expected));
            rig.run(&[Call::StatsSelect(Select { histogram, counted, dst })]);
            let expected = rig.reference.buffer(dst)[0];
            assert_close(&format!("{name}: {counted:?}"), &rig.download(dst)[..1], &[expected], 2e-7, f64::abs);
        }

        let median = rig.reference.buffer(STATS)[0];
        rig.set(STATS, &[median as f32, f32::NAN, f32::NAN]);
        rig.run(&[Call::StatsTiles(tile_means(frame.extent))]);
        let (found, expected) = (rig.download(TILE_LOGS), rig.reference.buffer(TILE_LOGS));
        for (i, (&found, &expected)) in found.iter().zip(expected).enumerate() {
            let error = (f64::from(found) - expected).abs();
            let dark = found < -1e30 && expected < -1e30;
            assert!(dark || error <= 3e-6, "{name}: tile {i} is {found}, not {expected}");
        }

        rig.share(TILE_LOGS);
        let tiles = tile_means(frame.extent).tiles();
        let key = Call::StatsKey(Key { src: TILE_LOGS, tiles, stats: STATS });
        rig.run(std::slice::from_ref(&key));
        rig.compare(STATS, 3e-6, f64::abs);
        rig.bench.planes.exposure = Some(3.5);
        rig.bench.run(&[key]).unwrap();
        assert_eq!(rig.download(STATS)[2], 3.5, "{name}: a fixed exposure is taken as it is");
    }
    assert_no_validation_messages();
}

fn expected_bits(counts: &[f64]) -> Vec<f32> {
    counts.iter().map(|&count| f32::from_bits(count as u32)).collect()
}

/// Some tiles of a padded frame, shared by both sides, on every other call.
fn tiles(rig: &mut Rig, extent: Extent, some: bool) -> Tiles {
    if !some {
        return Tiles::All;
    }
    let (across, down) = (extent.width.div_ceil(8), extent.height.div_ceil(8));
    let list: Vec<_> =
        (0..down).flat_map(|y| (0..across).map(move |x| (x, y))).filter(|(x, y)| (x + y) % 3 == 1).collect();
    rig.bench.upload(TILE_LIST, &tile_bits(&list));
    rig.reference.set_tiles(TILE_LIST, &list);
    Tiles::List { buffer: TILE_LIST, at_most: list.len() as u32 }
}

#[test]
fn the_way_in() {
    for (i, (name, frame)) in frames().into_iter().enumerate() {
        let Extent { width, height } = frame.extent;
        let buffers = buffers(frame.extent);
        let mut rig = Rig::new(name, &frame, &buffers, BUFFER_VARIANTS);
        // Keys from the frame's own to one that makes fireflies of many of its pixels.
        let key = if name.contains("fireflies") { 0.2 } else { [0.2, 3e-9, 1e-25, 1e34][i % 4] as f32 };
        rig.set(STATS, &[f32::NAN, key, 0.18 / key]);
        rig.set(DEPTH_SCALE, &[7.5]);
        let tiles = tiles(&mut rig, frame.extent, i % 3 == 0 && width > 8);
        rig.run(&[
            Call::InputColor(InputColor { stats: STATS, dst: log_color(frame.extent), width, height, tiles }),
            Call::InputAux(InputAux { depth_scale: DEPTH_SCALE, dst: aux(frame.extent), width, height, tiles }),
        ]);
        // log1p to 4 ulp, and the roundings of exposure and of a mended pixel's mean before it.
        rig.compare(LOG_COLOR, 7e-7, f64::abs);
        rig.compare(AUX, 2e-7, |value| value.abs().max(0.25));
    }
    assert_no_validation_messages();
}

#[test]
fn the_way_out() {
    for (i, (name, frame)) in frames().into_iter().enumerate() {
        let extent = frame.extent;
        let output_half = i % 3 == 2;
        let buffers = buffers(extent);
        let mut rig = Rig::new(name, &frame, &buffers, Variants { output_half, ..BUFFER_VARIANTS });
        let exposure = [0.36, 1e-5, 2e4, 1e-33][i % 4];
        rig.set(STATS, &[f32::NAN, f32::NAN, exposure]);
        let mut random = Random::new(i as u64);
        let tokens = log_color(extent).tokens() as usize;
        let colors = random.values(4 * tokens, 0.0, [1e-4, 3.0, 11.0][i % 3]);
        rig.set(LOG_COLOR, &colors);
        // Some take all of the colour away, some more than that, some nothing.
        let mut residuals = random.values(12 * tokens, -3.0, 1.0);
        for (r, c) in residuals.chunks_exact_mut(12).zip(colors.chunks_exact(4)) {
            (r[4], r[5]) = if random.coin() { (0.0, -c[1]) } else { (r[4] * c[0], r[5]) };
        }
        rig.set(RESIDUAL, &residuals);
        let blend = [0.0, 0.25, 1.0][i % 3];
        rig.reference.set_frame(&frame.frame(), None, blend.into()).unwrap();
        rig.reference.set_output_half(output_half);
        rig.bench.planes.blend = blend;
        let (output, len) = output_plane(&mut rig, extent, output_half);
        let tiles = tiles(&mut rig, extent, i % 2 == 0 && extent.width > 8);
        let Extent { width, height } = extent;
        let (residual, log_color) = (residual(extent), log_color(extent));
        // In half of the frames, without their outermost pixels where there are others.
        let region = if i % 4 < 2 && width > 2 && height > 2 {
            Region { x: 1, y: 1, width: width - 2, height: height - 2 }
        } else {
            Region::all(extent)
        };
        rig.run(&[Call::Output(Output {
            residual,
            radiance: i % 3 == 1,
            log_color,
            stats: STATS,
            width,
            height,
            tiles,
            region,
            quiet: None,
        })]);

        let found = samples(&rig.bench.download(output, len), output_half);
        let expected = spread_output(&rig, extent, found.len());
        for (at, (&found, &expected)) in found.iter().zip(&expected).enumerate() {
            if expected.is_nan() {
                assert!(found.is_nan(), "{name}: sample {at} was written: {found}");
                continue;
            }
            // c + r is rounded before the exponential; then a rounding of halves.
            let step = if output_half { 5e-4 * expected.abs() + 3e-8 } else { 0.0 };
            let bound = 2e-6 * (expected + 1.0 / f64::from(exposure)) + step;
            let error = (f64::from(found) - expected).abs();
            assert!(error <= bound, "{name}: sample {at} is {found:e}, not {expected:e}, limit {bound:.1e}");
        }
    }
    assert_no_validation_messages();
}

/// An output plane with gaps between its samples; its buffer and that buffer's length in floats.
fn output_plane(rig: &mut Rig, extent: Extent, half: bool) -> (BufferId, usize) {
    let (layout, samples) = odd_layout(extent, 3);
    let floats = if half { samples.div_ceil(2) } else { samples };
    let id = rig.bench.buffer("output", 4 * floats as u64).unwrap();
    rig.used.push(4 * floats as u64);
    // Any NaN will do for halves, too.
    rig.bench.upload(id, &vec![f32::from_bits(0x7fff_7fff); floats]);
    let [pixel, row, channel] = [layout.pixel_stride, layout.row_stride, layout.channel_stride].map(|s| s as u32);
    let plane = rig.bench.plane(id, pixel, row, channel);
    rig.bench.planes.output = PlaneArgs { offset: layout.offset as u32, half, ..plane };
    (id, floats)
}

fn samples(floats: &[f32], half: bool) -> Vec<f32> {
    if !half {
        return floats.to_vec();
    }
    let halves = floats.iter().flat_map(|f| [f.to_bits() as u16, (f.to_bits() >> 16) as u16]);
    halves.map(|bits| f16::from_bits(bits).to_f32()).collect()
}

/// The reference's output where the output plane has it; NaN elsewhere.
fn spread_output(rig: &Rig, extent: Extent, len: usize) -> Vec<f64> {
    let (layout, _) = odd_layout(extent, 3);
    let mut out = vec![f64::NAN; len];
    for (i, &value) in rig.reference.output().iter().enumerate() {
        let (x, y) = (i / 3 % extent.width as usize, i / 3 / extent.width as usize);
        out[layout.offset + y * layout.row_stride + x * layout.pixel_stride + i % 3 * layout.channel_stride] = value;
    }
    out
}
