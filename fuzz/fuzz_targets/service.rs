//! `poegp_tests::fuzzing`, target `service`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| poegp_tests::fuzzing::service::service(data));
