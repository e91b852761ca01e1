//! The kernels that leave out converged tiles, beside their twins.

mod common;

use common::device::assert_no_validation_messages;
use common::planes::{TestFrame, TestPlane};
use common::random::Random;
use common::rig::{Rig, words};
use vkdenoise::kernels::converged::{
    ALWAYS, ConvergedMap, Fill, MapSize, REACHES, Reach, Sample, TileList, TileNoise, list_bytes,
};
use vkdenoise::kernels::planes::{Format, PlaneArgs, Role};
use vkdenoise::kernels::{BufferId, Call, Storage, Tiles, View};
use vkdenoise::testing::SENTINEL;
use vkdenoise::{Extent, Noise, NoiseKind, Region};

const STATS: BufferId = BufferId(0);
const NOISE: BufferId = BufferId(1);

/// Smooth light with noise of different strength in different places, a hole of background, and what is bad of it.
fn noisy(extent: Extent, seed: u64, bad: bool) -> TestFrame {
    let mut random = Random::new(seed);
    let mut frame = TestFrame::random(extent, seed);
    let pixels = extent.pixels() as usize;
    let mut color = Vec::new();
    for i in 0..pixels {
        let (x, y) = (i as u32 % extent.width, i as u32 / extent.width);
        let strength = [0.0, 0.01, 0.1, 0.9][((x / 20 + y / 28) % 4) as usize];
        let light = 0.05 + 0.002 * x as f32 + 1e-5 * (y * y) as f32;
        color.extend((0..3).map(|_| light * (1.0 + strength * random.uniform(-1.0, 1.0))));
    }
    if bad {
        let at = 3 * (pixels / 2);
        for (i, wrong) in [(at, f32::NAN), (at + 40, -1.0), (7, 1e12)] {
            color[i.min(3 * pixels - 1)] = wrong;
        }
    }
    frame.color = TestPlane::packed(extent, 3, color);
    let depth = (0..pixels).map(|i| if (i as u32 % extent.width) < 40 { 0.0 } else { 3.0 }).collect();
    frame.depth = Some(TestPlane::packed(extent, 1, depth));
    frame
}

fn noise_plane(extent: Extent, kind: NoiseKind, seed: u64) -> TestPlane {
    let mut random = Random::new(seed);
    let mut value = |i: usize| match (kind, i % 331) {
        (_, 17) => [f32::NAN, -1.0, f32::INFINITY, 0.0][i / 331 % 4],
        (NoiseKind::Variance, _) => random.uniform(0.0, 0.3),
        (NoiseKind::Samples, _) => random.uniform(1.0, 4096.0).floor(),
    };
    TestPlane::packed(extent, 1, (0..extent.pixels() as usize).map(&mut value).collect())
}

#[test]
fn tile_noise() {
    let sizes = [(1, 1), (2, 40), (3, 3), (16, 16), (17, 33), (130, 75), (200, 128)];
    let (mut count, mut worst) = (0, 0.0f64);
    for (i, (width, height)) in sizes.into_iter().enumerate() {
        let extent = Extent::new(width, height);
        let map = MapSize::of(Extent::new(width.next_multiple_of(128), height.next_multiple_of(128)));
        let kinds = [None, Some(NoiseKind::Variance), Some(NoiseKind::Samples)];
        for ((kind, half), bad) in kinds.iter().flat_map(|k| [(k, false), (k, true)]).zip([false, true].repeat(3)) {
            let frame = noisy(extent, i as u64, bad).spread(half);
            let noise = kind.map(|kind| noise_plane(extent, kind, 7).spread(extent, 1, half));
            let buffers = words(&[3, u64::from(map.tiles())]);
            let mut rig = Rig::new(extent, &buffers);
            let exposure = [0.7f32, 300.0][i % 2];
            rig.set_floats(STATS, &[f32::NAN, 0.18 / exposure, exposure]);
            let mut used = Vec::new();
            frame.upload(&mut rig.bench, &mut used);
            let mut view = frame.frame();
            if let (Some(plane), Some(kind)) = (&noise, kind) {
                let row = plane.upload(&mut rig.bench, &mut used);
                rig.bench.planes[Role::Noise] = PlaneArgs { format: row.format.of_noise(*kind), ..row };
                view.features.noise = Some(Noise { plane: plane.plane(), kind: *kind });
            }
            rig.reference.set_frame(&view, None, 0.0).unwrap();
            rig.run(Call::TileNoise(TileNoise { stats: STATS, dst: NOISE, frame: extent, map }));
            let found = rig.bench.download(NOISE, map.tiles() as usize);
            let expected = rig.reference.buffer(NOISE);
            // Near 1 Vulkan's logarithm is good to 2^-21; the second difference adds 16 of them.
            let step = |expected: f64| 16.0 / 6.0 / f64::from(1 << 21) + 1e-5 * expected;
            for (at, (found, expected)) in found.iter().zip(expected).enumerate() {
                let error = (f64::from(*found) - expected).abs();
                let always = *expected == f64::from(ALWAYS);
                let fits = if always { *found == ALWAYS } else { error <= step(*expected) };
                assert!(fits, "{extent:?} {kind:?} {half}: square {at} is {found}, not {expected}");
                worst = if always { worst } else { worst.max(error) };
            }
            count += 1;
        }
    }
    println!("tile_noise: {count} frames, error {worst:.1e}");
    assert_no_validation_messages();
}

