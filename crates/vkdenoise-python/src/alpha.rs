//! A colour's fourth channel: passed on, or denoised with the colour's kernels.

use half::f16;
use pyo3::exceptions::{PyMemoryError, PyValueError};
use pyo3::prelude::*;
use vkdenoise::{Extent, Layout, Plane, PlaneMut, Region, Samples, SamplesMut, Signal, SignalKind};

/// What is done with it.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum AlphaMode {
    Keep,
    Denoise,
}

impl AlphaMode {
    /// Of a keyword, for a colour with such a channel or without.
    ///
    /// # Errors
    /// Where it is no such word, or there is nothing to denoise.
    pub fn new(text: &str, has_alpha: bool) -> PyResult<Self> {
        match text {
            "keep" => Ok(Self::Keep),
            "denoise" if has_alpha => Ok(Self::Denoise),
            "denoise" => {
                Err(PyValueError::new_err("alpha is 'denoise', and color has none; give it four channels, or 'keep'"))
            }
            other => Err(PyValueError::new_err(format!("alpha is '{other}'; it can be keep or denoise"))),
        }
    }
}

/// Memory for the denoised channel, in which all is 0.
pub fn zeros(extent: Extent) -> PyResult<Vec<f32>> {
    let (mut zeros, pixels) = (Vec::new(), extent.pixels() as usize);
    zeros.try_reserve_exact(pixels).map_err(|error| PyMemoryError::new_err(format!("the denoised alpha: {error}")))?;
    zeros.resize(pixels, 0.0);
    Ok(zeros)
}

/// The channel of a colour as a signal, and where it goes.
pub fn signal<'a>(color: &Plane<'a>, extent: Extent, denoised: &'a mut [f32]) -> Signal<'a> {
    let own = color.layout;
    let plane = Plane { layout: Layout { offset: own.offset + 3 * own.channel_stride, ..own }, ..*color };
    let output = PlaneMut::f32(denoised, Layout::interleaved(extent, 1));
    Signal { kind: SignalKind::Alpha, channels: 1, plane, output }
}

/// Writes a result's alpha, the colour's own or what was denoised of it. Pixels of four zeros have no noise, as outside
/// of a cut-out: they and what goes with them stay as they are. Where alpha is denoised, a few samples of coverage
/// leave holes in an edge: only pixels count then that have 5x5 such pixels around.
pub fn finish(
    color: &Plane,
    denoised: Option<&Plane>,
    extent: Extent,
    part: Region,
    output: &mut PlaneMut,
    layers: &mut [Signal],
) {
    let (width, height) = (extent.width as usize, extent.height as usize);
    let is_empty = |x: usize, y: usize| (0..4).all(|channel| get(color, x, y, channel) == 0.0);
    let near = |at: usize, end: usize| at.saturating_sub(2)..(at + 3).min(end);
    let in_the_midst = |x: usize, y: usize| near(y, height).all(|y| near(x, width).all(|x| is_empty(x, y)));
    for y in part.y as usize..part.bottom() as usize {
        for x in part.x as usize..part.right() as usize {
            if is_empty(x, y) && (denoised.is_none() || in_the_midst(x, y)) {
                (0..4).for_each(|channel| set(output, x, y, channel, 0.0));
                for Signal { channels, plane, output, .. } in layers.iter_mut() {
                    (0..*channels as usize).for_each(|channel| set(output, x, y, channel, get(plane, x, y, channel)));
                }
            } else {
                let alpha = denoised.map_or_else(|| get(color, x, y, 3), |denoised| get(denoised, x, y, 0));
                set(output, x, y, 3, alpha);
            }
        }
    }
}

fn at(layout: &Layout, x: usize, y: usize, channel: usize) -> usize {
    layout.offset + y * layout.row_stride + x * layout.pixel_stride + channel * layout.channel_stride
}

fn get(plane: &Plane, x: usize, y: usize, channel: usize) -> f32 {
    let at = at(&plane.layout, x, y, channel);
    match plane.samples {
        Samples::F32(samples) => samples[at],
        Samples::F16(samples) => samples[at].to_f32(),
    }
}

fn set(plane: &mut PlaneMut, x: usize, y: usize, channel: usize, value: f32) {
    let at = at(&plane.layout, x, y, channel);
    match &mut plane.samples {
        SamplesMut::F32(samples) => samples[at] = value,
        SamplesMut::F16(samples) => samples[at] = f16::from_f32(value),
    }
}
