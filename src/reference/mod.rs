//! The plan, computed again on the CPU in f64: for every kernel a twin of the same name.
//!
//! The twins follow the kernels' definitions, not their shaders: they work on packed maps, read the weights by the
//! tensors' own names and layout instead of the packed buffers, and keep every value in f64. So a wrong index, a wrong
//! packing or a lost digit of the device shows as a difference. Values never written are NaN.

mod converged;
mod dense;
mod energy;
mod expand;
mod film;
mod frame_io;
mod fused;
mod map;
mod maps;
mod matrix;
mod noisy_albedo;
mod parallel;
mod parameters;
mod predicted;
mod samples;
mod signals;
mod stats;
mod tiles;
mod unembed;
mod window_attention;

use crate::error::{Error, Result};
use crate::frame::{Extent, Frame, Plane};
use crate::kernels::frame_io::Fireflies;
use crate::kernels::{BufferId, Call, View, for_kernels};
use crate::net::weights::{Weights, WeightsError};
use crate::plan::{Buffer, Dispatch, Place, Plan};
use crate::signals::SignalKind;
use frame_io::FrameData;
use map::Map;
use parameters::Parameters;
use signals::SignalData;

/// A kernel that can be computed in f64. One of [`Call`]'s that cannot does not compile.
trait Twin {
    /// Computes it over the buffers of a plan.
    fn compute(&self, reference: &mut Reference);
}

/// Computes a plan in f64.
#[derive(Debug)]
pub struct Reference<'a> {
    extent: Extent,
    planned: &'a [Buffer],
    dispatches: &'a [Dispatch],
    /// By buffer: the weights that it stands for.
    parameters: Vec<Option<Parameters>>,
    /// By buffer: its elements, once something has been written to it.
    buffers: Vec<Vec<f64>>,
    /// By buffer: the dispatch after which nobody needs it.
    last_use: Vec<usize>,
    frame: FrameData,
    output: Vec<f64>,
}

impl<'a> Reference<'a> {
    /// A plan, its weights, and a black frame without features.
    ///
    /// # Errors
    /// [`WeightsError::Missing`] where `weights` are those of another network.
    pub fn new(plan: &'a Plan, weights: &Weights) -> Result<Self, WeightsError> {
        let mut reference = Self::for_calls(plan.extent, &plan.buffers, weights)?;
        reference.dispatches = &plan.dispatches;
        for (i, dispatch) in plan.dispatches.iter().enumerate() {
            let traffic = dispatch.traffic();
            for (buffer, _) in traffic.reads.iter().chain(&traffic.writes) {
                reference.last_use[buffer.0] = i;
            }
        }
        for kept in [plan.log_color.buffer, plan.aux.buffer, plan.residual.buffer, plan.stats] {
            reference.last_use[kept.0] = usize::MAX;
        }
        Ok(reference)
    }

    /// Buffers without a plan, for [`Reference::run_call`], and a black frame of `extent`.
    ///
    /// # Errors
    /// [`WeightsError::Missing`] where `weights` lack a tensor that a buffer packs.
    pub fn for_calls(extent: Extent, buffers: &'a [Buffer], weights: &Weights) -> Result<Self, WeightsError> {
        let parameters = buffers.iter().map(|buffer| match &buffer.place {
            Place::Weights { pack, turned, .. } => {
                Parameters::new(pack, weights.turned().filter(|_| *turned).unwrap_or(weights)).map(Some)
            }
            Place::Arena { .. } | Place::Persistent { .. } => Ok(None),
        });
        Ok(Self {
            extent,
            planned: buffers,
            dispatches: &[],
            parameters: parameters.collect::<Result<_, _>>()?,
            buffers: vec![Vec::new(); buffers.len()],
            last_use: vec![usize::MAX; buffers.len()],
            frame: FrameData::black(extent),
            output: Vec::new(),
        })
    }

    /// The frame to work on, its exposure (`None`: its own) and the share of the noisy colour in the output.
    ///
    /// # Errors
    /// [`Error::EmptyFrame`]; [`Error::PlaneMismatch`], also where the frame is not of the plan's size.
    pub fn set_frame(&mut self, frame: &Frame, exposure: Option<f64>, blend: f64) -> Result<()> {
        frame.check()?;
        if frame.extent != self.extent {
            let (found, expected) = (frame.extent, self.extent);
            return Err(Error::PlaneMismatch {
                plane: "colour",
                reason: format!("the frame is {found:?}, the plan is for {expected:?}"),
            });
        }
        let FrameData { output_half, converged_threshold, fireflies, .. } = self.frame;
        let signal = self.frame.signal.take();
        self.frame = FrameData::new(frame);
        self.frame.signal = signal;
        (self.frame.exposure, self.frame.blend, self.frame.output_half) = (exposure, blend, output_half);
        (self.frame.converged_threshold, self.frame.fireflies) = (converged_threshold, fireflies);
        Ok(())
    }