/// What the measure is for: noise shows, and what is smooth or black does not.
#[test]
fn noise_is_told_from_smoothness() {
    let extent = Extent::new(256, 128);
    let map = MapSize::of(extent);
    for deviation in [0.01f32, 0.1, 0.3] {
        let mut random = Random::new(3);
        let mut normal = || (0..12).map(|_| random.uniform(-0.5, 0.5)).sum::<f32>();
        // Columns of squares: black, constant, a ramp, noise, one noisy pixel of its own size a square.
        let color: Vec<f32> = (0..3 * 256 * 128)
            .map(|i| match i / 3 % 256 / 48 {
                0 => 0.0,
                1 => 0.4,
                2 => 0.01 * (i / 3 % 256) as f32,
                3 => 0.5 * (1.0 + deviation * normal()).max(0.0),
                _ if i / 3 % 16 == 5 && i / 768 % 16 == 9 => 1.0,
                _ => 0.5,
            })
            .collect();
        let frame = TestFrame::of_color(extent, color);
        let buffers = words(&[3, u64::from(map.tiles())]);
        let mut rig = Rig::new(extent, &buffers);
        rig.set_floats(STATS, &[f32::NAN, 0.18, 1.0]);
        frame.upload(&mut rig.bench, &mut Vec::new());
        rig.reference.set_frame(&frame.frame(), None, 0.0).unwrap();
        rig.run(Call::TileNoise(TileNoise { stats: STATS, dst: NOISE, frame: extent, map }));
        let found = rig.bench.download(NOISE, map.tiles() as usize);
        for (i, noise) in found.iter().enumerate() {
            let wanted = match i % 16 {
                // Next to another column its edge shows.
                2 | 3 | 5 | 6 | 8 | 9 | 11 | 12 => continue,
                0 | 1 | 4 => 0.0..1e-5,
                7 => 0.0..0.002,
                // Logarithms of what is near 0 make more of it.
                10 => 0.85 * deviation..2.5 * deviation,
                _ => 0.05..0.2,
            };
            assert!(wanted.contains(noise), "square {i}: {noise}, not in {wanted:?}");
        }
    }
}

#[test]
fn converged_maps_and_their_lists() {
    let mut random = Random::new(4);
    for round in 0..24 {
        let size = MapSize { columns: 8 * random.integer(1, 6), rows: 8 * random.integer(1, 4) };
        let tile_pixels = [8, 16, 32, 64, 128][round % 5];
        let tiles = |squares: u32| squares * 16 / tile_pixels;
        let (columns, rows) = (tiles(size.columns), tiles(size.rows));
        let max_y = random.integer(1, 5);
        let mut reaches = |most: u32| {
            std::array::from_fn::<_, REACHES, _>(|_| Reach {
                back: random.integer(0, most),
                on: random.integer(0, most),
            })
        };
        let (mut reach, read) = (reaches(3), reaches(6));
        if round % 6 == 5 {
            (reach[0].back, reach[2].on) = (255, 300);
        }
        let [src, map, sums, list, idle, groups, counts] = [0, 1, 2, 3, 4, 5, 6].map(BufferId);
        let mut call = TileList {
            sums,
            list,
            idle,
            groups,
            counts,
            slot: 2,
            map: size,
            columns,
            rows,
            tile_pixels,
            reach,
            read,
            max_y,
            sample: None,
        };
        call.slot = random.integer(0, 3);
        let real = |all: u32| if round % 4 == 3 { all - all / 3 } else { all };
        let real = MapSize { columns: real(size.columns), rows: real(size.rows) };
        let pitch = [4, 13, 64, 1000][(round + round / 4) % 4];
        call.sample = (round % 2 == 1).then(|| Sample::one_in(pitch, real));
        let listed = list_bytes(call.tiles()) / 4;
        let buffers = words(&[
            u64::from(size.tiles()),
            u64::from(size.tiles()),
            u64::from(size.sums()),
            listed,
            listed,
            call.groups_bytes() / 4,
            4,
        ]);
        let extent = Extent::new(16 * size.columns, 16 * size.rows);
        let mut rig = Rig::new(extent, &buffers);
        // From none to all.
        let noise = random.values(size.tiles() as usize, 0.0, [0.9, 1.003, 1.05, 2.0, 900.0][round / 5]);
        rig.set_floats(src, &noise);
        let counted = round % 2 == 0;
        rig.bench.frame.converged_threshold = 1.0;
        rig.reference.set_converged_threshold(1.0);
        let frame = TestFrame::of_color(extent, vec![0.0; 3 * extent.pixels() as usize]);
        let plane = TestPlane::packed(extent, 1, vec![1.0; extent.pixels() as usize]);
        let mut view = frame.frame();
        if counted {
            rig.bench.planes[Role::Noise].format = Format::F32.of_noise(NoiseKind::Samples);
            view.features.noise = Some(Noise { plane: plane.plane(), kind: NoiseKind::Samples });
        }
        rig.reference.set_frame(&view, None, 0.0).unwrap();
        let (x, y) = (random.integer(0, 60), random.integer(0, 60));
        let (width, height) = (random.integer(1, extent.width - x), random.integer(1, extent.height - y));
        let all = Region::all(extent);
        let region = if round % 3 == 0 { all } else { Region { x, y, width, height } };
        rig.run(Call::ConvergedMap(ConvergedMap { src, map, sums, size, real, region }));
        rig.assert_integers(map, "map");
        rig.assert_integers(sums, "sums");
        rig.run(Call::TileList(call));
        for (id, what) in [(list, "list"), (idle, "idle"), (groups, "groups"), (counts, "counts")] {
            rig.assert_integers(id, &format!("round {round}: {what}"));
        }
        let used: Vec<u64> = buffers.iter().map(|buffer| buffer.bytes).collect();
        rig.bench.check_guards(&used).unwrap();
    }
    assert_no_validation_messages();
}

