//! Frames whose statistics are easy to get wrong.

use super::*;

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

/// Features that grow noisy from the left to the right, and bars on them.
fn with_noisy_features(frame: TestFrame) -> TestFrame {
    let (extent, mut random) = (frame.extent, Random::new(6));
    let mut plane = |low: f32, slope: f32| {
        let value = |i: usize| {
            let (x, y) = (i / 3 % extent.width as usize, i / 3 / extent.width as usize);
            let noise = if x < 16 { 0.0 } else { 0.004 * (x - 16) as f32 * random.uniform(-1.0, 1.0) };
            low + slope * y as f32 + noise + if y % 13 < 2 { 0.2 } else { 0.0 }
        };
        let samples = (0..3 * extent.pixels() as usize).map(value).collect();
        Some(TestPlane::packed(extent, 3, samples))
    };
    TestFrame { albedo: plane(0.3, 0.005), normal: plane(-0.5, 0.02), ..frame }
}

/// Frames whose statistics are easy to get wrong.
pub fn frames() -> Vec<(&'static str, TestFrame)> {
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
    // Holes of NaN, all or one channel, larger than what single pixels are mended from; a lamp of +Inf and a lone one.
    let square = |left: usize, top: usize, side: usize, color: [f32; 3]| {
        (0..side * side).map(move |i| (70 * (top + i / side) + left + i % side, color))
    };
    let mut holes: Vec<_> = square(20, 3, 26, [nan; 3]).chain(square(50, 20, 12, [1.0, nan, 2.0])).collect();
    holes.extend(square(3, 30, 4, [inf; 3]).chain([(70 * 40 + 60, [0.5, inf, nan]), (70 * 44, [-1.0, 2.0, -0.5])]));
    holes.extend(square(52, 22, 2, [nan, inf, 1.0]));
    // A sun, stars of several sizes, wide-gamut colours.
    let mut lights: Vec<_> = square(10, 10, 5, [1.6e9, 1e9, 3e8]).chain(square(40, 30, 2, [1e12; 3])).collect();
    lights.extend([300, 340, 341, 2000, 2010].map(|at| (at, [500.0, 40.0, 0.01])));
    lights.extend([(420, [nan, 1e20, 1.0]), (69, [9e5; 3])]);
    lights.extend(square(30, 3, 5, [-0.02, 0.05, 0.9]));
    let smooth = || {
        let value =
            |i: usize| 0.2 + 0.001 * ((i / 3 % 70) as f32) + if i / 210 > 22 { 0.1 * (i % 7) as f32 } else { 0.0 };
        TestFrame::of_color(odd, (0..3 * 70 * 45).map(value).collect())
    };
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
        ("holes", with_pixels(random(), &holes)),
        ("holes in halves", with_pixels(smooth(), &holes).spread(true)),
        ("lights among noise", with_pixels(random(), &lights)),
        ("lights", with_pixels(smooth(), &lights)),
        ("lights, spread out", with_pixels(smooth(), &lights).spread(false)),
        ("all infinite", flat(Extent::new(9, 9), inf)),
        ("noisy features", with_noisy_features(flat(Extent::new(99, 45), 0.5))),
        ("noisy features, spread out, halves", with_noisy_features(flat(Extent::new(99, 45), 0.5)).spread(true)),
    ]
}
