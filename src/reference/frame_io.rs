//! Twins of the frame's way into the network and out of it ([`crate::kernels::frame_io`]).

use super::Reference;
use super::map::Map;
use super::tiles;
use crate::frame::{Extent, Frame, Plane, Samples};
use crate::kernels::frame_io::{InputAux, InputColor, Output};
use crate::kernels::quiet::{BLEND_PIXELS, MAP_TILE, NoiseKind};
use crate::kernels::stats::{EXPOSURE, KEY};

/// Exposed colour ends here, and so does an output of halves.
const LARGEST_HALF: f64 = 65504.0;
/// Depths from here on are background, in planes of floats and of halves.
const FAR: f32 = 1e9;
const FAR_HALF: f32 = 65000.0;
/// A pixel of more than this many keys is bad.
pub const FIREFLY_KEYS: f64 = 1e8;
/// So is one of more than this many keys and this many times its second-brightest neighbour.
const ISOLATED_KEYS: f64 = 1e3;
const ISOLATED_RATIO: f64 = 100.0;

/// A frame and its settings, planes interleaved.
#[derive(Debug)]
pub struct FrameData {
    extent: Extent,
    color: Vec<f32>,
    albedo: Option<Vec<f32>>,
    normal: Option<Vec<f32>>,
    depth: Option<Vec<f32>>,
    far: f32,
    /// What is known of the colour's noise.
    pub noise: Option<Vec<f32>>,
    /// What that is.
    pub noise_kind: NoiseKind,
    /// Relative noise up to which nothing is denoised.
    pub quiet_threshold: f64,
    /// Factor on the colour; `None`: the frame's own.
    pub exposure: Option<f64>,
    /// Share of the noisy colour in the output.
    pub blend: f64,
    /// Whether the output's samples are halves.
    pub output_half: bool,
}

impl FrameData {
    /// A black frame without features.
    pub fn black(extent: Extent) -> Self {
        let color = vec![0.0; 3 * extent.pixels() as usize];
        let (albedo, normal, depth) = (None, None, None);
        let (noise, noise_kind, quiet_threshold) = (None, NoiseKind::default(), 0.0);
        let (far, exposure, blend, output_half) = (FAR, None, 0.0, false);
        Self {
            extent,
            color,
            albedo,
            normal,
            depth,
            far,
            noise,
            noise_kind,
            quiet_threshold,
            exposure,
            blend,
            output_half,
        }
    }

    /// The planes of a frame that was checked.
    pub fn new(frame: &Frame) -> Self {
        let extent = frame.extent;
        let packed = |plane: &Plane, channels| {
            let mut out = vec![0.0; channels * extent.pixels() as usize];
            plane.pack(extent, channels, &mut out);
            out
        };
        let features = &frame.features;
        let half_depth = features.depth.is_some_and(|plane| matches!(plane.samples, Samples::F16(_)));
        Self {
            color: packed(&frame.color, 3),
            albedo: features.albedo.map(|plane| packed(&plane, 3)),
            normal: features.normal.map(|plane| packed(&plane, 3)),
            depth: features.depth.map(|plane| packed(&plane, 1)),
            noise: features.noise.map(|noise| packed(&noise.plane, 1)),
            noise_kind: features.noise.map_or(NoiseKind::default(), |noise| noise.kind),
            far: if half_depth { FAR_HALF } else { FAR },
            ..Self::black(extent)
        }
    }

    /// The colour of a pixel, if all of it is finite and not negative.
    pub fn color(&self, pixel: usize) -> Option<[f32; 3]> {
        let color = [0, 1, 2].map(|channel| self.color[3 * pixel + channel]);
        color.iter().all(|c| c.is_finite() && *c >= 0.0).then_some(color)
    }

    /// The luminance of a valid pixel.
    pub fn luminance(&self, pixel: usize) -> Option<f32> {
        self.color(pixel).map(|[r, g, b]| (0.2126 * r + 0.7152 * g + 0.0722 * b).min(f32::MAX))
    }

    /// Whether there is no plane of depths.
    pub fn has_no_depth(&self) -> bool {
        self.depth.is_none()
    }

