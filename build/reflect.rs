//! What a compiled shader declares.

use crate::kernels::contract::Contract;
use spirq::ReflectConfig;
use spirq::ty::{DescriptorType, ScalarType, Type};
use spirq::var::Variable;

/// Push constants and descriptors of a variant.
#[derive(Clone)]
pub struct Interface {
    /// Name and Rust type of every push constant, in order, without gaps between them.
    pub push: Vec<(String, &'static str)>,
    /// Name and variant of `BindingType` of every descriptor of set 0, in the order of their numbers, from 0 on.
    pub bindings: Vec<(String, &'static str)>,
}

impl Interface {
    /// Reads them off a module that has its names.
    ///
    /// # Errors
    /// Where the host cannot give what the shader declares, or its specialisation constants are not those of the
    /// contract.
    pub fn new(contract: &Contract, words: &[u32]) -> Result<Self, String> {
        let refused = |reason: String| format!("variant {} (glsl/{}): {reason}", contract.name, contract.source);
        let entry_points = ReflectConfig::new()
            .spv(without_matrices(words))
            .ref_all_rscs(true)
            .reflect()
            .map_err(|e| refused(format!("reflection failed: {e}")))?;
        let entry = entry_points.first().ok_or_else(|| refused("no entry point".into()))?;
        let (mut push, mut bindings, mut constants) = (Vec::new(), Vec::new(), Vec::new());
        for variable in &entry.vars {
            match variable {
                Variable::PushConstant { ty, .. } => push = members(ty).map_err(refused)?,
                Variable::Descriptor { name, desc_bind, desc_ty, .. } => {
                    let place = (desc_bind.set(), desc_bind.bind());
                    bindings.push((place, name.clone().unwrap_or_default(), describe(desc_ty).map_err(refused)?));
                }
                // One without a name stands behind `local_size_x_id`, beside the named one of its number.
                Variable::SpecConstant { name: Some(name), spec_id, .. } if !name.is_empty() => {
                    constants.push((*spec_id, name.clone()));
                }
                _ => {}
            }
        }
        bindings.sort();
        constants.sort();
        if let Some((at, (place, name, _))) = (0..).zip(&bindings).find(|(at, (place, ..))| *place != (0, *at)) {
            return Err(refused(format!("{name} is descriptor {place:?} (set, binding), not (0, {at})")));
        }
        let wanted: Vec<_> = (0..).zip(contract.constants).map(|(id, c)| (id, c.name.to_owned())).collect();
        if constants != wanted {
            return Err(refused(format!("its specialisation constants are {constants:?}, the contract's {wanted:?}")));
        }
        Ok(Self { push, bindings: bindings.into_iter().map(|(_, name, ty)| (name, ty)).collect() })
    }

    /// Bytes of the push constants.
    pub fn push_bytes(&self) -> usize {
        self.push.iter().map(|(_, ty)| size(ty)).sum()
    }
}

fn size(ty: &str) -> usize {
    if ty == "u64" { 8 } else { 4 }
}

const OP_TYPE_BOOL: u32 = 20;
const OP_TYPE_VECTOR: u32 = 23;
const OP_CONSTANT_TRUE: u32 = 41;
const OP_CONSTANT: u32 = 43;
const OP_SPEC_CONSTANT_OP: u32 = 52;
const OP_TYPE_COOPERATIVE_MATRIX: u32 = 4456;
/// Words before the first instruction.
const HEADER: usize = 5;

/// The module with cooperative matrices declared as vectors, and every size that is computed of specialisation
/// constants as any number: the reflection knows no matrices and computes little, and looks only at what lies outside
/// of the functions that use them.
fn without_matrices(words: &[u32]) -> Vec<u32> {
    let (header, mut rest) = words.split_at(HEADER.min(words.len()));
    let mut out = header.to_vec();
    let mut bool_type = None;
    while let Some(&first) = rest.first() {
        let (instruction, after) = rest.split_at((first >> 16).max(1).min(rest.len() as u32) as usize);
        match instruction {
            [_, result, component, ..] if first & 0xffff == OP_TYPE_COOPERATIVE_MATRIX => {
                out.extend([4 << 16 | OP_TYPE_VECTOR, *result, *component, 2]);
            }
            [_, ty, result, ..] if first & 0xffff == OP_SPEC_CONSTANT_OP => match bool_type == Some(*ty) {
                true => out.extend([3 << 16 | OP_CONSTANT_TRUE, *ty, *result]),
                false => out.extend([4 << 16 | OP_CONSTANT, *ty, *result, 1]),
            },
            [_, result] if first & 0xffff == OP_TYPE_BOOL => {
                bool_type = Some(*result);
                out.extend(instruction);
            }
            other => out.extend(other),
        }
        rest = after;
    }
    out
}

/// The members of a block.
fn members(ty: &Type) -> Result<Vec<(String, &'static str)>, String> {
    let Type::Struct(block) = ty else { return Err(format!("its push constants are {ty:?}, not a block")) };
    let mut end = 0;
    let mut found = Vec::new();
    for member in &block.members {
        let name = member.name.clone().unwrap_or_default();
        let ty = match &member.ty {
            Type::DevicePointer(_) | Type::DeviceAddress(_) => "u64",
            Type::Scalar(ScalarType::Integer { bits: 32, is_signed: false }) => "u32",
            Type::Scalar(ScalarType::Float { bits: 32, .. }) => "f32",
            other => return Err(format!("push constant {name} is {other:?}; it can be an address, a uint or a float")),
        };
        if member.offset != Some(end) {
            return Err(format!("push constant {name} does not follow the one before: addresses come first"));
        }
        end += size(ty);
        found.push((name, ty));
    }
    // A struct of addresses is a multiple of eight bytes long.
    match end % found.first().map_or(4, |(_, ty)| size(ty)) {
        0 => Ok(found),
        _ => Err("its push constants end in the middle of an address: add a uint".into()),
    }
}

fn describe(ty: &DescriptorType) -> Result<&'static str, String> {
    match ty {
        DescriptorType::SampledImage() => Ok("SampledImage"),
        DescriptorType::StorageImage(_) => Ok("StorageImage"),
        DescriptorType::UniformTexelBuffer() => Ok("TexelBuffer"),
        other => Err(format!("a descriptor is {other:?}; it can be a texture, an image or a texel buffer")),
    }
}
