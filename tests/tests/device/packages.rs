//! The share of each package in the image; `docs/reference/supply-chain.md` must list each package.

use std::collections::BTreeMap;
use std::fs;
use std::io::Write;
use std::process::{Command, Stdio};

use poegp_tests::firmware_build::firmware;
use poegp_tests::image::Image;
use poegp_tests::workspace;

/// Returns the package of a source file as the image names it, without its version.
fn package(path: &str) -> String {
    if let Some(rest) = path.strip_prefix("/crates/") {
        let folder = rest.split('/').next().unwrap_or(rest);
        let name = folder.rsplit_once('-').map_or(folder, |(name, _)| name);
        return name.to_owned();
    }
    if let Some(rest) = path.strip_prefix("/poegp/") {
        let folder = rest.split('/').next().unwrap_or(rest);
        return format!("poegp-{folder}");
    }
    if path.contains("/compiler-builtins/") || path.contains("/compiler_builtins") {
        return "compiler-builtins".to_owned();
    }
    if path.starts_with("/rustc/") || path.starts_with("/rust/") {
        return "core".to_owned();
    }
    "no source line".to_owned()
}

/// Returns the bytes of code of each package. Debug information assigns each half-word to a source line, so a function of
/// `nalgebra` that is inlined into the runtime counts as nalgebra's.
fn bytes_of_code() -> BTreeMap<String, usize> {
    let firmware = firmware().unwrap_or_else(|error| panic!("{error}"));
    let image = Image::read(&firmware.elf).unwrap();
    let mut addresses: Vec<u64> = image
        .functions
        .iter()
        .flat_map(|function| (function.address..function.address + function.size).step_by(2))
        .collect();
    // Identical functions are merged into one function with two names.
    addresses.sort_unstable();
    addresses.dedup();
    let mut reader = Command::new("arm-none-eabi-addr2line")
        .arg("--exe")
        .arg(&firmware.elf)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap_or_else(|error| {
            panic!("arm-none-eabi-addr2line: {error}\nhelp: apt-get install binutils-arm-none-eabi")
        });
    let mut input = reader.stdin.take().unwrap();
    let asked: String = addresses.iter().map(|at| format!("{at:#x}\n")).collect();
    let writer = std::thread::spawn(move || input.write_all(asked.as_bytes()));
    let output = reader.wait_with_output().unwrap();
    writer.join().unwrap().unwrap();
    let lines = String::from_utf8(output.stdout).unwrap();
    assert_eq!(lines.lines().count(), addresses.len());
    let mut bytes = BTreeMap::new();
    for line in lines.lines() {
        *bytes.entry(package(line)).or_insert(0) += 2;
    }
    bytes
}

#[test]
fn every_package_of_the_image_is_accounted_for() {
    let bytes = bytes_of_code();
    let mut rows: Vec<_> = bytes.iter().collect();
    rows.sort_by_key(|(_, bytes)| std::cmp::Reverse(**bytes));
    println!("bytes of code, by the source line that each half-word comes from:");
    for (name, bytes) in &rows {
        println!("| `{name}` | {bytes} |");
    }
    println!("| all | {} |", bytes.values().sum::<usize>());
    let documented =
        fs::read_to_string(workspace().join("docs/reference/supply-chain.md")).unwrap();
    let missing: Vec<_> = bytes
        .keys()
        .filter(|name| !documented.contains(&format!("| `{name}` |")))
        .collect();
    assert!(
        missing.is_empty(),
        "not in docs/reference/supply-chain.md: {missing:?}"
    );
    assert!(bytes["poegp-runtime"] > 10_000, "nothing was attributed");
}

/// The packages that cargo compiles for the device, including macros and packages that leave no code.
#[test]
fn every_package_that_is_compiled_is_accounted_for() {
    let output = Command::new(env!("CARGO"))
        .args([
            "tree",
            "--locked",
            "--offline",
            "--package",
            "poegp-firmware",
        ])
        .args(["--target", poegp_tests::firmware_build::TARGET])
        .args(["--edges", "normal", "--prefix", "none", "--format", "{p}"])
        .current_dir(workspace())
        .output()
        .unwrap();
    assert!(output.status.success(), "{output:?}");
    let text = String::from_utf8(output.stdout).unwrap();
    let documented =
        fs::read_to_string(workspace().join("docs/reference/supply-chain.md")).unwrap();
    let names: std::collections::BTreeSet<_> = text
        .lines()
        .filter_map(|line| line.split(' ').next())
        .filter(|name| !name.is_empty())
        .collect();
    assert!(names.contains("nalgebra"));
    let missing: Vec<_> = names
        .iter()
        .filter(|name| !documented.contains(&format!("`{name}`")))
        .collect();
    assert!(
        missing.is_empty(),
        "not in docs/reference/supply-chain.md: {missing:?}"
    );
}
