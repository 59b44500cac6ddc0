//! Keeps what an evaluation shows, in the form of a `Trace`.

use heapless::Vec;
use poegp_protocol::limits::{MAX_JOINTS, OUTPUTS};

use crate::model::Observer;
use crate::poe::JointMotion;
use crate::se3::Pose;

/// Intermediate results of one evaluation.
#[derive(Clone, Debug)]
pub struct Record {
    /// Sine and cosine of each joint.
    pub sin_cos: Vec<f32, { 2 * MAX_JOINTS }>,
    /// FNV-1a over the bits of the kernel values.
    pub kernel_hash: u32,
    /// Posterior mean.
    pub mean: [f32; OUTPUTS],
    /// f(q).
    pub chain: [f32; 12],
}

impl Default for Record {
    fn default() -> Self {
        Self::new()
    }
}

impl Record {
    /// Nothing seen yet.
    pub const fn new() -> Self {
        Self {
            sin_cos: Vec::new(),
            kernel_hash: 0x811c_9dc5,
            mean: [0.0; OUTPUTS],
            chain: [0.0; 12],
        }
    }
}

impl Observer<f32> for Record {
    fn motions(&mut self, motions: &[JointMotion<f32>]) {
        for motion in motions {
            // Room for all joints.
            let _ = self.sin_cos.extend_from_slice(&[motion.sin, motion.cos]);
        }
    }
    fn chain(&mut self, pose: &Pose<f32>) {
        self.chain = pose.to_rows();
    }
    fn kernel(&mut self, value: f32) {
        for byte in value.to_bits().to_le_bytes() {
            self.kernel_hash = (self.kernel_hash ^ u32::from(byte)).wrapping_mul(0x0100_0193);
        }
    }
    fn mean(&mut self, mean: &[f32; OUTPUTS]) {
        self.mean = *mean;
    }
    fn deflection(&mut self, deflection: &[f32; MAX_JOINTS]) {
        for (slot, value) in self.mean.iter_mut().zip(deflection) {
            *slot = *value;
        }
    }
}
