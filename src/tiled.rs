//! The host path of frames that are too large for the device: statistics over strips, the sums of FiLM means over
//! tiles, then the tiles themselves, one at a time.

use crate::engine::Engine;
use crate::error::{Error, Result};
use crate::frame::{Extent, Frame, PlaneMut, Region};
use crate::frame_statistics::{self, WholeStatistics};
use crate::host::{Commands, HostPass};
use crate::kernels::TILE;
use crate::kernels::stats::{EXPOSURE, STATS_FLOATS, TILE_WORDS};
use crate::memory::MemoryRequired;
use crate::options::{FrameOptions, Report, TileReport};
use crate::plan::active::Work;
use crate::plan::tile::{self, Given};
use crate::plan::{Dispatch, Plan};
use crate::progress::{self, Progress};
use crate::tiling::{Tile, Tiling};
use crate::vk::memory::Buffer;
use ash::vk;
use gpu_allocator::MemoryLocation;
use std::sync::Arc;
use std::time::Instant;

/// Shares of the work, as told: a pixel's of the statistics and of the sums, beside a tile's whole pass.
const STATISTICS_SHARE: f64 = 0.03;
const SUMS_SHARE: f64 = 0.2;

/// The tiling of a frame that does not fit the device or the budget in whole; `None` where no tile fits either.
///
/// # Errors
/// Those of planning the smallest frame.
pub(crate) fn tiling(engine: &Engine, extent: Extent) -> Result<Option<Tiling>> {
    if !engine.fits(frame_statistics::bytes(engine, extent) + engine.weights.size()) {
        return Ok(None);
    }
    let margin = tile::margin(&engine.graph, &engine.tile_target())?;
    let fits = |extent: Extent| {
        engine.tile_plan(extent).is_ok_and(|plan| engine.check_host(&plan).is_ok() && engine.fits(tile_bytes(&plan)))
    };
    Ok(Tiling::choose(extent, margin, engine.graph.arch.pad_multiple(), &fits))
}

/// A tiling that was chosen elsewhere.
pub(crate) fn tiling_of(engine: &Engine, extent: Extent, tile: [u32; 2], margin: u32) -> Result<Tiling> {
    let exact = tile::margin(&engine.graph, &engine.tile_target())?;
    let tiling = Tiling::new(extent, tile, margin, exact, engine.graph.arch.pad_multiple());
    tiling.work().map(|_| tiling).ok_or_else(|| Error::InvalidOption {
        option: "tile",
        reason: format!(
            "{tile:?} with margins of {margin}: no multiple of the padding, or nothing between the margins"
        ),
    })
}

/// Device memory of a tile.
fn tile_bytes(plan: &Plan) -> u64 {
    MemoryRequired::of_plan(plan).host() + given_bytes(plan)
}

/// Denoises a frame that was checked, tile by tile.
pub(crate) fn denoise(
    engine: &Arc<Engine>,
    tiling: &Tiling,
    frame: &Frame,
    options: &FrameOptions,
    output: &mut PlaneMut,
    started: Instant,
    progress: Option<&mut Progress>,
) -> Result<Report> {
    let whole = Work::of(&engine.plan_anywhere(frame.extent)?.dispatches).flops(None);
    let tiles = tiling.tiles();
    let area: f64 = tiles.iter().map(|tile| tile.extent().pixels() as f64).sum();
    let pixels = frame.extent.pixels() as f64;
    let mut meter = Meter { progress, done: 0.0, all: STATISTICS_SHARE * pixels + (1.0 + SUMS_SHARE) * area };
    meter.tell(0.0)?;
    let exposure = engine.fixed_exposure(options.exposure);
    let mut tell = |done: f64| meter.tell(done * STATISTICS_SHARE * pixels);
    let statistics = WholeStatistics::of(engine, frame, exposure, &mut tell)?;
    meter.done = STATISTICS_SHARE * pixels;
    let exposure = statistics.stats[EXPOSURE];
    let mut run = Run {
        engine,
        frame,
        options,
        statistics,
        means: Vec::new(),
        meter,
        gpu_ms: Some(0.0),
        flops: 0.0,
        device_bytes: 0,
    };
    let mut pass: Option<TilePass> = None;
    for tile in &tiles {
        run.sums(run.pass(&mut pass, tile)?, tile)?;
    }
    // The last size's pass is there: it comes first.
    for tile in tiles.iter().rev() {
        let wanted = options.region.unwrap_or(Region::all(frame.extent));
        match tile.core.common(&wanted) {
            Some(region) => run.pixels(run.pass(&mut pass, tile)?, tile, region, output)?,
            None => run.meter.pass_over(tile.extent().pixels() as f64)?,
        }
    }
    Ok(Report {
        exposure,
        gpu_ms: run.gpu_ms,
        total_ms: started.elapsed().as_secs_f64() * 1e3,
        work: run.flops / whole.max(1.0),
        device_bytes: run.device_bytes,
        tiles: Some(TileReport { count: tiles.len(), margin: tiling.margin, exact: tiling.exact }),
    })
}

