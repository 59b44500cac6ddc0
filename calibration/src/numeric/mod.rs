//! Optimisation, factors and statistics.

pub mod cholesky;
pub mod lbfgs;
pub mod statistics;
