//! Compiles every kernel variant of `src/kernels/contracts.rs` with shaderc, and reads off it what the host needs to
//! know.

use crate::cached::{Compiled, with_includes};
use crate::kernels::contract::{Contract, Module, Sharing};
use crate::kernels::contracts;
use crate::reflect::Interface;
use crate::write;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::hash::{Hash, Hasher};
use std::path::Path;

/// Writes `spirv.rs`, the modules with their interfaces, a file of words for each module, and `pushes.rs`, the push
/// constants.
///
/// # Errors
/// A shader that does not compile, or whose interface the host cannot meet; a file that cannot be written.
pub fn compile(out: &Path, compiled: &mut Compiled) -> Result<(), String> {
    let compiler = shaderc::Compiler::new().map_err(|e| format!("no shader compiler: {e}"))?;
    let mut modules = String::from("static MODULES: &[(&str, &[u32])] = &[\n");
    let mut interfaces = String::from("static INTERFACES: &[Interface] = &[\n");
    let mut pushes: BTreeMap<&str, (&Contract, Interface)> = BTreeMap::new();
    let mut hash = std::hash::DefaultHasher::new();
    for contract in contracts::ALL {
        let mut forms = Sharing::ALL.map(|sharing| contract.module(sharing)).to_vec();
        forms.dedup_by(|a, b| a.name == b.name);
        for module in &forms {
            let words = spirv(&compiler, compiled, (contract, module), shaderc::OptimizationLevel::Performance)?;
            (&module.name, &words).hash(&mut hash);
            write(&out.join(format!("{}.in", module.name)), &format!("{words:?}"))?;
            // Relative to the table, so that the folder can be moved.
            line(&mut modules, format_args!("    ({0:?}, &include!(\"{0}.in\")),", module.name))?;
        }
        // The optimiser strips names; all forms are of one source and declare the same.
        let named = spirv(&compiler, compiled, (contract, &forms[0]), shaderc::OptimizationLevel::Zero)?;
        let interface = Interface::new(contract, &named)?;
        let bindings = interface.bindings.iter();
        let bindings = bindings.map(|(name, ty)| format!("Binding {{ name: {name:?}, ty: BindingType::{ty} }}"));
        let (bindings, push_bytes) = (bindings.collect::<Vec<_>>().join(", "), interface.push_bytes());
        line(
            &mut interfaces,
            format_args!(
                "    Interface {{ name: {:?}, push_bytes: {push_bytes}, bindings: &[{bindings}] }},",
                contract.name
            ),
        )?;
        let (first, known) = pushes.entry(contract.push).or_insert_with(|| (contract, interface.clone()));
        if known.push != interface.push {
            return Err(format!(
                "{} and {} declare other push constants, and both call them {}:\n  {:?}\n  {:?}",
                first.name, contract.name, contract.push, known.push, interface.push
            ));
        }
    }
    line(&mut modules, format_args!("];\n{interfaces}];"))?;
    line(&mut modules, format_args!("/// Changes with any of the modules.\npub const HASH: u64 = {};", hash.finish()))?;
    write(&out.join("spirv.rs"), &modules)?;
    let mut structs = String::new();
    for (name, (contract, interface)) in pushes {
        let fields = interface.push.iter().map(|(name, ty)| format!("    pub {name}: {ty},\n")).collect::<String>();
        line(
            &mut structs,
            format_args!(
                "/// Of `{}`.\n#[repr(C)]\n#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]\n\
                 pub struct {name} {{\n{fields}}}\n",
                contract.source
            ),
        )?;
    }
    write(&out.join("pushes.rs"), &structs)
}

fn line(text: &mut String, line: std::fmt::Arguments) -> Result<(), String> {
    writeln!(text, "{line}").map_err(|e| e.to_string())
}

/// SPIR-V 1.5 of one module of a variant.
fn spirv(
    compiler: &shaderc::Compiler,
    compiled: &mut Compiled,
    (contract, module): (&Contract, &Module),
    level: shaderc::OptimizationLevel,
) -> Result<Vec<u32>, String> {
    let text = with_includes(Path::new(GLSL), contract.source)?;
    compiled.words((text, &module.defines, level as u32), || compile_module(compiler, contract, module, level))
}

const GLSL: &str = "glsl";

fn compile_module(
    compiler: &shaderc::Compiler,
    contract: &Contract,
    module: &Module,
    level: shaderc::OptimizationLevel,
) -> Result<Vec<u32>, String> {
    let path = Path::new(GLSL).join(contract.source);
    let source = fs::read_to_string(&path).map_err(|e| format!("{}: {e}", path.display()))?;
    let mut options = shaderc::CompileOptions::new().map_err(|e| e.to_string())?;
    options.set_target_env(shaderc::TargetEnv::Vulkan, shaderc::EnvVersion::Vulkan1_2 as u32);
    options.set_optimization_level(level);
    options.set_warnings_as_errors();
    for (name, value) in &module.defines {
        options.add_macro_definition(name, Some(value));
    }
    options.set_include_callback(|wanted, _, _, _| {
        let file = Path::new(GLSL).join(wanted);
        let content = fs::read_to_string(&file).map_err(|e| format!("{}: {e}", file.display()))?;
        Ok(shaderc::ResolvedInclude { resolved_name: file.display().to_string(), content })
    });
    compiler
        .compile_into_spirv(&source, shaderc::ShaderKind::Compute, &path.display().to_string(), "main", Some(&options))
        .map(|artifact| artifact.as_binary().to_vec())
        .map_err(|e| format!("variant {}: {e}", module.name))
}
