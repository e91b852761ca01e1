//! The renderer's planes, bound to a pass.

use super::Pass;
use crate::descriptors::{DescriptorSets, Resources};
use crate::error::Result;
use crate::kernels::planes::{Planes, Role};
use crate::kernels::signals::SignalRows;
use crate::kernels::{KernelTarget, TexelRange};
use crate::pipelines;
use crate::plan::{self, Dispatch, Present};
use crate::planes::PlaneTable;
use crate::renderer::{BufferFrame, ImageFrame};
use crate::signals::{self, BufferSignal};
use crate::vk::debug;
use crate::vk::pipeline::Pipeline;
use std::ffi::CString;

/// The renderer's planes, resolved for the [`Pass`] that made it: no other records it. `Send` and `Sync`; it must
/// outlive the recorded commands.
pub struct Binding {
    pub(super) sets: DescriptorSets,
    pub(super) pipelines: Vec<Pipeline>,
    /// What runs of the plan for these planes, whole.
    pub(super) dispatches: Vec<Dispatch>,
    /// What each of them is labelled with, where they are.
    pub(super) labels: Vec<CString>,
    pub(crate) planes: PlaneTable,
    /// The pass's own [`Pass::id`].
    pub(super) pass: u64,
}

impl Pass {
    /// Resolves a frame in the renderer's buffers. Not for the frame's hot path: it may compile kernels.
    ///
    /// # Errors
    /// [`crate::Error::PlaneMismatch`]; [`crate::Error::Binding`] for a format that the plane cannot have,
    /// [`crate::Error::InvalidOption`] for an encoding of depths that it cannot; [`crate::Error::Unsupported`] where
    /// the output's samples are halves and the device cannot write them; [`crate::Error::OutOfMemory`],
    /// [`crate::Error::Vulkan`].
    ///
    /// # Safety
    /// The buffers are valid, as their fields say, and belong to the device.
    pub unsafe fn bind_buffers(&self, frame: &BufferFrame) -> Result<Binding> {
        // SAFETY: the caller's promises are the same.
        unsafe { self.bind_buffers_with(frame, &[]) }
    }

    /// The same, with signals that go through the kernels of the frame's colour: each is recorded after the other, in
    /// the pass's own memory, so that their number is free ([`BufferSignal`]). Barriers as for the frame's planes.
    ///
    /// # Errors
    /// As [`Pass::bind_buffers`]; [`crate::Error::InvalidOption`] where the denoiser was made without
    /// [`Options::signals`](crate::Options::signals), and for a signal of a number of channels that its kind does not
    /// have; [`crate::Error::Binding`] where a signal's output has samples of another type than the frame's.
    ///
    /// # Safety
    /// As [`Pass::bind_buffers`], of the signals' buffers too.
    pub unsafe fn bind_buffers_with(&self, frame: &BufferFrame, signals: &[BufferSignal]) -> Result<Binding> {
        // SAFETY: the caller vouches for the buffers.
        unsafe { self.bind_rows(&frame.resolve(&self.engine.device, self.plan.extent)?, signals) }
    }

    /// Binds planes in buffers that were resolved.
    ///
    /// # Safety
    /// As [`Pass::bind_buffers_with`].
    pub(crate) unsafe fn bind_rows(&self, planes: &Planes, signals: &[BufferSignal]) -> Result<Binding> {
        let output_half = planes[Role::Output].format.is_half();
        let target = KernelTarget { output_half, ..self.engine.target.kernels };
        // SAFETY: no images; the caller vouches for the signals' buffers.
        unsafe {
            let signals = self.resolve_signals(signals, output_half)?;
            self.bind(None, target, planes, &signals)
        }
    }

    /// Resolves a frame in the renderer's images. Not for the frame's hot path: it may compile kernels and makes
    /// descriptor sets, which are never updated afterwards.
    ///
    /// # Errors
    /// [`crate::Error::PlaneMismatch`]; [`crate::Error::Binding`], [`crate::Error::InvalidOption`] as of buffers;
    /// [`crate::Error::OutOfMemory`], [`crate::Error::Vulkan`].
    ///
    /// # Safety
    /// The views are valid, as their fields say, belong to the device, and live as long as the binding.
    pub unsafe fn bind_images(&self, frame: &ImageFrame) -> Result<Binding> {
        // SAFETY: the caller's promises are the same.
        unsafe { self.bind_images_with(frame, &[]) }
    }

    /// The same, with signals in buffers, as [`Pass::bind_buffers_with`] takes them.
    ///
    /// # Errors
    /// As [`Pass::bind_images`] and, for the signals, [`Pass::bind_buffers_with`].
    ///
    /// # Safety
    /// As [`Pass::bind_images`]; the signals' buffers are valid, as their fields say, and belong to the device.
    pub unsafe fn bind_images_with(&self, frame: &ImageFrame, signals: &[BufferSignal]) -> Result<Binding> {
        let planes = frame.resolve(self.plan.extent)?;
        let output_half = planes[Role::Output].format.is_half();
        let target = KernelTarget { images: true, output_half, ..self.engine.target.kernels };
        // SAFETY: the caller vouches for the views and the signals' buffers.
        unsafe {
            let signals = self.resolve_signals(signals, output_half)?;
            self.bind(Some(frame), target, &planes, &signals)
        }
    }

    /// # Safety
    /// The buffers are valid, as their fields say, and belong to the device.
    unsafe fn resolve_signals(&self, signals: &[BufferSignal], output_half: bool) -> Result<Vec<SignalRows>> {
        if !signals.is_empty() && !self.engine.target.signals {
            return Err(signals::not_asked_for());
        }
        // SAFETY: the caller vouches for the buffers.
        let resolve =
            |signal: &BufferSignal| unsafe { signal.resolve(&self.engine.device, self.plan.extent, output_half) };
        signals.iter().map(resolve).collect()
    }

    /// # Safety
    /// The images are valid, belong to the device and live as long as the binding.
    pub(crate) unsafe fn bind(
        &self,
        images: Option<&ImageFrame>,
        target: KernelTarget,
        planes: &Planes,
        signals: &[SignalRows],
    ) -> Result<Binding> {
        let (engine, features) = (&self.engine, present(planes));
        let mut dispatches = self.plan.for_features(features).to_vec();
        dispatches.iter_mut().for_each(|dispatch| dispatch.choose(target));
        if !features.depth {
            plan::skip_depth(&mut dispatches);
        }
        let pipelines = pipelines::for_dispatches(&engine.device, &dispatches)?;
        let texels = |range: &TexelRange| {
            let (buffer, offset, bytes) = self.location(range.buffer);
            (buffer, offset + range.offset, bytes - range.offset)
        };
        let resources = Resources { images, texels: &texels };
        // SAFETY: the caller vouches for the images; the arena and the weights outlive every use of the binding.
        let sets = unsafe { DescriptorSets::new(&engine.device, &dispatches, &pipelines, &resources)? };
        let turned = engine.target.self_ensemble.then_some(self.plan.extent);
        let planes = PlaneTable::new(&engine.device, planes, signals, turned)?;
        let labelled = engine.label_kernels && engine.device.debug().is_some();
        let label =
            |dispatch: &Dispatch| debug::text(&format!("{} ({})", dispatch.name, dispatch.variant.contract.name));
        let labels = dispatches.iter().filter(|_| labelled).map(label).collect();
        Ok(Binding { sets, pipelines, dispatches, labels, planes, pass: self.id })
    }
}

fn present(planes: &Planes) -> Present {
    Present { albedo: planes.has(Role::Albedo), normal: planes.has(Role::Normal), depth: planes.has(Role::Depth) }
}
