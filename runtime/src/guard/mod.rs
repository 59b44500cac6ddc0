//! Safeguards of an answer: the limit of the correction, the extrapolation score, and the status bits.

pub mod limit;
pub mod status;
pub mod trust;
