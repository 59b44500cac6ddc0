//! Matrices, optimisation, rotations and statistics; formatting of numbers; parallel work on all cores.

pub mod cholesky;
pub mod decimal;
pub mod halton;
pub mod lbfgs;
pub mod matrix;
pub mod parallel;
pub mod product;
pub mod rotation;
pub mod statistics;
pub mod svd;
pub mod triangular;
pub mod vectors;
