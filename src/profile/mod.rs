//! Times of every kernel, by timestamps in the command buffer that does the work.
//!
//! A renderer makes a [`Profiler`] of its pass with one slot for each frame in flight, records with
//! [`crate::Pass::record_profiled`], and reads a slot after its own fence. Nothing here waits.
//!
//! ```no_run
//! # use vkdenoise::*;
//! # unsafe fn sketch(
//! #     pass: &Pass, binding: &Binding, commands: ash::vk::CommandBuffer, frame: u32, wait_for: impl Fn(u32),
//! # ) -> Result<()> {
//! let profiler = pass.profiler(2)?;                          // once; two frames in flight
//! let slot = frame % 2;
//! unsafe { pass.record_profiled(commands, binding, &FrameOptions::default(), &profiler, slot)? };
//! wait_for(frame);                                           // the renderer's own fence
//! if let Some(records) = profiler.read(slot)? {
//!     for record in &records {
//!         println!("{} {} {:.1} us", record.stage, record.name, record.microseconds);
//!     }
//! }
//! # Ok(())
//! # }
//! ```
//!
//! A [`Shape`] is what a kernel works on, [`Accesses`] how often it asks for memory, a [`Roof`] what a device can do at
//! most; [`PipelineStatistic`]s are what the driver's compiler says
//! ([`Denoiser::pipeline_statistics`](crate::Denoiser::pipeline_statistics)).
//!
//! A timestamp is taken when everything before it is done, so a kernel's time begins when the one before has ended: for
//! kernels that the device runs at once, the later one's time is what it adds.

mod record;
mod roof;
mod shape;

pub use crate::kernels::Accesses;
pub use crate::vk::statistics::{PipelineStatistic, StatisticValue};
pub use record::KernelRecord;
pub use roof::Roof;
pub use shape::Shape;

use crate::error::{Error, Result};
use crate::plan::Dispatch;
use crate::vk::device::Device;
use crate::vk::timestamps::Timestamps;
use std::sync::{Arc, Mutex, PoisonError};

/// Timestamps around the dispatches of a pass, in slots. `Send` and `Sync`; it must outlive the recorded commands.
pub struct Profiler {
    timestamps: Timestamps,
    /// The most that the pass records.
    dispatches: usize,
    /// By slot: what was recorded last.
    recorded: Mutex<Vec<Option<Arc<[Dispatch]>>>>,
}

impl Profiler {
    /// A profiler of `slots` slots for recordings of at most so many dispatches.
    pub(crate) fn new(device: &Device, dispatches: usize, slots: u32) -> Result<Self> {
        let count = slots.checked_mul(2 * dispatches as u32).filter(|&count| count > 0);
        let count = count.ok_or_else(|| Error::InvalidOption {
            option: "slots",
            reason: format!("{slots}; at least 1, and their timestamps must be countable in 32 bits"),
        })?;
        let timestamps = Timestamps::new(device, count)?;
        Ok(Self { timestamps, dispatches, recorded: Mutex::new(vec![None; slots as usize]) })
    }

    /// What the last recording of `slot` measured, in the order of the plan; `None` as long as the GPU has not finished
    /// it, or where none was recorded. It does not wait.
    ///
    /// To be called after the recording's own fence. Where a slot was recorded again and the new commands have not
    /// begun yet, the times are still those of the run before.
    ///
    /// # Errors
    /// [`Error::InvalidOption`] where there is no such slot; [`Error::DeviceLost`], [`Error::Vulkan`].
    pub fn read(&self, slot: u32) -> Result<Option<Vec<KernelRecord>>> {
        let Some(recorded) = self.slots(|slots| slots.get(slot as usize).cloned()).ok_or_else(|| self.no_slot(slot))?
        else {
            return Ok(None);
        };
        let times = self.timestamps.read(self.first(slot), 2 * recorded.len() as u32)?;
        Ok(times.map(|times| {
            let dispatches = recorded.iter().zip(times.chunks_exact(2));
            dispatches.map(|(dispatch, time)| KernelRecord::new(dispatch, time[0], time[1])).collect()
        }))
    }

    /// The timestamps of a slot, to be recorded with these dispatches.
    pub(crate) fn begin(&self, slot: u32, dispatches: &[Dispatch]) -> Result<(&Timestamps, u32)> {
        if dispatches.len() > self.dispatches {
            return Err(Error::Binding("the profiler was made for another pass".into()));
        }
        let known =
            self.slots(|slots| slots.get_mut(slot as usize).map(|slot| *slot = Some(dispatches.into())).is_some());
        if known { Ok((&self.timestamps, self.first(slot))) } else { Err(self.no_slot(slot)) }
    }

    fn slots<T>(&self, with: impl FnOnce(&mut Vec<Option<Arc<[Dispatch]>>>) -> T) -> T {
        with(&mut self.recorded.lock().unwrap_or_else(PoisonError::into_inner))
    }

    fn count(&self) -> u32 {
        2 * self.dispatches as u32
    }

    fn first(&self, slot: u32) -> u32 {
        slot * self.count()
    }

    fn no_slot(&self, slot: u32) -> Error {
        let slots = self.slots(|slots| slots.len());
        Error::InvalidOption { option: "slot", reason: format!("{slot}; the profiler has {slots}") }
    }
}