    /// Width and height in pixels.
    pub fn size(&self) -> [usize; 2] {
        [self.extent.width as usize, self.extent.height as usize]
    }

    /// A valid depth.
    pub fn depth(&self, pixel: usize) -> Option<f32> {
        self.depth.as_ref().map(|plane| plane[pixel]).filter(|&depth| depth > 0.0 && depth < self.far)
    }

    /// The colour of a pixel that is valid and not absurdly bright.
    fn in_range(&self, x: usize, y: usize, key: f64) -> Option<[f64; 3]> {
        let color = self.color(y * self.extent.width as usize + x)?.map(f64::from);
        color.iter().all(|&c| c <= FIREFLY_KEYS * key).then_some(color)
    }

    /// The 3x3 pixels around one as far as they lie in the frame, itself with them.
    fn around(&self, x: usize, y: usize) -> impl Iterator<Item = (usize, usize)> {
        let range = |at: usize, end: u32| at.saturating_sub(1)..(at + 2).min(end as usize);
        let columns = range(x, self.extent.width);
        range(y, self.extent.height).flat_map(move |y| columns.clone().map(move |x| (x, y)))
    }

    /// The colour of a pixel that is in range and not isolated: light of more than two pixels has two bright neighbours.
    pub fn good(&self, x: usize, y: usize, key: f64) -> Option<[f64; 3]> {
        let brightest = |[r, g, b]: [f64; 3]| r.max(g).max(b);
        let color = self.in_range(x, y, key)?;
        if brightest(color) <= ISOLATED_KEYS * key {
            return Some(color);
        }
        let others = self.around(x, y).filter(|at| *at != (x, y)).filter_map(|(x, y)| self.in_range(x, y, key));
        let mut light: Vec<f64> = others.map(brightest).collect();
        light.sort_by(|a, b| b.total_cmp(a));
        let second = light.get(1).copied().unwrap_or(0.0);
        (brightest(color) <= ISOLATED_RATIO * second).then_some(color)
    }

    /// The colour of a pixel, mended: bad ones are the mean of their good neighbours.
    fn mended(&self, x: usize, y: usize, key: f64) -> [f64; 3] {
        self.good(x, y, key).unwrap_or_else(|| {
            let good: Vec<[f64; 3]> = self.around(x, y).filter_map(|(x, y)| self.good(x, y, key)).collect();
            let count = good.len().max(1) as f64;
            [0, 1, 2].map(|channel| good.iter().map(|color| color[channel]).sum::<f64>() / count)
        })
    }

    /// The seven auxiliary channels of a pixel.
    fn features(&self, pixel: usize, depth_scale: f64) -> [f64; 7] {
        let three = |plane: &Option<Vec<f32>>, missing: f64, map: fn(f64) -> f64| {
            [0, 1, 2].map(|channel| {
                let value = plane.as_ref().map(|plane| plane[3 * pixel + channel]).filter(|v| v.is_finite());
                value.map_or(missing, |value| map(f64::from(value)).clamp(0.0, 1.0))
            })
        };
        let [r, g, b] = three(&self.albedo, 0.0, |albedo| albedo);
        let [x, y, z] = three(&self.normal, 0.5, |normal| (normal + 1.0) / 2.0);
        let depth = self.depth(pixel).map_or(0.0, |depth| (f64::from(depth) / depth_scale).min(1.0));
        [r, g, b, x, y, z, depth]
    }
}

/// `log1p(colour * exposure)`, bad pixels mended, reflected into the padding.
pub fn input_color(reference: &mut Reference, call: &InputColor) {
    let stats = reference.buffer(call.stats);
    let (key, exposure) = (stats[KEY], stats[EXPOSURE]);
    let frame = &reference.frame;
    let mut map = Map::zeros(call.dst.width as usize, call.dst.height as usize, call.dst.channels as usize);
    fill(&mut map, call.width, call.height, |x, y, token| {
        for (to, color) in token.iter_mut().zip(frame.mended(x, y, key)) {
            *to = (color * exposure).min(LARGEST_HALF).ln_1p();
        }
    });
    let tiles = reference.tiles(&call.tiles, call.dst.width, call.dst.height);
    reference.store(&map, &call.dst, &tiles, |x, y, channel| (x, y, channel));
}

