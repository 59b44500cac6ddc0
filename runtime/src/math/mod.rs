//! Numbers and rigid motions.

pub mod scalar;
pub mod se3;
pub mod vector;
