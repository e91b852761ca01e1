//! The pipelines that a plan needs, each made once, several at a time.

use crate::error::{Error, Result};
use crate::kernels::contract::{Contract, Specialisation};
use crate::parallel;
use crate::plan::Dispatch;
use crate::vk::device::Device;
use crate::vk::pipeline::Pipeline;
use crate::vk::statistics::{PipelineStatistic, of_pipeline};
use std::collections::{BTreeMap, HashMap};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

type Made = HashMap<Specialised, Arc<Pipeline>>;

/// A variant's name, and what its pipeline is specialised for.
type Specialised = (&'static str, Specialisation);

/// The pipelines of a device, made when first asked for and kept.
pub(crate) struct Pipelines {
    device: Device,
    made: Mutex<Made>,
}

impl Pipelines {
    pub fn new(device: &Device) -> Self {
        Self { device: device.clone(), made: Mutex::default() }
    }

    /// The pipeline of a kernel variant that is specialised for nothing.
    ///
    /// # Errors
    /// As [`Pipelines::for_dispatches`].
    pub fn get(&self, contract: &'static Contract) -> Result<Arc<Pipeline>> {
        Ok(self.of(&[(contract, Specialisation::default())])?.swap_remove(0))
    }

    /// One pipeline for each dispatch, in order. Those that are not there yet are made side by side: a driver compiles
    /// each on the thread that asks for it.
    ///
    /// # Errors
    /// [`Error::Unsupported`] where the device lacks what a variant needs; [`Error::Vulkan`].
    pub fn for_dispatches(&self, dispatches: &[Dispatch]) -> Result<Vec<Arc<Pipeline>>> {
        let chosen = dispatches.iter().map(|dispatch| &dispatch.variant);
        let wanted: Vec<_> = chosen.map(|variant| (variant.contract, variant.special)).collect();
        self.of(&wanted)
    }

    /// What the compiler says of every pipeline made so far, by variant.
    pub fn statistics(&self) -> Result<Vec<PipelineStatistic>> {
        let made = self.made();
        let sorted: BTreeMap<_, _> = made.iter().collect();
        let of_each = sorted
            .into_iter()
            .map(|((variant, special), pipeline)| of_pipeline(&self.device, &format!("{variant}{special}"), pipeline));
        Ok(of_each.collect::<Result<Vec<_>>>()?.concat())
    }

    fn of(&self, wanted: &[(&'static Contract, Specialisation)]) -> Result<Vec<Arc<Pipeline>>> {
        let key = |(contract, special): &(&'static Contract, Specialisation)| (contract.name, *special);
        let made = self.made();
        let missing: BTreeMap<Specialised, _> =
            wanted.iter().filter(|one| !made.contains_key(&key(one))).map(|one| (key(one), *one)).collect();
        drop(made);
        if !missing.is_empty() {
            let missing: Vec<_> = missing.into_values().collect();
            missing.iter().try_for_each(|(contract, _)| self.check(contract))?;
            let started = Instant::now();
            let new = parallel::map(&missing, |(contract, special)| Pipeline::new(&self.device, contract, *special));
            for (one, pipeline) in missing.iter().zip(new) {
                let pipeline = Arc::new(pipeline?);
                // Another thread may have been faster.
                self.made().entry(key(one)).or_insert(pipeline);
            }
            tracing::debug!(count = missing.len(), elapsed = ?started.elapsed(), "pipelines");
            self.device.pipeline_cache().store(self.device.raw());
        }
        let made = self.made();
        Ok(wanted.iter().map(|one| Arc::clone(&made[&key(one)])).collect())
    }

    fn check(&self, contract: &Contract) -> Result<()> {
        let Some(need) = contract.needs.iter().find(|need| !self.device.caps().meets(**need)) else { return Ok(()) };
        let device = self.device.info().name.clone();
        Err(Error::Unsupported { device, missing: format!("{need} (kernel {})", contract.name) })
    }

    fn made(&self) -> MutexGuard<'_, Made> {
        self.made.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
