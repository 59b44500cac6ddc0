//! A tool on the target: its pose on the calibrated arm, and its Jacobian by the controller's joints.
//!
//! ```text
//! base_from_tool = T_gp(q, m) f(q) · target_from_tool
//! J = POE′(C q) C        at the origin of the tool
//! ```
//!
//! J treats the correction as constant: its own derivative would change a column by some thousandths. Corrected commands and
//! [`crate::correct::inverse`] take their steps with these columns, too.

use poegp_protocol::limits::MAX_JOINTS;

use crate::guard::status::Status;
use crate::kinematics::coupling::PerJoint;
use crate::kinematics::minimal_chain::JointFrames;
use crate::kinematics::newton::{Jacobian, LinearizationPoint, NormalEquations};
use crate::kinematics::poe::zero_joint_trig;
use crate::math::se3::Pose;
use crate::model::Model;
use crate::model::arm::Arm;
use crate::model::evaluate::CompiledEvaluation;
use crate::model::validate::is_pose;
use crate::trace::Stages;

/// The answer of [`Model::tool_pose`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToolPose<T> {
    /// Pose `base_from_tool`; the identity without a model, or for invalid joints or an invalid tool.
    pub pose: Pose<T>,
    /// Extrapolation score, as [`crate::model::Evaluation::trust`].
    pub trust: T,
    /// How far the answer can be trusted, as for [`Model::evaluate`].
    pub status: Status,
}

/// The answer of [`Model::tool_jacobian`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToolJacobian<T> {
    /// One column for each controller joint, zeros beyond: first the velocity of the tool's origin along the axes of the
    /// base, in m per rad or m, then its angular velocity along the same axes, in rad per rad or m. All zero without a
    /// model, or for invalid joints or an invalid tool.
    pub columns: Jacobian<T>,
    /// How far the answer can be trusted, as for [`Model::evaluate`].
    pub status: Status,
}

impl<T: CompiledEvaluation, const WORDS: usize> Model<T, WORDS> {
    /// Returns the pose of a tool on the calibrated arm, at the controller's joints (rad or m) and with a payload in kg.
    #[inline(never)]
    pub fn tool_pose(
        &self,
        target_from_tool: &Pose<T>,
        joints: &[T],
        payload_kg: T,
    ) -> ToolPose<T> {
        match self.asked(target_from_tool, joints) {
            Ok(_) => {
                let there = T::evaluate(self.view(), joints, payload_kg, &mut Stages::new());
                ToolPose {
                    pose: there.pose * *target_from_tool,
                    trust: there.trust,
                    status: there.status,
                }
            }
            Err(status) => ToolPose {
                pose: Pose::identity(),
                trust: T::ZERO,
                status,
            },
        }
    }

    /// Returns the Jacobian of a tool on the calibrated arm, at the controller's joints (rad or m) and with a payload in kg.
    #[inline(never)]
    pub fn tool_jacobian(
        &self,
        target_from_tool: &Pose<T>,
        joints: &[T],
        payload_kg: T,
    ) -> ToolJacobian<T> {
        let tool = self.tool_pose(target_from_tool, joints, payload_kg);
        let mut equations = NormalEquations::new();
        if let Ok((arm, joints)) = self.asked(target_from_tool, joints) {
            let mut motions = zero_joint_trig();
            arm.motions(&joints, &mut motions);
            let mut frames = JointFrames::new();
            arm.calibrated.moved_frames_at(&motions, &mut frames);
            equations.form(&LinearizationPoint {
                kinds: arm.calibrated.kinds(),
                frames: &frames,
                point: &tool.pose.translation,
                coupling: arm.coupling.as_ref(),
            });
        }
        ToolJacobian {
            columns: *equations.columns(),
            status: tool.status,
        }
    }

    /// Returns the arm and its joints, or the status that says why there is no answer.
    fn asked(
        &self,
        target_from_tool: &Pose<T>,
        joints: &[T],
    ) -> Result<(&Arm<T>, PerJoint<T>), Status> {
        let arm = self.view().arm.ok_or(Status::NO_MODEL)?;
        let mut x = [T::ZERO; MAX_JOINTS];
        if arm.take_joints(joints, &mut x) && is_pose(target_from_tool) {
            Ok((arm, x))
        } else {
            Err(Status::BAD_INPUT)
        }
    }
}
