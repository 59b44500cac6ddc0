//! Touches: the arm and everything that was touched, most probable together.

pub mod arm;
pub mod beyond;
pub mod distances;
pub mod equations;
pub mod fit;
pub mod form;
pub mod jet;
pub mod judge;
pub mod left_out;
pub mod noise;
pub mod problem;
mod rows;
pub mod scene;
pub mod sisters;
pub mod start;
pub mod unseen;
pub mod volume;
