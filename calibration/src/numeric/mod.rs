//! Optimisation, factors, rotations and statistics.

pub mod cholesky;
pub mod lbfgs;
pub mod rotation;
pub mod statistics;
