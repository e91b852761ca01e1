//! What tiers that leave converged squares out leave out: what the scene's sample counts say and nothing else, and how
//! the rest differs from the whole frame's pass.

use super::moves::tone_mapped_db;
use super::scene::{CONVERGED, Scene};
use super::{Bound, Measured, Result};
use vkdenoise::kernels::converged::MAP_TILE;
use vkdenoise::{ActiveTiles, ConvergedMode, Denoiser, Layout, PlaneMut};

/// Keys above which a pixel that stands alone is a firefly, whose square is denoised.
const FIREFLY: f64 = 1000.0;

/// Depths of surfaces; others are background.
const GEOMETRY: std::ops::Range<f32> = f32::MIN_POSITIVE..1e9;

/// The squares of a frame: whether each was denoised, and its pixels.
fn squares(scene: &Scene, active: &ActiveTiles) -> Vec<(bool, Vec<usize>)> {
    let (width, height) = (scene.extent.width, scene.extent.height);
    let square = |at: u32| {
        let (x, y) = (at % width.div_ceil(MAP_TILE), at / width.div_ceil(MAP_TILE));
        let end = |first: u32, size: u32| first * MAP_TILE..((first + 1) * MAP_TILE).min(size);
        let pixels = end(y, height).flat_map(|row| end(x, width).map(move |column| (row * width + column) as usize));
        (active.map[(y * active.size.columns + x) as usize], pixels.collect())
    };
    (0..width.div_ceil(MAP_TILE) * height.div_ceil(MAP_TILE)).map(square).collect()
}

/// What the calls of a case left out.
#[derive(Default)]
pub struct LeftOut {
    /// Calls of denoisers that leave converged squares out.
    calls: usize,
    /// Those that left some out, but not all.
    partial: usize,
    /// Squares that were denoised or left out against the sample counts, the most of a call.
    wrong: usize,
}

impl LeftOut {
    /// Takes in a denoiser's latest call, where it leaves converged squares out.
    ///
    /// # Errors
    /// None that a scene can cause.
    pub fn take(&mut self, scene: &Scene, denoiser: &Denoiser) -> Result<()> {
        let (Some(active), Some(counts)) = (denoiser.active_tiles(), &scene.samples) else { return Ok(()) };
        let squares = squares(scene, active);
        let mut wrong = 0;
        for (denoised, pixels) in &squares {
            let is_noisy = pixels.iter().any(|pixel| counts[*pixel] < CONVERGED);
            let has_geometry =
                |pixel: &usize| scene.depth.as_ref().is_none_or(|depth| GEOMETRY.contains(&depth[*pixel]));
            if is_noisy && !denoised {
                // Few samples are enough where nothing is to be lit.
                wrong += usize::from(pixels.iter().any(has_geometry));
            } else if !is_noisy && *denoised {
                // A bad pixel or a firefly has its square denoised.
                let ordinary = 0.0..=FIREFLY * scene.key()?;
                let samples = pixels.iter().flat_map(|pixel| &scene.color[3 * pixel..][..3]);
                let is_ordinary = samples.into_iter().all(|&sample| ordinary.contains(&f64::from(sample)));
                wrong += usize::from(is_ordinary);
            }
        }
        let denoised = squares.iter().filter(|(denoised, _)| *denoised).count();
        self.calls += 1;
        self.partial += usize::from(denoised > 0 && denoised < squares.len());
        self.wrong = self.wrong.max(wrong);
        Ok(())
    }

    /// What was found; nothing of tiers that leave nothing out. `can`: whether there are squares that can be left out.
    pub fn figures(self, can: bool) -> Vec<Measured> {
        if self.calls == 0 {
            return Vec::new();
        }
        let mut wrong = Measured::new("squares denoised or left out against the sample counts", Bound::AtMost(0.0));
        wrong.take(self.wrong as f64, "");
        let least = if can { 1.0 } else { 0.0 };
        let mut partial = Measured::new("calls that leave some squares out, not all", Bound::AtLeast(least));
        partial.take(self.partial as f64, format!("of {}", self.calls));
        vec![wrong, partial]
    }
}

/// How the denoised squares differ from the whole frame's pass.
///
/// # Errors
/// As [`Denoiser::denoise`].
pub fn against_whole(
    scene: &Scene,
    output: &[f32],
    converged: (&Denoiser, ConvergedMode),
    whole: &mut Denoiser,
) -> Result<Measured> {
    let (denoiser, mode) = converged;
    let mut full = vec![f32::NAN; scene.color.len()];
    whole.denoise(&scene.frame(), PlaneMut::f32(&mut full, Layout::interleaved(scene.extent, 3)))?;
    let squares = denoiser.active_tiles().map_or(Vec::new(), |active| squares(scene, active));
    let denoised: Vec<usize> = squares.into_iter().filter(|(denoised, _)| *denoised).flat_map(|(_, p)| p).collect();
    let of = |values: &[f32]| denoised.iter().flat_map(|pixel| values[3 * pixel..][..3].to_vec()).collect::<Vec<_>>();
    let (own, full) = (of(output), of(&full));
    Ok(match mode {
        ConvergedMode::Exact => {
            let mut other = Measured::new("samples of other bits than the whole frame's", Bound::AtMost(0.0));
            other.take(own.iter().zip(&full).filter(|(a, b)| a.to_bits() != b.to_bits()).count() as f64, "");
            other
        }
        ConvergedMode::Approximate(_) => {
            let mut close = Measured::new("tone-mapped dB to the whole frame's", Bound::AtLeast(50.0));
            close.take(tone_mapped_db(&own, &full, scene.key()?)?, "");
            close
        }
    })
}
