//! Statistics of a frame whose planes are not on the device in whole: the kernels of the pass
//! ([`crate::kernels::stats`]) over strips of its rows, with the same bits.

use crate::descriptors::{DescriptorSets, Resources};
use crate::engine::Engine;
use crate::error::Result;
use crate::frame::{Extent, Frame, Plane};
use crate::kernels::planes::{Format, PlaneArgs, Planes, Role};
use crate::kernels::stats::{
    Clear, Counted, HISTOGRAM_BYTES, Histogram, RUN_TILES, STATS_FLOATS, Select, TILE_WORDS, TileStats,
};
use crate::kernels::{Addresses, BufferId, Call, FrameArgs, TILE};
use crate::net::op::Stage;
use crate::pipelines;
use crate::plan::Dispatch;
use crate::planes::PlaneTable;
use crate::record::Recording;
use crate::vk::memory::Buffer;
use crate::vk::submit::{Submission, barrier};
use ash::vk;
use gpu_allocator::MemoryLocation;

/// Rows of a strip are a multiple of this: its tiles are whole runs then, whatever the frame's width.
const ROWS: u32 = TILE * RUN_TILES;
/// Rows below a strip that its tiles look at: a pixel's neighbours.
const BELOW: u32 = 1;
/// Bytes of a strip's planes, where more rows than [`ROWS`] fit into it, and the part of the memory that they may take.
const STRIP_BYTES: u64 = 32 << 20;
const STRIPS_A_BUDGET: u64 = 16;
/// Floats of a pixel: colour and depth.
const PIXEL_FLOATS: u64 = 4;

const STATS: BufferId = BufferId(0);
const DEPTH_SCALE: BufferId = BufferId(1);
const LUMINANCES: BufferId = BufferId(2);
const DEPTHS: BufferId = BufferId(3);
const TILES: BufferId = BufferId(4);
const RUNS: BufferId = BufferId(5);
const STRIP_TILES: BufferId = BufferId(6);
const STRIP_RUNS: BufferId = BufferId(7);

/// What is known of a frame.
pub(crate) struct WholeStatistics {
    /// The statistics ([`STATS_FLOATS`]).
    pub stats: Vec<f32>,
    /// The depth scale; of no meaning without depth.
    pub depth_scale: f32,
    /// [`TILE_WORDS`] for every 8x8 tile, row by row.
    pub tile_stats: Vec<u32>,
}

/// Device memory that finding them takes.
pub(crate) fn bytes(engine: &Engine, extent: Extent) -> u64 {
    let most = rows(engine, extent) + ROWS + BELOW;
    let (strip, all) = (of_rows(extent.width, most), of_rows(extent.width, extent.height));
    let tiles = 2 * all.tile_bytes() + all.run_bytes() + strip.tile_bytes() + strip.run_bytes();
    let planes = u64::from(extent.width) * u64::from(most) * PIXEL_FLOATS * 4;
    tiles + planes + 2 * HISTOGRAM_BYTES
}

/// Rows of a strip.
fn rows(engine: &Engine, extent: Extent) -> u32 {
    let bytes = STRIP_BYTES.min(engine.most_bytes() / STRIPS_A_BUDGET);
    let rows = bytes / (u64::from(extent.width) * PIXEL_FLOATS * 4);
    (rows as u32 / ROWS * ROWS).clamp(ROWS, extent.height.next_multiple_of(ROWS))
}

fn of_rows(width: u32, height: u32) -> TileStats {
    TileStats { stats: STATS, dst: STRIP_TILES, runs: STRIP_RUNS, width, height }
}

impl WholeStatistics {
    /// Finds them; `exposure`: the factor on the colour, else the frame's own. After every strip, `tell` hears which
    /// share is done; its error ends it there.
    pub fn of(
        engine: &Engine,
        frame: &Frame,
        exposure: Option<f32>,
        tell: &mut dyn FnMut(f64) -> Result<()>,
    ) -> Result<Self> {
        let mut maker = Maker::new(engine, frame, exposure)?;
        let Extent { width, height } = frame.extent;
        let strips = height.div_ceil(maker.rows);
        let mut done = 0;
        let mut strip_done = || {
            done += 1;
            tell(f64::from(done) / f64::from(2 * strips))
        };
        let clear = |histogram| Call::StatsClear(Clear { histogram });
        maker.run(&[clear(LUMINANCES), clear(DEPTHS)], &[])?;
        for top in (0..height).step_by(maker.rows as usize) {
            let rows = maker.rows.min(height - top);
            maker.stage(top, rows);
            let count =
                |histogram, counted| Call::StatsHistogram(Histogram { histogram, counted, width, height: rows });
            let counts = [count(LUMINANCES, Counted::Luminance), count(DEPTHS, Counted::Depth)];
            maker.run(if frame.features.depth.is_some() { &counts } else { &counts[..1] }, &[])?;
            strip_done()?;
        }
        let select = |histogram, counted, dst| Call::StatsSelect(Select { histogram, counted, dst });
        maker
            .run(&[select(LUMINANCES, Counted::Luminance, STATS), select(DEPTHS, Counted::Depth, DEPTH_SCALE)], &[])?;
        for top in (0..height).step_by(maker.rows as usize) {
            maker.tiles(top)?;
            strip_done()?;
        }
        maker.finish()
    }
}

