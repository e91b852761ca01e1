//! The planes of the host path: from the caller's memory to staging memory and back, and how a pass reads them there.

use super::{HostPass, Present};
use crate::error::{Error, Result};
use crate::formats::SampleFormat;
use crate::frame::{Features, Layout, NoiseKind, Plane, PlaneMut, Region};
use crate::host_signals::SignalPlanes;
use crate::kernels::ensemble;
use crate::kernels::planes::Planes;
use crate::memory::{MemoryRequired, floats_before, input_bytes, plane_bytes};
use crate::pass::Binding;
use crate::renderer::BufferPlane;
use crate::role::Role;
use crate::signals::Signal;

impl HostPass {
    /// Stages the colour.
    pub fn write_color(&mut self, color: &Plane) {
        self.write(Role::Color, color);
    }

    fn write(&mut self, role: Role, plane: &Plane) {
        let extent = self.extent();
        let (first, pixels) = (floats_before(role), extent.pixels());
        let floats: &mut [f32] = bytemuck::cast_slice_mut(self.input.bytes_mut());
        let planes = &mut floats[(first * pixels) as usize..];
        plane.pack_as(role, extent, &mut planes[..role.channels() * pixels as usize]);
    }

    /// Stages the signals of the next run.
    pub fn write_signals(&mut self, signals: &[Signal]) -> Result<()> {
        let extent = self.extent();
        if signals.len() > self.signals.room() {
            // What names the old planes goes first.
            (self.recorded, self.binding, self.signals) = (None, None, SignalPlanes::default());
            let host = MemoryRequired::of_plan(self.pass.plan()).host();
            // Those of the turned frame too, where results are averaged: three channels at most.
            let averaged = if self.engine.target.self_ensemble { signals.len() as u64 } else { 0 };
            let turned = ensemble::result_bytes(extent, 3 * averaged);
            self.engine.check_memory(extent, host + SignalPlanes::bytes(extent, signals.len()) + turned)?;
            self.signals = SignalPlanes::new(&self.engine.device, extent, signals.len())?;
        }
        self.signals.write(extent, signals);
        Ok(())
    }

    /// Writes the results to the signals' outputs; `region` as in the last run.
    pub fn read_signals(&self, signals: &mut [Signal], region: Option<Region>) {
        self.signals.read(self.extent(), region, signals);
    }

    /// Copies the features, and says which there are.
    pub(super) fn stage(&mut self, features: &Features) -> [bool; Role::FEATURES.len()] {
        Role::FEATURES.map(|role| {
            let plane = features.plane(role);
            plane.into_iter().for_each(|plane| self.write(role, plane));
            plane.is_some()
        })
    }

    /// Copies what is known of the colour's noise, where that is asked for, and says what it is.
    pub(super) fn stage_noise(&mut self, features: &Features) -> Option<NoiseKind> {
        let noise = features.noise.filter(|_| self.pass.plan().converged.is_some())?;
        self.write(Role::Noise, &noise.plane);
        Some(noise.kind)
    }

    pub(super) fn kept_features(&self) -> Result<[bool; Role::FEATURES.len()]> {
        self.kept.ok_or_else(|| Error::InvalidOption {
            option: "features_unchanged",
            reason: "no frame of this size was denoised before".into(),
        })
    }

    /// Writes the result to the caller's plane; `region` as in the last run.
    pub fn read(&self, output: &mut PlaneMut, region: Option<Region>) {
        let extent = self.extent();
        let region = region.unwrap_or(Region::all(extent));
        output.unpack(extent, region, 3, bytemuck::cast_slice(&self.output.bytes()[..12 * extent.pixels() as usize]));
    }

    pub(super) fn bind(&self, (features, noise): Present) -> Result<Binding> {
        let extent = self.extent();
        let (device, signals) = (&self.engine.device, self.signals.planes(extent));
        let [from, to] = self.in_device.as_ref().map_or([&self.input, &self.output], |[input, output]| [input, output]);
        let place = |role: Role| match role {
            Role::Output => (to, plane_bytes(extent), 0),
            _ => (from, input_bytes(self.pass.plan()), floats_before(role)),
        };
        let present = Role::FEATURES.into_iter().zip(features).filter(|(_, present)| *present).map(|(role, _)| role);
        let mut planes = Planes::default();
        for role in [Role::Color, Role::Output].into_iter().chain(present).chain(noise.map(|_| Role::Noise)) {
            let (buffer, size, first) = place(role);
            let packed = Layout::interleaved(extent, role.channels());
            let plane = BufferPlane {
                buffer: buffer.raw(),
                size,
                format: SampleFormat::F32,
                layout: Layout { offset: (first * extent.pixels()) as usize, ..packed },
            };
            // SAFETY: the buffers are our own and as described; the same below.
            planes[role] = unsafe { plane.resolve(device, role.name(), extent, role.channels())? };
        }
        if let Some(kind) = noise {
            planes.tell_noise(kind);
        }
        unsafe { self.pass.bind_rows(&planes, &signals) }
    }
}
