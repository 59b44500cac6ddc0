//! The program as users have it: command lines, written files, and messages about bad input.
//!
//! Every test runs the real binary. The data are the simulated sets of `tests/data`, or changed copies of them.

mod bad_blobs;
mod bad_imports;
mod bad_measurements;
mod bad_robots;
#[cfg(unix)]
mod board;
mod bridge;
#[cfg(unix)]
mod browser;
mod campaign_files;
mod check;
mod check_unexplained;
mod choice;
mod conformity;
mod controller;
mod correct;
mod demo;
#[cfg(unix)]
mod device;
mod drift;
mod elastic;
mod export;
mod export_by_others;
mod export_region;
mod fake_controller;
#[cfg(unix)]
mod fake_device;
#[cfg(unix)]
#[allow(dead_code, reason = "the tests of the device use more of it")]
#[path = "../../../tests/src/firmware_build.rs"]
mod firmware_build;
mod foreign_files;
mod gauge;
mod help;
mod identifiability;
mod import;
mod import_tables;
mod joined_files;
mod json;
mod long;
mod manners;
mod measure;
mod measure_rows;
mod numbers;
mod output_kinds;
mod outputs;
mod plan;
mod predictions;
mod program;
mod programs;
mod programs_beside;
mod programs_checked;
mod programs_flow;
mod programs_postures;
mod programs_said;
mod programs_split;
mod programs_tables;
mod programs_turns;
mod project;
mod report;
mod reproducible;
mod robots;
#[cfg(target_os = "linux")]
mod shells;
mod signing;
mod slides;
mod texts;
mod tools;
mod touch_files;
mod touch_models;
mod units;
mod workbooks;