/// Tells the caller how much is done, in pixels of tiles.
struct Meter<'a, 'b> {
    progress: Option<&'a mut Progress<'b>>,
    done: f64,
    all: f64,
}

impl Meter<'_, '_> {
    /// So much more than what is done.
    fn tell(&mut self, more: f64) -> Result<()> {
        let done = (self.done + more) / self.all;
        self.progress.as_mut().map_or(Ok(()), |progress| progress::tell(*progress, done))
    }

    fn pass_over(&mut self, amount: f64) -> Result<()> {
        self.done += amount;
        self.tell(0.0)
    }

    /// Runs what counts for `amount`.
    fn run(
        &mut self,
        amount: f64,
        run: impl FnOnce(Option<&mut dyn FnMut(f64) -> Result<()>>) -> Result<Option<f64>>,
    ) -> Result<Option<f64>> {
        let milliseconds = match self.progress {
            Some(_) => run(Some(&mut |done| self.tell(done * amount)))?,
            None => run(None)?,
        };
        self.done += amount;
        Ok(milliseconds)
    }
}

/// The pass of a tile's size, and where what is of the whole frame is staged for it.
struct TilePass {
    pass: HostPass,
    given: Buffer,
}

/// Floats that are staged: the statistics, the depth scale, a sum for every channel of a mean, then the tiles' words.
fn given_bytes(plan: &Plan) -> u64 {
    let (sums, tiles) = plan.given.as_ref().map_or((0, 0), |given| {
        (given.sums.iter().map(|sums| u64::from(sums.channels)).sum::<u64>(), plan.buffer(given.tile_stats).bytes)
    });
    4 * (STATS_FLOATS + 1 + sums) + tiles
}

/// Runs the tiles of a frame.
struct Run<'a, 'b> {
    engine: &'a Arc<Engine>,
    frame: &'a Frame<'a>,
    options: &'a FrameOptions,
    statistics: WholeStatistics,
    /// Of every mean, the sum of each channel so far.
    means: Vec<Vec<f64>>,
    meter: Meter<'a, 'b>,
    gpu_ms: Option<f64>,
    flops: f64,
    /// The most at any time.
    device_bytes: u64,
}

