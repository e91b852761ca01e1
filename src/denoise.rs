//! The host path's calls: a frame in the caller's memory, in whole or in tiles, in the caller's view or not.

use crate::denoiser::Denoiser;
use crate::error::{Error, Result};
use crate::frame::{Extent, Features, Frame, Layout, PlaneMut, Region, check_in_place};
use crate::host::HostPass;
use crate::options::Report;
use crate::plan::Plan;
use crate::progress::Progress;
use crate::signals::{self, Signal};
use crate::tiled;
use crate::tiling::Tiling;
use std::time::Instant;

impl Denoiser {
    /// Denoises a frame in host memory and waits for the result. What a size needs is kept for the next call.
    ///
    /// # Errors
    /// [`Error::EmptyFrame`], [`Error::PlaneMismatch`], [`Error::InvalidOption`] for a region that leaves the frame and
    /// for unchanged features of which nothing is kept, [`Error::FrameTooLarge`], [`Error::OutOfMemory`],
    /// [`Error::DeviceLost`], [`Error::Vulkan`]; [`Error::Binding`] on a renderer's device, which has no queue of ours.
    /// The output is untouched then; but where the frame is cut into tiles ([`crate::Options::memory_budget`]), those
    /// that were done are written.
    pub fn denoise(&mut self, frame: &Frame, output: PlaneMut) -> Result<Report> {
        self.denoise_with(frame, output, &mut [], None)
    }

    /// The same, with signals that go through the kernels of the frame's colour, any number of them (parts of its
    /// light, whose sums then hold, other layers, alpha: [`Signal`]), and in the view of the caller.
    ///
    /// With `progress` the work goes to the device in submissions of about 50 ms (on a CPU driver one kernel of one
    /// band each) that are cut by what each is predicted to take, and it is called between them. Where it answers
    /// [`ControlFlow::Break`](std::ops::ControlFlow::Break), nothing more is submitted and the call ends. The result
    /// has the same bits as without.
    ///
    /// # Errors
    /// As [`Denoiser::denoise`]; [`Error::InvalidOption`] where the denoiser was made without
    /// [`Options::signals`](crate::Options::signals), for a signal of a number of channels that its kind does not have,
    /// and for signals of a frame that would be cut into tiles; [`Error::Cancelled`]. All outputs are then as after
    /// another error. Where features are kept ([`Denoiser::set_features_unchanged`]), the next frame after a cancelled
    /// one has to give them again.
    pub fn denoise_with(
        &mut self,
        frame: &Frame,
        mut output: PlaneMut,
        signals: &mut [Signal],
        progress: Option<&mut Progress>,
    ) -> Result<Report> {
        frame.check()?;
        output.check("output", frame.extent, 3)?;
        if !signals.is_empty() && !self.engine.target.signals {
            return Err(signals::not_asked_for());
        }
        signals.iter().try_for_each(|signal| signal.check(frame.extent))?;
        let started = Instant::now();
        match self.prepare(frame.extent)? {
            None => {
                let report = self.run(frame, signals, started, progress)?;
                self.read(&mut output);
                self.host.iter().for_each(|pass| pass.read_signals(signals, self.options.region));
                Ok(report)
            }
            Some(_) if !signals.is_empty() => Err(signals::not_in_tiles()),
            Some(tiling) => tiled::denoise(&self.engine, &tiling, frame, &self.options, &mut output, started, progress),
        }
    }

    /// As [`Denoiser::denoise`], with the result in the place of the colour.
    ///
    /// # Errors
    /// As [`Denoiser::denoise`]; the colour is untouched then, in tiles or not.
    pub fn denoise_in_place(&mut self, extent: Extent, color: PlaneMut, features: &Features) -> Result<Report> {
        self.denoise_in_place_watched(extent, color, features, None)
    }

