//! The crate's public interface is the one that is kept in `api.txt`: what a change adds is seen in its diff, and what
//! it takes away cannot go unseen.
//!
//! `rustdoc` gives the interface in its JSON format, which it writes on request only (`RUSTC_BOOTSTRAP`); `public-api`
//! reads the formats of some releases.

use std::path::Path;
use std::process::Command;
use std::{env, fs};

#[test]
#[ignore = "documents the crate anew, which takes minutes: tools/test --test public_api -- --ignored"]
fn the_public_interface_is_the_stored_one() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let target = Path::new(env!("CARGO_TARGET_TMPDIR")).parent().unwrap();
    let mut command = Command::new(env::var_os("CARGO").unwrap_or("cargo".into()));
    command.args(["rustdoc", "--release", "--locked", "--lib", "--features", "exr"]).current_dir(root);
    command.args(["--", "-Z", "unstable-options", "--output-format", "json", "--cap-lints", "allow"]);
    let output = command.env("RUSTC_BOOTSTRAP", "1").env("CARGO_TARGET_DIR", target).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let read = public_api::Builder::from_rustdoc_json(target.join("doc/vkdenoise.json"))
        .omit_blanket_impls(true)
        .omit_auto_trait_impls(true)
        .omit_auto_derived_impls(true)
        .build();
    let api = match read {
        Ok(api) => api,
        Err(error) => {
            println!("not compared: public-api does not read what this release of Rust writes ({error})");
            return;
        }
    };
    let made: String = api.items().map(|item| format!("{item}\n")).collect();
    let file = root.join("api.txt");
    if env::var_os("VKDENOISE_WRITE_STORED").is_some_and(|value| value == "1") {
        fs::write(&file, &made).unwrap();
    }
    let stored = fs::read_to_string(&file).unwrap_or_default();
    let missing = |of: &str, other: &str, sign: char| -> String {
        let gone = of.lines().filter(|line| !other.lines().any(|other| other == *line));
        gone.map(|line| format!("{sign} {line}\n")).collect()
    };
    assert!(
        stored == made,
        "the public interface is not that of api.txt:\n{}{}\
         What is gone or changed breaks those who use it: it needs a new minor version (a major one from 1.0 on). If \
         the change is meant, run the test once more with VKDENOISE_WRITE_STORED=1 and commit the file.",
        missing(&stored, &made, '-'),
        missing(&made, &stored, '+'),
    );
}
