//! `poegp_tests::fuzzing`, target `envelope`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| poegp_tests::fuzzing::wire::envelope(data));