impl Run<'_, '_> {
    /// The pass of a tile: the last one, if it fits.
    fn pass<'p>(&self, last: &'p mut Option<TilePass>, tile: &Tile) -> Result<&'p mut TilePass> {
        let fits = last.take().filter(|last| last.pass.extent() == tile.extent());
        // The old one is gone before the new one is allocated: both may not fit.
        let pass = match fits {
            Some(pass) => pass,
            None => {
                let plan = self.engine.tile_plan(tile.extent())?;
                let given = Buffer::new(
                    &self.engine.device,
                    "what is of the whole frame",
                    given_bytes(&plan),
                    MemoryLocation::CpuToGpu,
                )?;
                TilePass { pass: HostPass::new(self.engine, plan)?, given }
            }
        };
        Ok(last.insert(pass))
    }

    /// Adds the sums over a tile's own tokens.
    fn sums(&mut self, tile_pass: &mut TilePass, tile: &Tile) -> Result<()> {
        let TilePass { pass, given: staged } = tile_pass;
        let plan = pass.pass().plan();
        let Some(given) = plan.given.clone().filter(|given| !given.sums.is_empty()) else {
            return self.meter.pass_over(SUMS_SHARE * tile.extent().pixels() as f64);
        };
        self.means.resize_with(given.sums.len(), Vec::new);
        let (dispatches, counts) = plan.sums_of_tile(tile.local(tile.core));
        self.run(pass, staged, &given, tile, dispatches, SUMS_SHARE)?;
        // After the statistics, as the plan reads them back.
        let mut at = 4 * STATS_FLOATS as usize;
        let plan = pass.pass().plan();
        for ((sums, count), means) in given.sums.iter().zip(counts).zip(&mut self.means) {
            let channels = sums.channels as usize;
            means.resize(channels, 0.0);
            let partials: &[f32] = bytemuck::cast_slice(&pass.read_back()[at..][..4 * channels * count as usize]);
            for partial in partials.chunks_exact(channels) {
                means.iter_mut().zip(partial).for_each(|(mean, value)| *mean += f64::from(*value));
            }
            at += plan.buffer(sums.buffer).bytes as usize;
        }
        Ok(())
    }

    /// Makes the pixels of a region that lies in a tile.
    fn pixels(&mut self, tile_pass: &mut TilePass, tile: &Tile, region: Region, output: &mut PlaneMut) -> Result<()> {
        let TilePass { pass, given: staged } = tile_pass;
        let plan = pass.pass().plan();
        let Some(given) = plan.given.clone() else { return Ok(()) };
        let local = tile.local(region);
        let dispatches = plan.of_tile(local, self.frame.extent);
        self.run(pass, staged, &given, tile, dispatches, 1.0)?;
        pass.read(&mut output.part(tile.area.x, tile.area.y), Some(local));
        Ok(())
    }

    /// Stages a tile with what is of the whole frame and runs dispatches over it.
    fn run(
        &mut self,
        pass: &mut HostPass,
        staged: &mut Buffer,
        given: &Given,
        tile: &Tile,
        dispatches: Vec<Dispatch>,
        share: f64,
    ) -> Result<()> {
        self.flops += Work::of(&dispatches).flops(None);
        self.device_bytes = self.device_bytes.max(self.engine.device.memory_bytes());
        let uploads = self.stage(pass, staged, given, tile);
        let (x, y) = (tile.area.x, tile.area.y);
        let part = Frame {
            extent: tile.extent(),
            color: self.frame.color.part(x, y),
            features: self.frame.features.part(x, y),
        };
        let commands = Commands { dispatches, uploads };
        let (options, amount) = (self.options, share * tile.extent().pixels() as f64);
        let milliseconds = self.meter.run(amount, |tell| pass.run_commands(&part, &commands, options, tell))?;
        self.gpu_ms = self.gpu_ms.zip(milliseconds).map(|(sum, tile)| sum + tile);
        Ok(())
    }

    /// Writes what is of the whole frame where the device can read it, and says where each goes.
    fn stage(
        &self,
        pass: &HostPass,
        staged: &mut Buffer,
        given: &Given,
        tile: &Tile,
    ) -> Vec<(vk::Buffer, vk::Buffer, vk::BufferCopy)> {
        let from = staged.raw();
        let words: &mut [u32] = bytemuck::cast_slice_mut(staged.bytes_mut());
        let mut uploads = Vec::new();
        let mut at = 0;
        let mut put = |id, values: &mut dyn Iterator<Item = u32>| {
            let first = at;
            for value in values {
                words[at] = value;
                at += 1;
            }
            let (to, dst_offset, _) = pass.pass().location(id);
            let copy = vk::BufferCopy { src_offset: 4 * first as u64, dst_offset, size: 4 * (at - first) as u64 };
            uploads.push((from, to, copy));
        };
        let statistics = &self.statistics;
        put(given.stats, &mut statistics.stats.iter().map(|value| value.to_bits()));
        put(given.depth_scale, &mut std::iter::once(statistics.depth_scale.to_bits()));
        for (sums, means) in given.sums.iter().zip(&self.means) {
            // Before the first tile was summed there is nothing yet, and nobody reads it.
            if !means.is_empty() {
                put(sums.buffer, &mut means.iter().map(|sum| (*sum as f32).to_bits()));
            }
        }
        let columns = self.frame.extent.width.div_ceil(TILE) as usize * TILE_WORDS as usize;
        let first = (tile.area.x / TILE) as usize * TILE_WORDS as usize;
        let row = tile.area.width.div_ceil(TILE) as usize * TILE_WORDS as usize;
        let rows = (tile.area.y / TILE) as usize..tile.area.bottom().div_ceil(TILE) as usize;
        let tiles = rows.flat_map(|y| &statistics.tile_stats[y * columns + first..][..row]);
        put(given.tile_stats, &mut tiles.copied());
        uploads
    }
}

/// Checks that a frame in tiles may be: what was kept of features is of a whole frame.
pub(crate) fn check(options: &FrameOptions) -> Result<()> {
    if options.features_unchanged {
        return Err(Error::InvalidOption {
            option: "features_unchanged",
            reason: "the frame does not fit the device or the memory budget in whole, and of tiles nothing is kept"
                .into(),
        });
    }
    Ok(())
}
