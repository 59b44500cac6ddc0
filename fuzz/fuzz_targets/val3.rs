//! `poegp_tests::fuzzing`, target `val3`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| poegp_tests::fuzzing::programs::val3(data));
