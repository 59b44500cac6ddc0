//! `poegp_tests::fuzzing`, target `inform`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| poegp_tests::fuzzing::programs::inform(data));