/// The buffers, and what runs over them.
struct Maker<'a> {
    // Before the buffers that it uses.
    submission: Submission,
    engine: &'a Engine,
    frame: &'a Frame<'a>,
    exposure: Option<f32>,
    /// By identifier.
    buffers: Vec<Buffer>,
    planes: Buffer,
    table: PlaneTable,
    told: Buffer,
    rows: u32,
}

impl<'a> Maker<'a> {
    fn new(engine: &'a Engine, frame: &'a Frame<'a>, exposure: Option<f32>) -> Result<Self> {
        let device = &engine.device;
        let Extent { width, height } = frame.extent;
        let rows = rows(engine, frame.extent);
        let most = (rows + ROWS + BELOW).min(height);
        let (strip, all) = (of_rows(width, most), of_rows(width, height));
        let sizes = [
            ("statistics", STATS_FLOATS * 4),
            ("depth scale", 4),
            ("luminances", HISTOGRAM_BYTES),
            ("depths", HISTOGRAM_BYTES),
            ("tiles", all.tile_bytes()),
            ("runs", all.run_bytes()),
            ("tiles of a strip", strip.tile_bytes()),
            ("runs of a strip", strip.run_bytes()),
        ];
        let make = |(name, bytes)| Buffer::new(device, name, bytes, MemoryLocation::GpuOnly);
        let pixels = u64::from(width) * u64::from(most);
        let planes = Buffer::new(device, "strip", pixels * PIXEL_FLOATS * 4, MemoryLocation::CpuToGpu)?;
        let plane = |first: u64, channels: u32| PlaneArgs {
            address: planes.address() + 4 * first * pixels,
            pixel: channels,
            row: channels * width,
            channel: 1,
            format: Format::F32,
            ..PlaneArgs::default()
        };
        let mut table = Planes::default();
        table[Role::Color] = plane(0, 3);
        if frame.features.depth.is_some() {
            table[Role::Depth] = plane(3, 1);
        }
        let told = STATS_FLOATS * 4 + 4 + all.tile_bytes();
        Ok(Self {
            exposure,
            submission: Submission::new(device)?,
            buffers: sizes.into_iter().map(make).collect::<Result<_>>()?,
            told: Buffer::new(device, "statistics read", told, MemoryLocation::GpuToCpu)?,
            engine,
            frame,
            table: PlaneTable::new(device, &table, &[], None)?,
            planes,
            rows,
        })
    }

    /// Copies rows of colour and depth.
    fn stage(&mut self, top: u32, rows: u32) {
        let extent = Extent::new(self.frame.extent.width, rows);
        let all = self.planes.size() as usize / (4 * PIXEL_FLOATS as usize);
        let pixels = extent.pixels() as usize;
        let part = |plane: &Plane<'a>| plane.part(0, top);
        let floats: &mut [f32] = bytemuck::cast_slice_mut(self.planes.bytes_mut());
        part(&self.frame.color).pack(extent, 3, &mut floats[..3 * pixels]);
        if let Some(depth) = &self.frame.features.depth {
            part(depth).pack_as(Role::Depth, extent, &mut floats[3 * all..][..pixels]);
        }
    }

    /// What is known of the tiles of a strip, looked at with the rows beside it.
    fn tiles(&mut self, top: u32) -> Result<()> {
        let Extent { width, height } = self.frame.extent;
        let (first, end) = (top.saturating_sub(ROWS), (top + self.rows).min(height));
        let rows = (end + BELOW).min(height) - first;
        self.stage(first, rows);
        let columns = u64::from(width.div_ceil(TILE));
        let before = |row: u32| u64::from(row.div_ceil(TILE)) * columns;
        let (skipped, count, at) = (before(top - first), before(end) - before(top), before(top));
        let copy = |unit: u64, of: fn(u64) -> u64| vk::BufferCopy {
            src_offset: unit * of(skipped),
            dst_offset: unit * of(at),
            size: unit * of(count),
        };
        let runs: fn(u64) -> u64 = |tiles| tiles.div_ceil(u64::from(RUN_TILES));
        let copies = [
            (STRIP_TILES, TILES, copy(4 * TILE_WORDS, |tiles| tiles)),
            (STRIP_RUNS, RUNS, copy(4 * crate::kernels::stats::RUN_FLOATS, runs)),
        ];
        self.run(&[Call::StatsTiles(of_rows(width, rows))], &copies)
    }

