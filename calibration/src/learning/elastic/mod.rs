//! The elastic model: POE, gravity terms, gear ripple and joint-space processes, solved together.
//!
//! T = POE(C (q + φ(q, m) θ + ripple(q) + h(q) + δ(q, m))) is linearised as y = A x + Σ_c J_c (h_c + δ_c) + noise. The
//! parameters x (frames, gravity coefficients, ripple) have a Gaussian prior, h_c are Gaussian processes of a joint's own
//! angle, and δ_c are Gaussian processes of joints and payload. One generalised least-squares solution gives all of them;
//! the hyperparameters maximise the marginal likelihood.

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
