//! Gives the shared library the name by which programs find it: it changes with the interface's version.

#[path = "src/abi_version.rs"]
mod abi_version;

fn main() {
    println!("cargo::rerun-if-changed=src/abi_version.rs");
    if std::env::var("CARGO_CFG_TARGET_OS").is_ok_and(|os| os == "linux") {
        println!("cargo::rustc-cdylib-link-arg=-Wl,-soname,libvkdenoise.so.{}", abi_version::VKDENOISE_ABI_VERSION);
    }
}
