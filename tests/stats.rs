//! The frame's statistics, its way into the network and out of it, against the f64 twins.

mod common;
#[path = "stats/frames.rs"]
mod frames;
#[path = "stats/rig.rs"]
mod rig;

use common::case::{make_buffers, small_net, tile_bits};
use common::device::{assert_no_validation_messages, device};
use common::planes::{Samples, TestFrame, TestPlane, odd_layout};
use common::random::Random;
use frames::frames;
use half::f16;
use rig::Rig;
use vkdenoise::frame::{Extent, Region};
use vkdenoise::kernels::frame_io::{Fireflies, InputAux, InputColor, Output};
use vkdenoise::kernels::planes::{Format, PlaneArgs, Role};
use vkdenoise::kernels::stats::{self, Clear, Counted, Histogram, Select, TileStats};
use vkdenoise::kernels::energy::BLOCK;
use vkdenoise::kernels::{BufferId, Call, KernelTarget, Storage, Tiles, View};
use vkdenoise::net::{Block, Convolution, Weights};
use vkdenoise::plan::{Buffer, Place};
use vkdenoise::reference::Reference;
use vkdenoise::testing::{Bench, SENTINEL};

const STATS: BufferId = BufferId(0);
const HISTOGRAM: BufferId = BufferId(1);
const TILE_STATS: BufferId = BufferId(2);
const LOG_COLOR: BufferId = BufferId(3);
const AUX: BufferId = BufferId(4);
const RESIDUAL: BufferId = BufferId(5);
const TILE_LIST: BufferId = BufferId(6);
const DEPTH_SCALE: BufferId = BufferId(7);
const RUNS: BufferId = BufferId(8);
const GAINS: BufferId = BufferId(9);

const BUFFER_VARIANTS: KernelTarget = KernelTarget { cpu: false, images: false, output_half: false };

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

/// Of squares, some of them beyond the frame.
fn gains(extent: Extent) -> View {
    let (width, height) = (extent.width.div_ceil(BLOCK) + 1, extent.height.div_ceil(BLOCK) + 1);
    View { width, height, ..view(extent, GAINS, 0, 4, 4) }
}

fn tile_stats(Extent { width, height }: Extent) -> TileStats {
    TileStats { stats: STATS, dst: TILE_STATS, runs: RUNS, width, height }
}

fn buffers(extent: Extent) -> Vec<Buffer> {
    let tokens = padded(extent).0 as u64 * padded(extent).1 as u64;
    let sizes = [
        ("stats", 4 * stats::STATS_FLOATS),
        ("histogram", stats::HISTOGRAM_BYTES),
        ("tile stats", tile_stats(extent).tile_bytes()),
        ("log color", 16 * tokens),
        ("aux", 32 * tokens),
        ("residual", 48 * tokens),
        ("tile list", tokens / 16),
        ("depth scale", 4),
        ("runs", tile_stats(extent).run_bytes()),
        ("gains", gains(extent).bytes()),
    ];
    let place = Place::Arena { block: 0, offset: 0 };
    sizes.map(|(name, bytes)| Buffer { name: name.into(), bytes, storage: Storage::F32, place: place.clone() }).into()
}

/// No kernel of this file reads weights.
fn any_weights() -> Weights {
    small_net(8, Block::FilmCnn { conv: Convolution::Standard })
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
        rig.set(STATS, &[median as f32, f32::NAN, f32::NAN, f32::NAN, f32::NAN, f32::NAN, f32::NAN]);
        rig.run(&[Call::StatsTiles(tile_stats(frame.extent))]);
        rig.compare_tile_stats(2e-6);
        // Sums of logarithms, and counts: of noisy pixels some may be others.
        let (found, expected) = (rig.download(RUNS), rig.reference.buffer(RUNS));
        for (i, (&found, &expected)) in found.iter().zip(expected).enumerate() {
            let bound = [2.4e-5, 0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0][i % 8];
            assert!((f64::from(found) - expected).abs() <= bound, "{name}: run value {i} is {found}, not {expected}");
        }

        rig.share(RUNS);
        let tiles: Vec<f64> = rig.reference.buffer(TILE_STATS).to_vec();
        rig.set_tile_stats(&tiles);
        let key = Call::StatsKey(tile_stats(frame.extent).key(DEPTH_SCALE));
        rig.run(std::slice::from_ref(&key));
        rig.compare(STATS, 3e-6, f64::abs);
        rig.compare_tile_stats(2e-6);
        let has_gaps = rig.reference.buffer(TILE_STATS).iter().any(|mean| mean.is_nan());
        assert_eq!(has_gaps, name.starts_with("all bad") || name.starts_with("all infinite"), "{name}");
        rig.bench.frame.exposure = Some(3.5);
        rig.bench.run(std::slice::from_ref(&key)).unwrap();
        assert_eq!(rig.download(STATS)[2], 3.5, "{name}: a fixed exposure is taken as it is");
        exposure_by_buffer(&mut rig, &key);
    }
    assert_no_validation_messages();
}

