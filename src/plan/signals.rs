//! What signals beside the colour take of a plan: the kernels' application once more, over a signal in the place of
//! the colour. It is recorded for one signal after the other, so that all of them share its memory.

use super::lower::Lowering;
use crate::frame::Region;
use crate::kernels::signals::{InputSignal, OutputSignal};
use crate::kernels::{Call, Storage, Tiles, View};
use crate::net::op::Stage;
use std::collections::HashMap;

impl Lowering<'_> {
    /// Adds the dispatches of a signal, where they are asked for and there are predicted kernels. They come before
    /// the colour's output: that may go where the colour came from.
    pub(super) fn signals(&mut self) {
        if !self.options.signals {
            return;
        }
        let applied = |call: &Call| {
            matches!(call, Call::PredictKernels(_) | Call::Halve(_) | Call::ApplyKernels(_) | Call::MixLevels(_))
        };
        let head: Vec<_> = self.dispatches.iter().filter(|dispatch| applied(&dispatch.call)).cloned().collect();
        let taps = self.dispatches.iter().find_map(|dispatch| match &dispatch.call {
            Call::KernelInputs(inputs) => Some((inputs.taps, inputs.albedo)),
            _ => None,
        });
        let Some(views) = taps else { return };
        // Of the whole frame, where the kernels' inputs are made in bands.
        let (height, top) = (self.padded.height, 0);
        let (taps, albedo) = (View { height, top, ..views.0 }, View { height, top, ..views.1 });
        let first = self.dispatches.len();
        let (width, height) = (self.extent.width, self.extent.height);
        let dst = View { channels: 8, stride: 8, ..taps };
        let buffer = self.scratch("signal.input", dst.bytes(), Storage::F32);
        let (stats, tile_stats, dst) = (self.stats, self.tile_stats, View { buffer, ..dst });
        let input = InputSignal { stats, tile_stats, taps, albedo, dst, width, height, tiles: Tiles::All };
        let mut filtered = input.image();
        // What a map of the colour is of a signal.
        let mut maps = HashMap::from([(taps.buffer, filtered)]);
        self.push("signal.input", Stage::Input, 0, Call::InputSignal(input));
        for mut dispatch in head {
            let name = format!("signal.{}", dispatch.name);
            dispatch.call.kernel_mut().maps(&mut |view, access| {
                if access.writes() {
                    let own = View { buffer: self.scratch(&name, view.bytes(), view.storage), ..*view };
                    maps.insert(view.buffer, own);
                    filtered = own;
                }
                *view = maps.get(&view.buffer).copied().unwrap_or(*view);
            });
            if let Call::PredictKernels(predict) = &mut dispatch.call {
                predict.of_signal = true;
            }
            self.push(&name, dispatch.stage, dispatch.flops, dispatch.call);
        }
        let color = self.whole(self.graph.residual);
        let Some(gains) = self.gains() else { return };
        let output = OutputSignal {
            filtered,
            color,
            gains,
            input: dst,
            stats,
            width,
            height,
            tiles: Tiles::All,
            region: Region::all(self.extent),
            converged: None,
            member: self.member,
        };
        self.push("signal.output", Stage::Output, 0, Call::OutputSignal(output));
        self.dispatches[first..].iter_mut().for_each(|dispatch| dispatch.of_signals = true);
    }
}
