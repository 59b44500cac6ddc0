//! Results computed from held-out errors.

mod candidates;
pub mod command_change;
pub mod conformity;
pub mod cross_validation;
pub mod device_budget;
pub mod drift_fit;
pub mod held_out;
pub mod learning_curve;
pub mod model_selection;
pub mod next_steps;
pub mod repeated_poses;
pub mod signed_residuals;
pub mod touches;
pub mod work_volume;
pub mod worst_payload;