/// An exposure in a buffer comes before the fixed one, unless it is none; what was used is told.
fn exposure_by_buffer(rig: &mut Rig, key: &Call) {
    let [given, told] = [4, 16].map(|bytes| rig.bench.buffer("of the caller", bytes).unwrap());
    let address = |rig: &Rig, id| rig.bench.plane(id, 1, 1, 1).address;
    rig.bench.frame.exposure_at = Some(address(rig, given));
    rig.bench.frame.told_at = Some(address(rig, told));
    for (value, expected) in [(0.7, 0.7), (0.0, 3.5), (-1.0, 3.5), (f32::NAN, 3.5), (f32::INFINITY, 3.5), (1e-40, 3.5)]
    {
        rig.bench.upload(given, &[value]);
        rig.bench.run(std::slice::from_ref(key)).unwrap();
        let stats = rig.download(STATS);
        let depth_scale = if rig.bench.planes.has(Role::Depth) { rig.download(DEPTH_SCALE)[0] } else { 0.0 };
        assert_eq!(stats[stats::EXPOSURE], expected, "{} given {value}", rig.name);
        let told = rig.bench.download(told, 4);
        assert_eq!(told, [expected, depth_scale, stats[stats::KEY], stats[stats::NOISE]], "{}", rig.name);
    }
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
        let bright = ["fireflies", "lights", "holes"].iter().any(|word| name.contains(word));
        let key = if bright { 0.2 } else { [0.2, 3e-9, 1e-25, 1e34][i % 4] as f32 };
        rig.set(DEPTH_SCALE, &[7.5]);
        let mut random = Random::new(i as u64);
        // Some tiles are noisy, some are not, some know nothing; some have no mean, as nothing in the frame is good.
        let tile_values: Vec<f64> = (0..tile_stats(frame.extent).tiles())
            .flat_map(|tile| {
                let mean = if tile % 11 == 5 { f64::NAN } else { random.uniform(0.0, 3.0).into() };
                let counts: u32 = random.pick(&[0, 2, 48, 48 | 5 << 16, 48 | 48 << 16]);
                [mean, 1.0, 2.0, counts.into()]
            })
            .collect();
        rig.set_tile_stats(&tile_values);
        let tiles = tiles(&mut rig, frame.extent, i % 3 == 0 && width > 8);
        for fireflies in [Fireflies::Auto, Fireflies::Keep, Fireflies::Mend] {
            let noise = [0.1, 0.6][i % 2];
            rig.set(STATS, &[f32::NAN, key, 0.18 / key, noise, 7.0 * key, 3.0 * key, 1e6 * key]);
            rig.bench.frame.fireflies = fireflies;
            rig.reference.set_fireflies(fireflies);
            let dst = log_color(frame.extent);
            rig.run(&[Call::InputColor(InputColor {
                stats: STATS,
                tile_stats: TILE_STATS,
                dst,
                width,
                height,
                tiles,
            })]);
            // log1p to 4 ulp, and the roundings of exposure and of a mended pixel's mean before it.
            rig.compare(LOG_COLOR, 7e-7, f64::abs);
        }
        // Of the filter's noise, 0 to 1, relative roundings of 2e-6 in each of two ratios, over 0.2.
        for (clean, limit) in [(true, 2e-7), (false, 2e-5)] {
            let (depth_scale, dst) = (DEPTH_SCALE, aux(frame.extent));
            rig.run(&[Call::InputAux(InputAux { depth_scale, clean, dst, width, height, tiles })]);
            rig.compare(AUX, limit, |value| value.abs().max(0.25));
        }
    }
    assert_no_validation_messages();
}

