//! What is made early and read late as made again right before it is read: more work, and a map less that all of the
//! network has to keep (rematerialization: Briggs, Cooper and Torczon, 1992).

use super::graph::Graph;
use super::op::{Op, OpKind, Shape, Stage, Value, ValueId};
use std::collections::HashMap;

impl Graph {
    /// The map at full size that is kept for predicted kernels from before the first block to after the last one.
    pub fn kept_for_kernels(&self) -> Option<ValueId> {
        self.ops.iter().find_map(|op| match &op.kind {
            OpKind::KernelInputs { early, .. } => Some(early.value),
            _ => None,
        })
    }

    /// The same network in which that map is made of the network's inputs once more where it is read. `None` where
    /// there is no such map.
    pub fn rematerialized(&self) -> Option<Self> {
        let kept = self.kept_for_kernels()?;
        let reader = self.ops.iter().position(|op| matches!(op.kind, OpKind::KernelInputs { .. }))?;
        let (mut wanted, mut again) = (vec![kept], Vec::new());
        for op in self.ops[..reader].iter().rev() {
            if wanted.contains(&self.result(op).value) {
                wanted.extend(self.reads(op).iter().map(|slice| slice.value));
                again.push(op.clone());
            }
        }
        again.reverse();
        let mut graph = self.clone();
        let mut made: HashMap<ValueId, ValueId> = HashMap::new();
        for op in &mut again {
            let result = self.result(op).value;
            if !matches!(self.value(result).shape, Shape::Map { stride: 1, .. }) {
                return None;
            }
            let Value { name, shape } = self.value(result);
            graph.values.push(Value { name: format!("{name}.again"), shape: *shape });
            made.insert(result, ValueId(graph.values.len() - 1));
            op.name.push_str(".again");
            op.stage = Stage::Output;
            values_mut(op)?.into_iter().for_each(|value| *value = *made.get(value).unwrap_or(value));
        }
        // A sum takes the place of what it adds to.
        if let Some(Op { kind: OpKind::Linear { residual: Some(residual), output, .. }, .. }) = again.last_mut() {
            output.value = residual.value;
            made.insert(kept, residual.value);
        }
        let OpKind::KernelInputs { early, .. } = &mut graph.ops[reader].kind else { return None };
        early.value = *made.get(&kept)?;
        graph.ops.splice(reader..reader, again);
        graph.drop_dead();
        Some(graph)
    }

    /// Drops operations whose results nothing reads.
    fn drop_dead(&mut self) {
        while let Some(at) = self.ops.iter().position(|op| {
            let mut results = self.writes(op).into_iter().map(|slice| slice.value);
            results.all(|value| value != self.residual && !self.is_read(value))
        }) {
            self.ops.remove(at);
        }
    }

    fn is_read(&self, value: ValueId) -> bool {
        self.ops.iter().any(|op| self.reads(op).iter().any(|slice| slice.value == value))
    }
}

/// The maps of an operation that projects the network's inputs; `None` for others.
fn values_mut(op: &mut Op) -> Option<Vec<&mut ValueId>> {
    match &mut op.kind {
        OpKind::Conv3x3 { input, film: None, residual, output, .. } => {
            Some([input, output].into_iter().chain(residual).map(|slice| &mut slice.value).collect())
        }
        OpKind::Linear { inputs, film: None, residual, output, .. } => {
            Some(inputs.iter_mut().chain(residual).chain([output]).map(|slice| &mut slice.value).collect())
        }
        OpKind::Depthwise3x3 { input, output, .. } => Some(vec![&mut input.value, output]),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::net::arch::Arch;
    use crate::net::cost::op_flops;
    use crate::net::head::Head;

    #[test]
    fn the_projections_are_made_twice_and_nothing_else() {
        let graph = Graph::new(&Arch { head: Head::pure(), ..Arch::hybrid() }).unwrap();
        let again = graph.rematerialized().unwrap();
        let of = |graph: &Graph, counts: fn(&str) -> bool| -> u64 {
            let counted = graph.ops.iter().filter(|op| counts(&op.name));
            counted.map(|op| op_flops(graph, op, 256, 256).total()).sum()
        };
        let made = of(&again, |name| name.ends_with(".again"));
        assert!(made > 0);
        assert_eq!(of(&again, |_| true) - made, of(&graph, |name| !["head.f0", "head.x0"].contains(&name)));
        let names = |graph: &Graph| {
            let mut names: Vec<_> = graph.tensors().into_iter().map(|tensor| tensor.name).collect();
            names.sort();
            names
        };
        assert_eq!(names(&again), names(&graph));
        let reader = again.ops.iter().position(|op| matches!(op.kind, OpKind::KernelInputs { .. })).unwrap();
        assert!(again.ops[..reader].iter().rev().take(9 + 3).all(|op| op.name.ends_with(".again")));
        assert_eq!(Graph::new(&Arch::hybrid()).unwrap().rematerialized(), None);
    }
}
