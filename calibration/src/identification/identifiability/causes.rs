//! Known causes of unidentified directions: joints that stand still, one orientation throughout, positions only; also
//! payloads.

use nalgebra::Vector3;
use poegp_protocol::JointKind;
use poegp_runtime::math::se3::{Pose, Twist};

use crate::identification::identifiability::frames::{Frame, Role, Task};
use crate::identification::identifiability::wording::{list, numbers};
use crate::numeric::matrix::Mat;
use crate::numeric::rotation::angle_between;
use crate::numeric::statistics::extremes;
use crate::robot::{own_motion, still_span};

/// Largest rotation from the first orientation, in rad, at which all orientations count as one.
const ONE_ORIENTATION: f64 = 0.5 * std::f64::consts::PI / 180.0;
/// Absolute correlation above which a payload and a joint change together.
const TOGETHER: f64 = 0.95;

/// A cause of unidentified directions. Columns are in the order of the task's frames.
pub struct Cause {
    /// Description in one sentence.
    pub text: String,
    /// Advice on what to measure; `None` where there is none.
    pub remedy: Option<&'static str>,
    /// Directions that the cause hides, as columns; not orthonormal.
    pub directions: Mat<f64>,
}

/// Returns the span of a joint's values, and whether the joint stands still.
fn span(values: impl Iterator<Item = f64>, kind: JointKind) -> (f64, bool) {
    let (low, high) = extremes(values);
    (high - low, high - low < still_span(kind))
}

/// Returns the joints of the serial chain that stand still, numbered from 1, and the widest of their spans.
fn still_joints(task: &Task) -> (Vec<usize>, f64) {
    let mut widest = 0.0_f64;
    let kinds = task.chain.kinds();
    let joints = (0..kinds.len())
        .filter(|i| {
            let (span, still) = span(task.samples.iter().map(|s| s.serial_joints[*i]), kinds[*i]);
            if still {
                widest = widest.max(span);
            }
            still
        })
        .map(|i| i + 1)
        .collect();
    (joints, widest)
}

/// Returns the geometric causes that apply to `task`.
pub fn geometric(task: &Task, frames: &[Frame]) -> Vec<Cause> {
    [positions_only, still, one_orientation]
        .into_iter()
        .filter_map(|cause| cause(task, frames))
        .collect()
}

/// Assembles direction columns from lists of (index of the frame, twist).
fn columns(frames: &[Frame], directions: &[Vec<(usize, Twist<f64>)>]) -> Mat<f64> {
    let mut out = Mat::zeros(6 * frames.len(), directions.len());
    for (j, parts) in directions.iter().enumerate() {
        for (frame, twist) in parts {
            for (axis, value) in twist.to_array().into_iter().enumerate() {
                out[(6 * frame + axis, j)] += value;
            }
        }
    }
    out
}

fn unit(axis: usize) -> Twist<f64> {
    Twist::from_array(&std::array::from_fn(|i| f64::from(u8::from(i == axis))))
}

fn negative(twist: &Twist<f64>) -> Twist<f64> {
    Twist::from_array(&twist.to_array().map(|x| -x))
}

fn tools(frames: &[Frame]) -> impl Iterator<Item = usize> {
    (0..frames.len()).filter(|f| matches!(frames[*f].role, Role::Tool(_)))
}

fn positions_only(task: &Task, frames: &[Frame]) -> Option<Cause> {
    let joint_from_first = task.chain.frames().last()?;
    let n = task.chain.kinds().len();
    let without: Vec<usize> = tools(frames)
        .filter(|f| {
            let tool = frames[*f].position - n;
            let mut own = task.samples.iter().filter(|s| s.tool == tool);
            own.all(|s| !s.observation.has_orientation())
        })
        .collect();
    let turns = without.iter().flat_map(|f| {
        let joint_from_target = *joint_from_first * task.tools[frames[*f].position - n];
        (3..6).map(move |axis| vec![(*f, joint_from_target.transform_twist(&unit(axis)))])
    });
    let directions: Vec<_> = turns.collect();
    (!directions.is_empty()).then(|| Cause {
        text: "only positions were measured: the tool's orientation cannot be determined".into(),
        // A point target needs no orientation, and a target further out is proposed by what it gains.
        remedy: None,
        directions: columns(frames, &directions),
    })
}

fn still(task: &Task, frames: &[Frame]) -> Option<Cause> {
    let (joints, widest) = still_joints(task);
    let n = task.chain.kinds().len();
    let mut directions = Vec::new();
    for joint in &joints {
        let mean = task
            .samples
            .iter()
            .map(|s| s.serial_joints[joint - 1])
            .sum::<f64>()
            / task.samples.len() as f64;
        let axis = own_motion(task.chain.kinds()[joint - 1]);
        let motion = Pose::exp(&Twist::from_array(&unit(axis).to_array().map(|x| x * mean)));
        // Move the frame before the joint by ξ and the frame behind it back: Z(q)⁻¹ Exp(ξ) Z(q) is the same at every
        // pose.
        for i in 0..6 {
            let before = task.chain.frames()[joint - 1].transform_twist(&unit(i));
            let behind = negative(&motion.inverse().transform_twist(&unit(i)));
            let mut parts = Vec::new();
            for (index, frame) in frames.iter().enumerate() {
                if frame.position == joint - 1 {
                    parts.push((index, before));
                } else if frame.position == *joint || (*joint == n && frame.position > n) {
                    parts.push((index, behind));
                }
            }
            if parts.len() > 1 {
                directions.push(parts);
            }
        }
    }
    if directions.is_empty() {
        return None;
    }
    let turning = |joint: &usize| task.chain.kinds()[joint - 1] == JointKind::Revolute;
    let within = if joints.iter().all(turning) {
        format!(" (all values within {:.3}°)", widest.to_degrees().max(1e-3))
    } else {
        String::new()
    };
    let text = match joints.as_slice() {
        [joint] => format!(
            "joint {joint} never moves{within}: its offset, where its axis lies and the frames on both sides of it cannot be distinguished"
        ),
        _ => format!(
            "joints {} never move{within}: their offsets, where their axes lie and the frames on both sides of them cannot be distinguished",
            numbers(&joints)
        ),
    };
    Some(Cause {
        text,
        remedy: Some("Move every joint in some of the poses"),
        directions: columns(frames, &directions),
    })
}