    /// As [`Denoiser::denoise_with`], with the result in the place of the colour and without signals.
    ///
    /// # Errors
    /// As [`Denoiser::denoise_with`].
    pub fn denoise_in_place_with(
        &mut self,
        extent: Extent,
        color: PlaneMut,
        features: &Features,
        progress: &mut Progress,
    ) -> Result<Report> {
        self.denoise_in_place_watched(extent, color, features, Some(progress))
    }

    fn denoise_in_place_watched(
        &mut self,
        extent: Extent,
        mut color: PlaneMut,
        features: &Features,
        progress: Option<&mut Progress>,
    ) -> Result<Report> {
        check_in_place(extent, &color, features)?;
        let started = Instant::now();
        let frame = Frame { extent, color: color.as_plane(), features: *features };
        match self.prepare(extent)? {
            None => {
                let report = self.run(&frame, &[], started, progress)?;
                self.read(&mut color);
                Ok(report)
            }
            Some(tiling) => {
                // Tiles look at the noisy colour of those that are done.
                let mut result = zeros(3 * extent.pixels())?;
                let mut output = PlaneMut::f32(&mut result, Layout::interleaved(extent, 3));
                let report =
                    tiled::denoise(&self.engine, &tiling, &frame, &self.options, &mut output, started, progress)?;
                color.unpack(extent, self.options.region.unwrap_or(Region::all(extent)), 3, &result);
                Ok(report)
            }
        }
    }

    /// Makes the pass of a frame size, or finds the tiles that it is to be cut into.
    pub(crate) fn prepare(&mut self, extent: Extent) -> Result<Option<Tiling>> {
        self.options.region.map_or(Ok(()), |region| region.check(extent))?;
        if self.host.as_ref().is_some_and(|pass| pass.extent() == extent) {
            return Ok(None);
        }
        // The old one is gone before anything new is allocated: both may not fit.
        self.host = None;
        if let Some((_, tiling)) = self.tiling.filter(|(known, _)| *known == extent) {
            return tiled::check(&self.options).map(|()| Some(tiling));
        }
        let engine = &self.engine;
        let fitting = |plan: Result<Plan>| plan.and_then(|plan| engine.check_host(&plan).map(|()| plan));
        let planned = match fitting(engine.plan(extent)) {
            Err(error @ Error::FrameTooLarge { .. }) => fitting(engine.narrow_plan(extent)).map_err(|_| error),
            planned => planned,
        };
        let too_large = match planned {
            Ok(plan) => {
                self.host = Some(HostPass::new(engine, plan)?);
                return Ok(None);
            }
            Err(error @ Error::FrameTooLarge { .. }) => error,
            Err(error) => return Err(error),
        };
        tiled::check(&self.options)?;
        let tiling = tiled::tiling(&self.engine, extent)?.ok_or(too_large)?;
        self.tiling = Some((extent, tiling));
        Ok(Some(tiling))
    }

    /// Runs the pass that was made for a frame.
    fn run(
        &mut self,
        frame: &Frame,
        signals: &[Signal],
        started: Instant,
        progress: Option<&mut Progress>,
    ) -> Result<Report> {
        let Some(pass) = &mut self.host else { return Err(Error::Binding("no pass was made".into())) };
        pass.write_color(&frame.color);
        pass.write_signals(signals)?;
        pass.run(&frame.features, &self.options, self.profiling, started, progress)
    }

    /// Writes what was run last.
    fn read(&self, output: &mut PlaneMut) {
        self.host.iter().for_each(|pass| pass.read(output, self.options.region));
    }
}

/// So many zeros.
fn zeros(len: u64) -> Result<Vec<f32>> {
    let mut zeros = Vec::new();
    zeros.try_reserve_exact(len as usize).map_err(|error| Error::OutOfMemory {
        what: "the result of all tiles".into(),
        bytes: 4 * len,
        reason: error.to_string(),
    })?;
    zeros.resize(len as usize, 0.0);
    Ok(zeros)
}
