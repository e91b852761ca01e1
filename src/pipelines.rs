//! The pipelines that a plan needs, each made once, several at a time.

use crate::error::{Error, Result};
use crate::kernels::Variants;
use crate::kernels::contract::Contract;
use crate::parallel;
use crate::plan::Dispatch;
use crate::vk::device::Device;
use crate::vk::pipeline::Pipeline;
use crate::vk::statistics::{PipelineStatistic, of_pipeline};
use std::collections::{BTreeMap, HashMap};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

type Made = HashMap<&'static str, Arc<Pipeline>>;

/// The pipelines of a device, made when first asked for and kept.
pub(crate) struct Pipelines {
    device: Device,
    made: Mutex<Made>,
}

impl Pipelines {
    pub fn new(device: &Device) -> Self {
        Self { device: device.clone(), made: Mutex::default() }
    }

    /// The pipeline of a kernel variant.
    ///
    /// # Errors
    /// As [`Pipelines::for_dispatches`].
    pub fn get(&self, contract: &'static Contract) -> Result<Arc<Pipeline>> {
        Ok(self.of(&[contract])?.swap_remove(0))
    }

    /// One pipeline for each dispatch, in order. Those that are not there yet are made side by side: a driver compiles each on
    /// the thread that asks for it.
    ///
    /// # Errors
    /// [`Error::Unsupported`] where the device lacks what a variant needs; [`Error::Vulkan`].
    pub fn for_dispatches(&self, dispatches: &[Dispatch], variants: Variants) -> Result<Vec<Arc<Pipeline>>> {
        let contracts: Vec<_> = dispatches.iter().map(|dispatch| dispatch.call.kernel().contract(variants)).collect();
        self.of(&contracts)
    }

    /// What the compiler says of every pipeline made so far, by variant.
    pub fn statistics(&self) -> Result<Vec<PipelineStatistic>> {
        let made = self.made();
        let sorted: BTreeMap<_, _> = made.iter().collect();
        let of_each = sorted.into_iter().map(|(variant, pipeline)| of_pipeline(&self.device, variant, pipeline));
        Ok(of_each.collect::<Result<Vec<_>>>()?.concat())
    }

    fn of(&self, contracts: &[&'static Contract]) -> Result<Vec<Arc<Pipeline>>> {
        let made = self.made();
        let missing: BTreeMap<_, _> =
            contracts.iter().filter(|c| !made.contains_key(c.name)).map(|c| (c.name, *c)).collect();
        drop(made);
        if !missing.is_empty() {
            let missing: Vec<_> = missing.into_values().collect();
            missing.iter().try_for_each(|contract| self.check(contract))?;
            let started = Instant::now();
            let new = parallel::map(&missing, |contract| Pipeline::new(&self.device, contract));
            for (contract, pipeline) in missing.iter().zip(new) {
                let pipeline = Arc::new(pipeline?);
                // Another thread may have been faster.
                self.made().entry(contract.name).or_insert(pipeline);
            }
            tracing::debug!(count = missing.len(), elapsed = ?started.elapsed(), "pipelines");
            self.device.pipeline_cache().store(self.device.raw());
        }
        let made = self.made();
        Ok(contracts.iter().map(|contract| Arc::clone(&made[contract.name])).collect())
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
