//! The library as it is installed: C and C++ programs built against it by a C compiler, through pkg-config and
//! through CMake, and run; and the interface as it is kept in `abi.txt`.

mod common;

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;
use std::{env, fs};

const STRICT: [&str; 6] = ["-Wall", "-Wextra", "-Wpedantic", "-Werror", "-O1", "-g"];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Where the tests build: below Cargo's own folder.
fn scratch() -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join("vkdenoise-c")
}

/// What a command prints; it must succeed.
fn output(command: &mut Command) -> String {
    let output = command.output().unwrap_or_else(|error| panic!("{command:?}: {error}"));
    let (stdout, stderr) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{command:?}: {}\n{stdout}{stderr}", output.status);
    stdout.into_owned()
}

/// The library, installed by its own script.
fn installed() -> &'static Path {
    static PREFIX: OnceLock<PathBuf> = OnceLock::new();
    PREFIX.get_or_init(|| {
        let prefix = scratch().join("prefix");
        // Nothing of an earlier run stands in for what the script should install.
        let _ = fs::remove_dir_all(&prefix);
        let target = Path::new(env!("CARGO_TARGET_TMPDIR")).parent().unwrap();
        output(Command::new(root().join("install")).arg(&prefix).env("CARGO_TARGET_DIR", target));
        prefix
    })
}

/// What pkg-config says of the installed library.
fn pkg_config(arguments: &[&str]) -> Vec<String> {
    let path = installed().join("lib/pkgconfig");
    let said = output(Command::new("pkg-config").args(arguments).arg("vkdenoise").env("PKG_CONFIG_PATH", path));
    said.split_whitespace().map(str::to_owned).collect()
}

/// Builds a program against the shared library.
fn build(compiler: &str, standard: &str, source: &str, libraries: &[&str]) -> PathBuf {
    let program = scratch().join(source.replace(['/', '.'], "-"));
    let mut command = Command::new(compiler);
    command.arg(standard).args(STRICT).arg(root().join(source)).arg("-o").arg(&program);
    command.args(pkg_config(&["--cflags", "--libs"])).args(libraries);
    output(command.arg(format!("-Wl,-rpath,{}", installed().join("lib").display())));
    program
}

fn run(program: &Path) -> String {
    output(&mut Command::new(program))
}

#[test]
fn the_host_example_in_c() {
    let program = build("cc", "-std=c11", "examples/host.c", &["-lm"]);
    let picture = scratch().join("host.pfm");
    let said = output(Command::new(program).arg(&picture));
    assert!(said.contains("denoised"), "{said}");
    let bytes = fs::read(&picture).unwrap();
    assert!(bytes.starts_with(b"PF\n480 120\n-1.0\n"));
    assert_eq!(bytes.len(), 16 + 480 * 120 * 12);
}

#[test]
fn the_host_example_in_c_with_the_static_library() {
    let program = scratch().join("host-static");
    let archive = installed().join("lib/libvkdenoise.a");
    let private: Vec<_> = pkg_config(&["--libs", "--static"]).into_iter().filter(|lib| lib != "-lvkdenoise").collect();
    let mut command = Command::new("cc");
    command.arg("-std=c11").args(STRICT).arg(root().join("examples/host.c")).arg(archive).args(private);
    output(command.args(pkg_config(&["--cflags"])).arg("-lm").arg("-o").arg(&program));
    assert!(run(&program).contains("denoised"));
    let needed = output(Command::new("readelf").arg("-d").arg(&program));
    assert!(!needed.contains("libvkdenoise"), "{needed}");
}

#[test]
fn the_example_in_cpp() {
    let said = run(&build("c++", "-std=c++17", "examples/host.cpp", &[]));
    assert!(said.contains("as it should: the colour plane"), "{said}");
    assert!(said.contains("ended: the window is gone"), "{said}");
}

#[test]
fn the_renderer_example_in_c() {
    let said = run(&build("cc", "-std=c11", "examples/renderer.c", &["-lvulkan", "-lm"]));
    assert_eq!(said.matches("frame ").count(), 4, "{said}");
}

#[test]
fn a_renderers_images_and_what_its_path_refuses() {
    run(&build("cc", "-std=c11", "tests/programs/images.c", &["-lvulkan"]));
}

#[test]
fn the_formats_of_a_renderers_planes() {
    run(&build("cc", "-std=c11", "tests/programs/formats.c", &["-lvulkan", "-lm"]));
}

#[test]
fn passes_of_two_sizes_in_one_arena() {
    run(&build("cc", "-std=c11", "tests/programs/arena.c", &["-lvulkan"]));
}

#[test]
fn memory_and_semaphores_by_file_descriptors() {
    print!("{}", run(&build("cc", "-std=gnu11", "tests/programs/interop.c", &["-lvulkan"])));
}

