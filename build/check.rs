//! Compares what a compiled shader declares with its contract.

use crate::kernels::contract::{BindingType, Contract, FieldType};
use spirq::ReflectConfig;
use spirq::ty::{DescriptorType, ScalarType, Type};
use spirq::var::Variable;

/// Refuses a shader whose push constants, descriptors or specialisation constants are not those of the contract.
///
/// # Errors
/// A message that names both sides.
pub fn check(contract: &Contract, words: &[u32]) -> Result<(), String> {
    let entry_points = ReflectConfig::new()
        .spv(without_matrices(words))
        .ref_all_rscs(true)
        .reflect()
        .map_err(|e| format!("variant {}: reflection failed: {e}", contract.name))?;
    let entry = entry_points.first().ok_or_else(|| format!("variant {}: no entry point", contract.name))?;

    let (mut push, mut bindings, mut constants) = (Vec::new(), Vec::new(), Vec::new());
    for variable in &entry.vars {
        match variable {
            Variable::PushConstant { ty, .. } => push.extend(members(ty)),
            Variable::Descriptor { name, desc_bind, desc_ty, .. } => {
                let name = name.clone().unwrap_or_default();
                bindings.push((desc_bind.set(), desc_bind.bind(), describe(desc_ty), name));
            }
            // One without a name stands behind `local_size_x_id`, beside the named one of its number.
            Variable::SpecConstant { name: Some(name), spec_id, .. } if !name.is_empty() => {
                constants.push((*spec_id, name.clone()));
            }
            _ => {}
        }
    }
    push.sort();
    bindings.sort();
    constants.sort();

    let mut offset = 0;
    let mut wanted_push = Vec::new();
    for field in contract.push {
        let ty = match field.ty {
            FieldType::Address => "address",
            FieldType::U32 => "uint",
            FieldType::F32 => "float",
        };
        wanted_push.push((offset, ty.to_owned(), field.name.to_owned()));
        offset += field.ty.size() as usize;
    }
    let binding = |ty| match ty {
        BindingType::SampledImage => "sampled image",
        BindingType::StorageImage => "storage image",
        BindingType::TexelBuffer => "texel buffer",
    };
    let wanted_bindings: Vec<_> =
        (0..).zip(contract.bindings).map(|(at, b)| (0, at, binding(b.ty).to_owned(), b.name.to_owned())).collect();
    let wanted_constants: Vec<_> = (0..).zip(contract.constants).map(|(id, c)| (id, c.name.to_owned())).collect();
    compare(contract, "push constants (offset, type, name)", &push, &wanted_push)?;
    compare(contract, "descriptors (set, binding, type, name)", &bindings, &wanted_bindings)?;
    compare(contract, "specialisation constants (id, name)", &constants, &wanted_constants)
}

const OP_TYPE_BOOL: u32 = 20;
const OP_TYPE_VECTOR: u32 = 23;
const OP_CONSTANT_TRUE: u32 = 41;
const OP_CONSTANT: u32 = 43;
const OP_SPEC_CONSTANT_OP: u32 = 52;
const OP_TYPE_COOPERATIVE_MATRIX: u32 = 4456;
/// Words before the first instruction.
const HEADER: usize = 5;

/// The module with cooperative matrices declared as vectors, and every size that is computed of specialisation constants as
/// any number: the reflection knows no matrices and computes little, and looks only at what lies outside of the functions that use
/// them.
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

fn compare<T: PartialEq + std::fmt::Debug>(
    contract: &Contract,
    what: &str,
    shader: &[T],
    wanted: &[T],
) -> Result<(), String> {
    if shader == wanted {
        return Ok(());
    }
    Err(format!(
        "variant {}: {what} differ:\n  glsl/{}: {shader:?}\n  src/kernels/contracts.rs: {wanted:?}",
        contract.name, contract.source
    ))
}

fn members(ty: &Type) -> Vec<(usize, String, String)> {
    let Type::Struct(block) = ty else { return vec![(0, format!("{ty:?}"), String::new())] };
    block
        .members
        .iter()
        .map(|member| {
            let ty = match &member.ty {
                Type::DevicePointer(_) | Type::DeviceAddress(_) => "address".to_owned(),
                Type::Scalar(ScalarType::Integer { bits: 32, is_signed: false }) => "uint".to_owned(),
                Type::Scalar(ScalarType::Float { bits: 32, .. }) => "float".to_owned(),
                other => format!("{other:?}"),
            };
            (member.offset.unwrap_or(usize::MAX), ty, member.name.clone().unwrap_or_default())
        })
        .collect()
}

fn describe(ty: &DescriptorType) -> String {
    match ty {
        DescriptorType::SampledImage() => "sampled image".to_owned(),
        DescriptorType::StorageImage(_) => "storage image".to_owned(),
        DescriptorType::UniformTexelBuffer() => "texel buffer".to_owned(),
        other => format!("{other:?}"),
    }
}
