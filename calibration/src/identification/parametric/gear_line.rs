//! Frequencies of gear ripple: errors of a gear that repeat many times in one turn of its joint.

/// A frequency of gear ripple.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GearLine {
    /// The joint, from 0.
    pub joint: usize,
    /// Cycles per turn of the joint.
    pub cycles: f64,
    /// Whether the robot's description states it; else it was found in the measurements.
    pub is_stated: bool,
}

impl GearLine {
    /// One that was found.
    pub fn found(joint: usize, cycles: f64) -> Self {
        Self {
            joint,
            cycles,
            is_stated: false,
        }
    }

    /// One that the robot's description states.
    pub fn stated(joint: usize, cycles: f64) -> Self {
        Self {
            is_stated: true,
            ..Self::found(joint, cycles)
        }
    }
}

/// A frequency that the measured joint values cannot distinguish from another one. Neither is taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AmbiguousLine {
    /// The joint, from 0.
    pub joint: usize,
    /// Cycles per turn of the joint.
    pub cycles: f64,
    /// The other frequency.
    pub alias: f64,
}
