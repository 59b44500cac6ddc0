//! Tells the linker where the image goes: the scripts of cortex-m-rt and defmt, and `memory.x` of the workspace root.
//!
//! Only for the device; the host stub links as any program does. The linker runs in the workspace root and therefore
//! finds the root's `memory.x` first; the copy is for a build that is started elsewhere.

use std::path::PathBuf;
use std::{env, fs};

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-changed=../memory.x");
    if env::var("CARGO_CFG_TARGET_OS").as_deref() != Ok("none") {
        return;
    }
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    fs::copy("../memory.x", out.join("memory.x")).expect("memory.x is in the workspace root");
    println!("cargo:rustc-link-search={}", out.display());
    if env::var_os("CARGO_FEATURE_STM32F405").is_some() {
        println!("cargo:rustc-link-arg-bins=--defsym=__board_stm32f405=1");
    }
    // No page alignment: load addresses are exactly those of memory.x. Relocations stay in the ELF file, not in the image:
    // the bound of the stack tells addresses from numbers by them.
    for argument in ["--nmagic", "--emit-relocs", "-Tlink.x", "-Tdefmt.x"] {
        println!("cargo:rustc-link-arg-bins={argument}");
    }
}
