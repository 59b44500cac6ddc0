//! The program around [`poegp_calibration`]: files of other programs in, models, reports and robot programs out, the device on
//! its serial port, and controllers that are corrected live.
#![warn(missing_docs)]
#![cfg_attr(not(test), warn(clippy::too_many_lines))]

pub mod bridge;
pub mod cli;
pub mod device;
pub mod export;
pub mod import;
pub mod report;
pub mod robot_programs;
pub mod signing;
