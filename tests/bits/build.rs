//! Turns the queries of the golden files into constants, and lays the image out for the machine that it is built for.
//!
//! The memory of a bare machine comes in three variables (`tests/machines/run` has the table): `POEGP_BITS_FLASH` and
//! `POEGP_BITS_RAM`, addresses, and `POEGP_BITS_STACK`, bytes.

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::{env, fs};

const CASES: [&str; 4] = ["shared", "folded", "per_output", "elastic"];
/// What does not fit into 16 kB of RAM.
const FULL_SIZE: [&str; 4] = [
    "elastic_curve",
    "elastic_std",
    "full_shared",
    "full_elastic",
];

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-changed=bits.ld");
    let package = PathBuf::from(env::var_os("CARGO_MANIFEST_DIR").expect("cargo sets it"));
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets it"));
    let full_size = env::var_os("CARGO_FEATURE_FULL_SIZE").is_some();
    let mut cases = "[\n".to_owned();
    for name in CASES.iter().chain(FULL_SIZE.iter().filter(|_| full_size)) {
        write_case(&mut cases, name, &package.join("../data"));
    }
    fs::write(out.join("cases.rs"), cases + "]\n").expect("cargo made the folder");
    if env::var("CARGO_CFG_TARGET_OS").as_deref() == Ok("none") {
        println!(
            "cargo:rustc-link-arg-bins=-T{}",
            package.join("bits.ld").display()
        );
        for place in ["FLASH", "RAM", "STACK"] {
            let variable = format!("POEGP_BITS_{place}");
            println!("cargo:rerun-if-env-changed={variable}");
            let Ok(value) = env::var(&variable) else {
                // Clippy needs no layout, and the linker asks for the symbol by name.
                continue;
            };
            println!(
                "cargo:rustc-link-arg-bins=--defsym=bits_{}={value}",
                place.to_lowercase()
            );
        }
    }
}

/// One `Case`: the blob, and the first group of every line.
fn write_case(cases: &mut String, name: &str, data: &Path) {
    let blob = data.join(format!("golden_{name}.blob"));
    let bits = data.join(format!("golden_{name}_bits.txt"));
    println!("cargo:rerun-if-changed={}", blob.display());
    println!("cargo:rerun-if-changed={}", bits.display());
    let text = fs::read_to_string(&bits).unwrap_or_else(|e| panic!("{}: {e}", bits.display()));
    let mut add = |piece: std::fmt::Arguments<'_>| cases.write_fmt(piece).expect("strings grow");
    add(format_args!(
        "Case {{ name: {name:?}, blob: include_bytes!({blob:?}), queries: &[\n"
    ));
    for line in text.lines().filter(|line| !line.starts_with('#')) {
        let query = line.split('|').next().unwrap_or_default();
        let words: Vec<String> = query.split_whitespace().map(|w| format!("0x{w}")).collect();
        add(format_args!("&[{}],\n", words.join(", ")));
    }
    add(format_args!("] }},\n"));
}
