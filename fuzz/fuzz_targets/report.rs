//! `poegp_tests::fuzzing`, target `report`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| poegp_tests::fuzzing::page::report(data));
