//! Plans of whole frames and of networks' parts.

use super::arena::Limits;
use super::lower::Lowering;
use super::packing::Packing;
use super::steps::{Steps, packing};
use super::{Plan, ensemble};
use crate::error::{Error, Result};
use crate::frame::Extent;
use crate::kernels::ensemble::Member;
use crate::net::graph::Graph;
use crate::target::Target;

/// Pixels on a side that coordinates of tiles (16 bits) and strides (32 bits) hold with room to spare.
const MAX_SIDE: u32 = 1 << 18;

/// The networks of a pass.
#[derive(Clone, Copy, Debug)]
pub struct Networks<'a> {
    /// Of the frame.
    pub own: &'a Graph,
    /// Of the turned frame, where there is an ensemble; `None`: the same.
    pub turned: Option<&'a Graph>,
}

impl<'a> From<&'a Graph> for Networks<'a> {
    fn from(own: &'a Graph) -> Self {
        Self { own, turned: None }
    }
}

/// Plans one forward pass over a frame of `extent`.
///
/// # Errors
/// [`Error::EmptyFrame`]; [`Error::FrameTooLarge`] where a map exceeds `max_block_bytes` or a side 262144 pixels.
pub fn plan<'a>(networks: impl Into<Networks<'a>>, extent: Extent, options: &Target) -> Result<Plan> {
    let planned = of_frame(networks.into(), extent, options, Limits::Each(options.max_block_bytes))?;
    planned.map_err(|bytes| map_too_large(extent, bytes, options))
}

/// The same in an arena that is there, with blocks of so many bytes. A frame's own blocks, or larger ones, hold it.
///
/// # Errors
/// As [`plan`]; [`Error::FrameTooLarge`] where the maps do not fit the blocks.
pub fn plan_in<'a>(
    networks: impl Into<Networks<'a>>,
    extent: Extent,
    options: &Target,
    blocks: &[u64],
) -> Result<Plan> {
    let planned = of_frame(networks.into(), extent, options, Limits::Given(blocks, options.max_block_bytes))?;
    planned.map_err(|bytes| {
        let reason = format!(
            "its maps do not fit an arena with blocks of {blocks:?} bytes (there is no room for one of {bytes}): make \
             the arena for this size too (Denoiser::arena_required)"
        );
        Error::FrameTooLarge { width: extent.width, height: extent.height, reason }
    })
}

/// Fails within with the size of a map that no block holds.
fn of_frame(networks: Networks, extent: Extent, options: &Target, arena: Limits) -> Result<Result<Plan, u64>> {
    let own = Chosen::new(networks.own, extent, options, Packing::default())?;
    let Some(turned) = networks.turned.filter(|_| options.self_ensemble) else {
        let steps = Steps::new(&own.graph, options, false, own.packing);
        let mut lowering = Lowering::new(&steps, extent, own.padded);
        lowering.member = options.self_ensemble.then_some(Member::Upright);
        lowering.frame();
        return Ok(lowering.finish(None, &[], arena));
    };
    let of_own = packing(networks.own, options);
    let turned = Chosen::new(turned, extent, options, Packing::after(&of_own))?;
    let steps = Steps::new(&turned.graph, options, false, turned.packing);
    let mut lowering = Lowering::new(&steps, extent, turned.padded);
    lowering.member = Some(Member::Turned);
    lowering.frame();
    let result = lowering.turned_result();
    let lists = lowering.lists().lists;
    let mut before = lowering.buffers;
    ensemble::of_turned(&mut before);
    let bytes = steps.packing.bytes();

    let steps = Steps::among(before, &own.graph, options, false, own.packing);
    let mut lowering = Lowering::new(&steps, extent, own.padded);
    (lowering.member, lowering.turned_result) = (Some(Member::Upright), Some(result));
    lowering.frame();
    let planned = lowering.finish(Some(lists), &[], arena);
    Ok(planned.map(|plan| Plan { weights_bytes: bytes, ..plan }))
}

/// How a network is lowered for a frame.
struct Chosen {
    graph: Graph,
    padded: Extent,
    /// Where its weights lie at every size.
    packing: Packing,
}

impl Chosen {
    /// `packing`: where the weights begin, with nothing in it yet.
    fn new(graph: &Graph, extent: Extent, options: &Target, packing: Packing) -> Result<Self> {
        let (graph, padded) = (graph.folded(options.folds), padded(graph, extent)?);
        let Some(again) = rematerialized(&graph, padded, options) else { return Ok(Self { graph, padded, packing }) };
        let packing = Steps::new(&graph, options, false, packing).packing;
        Ok(Self { graph: again, padded, packing })
    }
}

/// Plans a graph's operations alone, without the frame around them: the caller fills [`Plan::log_color`] and
/// [`Plan::aux`] and reads [`Plan::residual`], which keep their places throughout.
///
/// # Errors
/// As [`plan`].
pub fn plan_part(graph: &Graph, extent: Extent, options: &Target) -> Result<Plan> {
    let graph = graph.folded(options.folds);
    let steps = Steps::new(&graph, options, true, Packing::default());
    let mut lowering = Lowering::new(&steps, extent, padded(&graph, extent)?);
    let kept = [graph.color, graph.aux, graph.residual].map(|value| lowering.whole(value).buffer);
    lowering.ops();
    lowering
        .finish(None, &kept, Limits::Each(options.max_block_bytes))
        .map_err(|bytes| map_too_large(extent, bytes, options))
}

/// The graph without the map that it keeps for predicted kernels, where that takes more than it may, and where it would
/// be made in bands: neither lists of tiles nor what is kept for the next frame are.
fn rematerialized(graph: &Graph, padded: Extent, options: &Target) -> Option<Graph> {
    if options.converged.is_some() || options.keep_features {
        return None;
    }
    let channels = graph.whole(graph.kept_for_kernels()?).channels;
    let bytes = padded.pixels() * u64::from(channels) * options.storage.bytes();
    if bytes > options.max_kept_bytes { graph.rematerialized() } else { None }
}

/// The size that the network works on.
fn padded(graph: &Graph, extent: Extent) -> Result<Extent> {
    extent.check()?;
    let multiple = graph.arch.pad_multiple();
    if extent.width.max(extent.height) > MAX_SIDE - multiple {
        let reason = format!("sides of more than {} pixels are not supported", MAX_SIDE - multiple);
        return Err(Error::FrameTooLarge { width: extent.width, height: extent.height, reason });
    }
    Ok(Extent::new(extent.width.next_multiple_of(multiple), extent.height.next_multiple_of(multiple)))
}

fn map_too_large(extent: Extent, bytes: u64, options: &Target) -> Error {
    let limit = options.max_block_bytes;
    let reason = format!("one feature map takes {bytes} bytes, and the device allocates at most {limit} at once");
    Error::FrameTooLarge { width: extent.width, height: extent.height, reason }
}
