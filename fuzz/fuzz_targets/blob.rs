//! `poegp_tests::fuzzing`, target `blob`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| poegp_tests::fuzzing::wire::blob(data));
