//! `poegp_tests::fuzzing`, target `measurements`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| poegp_tests::fuzzing::readers::measurements(data));
