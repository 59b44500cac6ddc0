//! The program around [`poegp_calibration`]: files of other programs in, models, reports and robot programs out, and the device
//! on its serial port.
#![warn(missing_docs)]

pub mod cli;
pub mod device;
pub mod export;
pub mod import;
pub mod report;
pub mod robot_programs;
pub mod signing;
