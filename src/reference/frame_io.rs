//! Twins of the frame's way into the network and out of it ([`crate::kernels::frame_io`]).

use super::energy;
use super::map::Map;
use super::noisy_albedo;
use super::samples::{Mending, Way, light_of};
use super::signals::SignalData;
use super::tiles;
use super::{Reference, Twin};
use crate::frame::NoiseKind;
use crate::frame::{Extent, Frame, Plane, Samples};
use crate::kernels::converged::{BLEND_PIXELS, MAP_TILE};
use crate::kernels::ensemble::Member;
use crate::kernels::frame_io::{Fireflies, InputAux, InputColor, Output};
use crate::kernels::stats::{EXPOSURE, LARGEST};

/// The network's range: what it is given of exposed colour ends here.
pub const RANGE: f64 = 2048.0;
/// An output of halves ends here.
pub const LARGEST_HALF: f64 = 65504.0;
/// Depths from here on are background, in planes of floats and of halves.
const FAR: f32 = 1e9;
const FAR_HALF: f32 = 65000.0;
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
    pub converged_threshold: f64,
    /// Factor on the colour; `None`: the frame's own.
    pub exposure: Option<f64>,
    /// What is done with fireflies.
    pub fireflies: Fireflies,
    /// Share of the noisy colour in the output.
    pub blend: f64,
    /// Whether the output's samples are halves.
    pub output_half: bool,
    /// A signal beside the colour.
    pub signal: Option<SignalData>,
}

