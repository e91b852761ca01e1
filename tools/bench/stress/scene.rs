//! A small procedural render: some balls before a tiled wall, noisy as four samples a pixel are, with its clean
//! picture, albedo, normal and depth, and sample counts that call half of it converged.

use super::Result;
use super::random::Random;
use vkdenoise::kernels::converged::MAP_TILE;
use vkdenoise::kernels::stats::{Clear, Counted, HISTOGRAM_BYTES, Histogram, KEY, STATS_FLOATS, Select, TileStats};
use vkdenoise::kernels::{BufferId, Call, Storage};
use vkdenoise::plan::{Buffer, Place};
use vkdenoise::reference::Reference;
use vkdenoise::{Extent, Features, Frame, Layout, Noise, NoiseKind, Plane, Weights};

/// Samples per pixel of the noise.
const SAMPLES: u32 = 4;

/// Samples of a pixel that counts as converged.
pub const CONVERGED: f32 = 4096.0;

/// A frame's planes, interleaved.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// Size.
    pub extent: Extent,
    /// The picture without noise.
    pub clean: Vec<f32>,
    /// Noisy radiance.
    pub color: Vec<f32>,
    /// Albedo.
    pub albedo: Option<Vec<f32>>,
    /// Normal.
    pub normal: Option<Vec<f32>>,
    /// Depth in metres.
    pub depth: Option<Vec<f32>>,
    /// Samples of every pixel, for tiers that leave out what is converged.
    pub samples: Option<Vec<f32>>,
}

/// What a ray meets: albedo, normal, depth.
type Surface = ([f32; 3], [f32; 3], f32);

impl Scene {
    /// The render at a size. Another seed gives other noise.
    pub fn new(extent: Extent, seed: u64) -> Self {
        let mut random = Random::new(seed);
        let (mut clean, mut color) = (Vec::new(), Vec::new());
        let (mut albedo, mut normal, mut depth) = (Vec::new(), Vec::new(), Vec::new());
        let side = extent.width.max(extent.height) as f32;
        for y in 0..extent.height {
            for x in 0..extent.width {
                let (u, v) = ((x as f32 + 0.5) / side, (y as f32 + 0.5) / side);
                let (surface, facing, distance) = surface(u, v);
                let light =
                    0.05 + 1.2 * (0.5 * facing[0] - 0.4 * facing[1] + 0.77 * facing[2]).max(0.0) * (0.3 + 0.7 * u);
                // The light's noise is common to the channels.
                let draw = |random: &mut Random| -random.uniform(1e-6, 1.0).ln();
                let noise = (0..SAMPLES).map(|_| draw(&mut random)).sum::<f32>() / SAMPLES as f32;
                for reflected in surface {
                    clean.push(reflected * light);
                    color.push(reflected * light * noise);
                }
                albedo.extend(surface);
                normal.extend(facing);
                depth.push(distance);
            }
        }
        let samples = Some(half_converged(extent));
        Self { extent, clean, color, albedo: Some(albedo), normal: Some(normal), depth: Some(depth), samples }
    }

    /// The same planes with another colour.
    pub fn with_color(&self, color: Vec<f32>) -> Self {
        Self { color, ..self.clone() }
    }

    /// The same planes with sample counts that call the other half converged.
    pub fn with_the_other_half_converged(&self) -> Self {
        let other = |count: &f32| if *count < CONVERGED { CONVERGED } else { SAMPLES as f32 };
        let samples = self.samples.as_ref().map(|samples| samples.iter().map(other).collect());
        Self { samples, ..self.clone() }
    }

    /// Index of the first sample of a pixel in a plane of three channels.
    pub fn at(&self, x: u32, y: u32) -> usize {
        3 * (y as usize * self.extent.width as usize + x as usize)
    }

    /// Pixels.
    pub fn pixels(&self) -> usize {
        self.extent.pixels() as usize
    }

    /// For the library's callers.
    pub fn frame(&self) -> Frame<'_> {
        let rgb = Layout::interleaved(self.extent, 3);
        Frame {
            extent: self.extent,
            color: Plane::f32(&self.color, rgb),
            features: Features {
                albedo: self.albedo.as_deref().map(|samples| Plane::f32(samples, rgb)),
                normal: self.normal.as_deref().map(|samples| Plane::f32(samples, rgb)),
                depth: self.depth.as_deref().map(|samples| Plane::f32(samples, Layout::interleaved(self.extent, 1))),
                noise: self.samples.as_deref().map(|samples| Noise {
                    plane: Plane::f32(samples, Layout::interleaved(self.extent, 1)),
                    kind: NoiseKind::Samples,
                }),
            },
        }
    }

    /// The key of the colour, as the f64 twins of the statistics find it.
    ///
    /// # Errors
    /// None that a scene can cause.
    pub fn key(&self) -> Result<f64> {
        let Extent { width, height } = self.extent;
        let [histogram, stats, dst, runs] = [0, 1, 2, 3].map(BufferId);
        let tile_stats = TileStats { stats, dst, runs, width, height };
        let sizes = [
            ("histogram", HISTOGRAM_BYTES),
            ("stats", 4 * STATS_FLOATS),
            ("tiles", tile_stats.tile_bytes()),
            ("runs", tile_stats.run_bytes()),
        ];
        let place = Place::Arena { block: 0, offset: 0 };
        let buffers =
            sizes.map(|(name, bytes)| Buffer { name: name.into(), bytes, storage: Storage::F32, place: place.clone() });
        let mut reference = Reference::for_calls(self.extent, &buffers, &Weights::hybrid_kernels()?)?;
        reference.set_frame(&self.frame(), None, 0.0)?;
        for call in [
            Call::StatsClear(Clear { histogram }),
            Call::StatsHistogram(Histogram { histogram, counted: Counted::Luminance, width, height }),
            Call::StatsSelect(Select { histogram, counted: Counted::Luminance, dst: stats }),
            Call::StatsTiles(tile_stats.clone()),
            Call::StatsKey(tile_stats.key(stats)),
        ] {
            reference.run_call(&call);
        }
        Ok(reference.buffer(stats)[KEY])
    }
}

/// The farther half of the squares along the longer side converged, whatever the picture says; what has one square not.
fn half_converged(extent: Extent) -> Vec<f32> {
    let Extent { width, height } = extent;
    let noisy = width.max(height).div_ceil(MAP_TILE).div_ceil(2) * MAP_TILE;
    let along = |pixel: u32| if width >= height { pixel % width } else { pixel / width };
    (0..width * height).map(|pixel| if along(pixel) < noisy { SAMPLES as f32 } else { CONVERGED }).collect()
}

/// The nearest surface at a place in the unit square.
fn surface(u: f32, v: f32) -> Surface {
    let balls = [(0.3, 0.55, 0.2, [0.8, 0.3, 0.2]), (0.7, 0.65, 0.15, [0.2, 0.5, 0.8]), (0.55, 0.25, 0.1, [0.9; 3])];
    for (x, y, radius, albedo) in balls {
        let (dx, dy) = ((u - x) / radius, (v - y) / radius);
        let height = 1.0 - dx * dx - dy * dy;
        if height > 0.0 {
            let z = height.sqrt();
            return (albedo, [dx, dy, z], 6.0 - radius * z);
        }
    }
    let light = ((u * 11.0) as u32 + (v * 9.0) as u32).is_multiple_of(2);
    (if light { [0.75, 0.7, 0.6] } else { [0.15, 0.2, 0.25] }, [0.0, 0.0, 1.0], 8.0 + v)
}
