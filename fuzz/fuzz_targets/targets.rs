//! `poegp_tests::fuzzing`, target `targets`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| poegp_tests::fuzzing::readers::targets(data));
