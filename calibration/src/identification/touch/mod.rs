//! Calibration by touches: fits the arm together with everything that was touched, for the most probable values of both.

pub mod added;
mod added_equation;
pub mod arm;
pub mod beyond;
pub mod distances;
pub mod equations;
mod evidence;
pub mod fit;
pub mod form;
pub mod images;
pub mod jet;
pub mod judge;
pub mod left_out;
pub mod lengths;
pub mod lost_zero;
pub mod mistakes;
pub mod noise;
pub mod problem;
mod rows;
pub mod scene;
pub mod shared_errors;
pub mod sisters;
pub mod start;
pub mod steps;
pub mod unseen;
pub mod volume;
pub mod whitened;
