//! `poegp_tests::fuzzing`, target `rsi`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| poegp_tests::fuzzing::bridge::rsi(data));