#[test]
fn what_the_host_path_refuses() {
    run(&build("cc", "-std=c11", "tests/programs/host_misuse.c", &["-pthread"]));
}

#[test]
fn the_host_paths_signals_progress_and_tiles() {
    let program = build("cc", "-std=c11", "tests/programs/signals.c", &["-lm"]);
    // A network that predicts no kernels.
    output(Command::new(program).arg(root().join("../../weights/hybrid.safetensors")));
}

/// The code of a language in the guide, in one piece.
fn guide(language: &str) -> String {
    let text = fs::read_to_string(root().join("../../docs/INTEGRATION.md")).unwrap();
    let opening = format!("```{language}\n");
    let blocks = text.split(&opening).skip(1).filter_map(|rest| rest.split("```").next());
    blocks.collect::<Vec<_>>().join("\n")
}

#[test]
fn the_guides_code_compiles() {
    for (compiler, standard, language) in [("cc", "-std=c11", "c"), ("c++", "-std=c++17", "cpp")] {
        let code = guide(language);
        assert!(code.contains("denoise"), "no code of {language} in the guide");
        fs::create_dir_all(scratch()).unwrap();
        let source = scratch().join(format!("guide.{language}"));
        fs::write(&source, code).unwrap();
        let mut command = Command::new(compiler);
        command.arg(standard).args(STRICT).arg("-c").arg(&source).arg("-o").arg(scratch().join("guide.o"));
        output(command.args(pkg_config(&["--cflags"])));
    }
}

/// Both libraries, found by CMake, in a program of a project of its own.
#[test]
fn a_cmake_project_finds_the_library() {
    let folder = scratch().join("cmake");
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).unwrap();
    let project = "cmake_minimum_required(VERSION 3.16)\n\
        project(finds C)\n\
        find_package(vkdenoise 0.1 REQUIRED)\n\
        add_executable(shared main.c)\n\
        target_link_libraries(shared PRIVATE vkdenoise::vkdenoise)\n\
        add_executable(fixed main.c)\n\
        target_link_libraries(fixed PRIVATE vkdenoise::static)\n";
    let main = "#include <stdio.h>\n#include <vkdenoise.h>\n\
        int main(void) { printf(\"%s %u\\n\", vkdenoise_version(), vkdenoise_abi_version()); return 0; }\n";
    fs::write(folder.join("CMakeLists.txt"), project).unwrap();
    fs::write(folder.join("main.c"), main).unwrap();
    let built = folder.join("built");
    let prefix = format!("-DCMAKE_PREFIX_PATH={}", installed().display());
    output(Command::new("cmake").arg("-S").arg(&folder).arg("-B").arg(&built).arg(prefix));
    output(Command::new("cmake").arg("--build").arg(&built));
    for program in ["shared", "fixed"] {
        assert_eq!(run(&built.join(program)), format!("{} 1\n", env!("CARGO_PKG_VERSION")), "{program}");
    }
    // Another release is asked for.
    fs::write(folder.join("CMakeLists.txt"), project.replace("0.1 REQUIRED", "0.2 REQUIRED")).unwrap();
    let refused = Command::new("cmake").arg("-S").arg(&folder).arg("-B").arg(&built).output().unwrap();
    assert!(!refused.status.success());
}

/// Structs, enums and functions of the header, as a compiler lays them out and the shared library exports them.
#[test]
fn the_interface_is_the_stored_one() {
    let header = fs::read_to_string(root().join("include/vkdenoise.h")).unwrap();
    let program = scratch().join("abi.c");
    fs::create_dir_all(scratch()).unwrap();
    fs::write(&program, layout_program(&header)).unwrap();
    let built = scratch().join("abi");
    output(Command::new("cc").arg(&program).arg("-o").arg(&built).args(pkg_config(&["--cflags"])));
    let layout = run(&built);
    assert_no_padding(&layout);
    let functions = functions(&header);
    let library = installed().join("lib/libvkdenoise.so.1");
    let symbols = output(Command::new("nm").args(["-D", "--defined-only", "--format=just-symbols"]).arg(&library));
    let mut exported: Vec<_> = symbols.lines().map(str::trim).collect();
    exported.sort_unstable();
    let mut named: Vec<_> = functions.iter().filter_map(|f| f.split('(').next()?.rsplit([' ', '*']).next()).collect();
    named.sort_unstable();
    assert_eq!(exported, named, "what the library exports, and what the header declares");
    let soname = output(Command::new("readelf").arg("-d").arg(&library));
    assert!(soname.contains("[libvkdenoise.so.1]"), "{soname}");
    // Sizes are those of 64-bit systems.
    if cfg!(all(target_pointer_width = "64", target_os = "linux")) {
        let version = header.lines().find_map(|line| line.strip_prefix("#define VKDENOISE_ABI_VERSION ")).unwrap();
        let made = format!("version {version}\n{layout}{}\n", functions.join("\n"));
        let file = root().join("abi.txt");
        assert_kept(&fs::read_to_string(&file).unwrap(), &made);
        common::assert_stored(&file, &made);
    }
}