    /// The signal that goes through the colour's kernels, of one channel or three; else there is none, and what is
    /// for signals does not run.
    ///
    /// # Errors
    /// [`Error::PlaneMismatch`].
    pub fn set_signal(&mut self, kind: SignalKind, channels: u32, plane: &Plane) -> Result<()> {
        let channels = channels as usize;
        plane.check("signal", self.extent, channels)?;
        let mut samples = vec![0.0; channels * self.extent.pixels() as usize];
        plane.pack(self.extent, channels, &mut samples);
        self.frame.signal = Some(SignalData { kind, channels, samples, output: Vec::new(), turned: Vec::new() });
        Ok(())
    }

    /// The denoised signal, its channels interleaved.
    pub fn signal(&self) -> &[f64] {
        self.frame.signal.as_ref().map_or(&[], |signal| &signal.output)
    }

    /// What is done with fireflies; else [`Fireflies::Auto`].
    pub fn set_fireflies(&mut self, fireflies: Fireflies) {
        self.frame.fireflies = fireflies;
    }

    /// Whether the output's samples are halves, so that they end at 65504.
    pub fn set_output_half(&mut self, half: bool) {
        self.frame.output_half = half;
    }

    /// Runs every dispatch. Of the arena only what the plan names itself (inputs, residual, statistics) is kept.
    pub fn run(&mut self) {
        for i in 0..self.dispatches.len() {
            self.run_dispatch(i);
            for (buffer, &last) in self.buffers.iter_mut().zip(&self.last_use) {
                if last == i {
                    *buffer = Vec::new();
                }
            }
        }
    }

    /// Runs one dispatch of the plan.
    pub fn run_dispatch(&mut self, index: usize) {
        let dispatch = &self.dispatches[index];
        if dispatch.turned {
            self.frame.turn();
        }
        if !dispatch.of_signals || self.frame.signal.is_some() {
            self.run_call(&dispatch.call);
        }
        if dispatch.turned {
            self.frame.turn();
        }
    }

    /// Runs one kernel over the plan's buffers.
    pub fn run_call(&mut self, call: &Call) {
        macro_rules! twins {
            ($($(#[$doc:meta])* $name:ident($module:ident::$kernel:ident),)*) => {
                match call {
                    $(Call::$name(kernel) => kernel.compute(self),)*
                }
            };
        }
        for_kernels!(twins);
    }

    /// The elements of a buffer: empty if nothing has been written to it yet, or if [`Reference::run`] is past it.
    pub fn buffer(&self, id: BufferId) -> &[f64] {
        &self.buffers[id.0]
    }

    /// Fills a buffer, from its start.
    pub fn set_buffer(&mut self, id: BufferId, values: &[f64]) {
        self.buffer_mut(id)[..values.len()].copy_from_slice(values);
    }

    /// Fills an element of a buffer.
    fn set_element(&mut self, id: BufferId, at: usize, value: f64) {
        self.buffer_mut(id)[at] = value;
    }

    /// Relative noise up to which nothing is denoised.
    pub fn set_converged_threshold(&mut self, threshold: f64) {
        self.frame.converged_threshold = threshold;
    }

    /// Fills a list of active tiles, each `(x, y)`.
    pub fn set_tiles(&mut self, id: BufferId, tiles: &[(u32, u32)]) {
        let entries = tiles.iter().map(|(x, y)| f64::from(x | y << 16));
        let list: Vec<f64> = std::iter::once(tiles.len() as f64).chain(entries).collect();
        self.set_buffer(id, &list);
    }

    /// What a view covers, `[token][channel]`.
    pub fn view(&self, view: &View) -> Vec<f64> {
        self.map(view).values
    }

    /// Fills what a view covers, from `[token][channel]`.
    pub fn set_view(&mut self, view: &View, values: &[f64]) {
        let map = Map::new(view.width, view.height, view.channels, values.to_vec());
        let tiles = tiles::all(view.width, view.height);
        self.store(&map, view, &tiles, |x, y, channel| (x, y, channel));
    }

    /// The denoised frame, interleaved RGB. Pixels of tiles that did not run are NaN.
    pub fn output(&self) -> &[f64] {
        &self.output
    }

    fn map(&self, view: &View) -> Map {
        Map::read(self.buffer(view.buffer), view)
    }

    /// Writes the listed tiles of `map` to a view, every element where `place` says.
    fn store(
        &mut self,
        map: &Map,
        view: &View,
        tiles: &[tiles::Tile],
        place: impl Fn(usize, usize, usize) -> map::Place,
    ) {
        map.write(self.buffer_mut(view.buffer), view, tiles, place);
    }

    fn buffer_mut(&mut self, id: BufferId) -> &mut [f64] {
        let buffer = &mut self.buffers[id.0];
        if buffer.is_empty() {
            let Buffer { bytes, storage, .. } = &self.planned[id.0];
            *buffer = vec![f64::NAN; (bytes / storage.bytes()) as usize];
        }
        buffer
    }

    /// The weights that a buffer stands for. The plan's calls name buffers of the right kind.
    fn parameters(&self, id: BufferId) -> &Parameters {
        match &self.parameters[id.0] {
            Some(parameters) => parameters,
            None => unreachable!("{} holds no weights", self.planned[id.0].name),
        }
    }
}
