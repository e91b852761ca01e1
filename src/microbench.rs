//! Runs a part of a network over and over on a device of our own.

use crate::engine::{self, Engine};
use crate::error::Result;
use crate::frame::Extent;
use crate::kernels::planes::Planes;
use crate::net::graph::Graph;
use crate::net::weights::Weights;
use crate::options::{FrameOptions, Options, Precision};
use crate::pass::{Binding, Pass};
use crate::plan::{Plan, packing_of_part, plan_part};
use crate::profile::{KernelRecord, Profiler};
use crate::target::Target;
use crate::vk::device::Device;
use crate::vk::submit::{Submission, barrier};
use ash::vk;
use std::sync::Arc;
use std::time::Instant;

/// What the maps hold before the first run: any ordinary number does, the work does not depend on it.
const ANY_VALUE: f32 = 0.5;

/// One run.
#[derive(Clone, Debug)]
pub struct TimedRun {
    /// Milliseconds of the whole: by timestamps around it, or on the host where the device has none.
    pub milliseconds: f64,
    /// Its kernels; empty without timestamps.
    pub records: Vec<KernelRecord>,
}

/// A part of a network ([`Graph::of_block`], [`Graph::of_convolution`]) on the device, without a frame around it.
pub struct PartRunner {
    // Fields drop in this order: the recording before what it uses.
    submission: Submission,
    profiler: Option<Profiler>,
    binding: Binding,
    pass: Pass,
}

impl PartRunner {
    /// Plans `graph` for maps of `extent` tokens and puts it on the device. `target` chooses among lowerings; its limit
    /// on memory is lowered to the device's own, and `precision`, as in [`crate::Options`], says how maps are stored
    /// and what computes.
    ///
    /// # Errors
    /// As [`crate::Denoiser::new`] and [`crate::Denoiser::pass`]; [`crate::Error::Binding`] on a renderer's device.
    pub fn new(
        device: &Device,
        graph: &Graph,
        weights: &Weights,
        extent: Extent,
        target: &Target,
        precision: Precision,
    ) -> Result<Self> {
        let own = engine::target(device, &Options { precision, ..Options::default() })?;
        let target = Target {
            kernels: own.kernels,
            max_block_bytes: own.max_block_bytes.min(target.max_block_bytes),
            storage: own.storage,
            arithmetic: own.arithmetic,
            ..*target
        };
        let plan = plan_part(graph, extent, &target)?;
        let packing = packing_of_part(graph, &target);
        let engine = Arc::new(Engine::with_packing(device, graph.clone(), &[(&packing, weights)], target)?);
        let pass = Pass::of_plan(&engine, plan)?;
        // SAFETY: no images.
        let binding = unsafe { pass.bind(None, engine.target.kernels, &Planes::default(), &[]) }?;
        let profiler = if device.has_timestamps() { Some(pass.profiler(1)?) } else { None };
        let mut runner = Self { submission: Submission::new(device)?, profiler, binding, pass };
        overwrite_memory(&runner.pass, &mut runner.submission, ANY_VALUE.to_bits())?;
        runner.record()?;
        Ok(runner)
    }

    /// What runs.
    pub fn plan(&self) -> &Plan {
        self.pass.plan()
    }

    /// Runs once and waits. The first run compiles.
    ///
    /// # Errors
    /// [`crate::Error::DeviceLost`], [`crate::Error::Vulkan`].
    pub fn run(&mut self) -> Result<TimedRun> {
        let clock = Instant::now();
        let device_ms = self.submission.run()?;
        let milliseconds = device_ms.unwrap_or_else(|| clock.elapsed().as_secs_f64() * 1e3);
        let records = match &self.profiler {
            Some(profiler) => profiler.read(0)?.unwrap_or_default(),
            None => Vec::new(),
        };
        Ok(TimedRun { milliseconds, records })
    }

    fn record(&mut self) -> Result<()> {
        let Self { submission, profiler, binding, pass } = self;
        let profiled = profiler.as_ref().map(|profiler| (profiler, 0));
        submission.record(|commands| {
            // SAFETY: the command buffer is ours, everything bound lives in `self`, and `run` waits.
            unsafe { pass.record_with(commands, binding, &FrameOptions::default(), profiled) }
        })
    }
}

/// Writes this word all over the memory of a pass, what outlives its recordings included, and waits.
pub(crate) fn overwrite_memory(pass: &Pass, submission: &mut Submission, word: u32) -> Result<()> {
    submission.record(|commands| {
        let transfer = (vk::PipelineStageFlags::TRANSFER, vk::AccessFlags::TRANSFER_WRITE);
        let shaders = vk::AccessFlags::SHADER_READ | vk::AccessFlags::SHADER_WRITE;
        for ((buffer, offset), bytes) in pass.memory() {
            // SAFETY: the memory is the pass's own, and `run` waits.
            unsafe {
                pass.device().raw().cmd_fill_buffer(commands, buffer, offset, bytes, word);
                barrier(pass.device(), commands, transfer, (vk::PipelineStageFlags::COMPUTE_SHADER, shaders));
            }
        }
        Ok(())
    })?;
    submission.run().map(|_| ())
}
