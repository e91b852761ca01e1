//! The device memory of a frame size, known before any of it is allocated.

use crate::error::{Error, Result};
use crate::frame::Extent;
use crate::plan::Plan;
use crate::role::Role;

/// Device memory that a frame size takes, in bytes. The caller's own planes are apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct MemoryRequired {
    /// The feature maps between the kernels.
    pub arena: u64,
    /// What outlives a recording, such as the maps of [`Options::keep_features`](crate::Options::keep_features): a
    /// pass's own, in whatever arena it runs.
    pub persistent: u64,
    /// The packed weights, shared by all sizes of a denoiser.
    pub weights: u64,
    /// Planes on their way in and out, in the host path alone.
    pub staging: u64,
}

impl MemoryRequired {
    pub(crate) fn of_plan(plan: &Plan) -> Self {
        Self {
            arena: plan.blocks.iter().sum(),
            persistent: plan.persistent.iter().sum(),
            weights: plan.weights_bytes,
            staging: input_bytes(plan) + output_bytes(plan),
        }
    }

    /// What a renderer's pass takes: no staging.
    pub fn pass(&self) -> u64 {
        self.arena + self.persistent + self.weights
    }

    /// What the host path takes.
    pub fn host(&self) -> u64 {
        self.pass() + self.staging
    }
}

/// The planes that go in, each by itself; that of noise, the last, only where converged tiles are left out.
pub(crate) fn input_bytes(plan: &Plan) -> u64 {
    let end = if plan.converged.is_some() { Role::Output } else { Role::Noise };
    4 * plan.extent.pixels() * floats_before(end)
}

/// Floats of a pixel of the planes in the host path's staging memory that lie before a role's.
pub(crate) fn floats_before(role: Role) -> u64 {
    Role::ALL[..role as usize].iter().map(|role| role.channels() as u64).sum()
}

/// The denoised plane.
pub(crate) fn plane_bytes(extent: Extent) -> u64 {
    4 * extent.pixels() * Role::Output.channels() as u64
}

/// The denoised plane, then what is read back of the plan.
pub(crate) fn output_bytes(plan: &Plan) -> u64 {
    let read_back = plan.read_back().into_iter().map(|id| plan.buffer(id).bytes);
    plane_bytes(plan.extent) + read_back.sum::<u64>()
}

/// Refuses a frame that takes more than the budget or than the device has.
pub(crate) fn check(extent: Extent, bytes: u64, budget: Option<u64>, heap: u64) -> Result<()> {
    let reason = match budget {
        Some(budget) if bytes > budget => format!(
            "it needs {bytes} bytes of device memory, the budget is {budget}: raise the budget (memory_budget), or give \
             the frame in smaller parts"
        ),
        _ if bytes > heap => format!("it needs {bytes} bytes of device memory, the device has {heap}"),
        _ => return Ok(()),
    };
    Err(Error::FrameTooLarge { width: extent.width, height: extent.height, reason })
}
