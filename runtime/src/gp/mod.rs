//! Gaussian processes as the device evaluates them: the paper's quadratic kernel, the processes of each joint, and the
//! innermost loops of both.

pub mod inducing_sets;
pub mod joint_kernel;
pub mod joint_processes;
pub(crate) mod loops;
pub mod quadratic_kernel;
pub mod quadratic_posterior;
pub mod quadratic_variance;

pub use loops::KernelLoops;