#[test]
fn the_way_out() {
    for (i, (name, frame)) in frames().into_iter().enumerate() {
        let extent = frame.extent;
        let output_half = i % 3 == 2;
        let buffers = buffers(extent);
        let mut rig = Rig::new(name, &frame, &buffers, KernelTarget { output_half, ..BUFFER_VARIANTS });
        let exposure = [0.36, 1e-5, 2e4, 1e-33][i % 4];
        let mut random = Random::new(i as u64);
        let tokens = log_color(extent).tokens() as usize;
        let log_top = [1e-4, 3.0, 11.0][i % 3];
        // Now and then a result exceeds the frame's largest samples.
        let largest = [0.5, 0.9, 2.0].map(|share: f32| (log_top * share).exp_m1() / exposure);
        rig.set(STATS, &[f32::NAN, f32::NAN, exposure, f32::NAN, largest[0], largest[1], largest[2]]);
        let mut colors = random.values(4 * tokens, 0.0, log_top);
        // Light goes around the network here and there; what is not finite counts for more than its range.
        colors
            .iter_mut()
            .skip(3)
            .step_by(4)
            .for_each(|mark| *mark = random.pick(&[0.0, 0.0, 1.0, 9.0, 60.0, -1.0, -5.0, -60.0]));
        rig.set(LOG_COLOR, &colors);
        // Some take all of the colour away, some more than that, some nothing.
        let mut residuals = random.values(12 * tokens, -3.0, 1.0);
        for (r, c) in residuals.chunks_exact_mut(12).zip(colors.chunks_exact(4)) {
            (r[4], r[5]) = if random.coin() { (0.0, -c[1]) } else { (r[4] * c[0], r[5]) };
        }
        rig.set(RESIDUAL, &residuals);
        rig.set(GAINS, &random.values(gains(extent).elements() as usize, -0.125, 0.125));
        let blend = [0.0, 0.25, 1.0][i % 3];
        rig.reference.set_frame(&frame.frame(), None, blend.into()).unwrap();
        rig.reference.set_output_half(output_half);
        rig.bench.frame.blend = blend;
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
            residual_top: 0,
            gains: (i % 3 == 1).then_some(gains(extent)),
            log_color,
            stats: STATS,
            width,
            height,
            tiles,
            region,
            converged: None,
            ensemble: None,
        })]);

        let found = samples(&rig.bench.download(output, len), output_half);
        let expected = spread_output(&rig, extent, found.len());
        let own = spread_color(&frame, found.len());
        for (at, (&found, &expected)) in found.iter().zip(&expected).enumerate() {
            if expected.is_nan() {
                assert!(found.is_nan(), "{name}: sample {at} was written: {found}");
                continue;
            }
            // c + r is rounded before the exponential; then a rounding of halves.
            let step = if output_half { 5e-4 * expected.abs() + 3e-8 } else { 0.0 };
            // What went around is a difference of two that may be larger.
            let own = own[at].filter(|own| own.is_finite()).map_or(0.0, |own| f64::from(own.max(0.0)));
            let bound = 2e-6 * (expected + own + 1.0 / f64::from(exposure)) + step;
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
    let format = if half { Format::F16 } else { Format::F32 };
    rig.bench.planes[Role::Output] = PlaneArgs { offset: layout.offset as u32, format, ..plane };
    (id, floats)
}

fn samples(floats: &[f32], half: bool) -> Vec<f32> {
    if !half {
        return floats.to_vec();
    }
    let halves = floats.iter().flat_map(|f| [f.to_bits() as u16, (f.to_bits() >> 16) as u16]);
    halves.map(|bits| f16::from_bits(bits).to_f32()).collect()
}

/// The caller's colour where the output plane has its result.
fn spread_color(frame: &TestFrame, len: usize) -> Vec<Option<f32>> {
    let (layout, _) = odd_layout(frame.extent, 3);
    let (width, pixels) = (frame.extent.width as usize, frame.extent.pixels() as usize);
    let mut out = vec![None; len];
    for i in 0..3 * pixels {
        let (x, y, channel) = (i / 3 % width, i / 3 / width, i % 3);
        let at = layout.offset + y * layout.row_stride + x * layout.pixel_stride + channel * layout.channel_stride;
        out[at] = Some(frame.color.sample(x, y, channel));
    }
    out
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
