//! The elastic model: POE, gravity terms, gear ripple and joint-space processes, solved together.
//!
//! T = POE(C (q + φ(q, m) θ + ripple(q) + h(q) + δ(q, m))), with y = A x + Σ_c J_c (h_c + δ_c) + noise linearised around it:
//! frames, gravity coefficients and ripple x under a Gaussian prior, h_c Gaussian processes of a joint's own angle, δ_c
//! Gaussian processes of joints and payload. One generalised least-squares solution for all of it, hyperparameters by the
//! marginal likelihood.

pub mod device_variance;
pub mod fit;
pub mod hyperparameter_objective;
pub mod hyperparameter_search;
pub mod hyperparameters;
pub mod inducing_sets;
pub mod inputs;
pub mod likelihood;
pub mod options;
pub mod outliers;
pub mod own_joint_curve;
pub mod posterior_covariance;
pub mod predictive_variance;
pub mod reduced_model;
pub mod reduced_solution;
pub mod solution;
pub mod variance_inflation;
pub mod warm_up;
