//! Gaussian processes for the errors that geometry does not explain.

pub mod elastic;
pub mod landmarks;
pub mod task_space;