impl FrameData {
    /// A black frame without features.
    pub fn black(extent: Extent) -> Self {
        let color = vec![0.0; 3 * extent.pixels() as usize];
        let (albedo, normal, depth) = (None, None, None);
        let (noise, noise_kind, converged_threshold) = (None, NoiseKind::default(), 0.0);
        let (far, exposure, fireflies, blend, output_half) = (FAR, None, Fireflies::Auto, 0.0, false);
        Self {
            extent,
            color,
            albedo,
            normal,
            depth,
            far,
            noise,
            noise_kind,
            converged_threshold,
            exposure,
            fireflies,
            blend,
            output_half,
            signal: None,
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

    /// Turns the frame by half a circle, its signal with it.
    pub fn turn(&mut self) {
        let Self { color, albedo, normal, depth, noise, .. } = self;
        turn(color, 3);
        [albedo, normal].into_iter().flatten().for_each(|plane| turn(plane, 3));
        [depth, noise].into_iter().flatten().for_each(|plane| turn(plane, 1));
        self.signal.iter_mut().for_each(|signal| turn(&mut signal.samples, signal.channels));
    }

    /// The samples of a pixel as they are.
    pub fn samples(&self, x: usize, y: usize) -> [f32; 3] {
        let first = 3 * (y * self.extent.width as usize + x);
        [0, 1, 2].map(|channel| self.color[first + channel])
    }

    /// The colour of a pixel, if all of it is finite; what is negative is 0.
    pub fn color(&self, pixel: usize) -> Option<[f32; 3]> {
        let color = [0, 1, 2].map(|channel| self.color[3 * pixel + channel]);
        color.iter().all(|c| c.is_finite()).then(|| color.map(|c| c.max(0.0)))
    }

    /// The luminance of a finite pixel.
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

    /// Whether there are both albedo and normals.
    fn has_albedo_and_normal(&self) -> bool {
        self.albedo.is_some() && self.normal.is_some()
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

impl Twin for InputColor {
    /// `log1p(colour * exposure)`, samples mended, reflected into the padding, and a mark where light goes around the
    /// network.
    fn compute(&self, reference: &mut Reference) {
        let stats = reference.buffer(self.stats);
        let frame = &reference.frame;
        let mending = Mending::new(frame, stats, reference.buffer(self.tile_stats));
        let exposure = stats[EXPOSURE];
        let mut map = Map::zeros(self.dst.width as usize, self.dst.height as usize, self.dst.channels as usize);
        fill(&mut map, self.width, self.height, |x, y, token| {
            let (light, way) = mending.pixel(x, y);
            let exposed = light.map(|channel| channel * exposure);
            for (to, color) in token.iter_mut().zip(exposed) {
                *to = color.min(RANGE).ln_1p();
            }
            let exceeds = exposed.iter().any(|&color| color > RANGE);
            if [Way::Kept, Way::Lamp].contains(&way) || way == Way::AsItIs && exceeds {
                let samples = frame.samples(x, y);
                let others = exposed.iter().zip(samples).filter(|(_, sample)| !sample.is_finite());
                let otherwise = others.map(|(exposed, _)| exposed.min(f64::from(f32::MAX))).fold(0.0, f64::max);
                token[3] = (1.0 + otherwise.ln_1p()) * if way == Way::Lamp { -1.0 } else { 1.0 };
            }
        });
        let tiles = reference.tiles(&self.tiles, self.dst.width, self.dst.height);
        reference.store(&map, &self.dst, &tiles, |x, y, channel| (x, y, channel));
    }
}

impl Twin for InputAux {
    /// Albedo, filtered where it is noisy, normal, depth and a zero, reflected into the padding.
    fn compute(&self, reference: &mut Reference) {
        let depth_scale = reference.buffer(self.depth_scale)[0];
        let frame = &reference.frame;
        let size = [self.width as usize, self.height as usize];
        let features: Vec<_> = (0..size[0] * size[1]).map(|pixel| frame.features(pixel, depth_scale)).collect();
        let filters = !self.clean && frame.has_albedo_and_normal();
        let mut map = Map::zeros(self.dst.width as usize, self.dst.height as usize, self.dst.channels as usize);
        fill(&mut map, self.width, self.height, |x, y, token| {
            token[..7].copy_from_slice(&features[y * size[0] + x]);
            if filters {
                token[..3].copy_from_slice(&noisy_albedo::filtered(&features, size, x, y));
            }
        });
        let tiles = reference.tiles(&self.tiles, self.dst.width, self.dst.height);
        reference.store(&map, &self.dst, &tiles, |x, y, channel| (x, y, channel));
    }
}

impl Twin for Output {
    /// `max(expm1(c + r) / exposure, 0)`, or of radiance `max(r / exposure, 0)` with the light that is given back, at
    /// most the frame's largest sample, mixed with the noisy colour, and what went around the network; cropped.
    fn compute(&self, reference: &mut Reference) {
        let (residual, log_color) = (reference.map(&self.residual), reference.map(&self.log_color));
        let size = reference.frame.size();
        let gains = self.gains.map(|gains| energy::of_frame(&reference.map(&gains), size));
        let top = self.residual_top as usize;
        let stats = reference.buffer(self.stats);
        let exposure = stats[EXPOSURE];
        let map = self.converged.map(|map| reference.buffer(map));
        let frame = &reference.frame;
        let most = f64::from(f32::MAX);
        let (blend, end) = (frame.blend, if frame.output_half { LARGEST_HALF } else { most });
        let (width, height) = (self.width as usize, self.height as usize);
        // What is not written is no number.
        let mut out = vec![f64::NAN; 3 * width * height];
        for (x, y) in tiles::tokens(&reference.tiles(&self.tiles, self.width, self.height), width, height) {
            if !self.region.contains(x as u32, y as u32) {
                continue;
            }
            let converged = map.map_or(0.0, |map| converged_share(map, self.residual.width / MAP_TILE, x, y));
            let mark = log_color.token(x, y)[3];
            for channel in 0..3 {
                let (c, r) = (log_color.token(x, y)[channel], residual.token(x, y - top)[channel]);
                let linear = |log: f64| clamp(log.exp_m1() / exposure, most);
                let clean = match &gains {
                    Some(gains) => {
                        let clean = clamp(r / exposure, most);
                        clean * energy::factor(gains, (x, y), channel, clean, stats[LARGEST + channel])
                    }
                    None => linear(c + r),
                };
                let denoised = clamp(clean, stats[LARGEST + channel]);
                let mut mixed = (1.0 - blend) * denoised + blend * linear(c);
                let sample = frame.samples(x, y)[channel];
                if mark != 0.0 {
                    let own = if sample.is_finite() { light_of(sample) } else { linear(mark.abs() - 1.0) };
                    let is_lamp = mark < 0.0 && sample == f32::INFINITY;
                    mixed = if is_lamp { own } else { mixed + (own - linear(c)).max(0.0) };
                }
                let (mixed, own) = (clamp(mixed, end), light_of(sample).min(end));
                out[3 * (y * width + x) + channel] = match converged {
                    0.0 => mixed,
                    1.0 => own,
                    share => (1.0 - share) * mixed + share * own,
                };
            }
        }
        let write = |to: &mut [f64], out: &[f64]| {
            to.iter_mut().zip(out).filter(|(_, out)| !out.is_nan()).for_each(|(to, out)| *to = *out);
        };
        match self.ensemble {
            Some((Member::Turned, result)) => return write(reference.buffer_mut(result), &out),
            Some((Member::Upright, result)) => average(&mut out, reference.buffer(result), 3),
            None => {}
        }
        reference.output.resize(out.len(), f64::NAN);
        write(&mut reference.output, &out);
    }
}

/// Turns a plane by half a circle: its first pixel is the last one.
fn turn(plane: &mut [f32], channels: usize) {
    plane.reverse();
    plane.chunks_exact_mut(channels).for_each(<[f32]>::reverse);
}

/// Averages a result with that of the turned frame.
pub fn average(upright: &mut [f64], turned: &[f64], channels: usize) {
    let turned = turned.chunks_exact(channels).rev();
    for (own, other) in upright.chunks_exact_mut(channels).zip(turned) {
        own.iter_mut().zip(other).for_each(|(own, other)| *own = 0.5 * *own + 0.5 * other);
    }
}

/// The caller's share of a pixel: by its distance to the nearest square that is denoised.
pub fn converged_share(map: &[f64], columns: u32, x: usize, y: usize) -> f64 {
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
pub fn clamp(value: f64, end: f64) -> f64 {
    if value < 0.0 {
        0.0
    } else if value > end {
        end
    } else {
        value
    }
}

/// Fills every token of a padded map from the pixel that it shows.
pub fn fill(map: &mut Map, width: u32, height: u32, mut fill: impl FnMut(usize, usize, &mut [f64])) {
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
