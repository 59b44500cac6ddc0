//! The first instructions of a bare machine: stack, floating-point unit, main.
//!
//! For emulators, which load every byte to its place and clear the rest. The only module of this crate with assembly.
#![allow(unsafe_code)]

use core::arch::global_asm;
use core::panic::PanicInfo;

use semihosting::{eprintln, println, process};

use crate::answers;

// Stack pointer and start of a Cortex-M; every exception after that is a fault, and the emulator stops at the second.
#[cfg(target_arch = "arm")]
global_asm!(
    ".section .start, \"ax\"",
    ".word stack_top",
    ".word start",
    ".rept 14",
    ".word fault",
    ".endr",
    ".global start",
    ".type start, %function",
    ".thumb_func",
    "start:",
    "ldr r0, =0xE000ED88",
    "ldr r1, =0xF00000",
    "str r1, [r0]", // CPACR: full access to the floating-point unit, where there is one
    "dsb",
    "isb",
    "bl bits_main",
    ".type fault, %function",
    ".thumb_func",
    "fault:",
    "udf #0",
    ".pool",
);

// mstatus.FS = 1: the floating-point unit may be used. Without one the bits stay zero.
#[cfg(target_arch = "riscv32")]
global_asm!(
    ".section .start, \"ax\"",
    ".global start",
    "start:",
    "la sp, stack_top",
    "li t0, 0x2000",
    "csrs mstatus, t0",
    "call bits_main",
);

/// Called by `start`.
// The name is that of nothing else.
#[unsafe(no_mangle)]
extern "C" fn bits_main() -> ! {
    match answers::print(1, |line| println!("{line}")) {
        Ok(()) => process::exit(0),
        Err(problem) => {
            eprintln!("error: {problem}");
            process::exit(1)
        }
    }
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    eprintln!("{info}");
    process::exit(101)
}
