//! The firmware's routines that copy and clear memory, tested byte by byte on the emulated processor.
//!
//! The test takes their assembly source from the firmware and assembles it under other names into a C program. The program
//! tries every number of bytes up to four rounds of the loops and checks the bytes around the destination.

use std::fmt::Write as _;
use std::fs;

use poegp_tests::workspace;

use crate::c::{Machine, capi, compile, run_on_device};

const PROGRAM: &str = r#"
#include <stdint.h>
#include <string.h>

#include "startup.h"

void tested_memclr4(void *to, uint32_t bytes);
void tested_memcpy4(void *to, const void *from, uint32_t bytes);

static uint32_t from[64], to[64];

int main(void)
{
    uint8_t *f = (uint8_t *)from, *t = (uint8_t *)to;
    int wrong = 0;
    for (uint32_t bytes = 0; bytes <= 132; bytes++) {
        for (uint32_t start = 4; start <= 12; start += 4) {
            for (uint32_t i = 0; i < sizeof to; i++) {
                f[i] = (uint8_t)(7 * i + 1 + bytes);
                t[i] = 0xa5;
            }
            tested_memcpy4(t + start, f + 8, bytes);
            for (uint32_t i = 0; i < sizeof to; i++) {
                uint8_t expected = i - start < bytes ? f[i - start + 8] : 0xa5;
                wrong += t[i] != expected;
            }
            tested_memclr4(f + start, bytes);
            for (uint32_t i = 0; i < sizeof to; i++) {
                uint8_t expected = i - start < bytes ? 0 : (uint8_t)(7 * i + 1 + bytes);
                wrong += f[i] != expected;
            }
        }
    }
    print(wrong == 0 ? "all bytes right\n" : "wrong bytes\n");
    return wrong != 0;
}
"#;

/// Returns the strings of the firmware's `global_asm!`.
fn assembly() -> String {
    let source = fs::read_to_string(workspace().join("firmware/src/mem_intrinsics.rs")).unwrap();
    let mut out = String::from("__asm__(\".syntax unified\\n\"\n");
    for line in source.lines() {
        let Some(rest) = line.trim().strip_prefix('"') else {
            continue;
        };
        // Only a comma and a comment may follow the string.
        let end = rest.rfind("\",").unwrap();
        let text = rest[..end].replace("{{", "{").replace("}}", "}");
        writeln!(out, "\"{}\\n\"", text.replace("__aeabi", "tested")).unwrap();
    }
    out + "\".text\\n\");\n"
}

#[test]
fn the_firmware_copies_and_clears_every_byte() {
    let folder = tempfile::Builder::new().prefix("poegp-").tempdir().unwrap();
    let source = folder.path().join("copies.c");
    fs::write(&source, assembly() + PROGRAM).unwrap();
    let program = folder.path().join("copies");
    compile(
        Machine::Device,
        &source,
        &[&capi().join("examples"), folder.path()],
        &program,
    );
    assert_eq!(run_on_device(&program, false).trim(), "all bytes right");
}
