//! The pipelines that plans need, each made once for a device, several at a time. They live as long as the device: a
//! denoiser that is made again, or another one beside it, finds what it shares with the ones before.

use crate::error::{Error, Result};
use crate::kernels::contract::{Contract, Specialisation};
use crate::parallel;
use crate::plan::Dispatch;
use crate::vk::device::Device;
use crate::vk::pipeline::{MadePipelines, Pipeline, Specialised};
use crate::vk::statistics::{PipelineStatistic, of_pipeline};
use std::collections::BTreeMap;
use std::collections::hash_map::Entry;
use std::sync::{MutexGuard, PoisonError};
use std::time::Instant;

/// The pipeline of a kernel variant that is specialised for nothing.
///
/// # Errors
/// As [`for_dispatches`].
pub(crate) fn get(device: &Device, contract: &'static Contract) -> Result<Pipeline> {
    Ok(of(device, &[(contract, Specialisation::default())])?.swap_remove(0))
}

/// One pipeline for each dispatch, in order. Those that are not there yet are made side by side: a driver compiles each
/// on the thread that asks for it.
///
/// # Errors
/// [`Error::Unsupported`] where the device lacks what a variant needs; [`Error::Vulkan`].
pub(crate) fn for_dispatches(device: &Device, dispatches: &[Dispatch]) -> Result<Vec<Pipeline>> {
    let chosen = dispatches.iter().map(|dispatch| &dispatch.variant);
    let wanted: Vec<_> = chosen.map(|variant| (variant.contract, variant.special)).collect();
    of(device, &wanted)
}

/// What the compiler says of every pipeline made so far, by variant.
pub(crate) fn statistics(device: &Device) -> Result<Vec<PipelineStatistic>> {
    let made = made(device);
    let sorted: BTreeMap<_, _> = made.iter().collect();
    let of_each = sorted
        .into_iter()
        .map(|((variant, special), pipeline)| of_pipeline(device, &format!("{variant}{special}"), pipeline));
    Ok(of_each.collect::<Result<Vec<_>>>()?.concat())
}

fn of(device: &Device, wanted: &[(&'static Contract, Specialisation)]) -> Result<Vec<Pipeline>> {
    let key = |(contract, special): &(&'static Contract, Specialisation)| (contract.name, *special);
    let known = made(device);
    let missing: BTreeMap<Specialised, _> =
        wanted.iter().filter(|one| !known.contains_key(&key(one))).map(|one| (key(one), *one)).collect();
    drop(known);
    if !missing.is_empty() {
        let missing: Vec<_> = missing.into_values().collect();
        missing.iter().try_for_each(|(contract, _)| check(device, contract))?;
        let started = Instant::now();
        let new = parallel::map(&missing, |(contract, special)| Pipeline::new(device, contract, *special));
        let mut failed = None;
        for (one, pipeline) in missing.iter().zip(new) {
            match pipeline {
                Ok(pipeline) => match made(device).entry(key(one)) {
                    Entry::Vacant(place) => _ = place.insert(pipeline),
                    // Another thread was faster, and somebody may have its own by now.
                    // SAFETY: it was made on this device, just now, and for this function alone.
                    Entry::Occupied(_) => unsafe { pipeline.destroy(device.raw()) },
                },
                Err(error) => failed = failed.or(Some(error)),
            }
        }
        failed.map_or(Ok(()), Err)?;
        tracing::debug!(count = missing.len(), elapsed = ?started.elapsed(), "pipelines");
        device.pipeline_cache().store(device.raw());
    }
    let made = made(device);
    Ok(wanted.iter().map(|one| made[&key(one)]).collect())
}

fn check(device: &Device, contract: &Contract) -> Result<()> {
    let Some(need) = contract.needs.iter().find(|need| !device.caps().meets(**need)) else { return Ok(()) };
    let name = device.info().name.clone();
    Err(Error::Unsupported { device: name, missing: format!("{need} (kernel {})", contract.name) })
}

fn made(device: &Device) -> MutexGuard<'_, MadePipelines> {
    device.made_pipelines().lock().unwrap_or_else(PoisonError::into_inner)
}
