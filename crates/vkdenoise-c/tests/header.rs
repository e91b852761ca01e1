//! `include/vkdenoise.h` is what cbindgen makes of the sources.

mod common;

use std::path::Path;

#[test]
fn the_header_is_of_the_sources() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let config = cbindgen::Config::from_file(root.join("cbindgen.toml")).unwrap();
    let bindings = cbindgen::Builder::new().with_crate(root).with_config(config).generate().unwrap();
    let mut made = Vec::new();
    bindings.write(&mut made);
    common::assert_stored(&root.join("include/vkdenoise.h"), &String::from_utf8(made).unwrap());
}
