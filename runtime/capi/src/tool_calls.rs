//! The implementation of the tool functions for both precisions; see `calls.rs`.

use poegp_runtime::math::se3::Pose;

use crate::calls::{answer_apart, finite};
use crate::memory::{self, Joints, usable};
use crate::types::{
    Forward, Inverse, Jacobian, Model, Number, POEGP_MAX_JOINTS, POEGP_STATUS_BAD_INPUT,
    POEGP_STATUS_NO_MODEL,
};

/// # Safety
/// As `poegp_forward`.
#[inline(always)]
pub(crate) unsafe fn forward<T: Number>(
    model: *const Model<T>,
    target_from_tool: *const T,
    joints: *const T,
    count: usize,
    payload_kg: T,
    out: *mut Forward<T>,
) -> i32 {
    if let Err(code) = usable(out).and(answer_apart(model, out)) {
        return code;
    }
    // SAFETY: the same contract.
    let asked = unsafe { ToolQuestion::read(model, target_from_tool, joints, count) };
    let (code, answer) = match asked {
        Err((code, status)) => {
            let answer = Forward {
                base_from_tool: Pose::identity().to_rows(),
                trust: T::ZERO,
                status,
            };
            (code, answer)
        }
        Ok(asked) => {
            let arm = asked.model.resident.model();
            let result = arm.tool_pose(&asked.tool, asked.joints.as_slice(), payload_kg);
            let answer = Forward {
                base_from_tool: result.pose.to_rows(),
                trust: result.trust,
                status: u32::from(result.status.bits()),
            };
            (asked.joints.fit(asked.model), answer)
        }
    };
    // SAFETY: not null, aligned, not in the model; the caller's by the contract of this function.
    unsafe { out.write(answer) };
    code
}

/// # Safety
/// As `poegp_inverse`.
#[inline(always)]
pub(crate) unsafe fn inverse<T: Number>(
    model: *const Model<T>,
    target_from_tool: *const T,
    base_from_tool: *const T,
    seed: *const T,
    count: usize,
    payload_kg: T,
    out: *mut Inverse<T>,
) -> i32 {
    if let Err(code) = usable(out).and(answer_apart(model, out)) {
        return code;
    }
    let stays = |seed: &[T], status| Inverse {
        joints: finite(seed),
        position_error: T::ZERO,
        rotation_error: T::ZERO,
        status,
    };
    // SAFETY: the same contract.
    let (code, answer) = match unsafe { Joints::read(seed, count) } {
        Err(code) => (code, stays(&[], POEGP_STATUS_BAD_INPUT)),
        Ok(joints) => {
            // SAFETY: the same contract.
            let wanted = unsafe { memory::pose(base_from_tool) }
                .map_err(|code| (code, POEGP_STATUS_BAD_INPUT));
            // SAFETY: the same contract.
            let asked = unsafe { ToolQuestion::read(model, target_from_tool, seed, count) };
            match wanted.and_then(|wanted| Ok((wanted, asked?))) {
                Err((code, status)) => (code, stays(joints.as_slice(), status)),
                Ok((wanted, asked)) => {
                    let arm = asked.model.resident.model();
                    let result =
                        arm.tool_inverse(&wanted, &asked.tool, joints.as_slice(), payload_kg);
                    let answer = Inverse {
                        joints: result.joints,
                        position_error: result.position_error,
                        rotation_error: result.rotation_error,
                        status: u32::from(result.status.bits()),
                    };
                    (asked.joints.fit(asked.model), answer)
                }
            }
        }
    };
    // SAFETY: not null, aligned, not in the model; the caller's by the contract of this function.
    unsafe { out.write(answer) };
    code
}

/// # Safety
/// As `poegp_jacobian`.
#[inline(always)]
pub(crate) unsafe fn jacobian<T: Number>(
    model: *const Model<T>,
    target_from_tool: *const T,
    joints: *const T,
    count: usize,
    payload_kg: T,
    out: *mut Jacobian<T>,
) -> i32 {
    if let Err(code) = usable(out).and(answer_apart(model, out)) {
        return code;
    }
    let mut rows = [[T::ZERO; POEGP_MAX_JOINTS]; 6];
    // SAFETY: the same contract.
    let asked = unsafe { ToolQuestion::read(model, target_from_tool, joints, count) };
    let (code, status) = match asked {
        Err((code, status)) => (code, status),
        Ok(asked) => {
            let arm = asked.model.resident.model();
            let result = arm.tool_jacobian(&asked.tool, asked.joints.as_slice(), payload_kg);
            for (r, row) in rows.iter_mut().enumerate() {
                for (slot, column) in row.iter_mut().zip(&result.columns) {
                    *slot = column.get(r).copied().unwrap_or(T::ZERO);
                }
            }
            (
                asked.joints.fit(asked.model),
                u32::from(result.status.bits()),
            )
        }
    };
    // SAFETY: not null, aligned, not in the model; the caller's by the contract of this function.
    unsafe { out.write(Jacobian { rows, status }) };
    code
}

/// The checked arguments of a tool function.
struct ToolQuestion<'a, T> {
    model: &'a Model<T>,
    tool: Pose<T>,
    joints: Joints<T>,
}

impl<T: Number> ToolQuestion<'_, T> {
    /// Copies the joints and the tool. If an argument cannot be used, returns an error code and the status to answer with.
    ///
    /// # Safety
    /// As `poegp_forward`.
    #[inline(always)]
    unsafe fn read(
        model: *const Model<T>,
        target_from_tool: *const T,
        joints: *const T,
        count: usize,
    ) -> Result<Self, (i32, u32)> {
        let unreadable = |code| (code, POEGP_STATUS_BAD_INPUT);
        Ok(Self {
            // SAFETY: the same contract.
            joints: unsafe { Joints::read(joints, count) }.map_err(unreadable)?,
            // SAFETY: the same contract.
            tool: unsafe { memory::pose_or_none(target_from_tool) }.map_err(unreadable)?,
            // SAFETY: the same contract.
            model: unsafe { memory::model(model) }.map_err(|code| (code, POEGP_STATUS_NO_MODEL))?,
        })
    }
}
