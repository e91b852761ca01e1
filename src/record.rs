//! The executor: dispatches into a command buffer.

use crate::descriptors::DescriptorSets;
use crate::kernels::signals::SignalArgs;
use crate::kernels::{Addresses, BufferId, FrameArgs};
use crate::plan::Dispatch;
use crate::planes::FrameTable;
use crate::vk::device::Device;
use crate::vk::pipeline::Pipeline;
use crate::vk::submit;
use crate::vk::timestamps::Timestamps;
use ash::vk;
use std::ffi::CString;
use std::ops::Range;

/// What a recording needs beside the dispatches.
pub(crate) struct Recording<'a> {
    pub device: &'a Device,
    pub addresses: Addresses<'a>,
    /// In which buffer one of the plan's lies, and from which byte on.
    pub buffers: &'a dyn Fn(BufferId) -> (vk::Buffer, u64),
    /// One for each dispatch.
    pub pipelines: &'a [Pipeline],
    /// Made for these dispatches.
    pub sets: &'a DescriptorSets,
    /// Signals beside the colour: what is for them is recorded for each.
    pub signals: &'a [SignalArgs],
    /// The planes and signals of the turned frame, where some dispatches work on that.
    pub turned: Option<&'a FrameTable>,
    /// One for each dispatch, or none.
    pub labels: &'a [CString],
    /// Where the time before and after every dispatch goes: two timestamps each, from the number on; of what is for
    /// signals those of the first.
    pub timestamps: Option<(&'a Timestamps, u32)>,
}

impl Recording<'_> {
    /// Records those of the pass's dispatches that `part` names. It begins with a barrier that makes them wait for
    /// every compute shader before, so that a pass may be recorded again while its last run is in flight on the same
    /// queue, and its parts one after another. Timestamps are reset by the first part.
    ///
    /// # Safety
    /// `commands` is recording, belongs to the device and to a family with compute, outside a render pass; everything
    /// that the addresses and sets name lives until the commands have run.
    pub unsafe fn record(&self, commands: vk::CommandBuffer, dispatches: &[Dispatch], part: Range<usize>) {
        let device = self.device.raw();
        let mut bound = vk::Pipeline::null();
        if let Some((timestamps, first)) = self.timestamps.filter(|_| part.start == 0) {
            // SAFETY: the caller vouches for `commands`.
            unsafe { timestamps.reset(commands, first, 2 * dispatches.len() as u32) };
        }
        let indirect = dispatches.iter().any(|dispatch| dispatch.indirect.is_some());
        let (mut waits, mut last) = (true, 0);
        for (i, signal) in self.order(dispatches).filter(|(i, _)| part.contains(i)) {
            let (dispatch, pipeline) = (&dispatches[i], &self.pipelines[i]);
            // A signal's dispatches overwrite what the last one's read.
            waits |= dispatch.barrier || signal > last;
            last = signal;
            let timed = |at: usize| (signal == 0).then_some((2 * i + at) as u32);
            if dispatch.skipped || dispatch.of_signals && self.signals.is_empty() {
                // SAFETY: the caller vouches for `commands`.
                unsafe {
                    self.timestamp(commands, timed(0));
                    self.timestamp(commands, timed(1));
                }
                continue;
            }
            if std::mem::take(&mut waits) {
                // SAFETY: the caller vouches for `commands`.
                unsafe { self.barrier(commands, indirect) };
            }
            let [x, y, z] = dispatch.groups;
            let frame = self.frame(dispatch, signal);
            let push = dispatch.call.kernel().push(&Addresses { frame, ..self.addresses });
            // SAFETY: the caller vouches for `commands`; the contract's push constants were checked by the build.
            unsafe {
                if pipeline.raw != bound {
                    device.cmd_bind_pipeline(commands, vk::PipelineBindPoint::COMPUTE, pipeline.raw);
                    bound = pipeline.raw;
                }
                let set = self.sets.of(i);
                if set != vk::DescriptorSet::null() {
                    let point = vk::PipelineBindPoint::COMPUTE;
                    device.cmd_bind_descriptor_sets(commands, point, pipeline.layout, 0, &[set], &[]);
                }
                let stage = vk::ShaderStageFlags::COMPUTE;
                device.cmd_push_constants(commands, pipeline.layout, stage, 0, push.as_slice());
                let label = self.labels.get(i);
                if let Some(label) = label {
                    self.device.begin_label(commands, label);
                }
                self.timestamp(commands, timed(0));
                match dispatch.indirect.and_then(|groups| Some((groups, groups.offset(dispatch)?))) {
                    Some((groups, offset)) => {
                        let (buffer, first) = (self.buffers)(groups.buffer);
                        device.cmd_dispatch_indirect(commands, buffer, first + offset);
                    }
                    None => device.cmd_dispatch(commands, x, y, z),
                }
                self.timestamp(commands, timed(1));
                if label.is_some() {
                    self.device.end_label(commands);
                }
            }
        }
    }

    /// The frame that a dispatch works on, with one of the signals.
    fn frame(&self, dispatch: &Dispatch, signal: usize) -> FrameArgs {
        let (frame, signals) = match self.turned.filter(|_| dispatch.turned) {
            // The frame's own statistics are told, after this one's.
            Some(turned) => {
                (FrameArgs { planes: turned.address, told_at: None, ..self.addresses.frame }, turned.signals.as_slice())
            }
            None => (self.addresses.frame, self.signals),
        };
        let own = signals.get(signal).copied().filter(|_| dispatch.of_signals);
        FrameArgs { signal: own.or(frame.signal), ..frame }
    }

    /// The dispatches in the order in which they are recorded, each with its signal: what is for signals once for
    /// each of them, and once where there is none.
    fn order(&self, dispatches: &[Dispatch]) -> impl Iterator<Item = (usize, usize)> {
        let (signals, mut at) = (self.signals.len().max(1), 0);
        dispatches.chunk_by(|a, b| a.of_signals == b.of_signals).flat_map(move |run| {
            let run_at = at..at + run.len();
            at = run_at.end;
            let times = if run.iter().any(|dispatch| dispatch.of_signals) { signals } else { 1 };
            (0..times).flat_map(move |signal| run_at.clone().map(move |i| (i, signal)))
        })
    }

    /// # Safety
    /// As [`Recording::record`].
    unsafe fn timestamp(&self, commands: vk::CommandBuffer, at: Option<u32>) {
        if let (Some((timestamps, first)), Some(at)) = (self.timestamps, at) {
            // SAFETY: the caller vouches for `commands`; `record` begins with the reset.
            unsafe { timestamps.write(commands, first + at) };
        }
    }

    /// Compute waits for compute: what was written can be read, what was read can be overwritten. With `indirect`,
    /// numbers of workgroups too.
    ///
    /// # Safety
    /// As [`Recording::record`].
    unsafe fn barrier(&self, commands: vk::CommandBuffer, indirect: bool) {
        let mut stages = vk::PipelineStageFlags::COMPUTE_SHADER;
        let (mut read, write) = (vk::AccessFlags::SHADER_READ, vk::AccessFlags::SHADER_WRITE);
        if indirect {
            stages |= vk::PipelineStageFlags::DRAW_INDIRECT;
            read |= vk::AccessFlags::INDIRECT_COMMAND_READ;
        }
        // SAFETY: the caller vouches for `commands`.
        unsafe { submit::barrier(self.device, commands, (stages, write), (stages, read | write)) };
    }
}
