//! Optimisation, factors, rotations and statistics; numbers as text; work on all cores.

pub mod cholesky;
pub mod decimal;
pub mod lbfgs;
pub mod parallel;
pub mod rotation;
pub mod statistics;