/// Albedo, normal, depth and a zero, reflected into the padding.
pub fn input_aux(reference: &mut Reference, call: &InputAux) {
    let depth_scale = reference.buffer(call.depth_scale)[0];
    let frame = &reference.frame;
    let mut map = Map::zeros(call.dst.width as usize, call.dst.height as usize, call.dst.channels as usize);
    fill(&mut map, call.width, call.height, |x, y, token| {
        token[..7].copy_from_slice(&frame.features(y * call.width as usize + x, depth_scale));
    });
    let tiles = reference.tiles(&call.tiles, call.dst.width, call.dst.height);
    reference.store(&map, &call.dst, &tiles, |x, y, channel| (x, y, channel));
}

/// `max(expm1(c + r) / exposure, 0)`, mixed with the noisy colour, cropped.
pub fn output(reference: &mut Reference, call: &Output) {
    let (residual, log_color) = (reference.map(&call.residual), reference.map(&call.log_color));
    let exposure = reference.buffer(call.stats)[EXPOSURE];
    let map = call.quiet.map(|map| reference.buffer(map));
    let frame = &reference.frame;
    let (blend, end) = (frame.blend, if frame.output_half { LARGEST_HALF } else { f64::from(f32::MAX) });
    let (width, height) = (call.width as usize, call.height as usize);
    let mut out = reference.output.clone();
    out.resize(3 * width * height, f64::NAN);
    for (x, y) in tiles::tokens(&reference.tiles(&call.tiles, call.width, call.height), width, height) {
        if !call.region.contains(x as u32, y as u32) {
            continue;
        }
        let quiet = map.map_or(0.0, |map| quiet_share(map, call.residual.width / MAP_TILE, x, y));
        for channel in 0..3 {
            let (c, r) = (log_color.token(x, y)[channel], residual.token(x, y)[channel]);
            let radiance = if call.radiance { r } else { (c + r).exp_m1() };
            let denoised = clamp(radiance / exposure, end);
            let noisy = clamp(c.exp_m1() / exposure, end);
            let mixed = (1.0 - blend) * denoised + blend * noisy;
            let own = f64::from(frame.color[3 * (y * width + x) + channel]).min(end);
            out[3 * (y * width + x) + channel] = match quiet {
                0.0 => mixed,
                1.0 => own,
                share => (1.0 - share) * mixed + share * own,
            };
        }
    }
    reference.output = out;
}

/// The caller's share of a pixel: by its distance to the nearest square that is denoised.
fn quiet_share(map: &[f64], columns: u32, x: usize, y: usize) -> f64 {
    let (columns, side) = (columns as usize, MAP_TILE as usize);
    let beyond = |at: usize, square: usize| {
        let (at, low) = (at as f64 + 0.5, (square * side) as f64);
        (low - at).max(at - low - side as f64).max(0.0)
    };
    let near = |at: usize, end: usize| (at / side).saturating_sub(1)..(at / side + 2).min(end);
    let squares = near(y, map.len() / columns).flat_map(|row| near(x, columns).map(move |column| (column, row)));
    let distances = squares
        .filter(|(column, row)| map[row * columns + column] > 0.0)
        .map(|(column, row)| beyond(x, column).hypot(beyond(y, row)));
    let share = (distances.fold(f64::MAX, f64::min) / f64::from(BLEND_PIXELS)).min(1.0);
    share * share * (3.0 - 2.0 * share)
}

/// Clamps to [0, end]; NaN stays.
fn clamp(value: f64, end: f64) -> f64 {
    if value < 0.0 {
        0.0
    } else if value > end {
        end
    } else {
        value
    }
}

/// Fills every token of a padded map from the pixel that it shows.
fn fill(map: &mut Map, width: u32, height: u32, mut fill: impl FnMut(usize, usize, &mut [f64])) {
    let (across, channels) = (map.width, map.channels);
    for (i, token) in map.values.chunks_exact_mut(channels).enumerate() {
        fill(reflect(i % across, width as usize), reflect(i / across, height as usize), token);
    }
}

