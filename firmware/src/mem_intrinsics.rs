//! Fast routines that copy and clear memory with several registers at once.
//!
//! For copies and clears that it does not expand inline, the compiler calls four routines of the Arm run-time ABI. The
//! compiler's own library implements them in portable source, one word at a time: clearing the 344 bytes of a Newton step's
//! equations takes 150 instructions. The routines below take 60, which saves some hundred instructions in a pose or a
//! corrected command. They replace those of the library, which are weak symbols (`tests/tests/device/image.rs`), with the
//! same result byte for byte (`tests/tests/capi/copies.rs`).
//!
//! As in the ABI, the result for overlapping data is undefined. The routines check nothing: compilers generate their calls.
#![allow(unsafe_code)]

use core::arch::global_asm;

// Clears memory. r0: destination, aligned to words; r1: number of bytes.
global_asm!(
    ".section .text.__aeabi_memclr4,\"ax\",%progbits",
    ".global __aeabi_memclr4",
    ".global __aeabi_memclr8",
    ".type __aeabi_memclr4,%function",
    ".type __aeabi_memclr8,%function",
    ".thumb_func",
    "__aeabi_memclr8:",
    ".thumb_func",
    "__aeabi_memclr4:",
    "push {{r4, lr}}",
    "movs r2, #0",
    "movs r3, #0",
    "movs r4, #0",
    "mov r12, r2",
    "subs r1, #32",
    "blo 2f",
    "1:",
    "stmia r0!, {{r2, r3, r4, r12}}",
    "stmia r0!, {{r2, r3, r4, r12}}",
    "subs r1, #32",
    "bhs 1b",
    "2:", // what is left: the low five bits of the count
    "lsls r1, r1, #28",
    "it cs",
    "stmiacs r0!, {{r2, r3, r4, r12}}",
    "it mi",
    "stmiami r0!, {{r2, r3}}",
    "lsls r1, r1, #2",
    "it cs",
    "strcs r2, [r0], #4",
    "it mi",
    "strhmi r2, [r0], #2",
    "lsls r1, r1, #1",
    "it mi",
    "strbmi r2, [r0]",
    "pop {{r4, pc}}",
    ".size __aeabi_memclr4, . - __aeabi_memclr4",
);

// Copies memory. r0: destination, r1: source, both aligned to words; r2: number of bytes.
global_asm!(
    ".section .text.__aeabi_memcpy4,\"ax\",%progbits",
    ".global __aeabi_memcpy4",
    ".global __aeabi_memcpy8",
    ".type __aeabi_memcpy4,%function",
    ".type __aeabi_memcpy8,%function",
    ".thumb_func",
    "__aeabi_memcpy8:",
    ".thumb_func",
    "__aeabi_memcpy4:",
    "push {{r4, lr}}",
    "subs r2, #32",
    "blo 2f",
    "1:",
    "ldmia r1!, {{r3, r4, r12, lr}}",
    "stmia r0!, {{r3, r4, r12, lr}}",
    "ldmia r1!, {{r3, r4, r12, lr}}",
    "stmia r0!, {{r3, r4, r12, lr}}",
    "subs r2, #32",
    "bhs 1b",
    "2:",
    "lsls r2, r2, #28",
    "itt cs",
    "ldmiacs r1!, {{r3, r4, r12, lr}}",
    "stmiacs r0!, {{r3, r4, r12, lr}}",
    "itt mi",
    "ldmiami r1!, {{r3, r4}}",
    "stmiami r0!, {{r3, r4}}",
    "lsls r2, r2, #2",
    "itt cs",
    "ldrcs r3, [r1], #4",
    "strcs r3, [r0], #4",
    "itt mi",
    "ldrhmi r3, [r1], #2",
    "strhmi r3, [r0], #2",
    "lsls r2, r2, #1",
    "itt mi",
    "ldrbmi r3, [r1]",
    "strbmi r3, [r0]",
    "pop {{r4, pc}}",
    ".size __aeabi_memcpy4, . - __aeabi_memcpy4",
);
