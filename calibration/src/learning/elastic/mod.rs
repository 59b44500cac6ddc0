//! The elastic model: POE, gravity terms, gear ripple and joint-space processes, solved together.
//!
//! T = POE(C (q + φ(q, m) θ + ripple(q) + δ(q, m))), with y = A x + Σ_c J_c δ_c + noise linearised around it: frames,
//! gravity coefficients and ripple x under a Gaussian prior, δ_c Gaussian processes of joints and payload. One generalised
//! least-squares solution for all of it, hyperparameters by the marginal likelihood.

pub mod device_variance;
pub mod fit;
pub mod hyperparameters;
pub mod inducing_points;
pub mod inducing_sets;
pub mod likelihood;
pub mod options;
pub mod outliers;
pub mod posterior_covariance;
pub mod predictive_variance;
pub mod reduced_model;
pub mod solution;
pub mod variance_inflation;
