//! The elastic model: POE, gravity terms, gear ripple and joint-space processes, solved together.
//!
//! T = POE(C (q + φ(q, m) θ + ripple(q) + δ(q, m))), with y = A x + Σ_c J_c δ_c + noise linearised around it: frames,
//! gravity coefficients and ripple x under a Gaussian prior, δ_c Gaussian processes of joints and payload. One generalised
//! least-squares solution for all of it, hyperparameters by the marginal likelihood.

pub mod device_sigma;
pub mod fit;
pub mod hyperparameters;
pub mod inflation;
pub mod likelihood;
pub mod model;
pub mod outliers;
pub mod parameters;

pub mod ripple;
pub mod sets;
pub mod state;
pub mod support;
pub mod uncertainty;
