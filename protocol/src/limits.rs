//! Maximum sizes that the trainer and the device rely on.

/// Maximum number of joints of an arm.
pub const MAX_JOINTS: usize = 8;
/// Maximum number of fixed frames of a chain: one before every joint and one to the tool.
pub const MAX_FRAMES: usize = MAX_JOINTS + 1;
/// Maximum number of inputs of the Gaussian process: the joints and the payload.
pub const MAX_INPUTS: usize = MAX_JOINTS + 1;
/// Number of outputs of the task-space Gaussian process: the components of a twist (v, ω).
pub const OUTPUTS: usize = 6;
/// Maximum number of gear-ripple terms of an elastic correction.
pub const MAX_RIPPLE: usize = 16;
/// Highest order of an own-joint curve, in cycles per turn of the joint.
pub const MAX_CURVE_ORDER: usize = 64;
/// Maximum number of payload groups of the inducing points of an elastic correction.
pub const MAX_GROUPS: usize = 16;
/// Maximum number of pairs (joint, link at or beyond that joint) of an arm.
pub const MAX_LINK_TERMS: usize = MAX_JOINTS * (MAX_JOINTS + 1) / 2;
/// Maximum number of tools of a calibration: one for each session and target.
pub const MAX_TOOLS: usize = 16;
/// Maximum number of variance landmarks of an elastic correction.
pub const MAX_LANDMARKS: usize = 16;
/// Maximum number of variance landmarks of a task-space correction.
pub const MAX_TASK_SPACE_LANDMARKS: usize = 48;

/// Largest element of a coupling matrix. With it, serial joints stay within 65 536 rad, where sine and cosine in `f32` are
/// within 1e-6.
pub const MAX_COUPLING: f32 = 2.0;
