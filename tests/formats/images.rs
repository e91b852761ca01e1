//! Planes in images.

use super::*;

#[test]
fn albedo_and_colour_in_images() {
    let mut rig = Rig::new();
    let (packed, values) = pixels(SampleFormat::Unorm8, 4, 30);
    let linear = |v: f32| if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) };
    // Light is divided by the albedo and multiplied by it for kernels, which enlarges a driver's error: its sRGB is for
    // a network that adds a residual.
    let mut residual = Rig::of(&residual_hybrid());
    let cases = [
        (&mut rig, ImageFormat::Rgba8Unorm, None, NEAR),
        (&mut residual, ImageFormat::Rgba8Srgb, Some(linear), NEAR_SRGB),
    ];
    for (rig, format, decode, limit) in cases {
        let decoded = values.iter().flat_map(|pixel| &pixel[..3]);
        rig.albedo = decoded.map(|v| decode.map_or(*v, |decode| decode(*v))).collect();
        let expected = rig.in_images(|_| ());
        let image = RendererImage::of_bytes(&rig.renderer, EXTENT, format, &packed);
        let found = rig.in_images(|frame| frame.albedo = Some(image.plane()));
        assert_near(limit, &found, &expected, &format!("{format:?}"));
    }
    residual.renderer.assert_silent();
    // Floats of 11, 11 and 10 bits: five of the exponent, six and five of the mantissa, no sign.
    let mut random = Random::new(31);
    let words: Vec<u32> = (0..PIXELS)
        .map(|_| {
            let mut float = |mantissa: u32| {
                ((12 + random.bits() as u32 % 4) << mantissa) | (random.bits() as u32 % (1 << mantissa))
            };
            float(6) | float(6) << 11 | float(5) << 22
        })
        .collect();
    let float = |bits: u32, mantissa: u32| f16::from_bits((bits << (10 - mantissa)) as u16).to_f32();
    let values: Vec<f32> =
        words.iter().flat_map(|w| [float(w & 2047, 6), float(w >> 11 & 2047, 6), float(w >> 22, 5)]).collect();
    let image = RendererImage::of_bytes(&rig.renderer, EXTENT, ImageFormat::B10G11R11F, bytemuck::cast_slice(&words));
    (rig.color, rig.albedo) = (values.clone(), values);
    let expected = rig.in_images(|_| ());
    let found = rig.in_images(|frame| (frame.color, frame.albedo) = (image.plane(), Some(image.plane())));
    assert_same_bits(&found, &expected, "B10G11R11F");
    rig.renderer.assert_silent();
}

#[test]
fn normals_in_images() {
    let mut rig = Rig::new();
    let cases = [
        (ImageFormat::Rgba8Unorm, SampleFormat::Unorm8, 4),
        (ImageFormat::Rgb10A2Unorm, SampleFormat::Rgb10A2Unorm, 3),
        (ImageFormat::Rgba16Snorm, SampleFormat::Snorm16, 4),
        (ImageFormat::Rgba16F, SampleFormat::F16, 4),
        (ImageFormat::Rgba32F, SampleFormat::F32, 4),
        (ImageFormat::Rg16Snorm, SampleFormat::Snorm16, 2),
        (ImageFormat::Rg16F, SampleFormat::F16, 2),
        (ImageFormat::Rg32F, SampleFormat::F32, 2),
    ];
    for (seed, (format, samples, channels)) in (40..).zip(cases) {
        for encoding in [NormalEncoding::Vector, NormalEncoding::Unsigned, NormalEncoding::Octahedral] {
            if channels == 2 && encoding != NormalEncoding::Octahedral {
                continue;
            }
            let (packed, values) = pixels(samples, channels, seed);
            rig.normal =
                values.iter().flat_map(|pixel| normal_of(samples, encoding, &pixel[..pixel.len().min(3)])).collect();
            let expected = rig.in_images(|_| ());
            let image = RendererImage::of_bytes(&rig.renderer, EXTENT, format, &packed);
            let found = rig.in_images(|frame| {
                (frame.normal, frame.normal_encoding) = (Some(image.plane()), encoding);
            });
            assert_near(NEAR, &found, &expected, &format!("{format:?}, {encoding:?}"));
        }
    }
    rig.renderer.assert_silent();
}

#[test]
fn depths_in_images() {
    let mut rig = Rig::new();
    let cases = [
        (ImageFormat::R32F, SampleFormat::F32),
        (ImageFormat::R16F, SampleFormat::F16),
        (ImageFormat::D32F, SampleFormat::F32),
        (ImageFormat::D16Unorm, SampleFormat::Unorm16),
    ];
    for (seed, (format, samples)) in (50..).zip(cases) {
        let (packed, values) = pixels(samples, 1, seed);
        let is_depth = matches!(format, ImageFormat::D32F | ImageFormat::D16Unorm);
        // Depth buffers hold numbers from 0 to 1.
        let unit: Vec<f32> = values.iter().map(|pixel| pixel[0].abs()).collect();
        let bytes: Vec<u8> = match format {
            ImageFormat::D32F => bytemuck::cast_slice(&unit).to_vec(),
            _ => packed,
        };
        let numbers = if is_depth { unit } else { values.concat() };
        for encoding in PERSPECTIVES.into_iter().chain((!is_depth).then_some(DepthEncoding::Linear)) {
            rig.depth = numbers.iter().map(|number| distance(encoding, *number)).collect();
            let expected = rig.in_images(|_| ());
            let image = RendererImage::of_bytes(&rig.renderer, EXTENT, format, &bytes);
            let found = rig.in_images(|frame| (frame.depth, frame.depth_encoding) = (Some(image.plane()), encoding));
            assert_near(NEAR, &found, &expected, &format!("{format:?}, {encoding:?}"));
        }
    }
    rig.renderer.assert_silent();
}