/// The pixel that a position beyond the frame's end mirrors, again and again.
pub fn reflect(at: usize, size: usize) -> usize {
    let period = 2 * (size - 1);
    match at % period.max(1) {
        at if at < size => at,
        at => period - at,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Layout;
    use half::f16;

    #[test]
    fn reflection_repeats_no_edge_and_goes_on() {
        let row = |size| (0..9).map(|i| reflect(i, size)).collect::<Vec<_>>();
        assert_eq!(row(4), [0, 1, 2, 3, 2, 1, 0, 1, 2]);
        assert_eq!(row(2), [0, 1, 0, 1, 0, 1, 0, 1, 0]);
        assert_eq!(row(1), [0; 9]);
    }

    #[test]
    fn bad_pixels_take_the_mean_of_their_good_neighbours() {
        let extent = Extent::new(3, 2);
        let mut color: Vec<f32> = (0..18).map(|i| i as f32).collect();
        color[4] = f32::NAN; // Pixel (1, 0).
        color[9] = -1.0; // Pixel (0, 1).
        color[17] = 3e9; // Pixel (2, 1), a firefly.
        let frame = FrameData::new(&Frame {
            extent,
            color: Plane::f32(&color, Layout::interleaved(extent, 3)),
            features: Default::default(),
        });
        assert_eq!(frame.mended(0, 0, 1.0), [0.0, 1.0, 2.0]);
        // The good ones are (0, 0), (2, 0) and (1, 1).
        assert_eq!(frame.mended(1, 0, 1.0), [6.0, 7.0, 8.0]);
        assert_eq!(frame.mended(2, 1, 1.0), [9.0, 10.0, 11.0]);
        assert_eq!(frame.mended(2, 1, 1e7), [15.0, 16.0, 3e9]);
        assert_eq!(frame.mended(2, 1, 1e-9), [0.0; 3], "nothing around is good");
    }

    #[test]
    fn isolated_fireflies_are_bad_and_small_lights_are_not() {
        let extent = Extent::new(12, 12);
        let lit = |x: usize, y: usize| match (x, y) {
            (1, 1) | (6 | 7, 1) | (1 | 2, 5 | 6) | (6..=8, 5) => 2e3,
            (1, 9) => 9e2,
            _ => 1.0,
        };
        let color: Vec<f32> = (0..3 * 144).map(|i| lit(i / 3 % 12, i / 36)).collect();
        let frame = FrameData::new(&Frame {
            extent,
            color: Plane::f32(&color, Layout::interleaved(extent, 3)),
            features: Default::default(),
        });
        // One bright pixel and a pair are fireflies, and so are a line's two ends.
        for (x, y) in (0..144).map(|i| (i % 12, i / 12)) {
            let expected = match (x, y) {
                (1, 1) | (6 | 7, 1) => 1.0,
                (6 | 8, 5) => (7.0 + 2e3) / 8.0,
                _ => f64::from(lit(x, y)),
            };
            assert_eq!(frame.mended(x, y, 1.0), [expected; 3], "{x}, {y}");
        }
    }

    #[test]
    fn features_are_brought_to_the_unit_interval() {
        let extent = Extent::new(1, 1);
        let (albedo, normal, depth) = ([2.0, -1.0, f32::INFINITY], [f32::NAN, -1.0, 0.5], [f16::from_f32(64.0)]);
        let layout = Layout::interleaved(extent, 3);
        let mut frame = Frame { extent, color: Plane::f32(&[0.0; 3], layout), features: Default::default() };
        assert_eq!(FrameData::new(&frame).features(0, 1.0), [0.0, 0.0, 0.0, 0.5, 0.5, 0.5, 0.0]);
        frame.features.albedo = Some(Plane::f32(&albedo, layout));
        frame.features.normal = Some(Plane::f32(&normal, layout));
        frame.features.depth = Some(Plane::f16(&depth, layout));
        assert_eq!(FrameData::new(&frame).features(0, 256.0), [1.0, 0.0, 0.0, 0.5, 0.0, 0.75, 0.25]);
        let far = [f16::from_f32(65024.0)];
        frame.features.depth = Some(Plane::f16(&far, layout));
        assert_eq!(FrameData::new(&frame).depth(0), None);
    }
}
