//! Which form of a convolution is fastest on a device: measured once, and kept.
//!
//! Whole passes run with every form in turn, with a timestamp around each kernel; a shape takes the form whose kernels took
//! least. So each is measured where it will run, between its neighbours and with their caches.

use crate::cache::hash;
use crate::denoiser::{Denoiser, Options};
use crate::engine::{prefers_cpu_kernels, wanted_arithmetic, wanted_storage};
use crate::error::{Error, Result};
use crate::frame::{Extent, Features, Frame, Layout, Plane, PlaneMut};
use crate::kernels::winograd::WinogradTile;
use crate::net::weights::Weights;
use crate::plan::{ConvAlgorithm, ConvShape, ConvTable};
use crate::vk::device::Device;
use std::collections::BTreeMap;

/// What is tried. Of equals the first wins.
const FORMS: [ConvAlgorithm; 3] =
    [ConvAlgorithm::Direct, ConvAlgorithm::Winograd(WinogradTile::F2), ConvAlgorithm::Winograd(WinogradTile::F4)];

/// Timed passes of each form. The least time counts: whatever else a machine does only adds to it.
const RUNS: usize = 4;

/// The table for frames of about `extent`.
pub(crate) fn conv_table(device: &Device, weights: &Weights, options: &Options, extent: Extent) -> Result<ConvTable> {
    extent.check()?;
    let file = device.cache_file(&what(device, weights, options, extent)?);
    let known = file.as_ref().and_then(|file| serde_json::from_slice::<Vec<Row>>(&file.read()?).ok());
    if let Some(rows) = known {
        return Ok(rows.into_iter().collect());
    }
    let rows = measure(device, weights, options, extent)?;
    if let (Some(file), Ok(text)) = (file, serde_json::to_vec(&rows))
        && let Err(error) = file.write(&text)
    {
        tracing::debug!(%error, "the choices cannot be written");
    }
    Ok(rows.into_iter().collect())
}

/// What is chosen for which form of which network, and for which frames.
fn what(device: &Device, weights: &Weights, options: &Options, extent: Extent) -> Result<String> {
    let storage = wanted_storage(device, options.precision)?;
    let kernels = (prefers_cpu_kernels(device), wanted_arithmetic(device, options.precision)?);
    let model = format!("{:?} {storage:?} {kernels:?} {:?} {:?}", weights.arch(), options.folds, options.separable);
    Ok(format!("convolutions-{:016x}-{}", hash(model.as_bytes()), extent.pixels().ilog2()))
}

/// A row of a table; a file is a list of them.
type Row = (ConvShape, ConvAlgorithm);

fn measure(device: &Device, weights: &Weights, options: &Options, extent: Extent) -> Result<Vec<Row>> {
    let mut least: BTreeMap<ConvShape, [f64; FORMS.len()]> = BTreeMap::new();
    for (at, form) in FORMS.into_iter().enumerate() {
        let options = Options { conv: Some(form), quiet: None, ..*options };
        let mut denoiser = Denoiser::new(device, weights, &options)?;
        denoiser.set_profiling(true)?;
        // The first pass compiles.
        for run in 0..=RUNS {
            let times = run_once(&mut denoiser, extent)?;
            for (shape, time) in times.into_iter().filter(|_| run > 0) {
                let least = &mut least.entry(shape).or_insert([f64::INFINITY; FORMS.len()])[at];
                *least = least.min(time);
            }
        }
    }
    let rows = least.into_iter().map(|(shape, times)| {
        let best = (0..FORMS.len()).min_by(|a, b| times[*a].total_cmp(&times[*b])).unwrap_or_default();
        tracing::debug!(?shape, ?times, chosen = ?FORMS[best], "convolution");
        (shape, FORMS[best])
    });
    Ok(rows.collect())
}

/// Microseconds of all convolutions of a shape in one pass.
fn run_once(denoiser: &mut Denoiser, extent: Extent) -> Result<BTreeMap<ConvShape, f64>> {
    let pixels = extent.pixels() as usize;
    let (rgb, one) = (Layout::interleaved(extent, 3), Layout::interleaved(extent, 1));
    // The work does not depend on the values.
    let (input, mut output) = (vec![0.5; 3 * pixels], vec![0.0; 3 * pixels]);
    let plane = Plane::f32(&input, rgb);
    let depth = Plane::f32(&input[..pixels], one);
    let features = Features { albedo: Some(plane), normal: Some(plane), depth: Some(depth), noise: None };
    denoiser.denoise(&Frame { extent, color: plane, features }, PlaneMut::f32(&mut output, rgb))?;
    let pass = denoiser.last_pass().ok_or_else(|| Error::Binding("nothing was denoised yet".into()))?;
    let plan = pass.plan();
    let mut times = BTreeMap::new();
    for (dispatch, record) in plan.dispatches.iter().zip(denoiser.records()) {
        if let Some(shape) = ConvShape::of(&dispatch.call, plan) {
            *times.entry(shape).or_insert(0.0) += record.microseconds;
        }
    }
    Ok(times)
}
