//! Gaussian processes for what geometry does not explain.

pub mod elastic;
pub mod landmarks;
pub mod task_space;
