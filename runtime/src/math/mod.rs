//! Numbers and rigid motions.

pub mod fourier;
pub mod scalar;
pub mod se3;
pub mod vector;
