//! `poegp_tests::fuzzing`, target `preset`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| poegp_tests::fuzzing::readers::preset(data));
