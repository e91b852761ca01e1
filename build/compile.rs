//! Compiles every kernel variant with shaderc and checks what the shader declares against its contract in
//! `src/kernels/contracts.rs`.

use crate::check;
use crate::kernels::contract::{Contract, Module, Sharing};
use crate::kernels::contracts;
use crate::write;
use std::fmt::Write as _;
use std::fs;
use std::hash::{Hash, Hasher};
use std::path::Path;

/// Writes `spirv.rs`, a table of the modules, and a file of words for each.
///
/// # Errors
/// A shader that does not compile or does not meet its contract; a file that cannot be written.
pub fn compile(out: &Path) -> Result<(), String> {
    let compiler = shaderc::Compiler::new().map_err(|e| format!("no shader compiler: {e}"))?;
    let mut modules = String::from("static MODULES: &[(&str, &[u32])] = &[\n");
    let mut hash = std::hash::DefaultHasher::new();
    for contract in contracts::ALL {
        let mut forms = Sharing::ALL.map(|sharing| contract.module(sharing)).to_vec();
        forms.dedup_by(|a, b| a.name == b.name);
        for module in &forms {
            // The optimiser strips the names that the check compares.
            check::check(contract, &spirv(&compiler, contract, module, shaderc::OptimizationLevel::Zero)?)?;
            let words = spirv(&compiler, contract, module, shaderc::OptimizationLevel::Performance)?;
            (&module.name, &words).hash(&mut hash);
            write(&out.join(format!("{}.in", module.name)), &format!("{words:?}"))?;
            // Relative to the table, so that the folder can be moved.
            writeln!(modules, "    ({0:?}, &include!(\"{0}.in\")),", module.name).map_err(|e| e.to_string())?;
        }
    }
    writeln!(modules, "];\n/// Changes with any of the modules.\npub const HASH: u64 = {};", hash.finish())
        .map_err(|e| e.to_string())?;
    write(&out.join("spirv.rs"), &modules)
}

/// SPIR-V 1.5 of one module of a variant.
fn spirv(
    compiler: &shaderc::Compiler,
    contract: &Contract,
    module: &Module,
    level: shaderc::OptimizationLevel,
) -> Result<Vec<u32>, String> {
    let path = Path::new("glsl").join(contract.source);
    let source = fs::read_to_string(&path).map_err(|e| format!("{}: {e}", path.display()))?;
    let mut options = shaderc::CompileOptions::new().map_err(|e| e.to_string())?;
    options.set_target_env(shaderc::TargetEnv::Vulkan, shaderc::EnvVersion::Vulkan1_2 as u32);
    options.set_optimization_level(level);
    options.set_warnings_as_errors();
    for (name, value) in &module.defines {
        options.add_macro_definition(name, Some(value));
    }
    options.set_include_callback(|wanted, _, _, _| {
        let file = Path::new("glsl").join(wanted);
        let content = fs::read_to_string(&file).map_err(|e| format!("{}: {e}", file.display()))?;
        Ok(shaderc::ResolvedInclude { resolved_name: file.display().to_string(), content })
    });
    compiler
        .compile_into_spirv(&source, shaderc::ShaderKind::Compute, &path.display().to_string(), "main", Some(&options))
        .map(|artifact| artifact.as_binary().to_vec())
        .map_err(|e| format!("variant {}: {e}", module.name))
}