    /// Key and what hangs on it, and everything back on the host.
    fn finish(mut self) -> Result<WholeStatistics> {
        let Extent { width, height } = self.frame.extent;
        let all = TileStats { dst: TILES, runs: RUNS, ..of_rows(width, height) };
        self.run(&[Call::StatsKey(all.key(DEPTH_SCALE))], &[])?;
        let Self { submission, engine, buffers, told, .. } = &mut self;
        let device = &engine.device;
        submission.record(|commands| {
            let written = (vk::PipelineStageFlags::COMPUTE_SHADER, vk::AccessFlags::SHADER_WRITE);
            let copied = (vk::PipelineStageFlags::TRANSFER, vk::AccessFlags::TRANSFER_WRITE);
            let mut dst_offset = 0;
            // SAFETY: the command buffer is ours, the buffers live in `self`, and `run` waits.
            unsafe {
                barrier(device, commands, written, (vk::PipelineStageFlags::TRANSFER, vk::AccessFlags::TRANSFER_READ));
                for id in [STATS, DEPTH_SCALE, TILES] {
                    let from = &buffers[id.0];
                    let copy = vk::BufferCopy { src_offset: 0, dst_offset, size: from.size() };
                    device.raw().cmd_copy_buffer(commands, from.raw(), told.raw(), &[copy]);
                    dst_offset += from.size();
                }
                barrier(device, commands, copied, (vk::PipelineStageFlags::HOST, vk::AccessFlags::HOST_READ));
            }
            Ok(())
        })?;
        submission.run()?;
        let floats: &[f32] = bytemuck::cast_slice(told.bytes());
        let (stats, rest) = floats.split_at(STATS_FLOATS as usize);
        Ok(WholeStatistics {
            stats: stats.to_vec(),
            depth_scale: rest[0],
            tile_stats: bytemuck::cast_slice(&rest[1..]).to_vec(),
        })
    }

    /// Runs calls one after another, then copies, and waits.
    fn run(&mut self, calls: &[Call], copies: &[(BufferId, BufferId, vk::BufferCopy)]) -> Result<()> {
        let Self { submission, engine, exposure, table, buffers, .. } = self;
        let (device, target) = (&engine.device, engine.target.kernels);
        let dispatch = |call: &Call| Dispatch::new("statistics", Stage::Input, 0, call.clone(), target);
        let mut dispatches: Vec<Dispatch> = calls.iter().map(dispatch).collect();
        dispatches.iter_mut().for_each(|dispatch| dispatch.barrier = true);
        let pipelines = pipelines::for_dispatches(device, &dispatches)?;
        let whole = |id: BufferId| (buffers[id.0].raw(), 0, buffers[id.0].size());
        let resources = Resources { images: None, texels: &|range| whole(range.buffer) };
        // SAFETY: the buffers live in `self`, and `run` waits.
        let sets = unsafe { DescriptorSets::new(device, &dispatches, &pipelines, &resources)? };
        let frame = FrameArgs { planes: table.upright().address, exposure: *exposure, ..FrameArgs::default() };
        let recording = Recording {
            device,
            addresses: Addresses { buffer: &|id| buffers[id.0].address(), frame },
            buffers: &|id| (buffers[id.0].raw(), 0),
            pipelines: &pipelines,
            sets: &sets,
            signals: &[],
            turned: None,
            labels: &[],
            timestamps: None,
        };
        let compute = (vk::PipelineStageFlags::COMPUTE_SHADER, vk::AccessFlags::SHADER_WRITE);
        let transfer = vk::PipelineStageFlags::TRANSFER;
        let both = vk::AccessFlags::SHADER_READ | vk::AccessFlags::SHADER_WRITE;
        submission.record(|commands| {
            // SAFETY: the command buffer is ours, the buffers live in `self`, and `run` waits.
            unsafe {
                recording.record(commands, &dispatches, 0..dispatches.len());
                barrier(device, commands, compute, (transfer, vk::AccessFlags::TRANSFER_READ));
                for (from, to, copy) in copies {
                    let [from, to] = [from, to].map(|id| buffers[id.0].raw());
                    device.raw().cmd_copy_buffer(commands, from, to, &[*copy]);
                }
                let read = (vk::PipelineStageFlags::COMPUTE_SHADER, both);
                barrier(device, commands, (transfer, vk::AccessFlags::TRANSFER_WRITE), read);
            }
            Ok(())
        })?;
        submission.run().map(|_| ())
    }
}