/// More workgroups than a dispatch has in x go to z.
#[test]
fn long_lists_fill_several_layers() {
    let size = MapSize { columns: 8, rows: 4104 };
    let [sums, list, idle, groups, counts] = [0, 1, 2, 3, 4].map(BufferId);
    let (columns, rows) = (16, 8208);
    let reach = [Reach::default(); REACHES];
    let call = TileList {
        sums,
        list,
        idle,
        groups,
        counts,
        slot: 0,
        map: size,
        columns,
        rows,
        tile_pixels: 8,
        reach,
        read: reach,
        max_y: 2,
        sample: None,
    };
    let listed = list_bytes(call.tiles()) / 4;
    let buffers = words(&[u64::from(size.sums()), listed, listed, call.groups_bytes() / 4, 1]);
    let mut rig = Rig::new(Extent::new(1, 1), &buffers);
    let all: Vec<u32> = (0..=size.rows).flat_map(|y| (0..=size.columns).map(move |x| x * y)).collect();
    rig.bench.upload(sums, &all.iter().map(|&sum| f32::from_bits(sum)).collect::<Vec<_>>());
    rig.bench.run(&[Call::TileList(call)]).unwrap();
    let found = rig.bench.download(groups, buffers[3].bytes as usize / 4);
    let found: Vec<u32> = found.into_iter().map(f32::to_bits).collect();
    let tiles = 16 * 8208u32;
    assert!(tiles > 2 * 65535);
    assert_eq!(found[..9], [tiles / 3, 1, 3, tiles / 3, 2, 3, tiles / 4, 1, 2]);
    assert_eq!(found[24..], [tiles / 16, 1, 1, tiles / 16, 2, 1, 0, 1, 1]);
}

#[test]
fn fill() {
    let mut random = Random::new(6);
    for (round, storage) in [Storage::F32, Storage::F16].repeat(9).into_iter().enumerate() {
        let side = [4, 8, 16][round / 2 % 3];
        let (columns, rows) = (random.integer(1, 5), random.integer(1, 5));
        let (first, channels) = (4 * random.integer(0, 2), 4 * random.integer(1, 9));
        let stride = first + channels + 4 * random.integer(0, 1);
        let (width, height, top) = (columns * side, rows * side, 8 * random.integer(0, 1));
        // Rows of a map come in tiles.
        let dst = View { buffer: BufferId(0), first, channels, stride, width, height, top, storage };
        let elements = u64::from((top + height) * width * stride);
        let all: Vec<_> = (0..rows).flat_map(|y| (0..columns).map(move |x| (x, y))).collect();
        let list: Vec<_> = all.into_iter().filter(|_| random.coin()).collect();
        let mut buffers = words(&[elements * storage.bytes() / 4, 1 + u64::from(rows * columns)]);
        buffers[0].storage = storage;
        let mut rig = Rig::new(Extent::new(1, 1), &buffers);
        rig.bench.upload(BufferId(1), &common::case::tile_bits(&list));
        rig.reference.set_tiles(BufferId(1), &list);
        let tiles = Tiles::List { buffer: BufferId(1), at_most: rows * columns };
        rig.run(Call::Fill(Fill { dst, side, tiles }));
        let words = rig.bench.download(BufferId(0), buffers[0].bytes as usize / 4);
        let sentinel = [SENTINEL & 0xffff, SENTINEL >> 16];
        for (i, expected) in rig.reference.buffer(BufferId(0)).iter().enumerate() {
            let (found, untouched) = match storage {
                Storage::F32 => (words[i].to_bits(), SENTINEL),
                Storage::F16 => (words[i / 2].to_bits() >> (16 * (i % 2)) & 0xffff, sentinel[i % 2]),
            };
            assert_eq!(found, if expected.is_nan() { untouched } else { 0 }, "round {round}: element {i}");
        }
    }
    assert_no_validation_messages();
}
