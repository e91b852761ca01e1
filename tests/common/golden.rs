//! Golden vectors: what PyTorch computes, by `tools/train/vkdn/golden.py`.

use super::planes::{TestFrame, TestPlane};
use safetensors::{Dtype, SafeTensors};
use std::collections::HashMap;
use vkdenoise::frame::Extent;

/// A golden file: its tensors as 32-bit floats, and its metadata.
pub struct Golden {
    tensors: HashMap<String, (Vec<usize>, Vec<f32>)>,
    metadata: HashMap<String, String>,
}

impl Golden {
    /// Reads `<name>` in `tests/data`, or in the folder that `VKDENOISE_GOLDEN` names.
    pub fn read(name: &str) -> Self {
        let own = || format!("{}/tests/data", env!("CARGO_MANIFEST_DIR"));
        let path = format!("{}/{name}", std::env::var("VKDENOISE_GOLDEN").unwrap_or_else(|_| own()));
        let bytes = std::fs::read(&path).unwrap_or_else(|error| panic!("{path}: {error}"));
        let (_, header) = SafeTensors::read_metadata(&bytes).unwrap();
        let file = SafeTensors::deserialize(&bytes).unwrap();
        let tensors = file.tensors().into_iter().map(|(name, tensor)| {
            let data = tensor.data();
            let values = match tensor.dtype() {
                Dtype::F32 => data.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect(),
                Dtype::F16 => data.chunks_exact(2).map(|b| half::f16::from_le_bytes([b[0], b[1]]).to_f32()).collect(),
                other => panic!("{name} holds {other:?}"),
            };
            (name, (tensor.shape().to_vec(), values))
        });
        Self { tensors: tensors.collect(), metadata: header.metadata().clone().unwrap_or_default() }
    }

    /// A tensor `[height, width, channels]` or `[height, width]`.
    pub fn tensor(&self, name: &str) -> &[f32] {
        &self.tensors[name].1
    }

    /// Width and height of a tensor.
    pub fn extent(&self, name: &str) -> Extent {
        let shape = &self.tensors[name].0;
        Extent::new(shape[1] as u32, shape[0] as u32)
    }

    /// The planes of the crop that `prefix` names, as a frame.
    pub fn frame(&self, prefix: &str) -> TestFrame {
        let extent = self.extent(&format!("{prefix}color"));
        let plane = |name: &str, channels| {
            TestPlane::packed(extent, channels, self.tensor(&format!("{prefix}{name}")).to_vec())
        };
        TestFrame {
            extent,
            color: plane("color", 3),
            albedo: Some(plane("albedo", 3)),
            normal: Some(plane("normal", 3)),
            depth: Some(plane("depth", 1)),
        }
    }

    /// A number of the metadata.
    pub fn number(&self, name: &str) -> f64 {
        self.metadata[name].parse().unwrap()
    }
}