fn one_orientation(task: &Task, frames: &[Frame]) -> Option<Cause> {
    let poses: Vec<Pose<f64>> = task
        .samples
        .iter()
        .map(|s| task.chain.forward(&s.serial_joints))
        .collect();
    let first = poses.first()?;
    let widest = poses
        .iter()
        .map(|p| angle_between(first, p))
        .fold(0.0, f64::max);
    if widest > ONE_ORIENTATION {
        return None;
    }
    // Move the base by e and the tool back: joint_from_base · e is the same at every pose.
    let joint_from_target = task.chain.frames().last()?;
    let base_from_joint = first.rotation * joint_from_target.rotation.transpose();
    let directions: Vec<_> = (0..3)
        .map(|axis| {
            let mut e = Vector3::zeros();
            e[axis] = 1.0;
            let back = Twist {
                linear: -(base_from_joint.transpose() * e),
                angular: Vector3::zeros(),
            };
            let mut parts = vec![(0, unit(axis))];
            parts.extend(tools(frames).map(|tool| (tool, back)));
            parts
        })
        .collect();
    Some(Cause {
        remedy: Some("Turn the tool in some of the poses"),
        text: format!(
            "all poses have the same tool orientation (within {:.2}°): the base's and the tool's positions cannot be distinguished",
            widest.to_degrees()
        ),
        directions: columns(frames, &directions),
    })
}

/// Returns a sentence if there are fewer equations than identifiable directions.
pub fn too_few(task: &Task, possible: usize) -> Option<String> {
    let equations: usize = task.samples.iter().map(|s| s.observation.equations()).sum();
    (equations < possible).then(|| {
        format!(
            "{} poses give {equations} equations for {possible} unknowns: measure more",
            task.samples.len()
        )
    })
}

/// Returns the reasons why these poses do not identify the effect of payloads, each with advice.
pub fn payload(task: &Task) -> Vec<(String, &'static str)> {
    let payloads: Vec<f64> = task.samples.iter().filter_map(|s| s.payload_kg).collect();
    let mut out = Vec::new();
    if payloads.len() < task.samples.len() || payloads.iter().all(|m| *m == payloads[0]) {
        return out;
    }
    let kinds = task.chain.kinds();
    let values = |i: usize| task.samples.iter().map(move |s| s.joints[i]);
    let moves = |i: &usize| !span(values(*i), kinds[*i]).1;
    let driven = (0..kinds.len()).filter(|i| !task.robot.is_passive(*i));
    let (moving, still): (Vec<usize>, Vec<usize>) = driven.partition(moves);
    let count = |joints: &[usize]| numbers(&joints.iter().map(|i| i + 1).collect::<Vec<_>>());
    if !still.is_empty() && !moving.is_empty() {
        let (joints, verb) = if moving.len() == 1 {
            ("joint", "moves")
        } else {
            ("joints", "move")
        };
        let text = format!(
            "under these payloads only {joints} {} {verb}: how the load bends the arm elsewhere is unknown",
            count(&moving)
        );
        out.push((text, "Move all joints under each payload"));
    }
    let together: Vec<usize> = moving
        .iter()
        .copied()
        .filter(|i| correlation(&payloads, &values(*i).collect::<Vec<_>>()).abs() > TOGETHER)
        .collect();
    if !together.is_empty() {
        let text = format!(
            "the payload changes only together with joint {}: their effects cannot be distinguished",
            count(&together)
        );
        out.push((text, "Measure the same poses with each payload"));
    }
    let with_tool = |k: usize| {
        let tool = task.samples[k].tool;
        let mut same = (0..payloads.len()).filter(|j| task.samples[*j].tool == tool);
        same.all(|j| payloads[j] == payloads[k])
    };
    if (0..payloads.len()).all(with_tool) {
        let what = [
            "a displacement by the load",
            "the tool's frame of its session",
        ];
        let text = format!(
            "the payload changes only where the target was remounted: {} cannot be distinguished",
            list(&what.map(str::to_owned))
        );
        let remedy = "Measure two payloads without mounting the target again between them";
        out.push((text, remedy));
    }
    out
}

fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    let (ma, mb) = (mean(a), mean(b));
    let product = |f: &dyn Fn(f64, f64) -> f64| -> f64 {
        a.iter().zip(b).map(|(x, y)| f(x - ma, y - mb)).sum()
    };
    let scale = (product(&|x, _| x * x) * product(&|_, y| y * y)).sqrt();
    if scale > 0.0 {
        product(&|x, y| x * y) / scale
    } else {
        0.0
    }
}
