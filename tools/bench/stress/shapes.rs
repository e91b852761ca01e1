//! Sizes and layouts.

use super::scene::Scene;
use super::subject::Subject;
use super::{Bound, Cases, Effort, Measured, Result, bad_samples, sound};
use half::f16;
use vkdenoise::{Extent, Features, Frame, Layout, Noise, NoiseKind, Plane, PlaneMut};

/// What this module measures.
pub const CASES: Cases = &[("sizes from 1x1 to 4096x1, primes", sizes), ("odd strides and offsets", strides)];

fn sizes(subject: &mut Subject, effort: Effort) -> Result<Vec<Measured>> {
    let sizes: &[(u32, u32)] = match effort {
        Effort::Sample => &[(1, 1), (2, 1), (13, 17)],
        Effort::Everything => &[
            (1, 1),
            (1, 2),
            (2, 1),
            (3, 3),
            (1, 7),
            (7, 1),
            (13, 17),
            (61, 47),
            (64, 64),
            (127, 131),
            (128, 128),
            (129, 127),
            (211, 89),
            (4096, 1),
            (1, 4096),
            (4093, 3),
            (257, 263),
        ],
    };
    let mut sound = sound();
    for &(width, height) in sizes {
        let scene = Scene::new(Extent::new(width, height), 8);
        sound.take(bad_samples(&subject.denoise(&scene)?), format!("{width}x{height}"));
    }
    Ok(vec![sound])
}

/// What lies in the gaps of a plane, as an input and as an output.
const SENTINEL: f32 = -12345.0;

/// A layout with gaps before, between and after the pixels, and the samples that it needs.
fn gapped(extent: Extent, channels: usize, offset: usize, gap: usize) -> (Layout, usize) {
    let pixel_stride = 2 * channels + gap;
    let row_stride = extent.width as usize * pixel_stride + gap + 2;
    let layout = Layout { offset, pixel_stride, row_stride, channel_stride: 2 };
    (layout, offset + extent.height as usize * row_stride)
}

/// The index of every sample of a packed plane in another layout.
fn places(extent: Extent, channels: usize, layout: Layout) -> impl Iterator<Item = usize> {
    let (width, height) = (extent.width as usize, extent.height as usize);
    (0..height * width * channels).map(move |i| {
        let (channel, x, y) = (i % channels, i / channels % width, i / channels / width);
        layout.offset + y * layout.row_stride + x * layout.pixel_stride + channel * layout.channel_stride
    })
}

fn spread(values: &[f32], extent: Extent, channels: usize, (layout, len): (Layout, usize)) -> Vec<f32> {
    let mut out = vec![SENTINEL; len];
    places(extent, channels, layout).zip(values).for_each(|(at, &value)| out[at] = value);
    out
}

fn strides(subject: &mut Subject, effort: Effort) -> Result<Vec<Measured>> {
    let Some(engine) = subject.as_engine() else { return Ok(Vec::new()) };
    let mut differing = Measured::new("samples of other bits than packed", Bound::AtMost(0.0));
    let mut overwritten = Measured::new("samples overwritten in gaps", Bound::AtMost(0.0));
    let gaps: &[usize] = if effort == Effort::Sample { &[1] } else { &[0, 1, 2, 5, 31] };
    for (&gap, half) in gaps.iter().flat_map(|gap| [(gap, false), (gap, true)]) {
        let extent = Extent::new(29, 23);
        let mut scene = Scene::new(extent, 9);
        if half {
            // Values that halves hold.
            let round = |v: &mut f32| *v = f16::from_f32(*v).to_f32();
            let features = [&mut scene.albedo, &mut scene.normal, &mut scene.depth];
            scene.color.iter_mut().chain(features.into_iter().flatten().flatten()).for_each(round);
        }
        let rgb = Layout::interleaved(extent, 3);
        let mut packed = vec![0.0; scene.color.len()];
        engine.denoiser.denoise(&scene.frame(), PlaneMut::f32(&mut packed, rgb))?;
        engine.left_out.take(&scene, &engine.denoiser)?;

        let (three, one) = (gapped(extent, 3, 7 + gap, gap), gapped(extent, 1, gap, gap));
        let plane = |values: &Option<Vec<f32>>, channels, place| {
            spread(values.as_deref().unwrap_or_default(), extent, channels, place)
        };
        let planes = [
            spread(&scene.color, extent, 3, three),
            plane(&scene.albedo, 3, three),
            plane(&scene.normal, 3, three),
            plane(&scene.depth, 1, one),
            plane(&scene.samples, 1, one),
        ];
        let halves = planes.clone().map(|plane| plane.into_iter().map(f16::from_f32).collect::<Vec<_>>());
        let view = |i: usize, layout| match half {
            true => Plane::f16(&halves[i], layout),
            false => Plane::f32(&planes[i], layout),
        };
        let features = Features {
            albedo: Some(view(1, three.0)),
            normal: Some(view(2, three.0)),
            depth: Some(view(3, one.0)),
            noise: Some(Noise { plane: view(4, one.0), kind: NoiseKind::Samples }),
        };
        let frame = Frame { extent, color: view(0, three.0), features };
        let mut output = vec![SENTINEL; three.1];
        engine.denoiser.denoise(&frame, PlaneMut::f32(&mut output, three.0))?;
        let input = format!("gap {gap}{}", if half { ", halves" } else { "" });
        let mut count = 0;
        for (at, expected) in places(extent, 3, three.0).zip(&packed) {
            count += usize::from(output[at].to_bits() != expected.to_bits());
            output[at] = SENTINEL;
        }
        differing.take(count as f64, &input);
        overwritten.take(output.iter().filter(|v| **v != SENTINEL).count() as f64, &input);
    }
    Ok(vec![differing, overwritten])
}