/// What there was is still there, unless the interface has a new version. Structs may grow, and reserved fields be
/// used.
fn assert_kept(stored: &str, made: &str) {
    if stored.lines().next() != made.lines().next() {
        return;
    }
    let free = |line: &&str| !line.starts_with("struct ") && !line.contains(" reserved: ");
    for line in stored.lines().filter(free) {
        assert!(
            made.lines().any(|now| now == line),
            "'{line}' is gone: raise VKDENOISE_ABI_VERSION in src/abi_version.rs"
        );
    }
}

#[test]
fn an_interface_that_loses_something_needs_a_new_version() {
    let stored = "version 1\nstruct a 8\na: size_t struct_size: 0 + 8\na: uint32_t reserved: 8 + 4\nB 1\n";
    assert_kept(stored, stored);
    assert_kept(stored, &stored.replace("a 8", "a 16").replace("reserved", "used"));
    assert_kept(stored, &stored.replace("version 1", "version 2").replace("B 1", "B 2"));
    let lost = std::panic::catch_unwind(|| assert_kept(stored, &stored.replace("B 1", "B 2")));
    assert!(lost.is_err());
}

/// The header without comments and lines of the preprocessor.
fn code(header: &str) -> String {
    let code = header.lines().map(|line| line.split("//").next().unwrap_or_default().trim());
    code.filter(|line| !line.starts_with('#')).collect::<Vec<_>>().join(" ")
}

/// A program that prints every struct's size, every field's place, every enum's values.
fn layout_program(header: &str) -> String {
    let code = code(header);
    let mut lines = String::new();
    for part in code.split("typedef struct ").skip(1) {
        let Some((name, rest)) = part.split_once(" {") else { continue };
        let fields = rest.split('}').next().unwrap();
        lines += &format!("printf(\"struct {name} %zu\\n\", sizeof({name}));\n");
        for field in fields.split(';').map(str::trim).filter(|field| !field.is_empty()) {
            let declared = field.split('[').next().unwrap();
            let field_name = declared.rsplit([' ', '*']).next().unwrap();
            let place = format!("offsetof({name}, {field_name}), sizeof((({name} *)0)->{field_name})");
            lines += &format!("printf(\"{name}: {field}: %zu + %zu\\n\", {place});\n");
        }
    }
    for part in code.split("enum vkdenoise_").skip(1) {
        let Some((name, rest)) = part.split_once('{').filter(|(name, _)| !name.contains(';')) else { continue };
        let name = name.split_whitespace().next().unwrap();
        let values = rest.split('}').next().unwrap();
        lines += &format!("printf(\"enum vkdenoise_{name} %zu\\n\", sizeof(vkdenoise_{name}));\n");
        for value in values.split(',').filter_map(|value| value.split('=').next()).map(str::trim) {
            if !value.is_empty() {
                lines += &format!("printf(\"{value} %u\\n\", (unsigned){value});\n");
            }
        }
    }
    format!("#include <stdio.h>\n#include <vkdenoise.h>\nint main(void) {{\n{lines}return 0;\n}}\n")
}

/// The prototypes, one a line.
fn functions(header: &str) -> Vec<String> {
    let code = code(header);
    let declared = code.split("extern \"C\" {").nth(1).unwrap().split('}').next().unwrap();
    let one_line = |function: &str| function.split_whitespace().collect::<Vec<_>>().join(" ");
    let mut functions: Vec<_> = declared.split(';').map(one_line).filter(|f| !f.is_empty()).collect();
    functions.sort();
    functions
}

/// A field that is added where padding was would be read from programs that never wrote it.
fn assert_no_padding(layout: &str) {
    let mut structs = 0;
    let (mut name, mut size, mut end) = ("", 0, 0);
    for line in layout.lines().chain(["struct end 0"]) {
        if let Some((of, bytes)) = line.strip_prefix("struct ").and_then(|rest| rest.split_once(' ')) {
            assert_eq!(end, size, "{name} has padding at its end");
            (name, size, end) = (of, bytes.parse::<usize>().unwrap(), 0);
            structs += 1;
        } else if let Some((field, place)) = line.rsplit_once(": ") {
            let (at, bytes) = place.split_once(" + ").unwrap();
            assert_eq!(at.parse::<usize>().unwrap(), end, "{name} has padding before {field}");
            end += bytes.parse::<usize>().unwrap();
        }
    }
    assert!(structs > 10, "{structs} structs were found in the header");
}
