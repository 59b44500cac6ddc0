//! Touches: the arm and everything that was touched, most probable together.

pub mod arm;
pub mod equations;
pub mod fit;
pub mod form;
pub mod jet;
pub mod scene;
pub mod start;
