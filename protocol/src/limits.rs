//! Sizes that both sides rely on.

/// Most joints of an arm.
pub const MAX_JOINTS: usize = 8;
/// Fixed frames of the longest chain: one before every joint and one to the tool.
pub const MAX_FRAMES: usize = MAX_JOINTS + 1;
/// Inputs of the Gaussian process: the joints and the payload.
pub const MAX_INPUTS: usize = MAX_JOINTS + 1;
/// Outputs of the task-space Gaussian process: a twist (v, ω).
pub const OUTPUTS: usize = 6;
/// Most gear-ripple terms of an elastic correction.
pub const MAX_RIPPLE: usize = 16;
/// Highest order of an own-joint curve: cycles per turn of the joint.
pub const MAX_CURVE_ORDER: usize = 64;
/// Most payload groups of its inducing points.
pub const MAX_GROUPS: usize = 16;
/// Pairs (joint, link at or beyond it) of the longest arm.
pub const MAX_LINK_TERMS: usize = MAX_JOINTS * (MAX_JOINTS + 1) / 2;
/// Most tools of a calibration: one for each session and target.
pub const MAX_TOOLS: usize = 16;
/// Most landmarks of the variance of an elastic correction.
pub const MAX_LANDMARKS: usize = 16;
/// Most landmarks of the variance of a correction in task space.
pub const MAX_TASK_SPACE_LANDMARKS: usize = 48;
