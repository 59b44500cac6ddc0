//! `poegp_tests::fuzzing`, target `table`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| poegp_tests::fuzzing::programs::table(data));
