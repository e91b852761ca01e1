//! The kernels' SPIR-V: compiled here (feature `shaderc`), or taken from the folder `shaders`, which `tools/package`
//! puts into the published crate. Both are the same files, in `OUT_DIR/shaders`.

// The contracts are the library's own: both sides see the same tables.
#[cfg(feature = "shaderc")]
#[path = "src/kernels"]
#[allow(dead_code, reason = "the build reads the contracts only")]
mod kernels {
    pub mod contract;
    pub mod contracts;
}
#[cfg(feature = "shaderc")]
#[path = "build/cached.rs"]
mod cached;
#[cfg(feature = "shaderc")]
#[path = "build/compile.rs"]
mod compile;
#[cfg(feature = "shaderc")]
#[path = "build/reflect.rs"]
mod reflect;
#[path = "build/sources.rs"]
mod sources;
#[cfg(not(feature = "shaderc"))]
#[path = "build/stored.rs"]
mod stored;

use std::path::{Path, PathBuf};
use std::{env, fs};

fn main() {
    if let Err(message) = build() {
        eprintln!("{message}");
        std::process::exit(1);
    }
}

fn build() -> Result<(), String> {
    for path in sources::PATHS {
        println!("cargo::rerun-if-changed={path}");
    }
    let folder = PathBuf::from(env::var_os("OUT_DIR").ok_or("OUT_DIR is not set")?);
    let out = folder.join("shaders");
    // Nothing of an earlier build stays.
    match fs::remove_dir_all(&out) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            return Err(format!("{}: {error}", out.display()));
        }
        _ => {}
    }
    fs::create_dir_all(&out).map_err(|e| format!("{}: {e}", out.display()))?;
    let hash = sources::hash()?;
    #[cfg(feature = "shaderc")]
    {
        let mut compiled = cached::Compiled::in_folder(folder.join("compiled"))?;
        compile::compile(&out, &mut compiled)?;
        compiled.forget_others();
    }
    #[cfg(not(feature = "shaderc"))]
    stored::copy(Path::new(stored::FOLDER), hash, &out)?;
    write(&out.join(sources::STAMP), &format!("{hash:016x}\n"))
}

fn write(file: &Path, text: &str) -> Result<(), String> {
    fs::write(file, text).map_err(|e| format!("{}: {e}", file.display()))
}
