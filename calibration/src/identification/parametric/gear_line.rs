//! Frequencies of gear ripple: errors of a gear that repeat many times in one turn of its joint.

/// A frequency of gear ripple.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GearLine {
    /// Index of the joint, from 0.
    pub joint: usize,
    /// Cycles per turn of the joint.
    pub cycles: f64,
    /// Whether the robot's description states it; otherwise it was found in the measurements.
    pub is_stated: bool,
}

impl GearLine {
    /// Creates a frequency that was found in the measurements.
    pub fn found(joint: usize, cycles: f64) -> Self {
        Self {
            joint,
            cycles,
            is_stated: false,
        }
    }

    /// Creates a frequency that the robot's description states.
    pub fn stated(joint: usize, cycles: f64) -> Self {
        Self {
            is_stated: true,
            ..Self::found(joint, cycles)
        }
    }
}

/// A pair of frequencies that the measured joint values cannot distinguish. Neither is used.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AmbiguousLine {
    /// Index of the joint, from 0.
    pub joint: usize,
    /// Cycles per turn of the joint.
    pub cycles: f64,
    /// The other frequency.
    pub alias: f64,
}
