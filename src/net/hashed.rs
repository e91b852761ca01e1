//! Random test weights made from a seed, the same as the training kit's (`tools/train/vkdn/hashweights.py`, which says
//! why the numbers are what they are): a test can compare with PyTorch without a file of weights.

use half::f16;

use super::arch::Arch;
use super::graph::{Graph, TensorSpec};
use super::weights::{Preprocessing, Tensor, Weights, WeightsError};

impl Weights {
    /// Noise that follows from `seed`: every value is one of half precision, and every branch of every block matters to
    /// the result. For tests.
    ///
    /// # Errors
    /// [`WeightsError::Arch`] for an impossible architecture.
    #[cfg_attr(not(feature = "internals"), doc(hidden))]
    pub fn hashed(arch: &Arch, preprocessing: Preprocessing, seed: u64) -> Result<Weights, WeightsError> {
        let tensors = Graph::new(arch)?.tensors().into_iter().map(|spec| {
            let data = values(&spec, seed);
            (spec.name, Tensor { shape: spec.shape, data })
        });
        Weights::from_parts(arch.clone(), preprocessing, tensors.collect())
    }
}

fn values(spec: &TensorSpec, seed: u64) -> Vec<f32> {
    let (offset, scale) = spread(spec);
    let start = fnv1a64(&spec.name) ^ seed.wrapping_mul(0xD1B5_4A32_D192_ED03);
    let value = |i| f16::from_f32((offset + scale * uniform(start, i)) as f32).to_f32();
    (0..spec.elements()).map(value).collect()
}

/// Offset and scale of a tensor's values.
fn spread(spec: &TensorSpec) -> (f64, f64) {
    let mut parts = spec.name.rsplit('.');
    let (last, owner) = (parts.next().unwrap_or_default(), parts.next().unwrap_or_default());
    match (owner, last) {
        (_, "bias_table") => (0.0, 2.0),
        ("norm1" | "norm1_f" | "norm2", "weight") => (1.0, 0.5),
        ("norm1" | "norm1_f" | "norm2", _) => (0.0, 0.5),
        (_, "bias") => (0.0, 0.3),
        _ => {
            let fan_in: u32 = spec.shape.iter().skip(1).product();
            let gain = match (spec.name.split('.').next().unwrap_or_default(), owner) {
                ("down" | "up" | "skip", _) => 0.7,
                (_, "q" | "k" | "qf" | "kf") => 1.2,
                (_, "v") => 7.0,
                (_, "proj") => 0.35,
                (_, "contract") => 1.5,
                _ => 1.0,
            };
            (0.0, gain * (3.0 / f64::from(fan_in)).sqrt())
        }
    }
}

fn fnv1a64(name: &str) -> u64 {
    name.bytes().fold(0xCBF2_9CE4_8422_2325, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x100_0000_01B3))
}

/// In [-1, 1): output `i` of a SplitMix64 generator.
fn uniform(start: u64, i: u64) -> f64 {
    let z = start.wrapping_add((i + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15));
    let z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    let z = z ^ (z >> 31);
    (z >> 40) as f64 / f64::from(1 << 23) - 1.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::net::weights::{DepthRule, ExposureRule};

    const SEED: u64 = 7;

    fn hybrid() -> (Graph, Weights) {
        let preprocessing = Preprocessing {
            exposure: ExposureRule::Auto,
            depth: DepthRule::Percentile,
            version: Preprocessing::VERSION,
        };
        let arch = Arch::hybrid();
        (Graph::new(&arch).unwrap(), Weights::hashed(&arch, preprocessing, SEED).unwrap())
    }

    /// The first values of one tensor for each rule, as Python prints them.
    #[test]
    fn first_values_are_those_of_python() {
        let (_, weights) = hybrid();
        let rows = [
            ("enc.1.0.bias_table", [-1.11328125, -0.6416015625, -0.5732421875]),
            ("dec.0.0.norm1_f.weight", [0.9033203125, 1.2890625, 0.66650390625]),
            ("bottleneck.1.norm2.bias", [-0.10333251953125, -0.200439453125, 0.0109100341796875]),
            ("output.bias", [-0.0819091796875, 0.0848388671875, 0.264404296875]),
            ("down.2.weight", [-0.02984619140625, -0.00936126708984375, 0.0340576171875]),
            ("skip.1.weight", [0.07476806640625, 0.055816650390625, 0.048126220703125]),
            ("enc.2.3.v.weight", [1.615234375, 2.00390625, -1.9609375]),
            ("enc.2.3.proj.weight", [-0.0219268798828125, 0.01264190673828125, 0.01206207275390625]),
            ("dec.2.1.ffn.contract.weight", [0.035797119140625, 0.0027599334716796875, 0.0533447265625]),
            ("aux_proj.0.depthwise.weight", [0.1414794921875, 0.325927734375, -0.08770751953125]),
            ("enc.0.0.film.weight", [0.0645751953125, -0.1566162109375, 0.241943359375]),
        ];
        for (name, expected) in rows {
            let found: Vec<f64> = weights.tensor(name).unwrap().data[..3].iter().map(|&v| v.into()).collect();
            assert_eq!(found, expected, "{name}");
        }
    }

    /// The sum of every value's bits times its position in its tensor (from 1), as Python computes it.
    #[test]
    fn all_values_are_those_of_python() {
        let (graph, weights) = hybrid();
        let mut sum = 0u64;
        for spec in graph.tensors() {
            for (position, value) in (1u64..).zip(&weights.tensor(&spec.name).unwrap().data) {
                sum = sum.wrapping_add(u64::from(value.to_bits()).wrapping_mul(position));
            }
        }
        assert_eq!(sum, 0x9171_16C5_ED8B_6000);
    }
}
