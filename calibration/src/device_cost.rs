//! What an elastic model costs on the device, before it is made.
//!
//! Instructions of one evaluation on the Cortex-M4F, fitted to the counts of the emulated device (QEMU `-icount`,
//! `-C target-cpu=cortex-m4`, opt-level 3, LTO, rustc 1.95, innermost loops in assembly): within 5 % for arms of three to seven joints, within 10 %
//! when the firmware is built with Debian's 1.96; `tests/tests/device/cost.rs` measures again and prints. Instructions,
//! not cycles. Bytes are exact: the format's own lengths.

use poegp_protocol::JointKind;
use poegp_protocol::blob::{Blob, Correction, HEADER_LENGTH};
use poegp_runtime::elastic::curve::coefficient_count;
use poegp_runtime::elastic::position_variance::landmark_words;
use poegp_runtime::gp::inducing_sets::InducingSet;
use poegp_runtime::gp::joint_processes::JointProcesses;

/// An elastic model by its sizes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ElasticSize {
    /// Joints of the arm.
    pub joints: usize,
    /// How many of them slide.
    pub prismatic: usize,
    /// Inducing points of all joints together.
    pub points: usize,
    /// Words of their rows.
    pub words: usize,
    /// Payload groups.
    pub groups: usize,
    /// Payload groups that have points, counted for every joint.
    pub blocks: usize,
    /// Terms of gear ripple.
    pub ripple: usize,
    /// Orders of each joint's own-joint curve; 0 for none.
    pub curve_orders: usize,
    /// Landmarks of the standard deviation; 0 for none.
    pub landmarks: usize,
}

impl ElasticSize {
    /// The largest of an arm with so many joints and inducing points: kernels that look at all joints, points of every
    /// payload for every joint; no ripple, curves or landmarks.
    pub fn largest(joints: usize, prismatic: usize, points: usize, groups: usize) -> Self {
        Self {
            joints,
            prismatic,
            points,
            words: points * (2 * joints + 1),
            groups,
            blocks: (joints * groups).min(points),
            ripple: 0,
            curve_orders: 0,
            landmarks: 0,
        }
    }

    /// The same with these processes.
    pub fn with_processes(self, processes: &JointProcesses<f64>) -> Self {
        let blocks = |set: &InducingSet| set.points().iter().filter(|points| **points > 0).count();
        Self {
            points: processes.points(),
            words: processes.words(),
            groups: processes.group_payloads_kg.len(),
            blocks: processes.sets.iter().map(blocks).sum(),
            ..self
        }
    }

    /// That of a blob; `None` when it has no elastic correction.
    pub fn of_blob(blob: &Blob<'_>) -> Option<Self> {
        let Correction::Elastic(elastic) = &blob.correction else {
            return None;
        };
        let sliding = |j: &&poegp_protocol::blob::Joint| j.kind == JointKind::Prismatic;
        let points = || elastic.sets.iter().flatten();
        Some(Self {
            joints: blob.robot.joints.len(),
            prismatic: blob.robot.joints.iter().filter(sliding).count(),
            points: points().map(|p| usize::from(*p)).sum(),
            words: elastic.rows.len() / 4,
            groups: elastic.group_payloads_kg.len(),
            blocks: points().filter(|p| **p > 0).count(),
            ripple: elastic.ripple.len(),
            curve_orders: elastic.curves.len() / (8 * blob.robot.joints.len().max(1)),
            landmarks: blob
                .variance
                .as_ref()
                .map_or(0, |v| usize::from(v.landmarks)),
        })
    }
}

/// Instructions of one inducing point whose row has so many words; more when a joint of the arm slides.
pub fn set_row_instructions(words: usize, sliding: bool) -> f64 {
    if sliding {
        37.6 + 11.49 * words as f64
    } else {
        14.5 + 2.1 * words as f64
    }
}

/// Instructions of one payload group of a joint beside its rows.
pub fn set_block_instructions(sliding: bool) -> f64 {
    if sliding { 51.4 } else { 56.0 }
}

/// Instructions of the inducing points of all joints.
fn point_instructions(size: &ElasticSize) -> f64 {
    let (sliding, n) = (size.prismatic > 0, size.joints as f64);
    // Every joint scales the query by the rates of the joints that it looks at.
    let mean_words = size.words as f64 / size.points.max(1) as f64;
    let each = if sliding {
        172.0 + 74.5 * n
    } else {
        164.0 + n * (97.0 + 7.6 * mean_words)
    };
    let row = set_row_instructions(0, sliding);
    let word = set_row_instructions(1, sliding) - row;
    each + size.blocks as f64 * set_block_instructions(sliding)
        + size.points as f64 * row
        + size.words as f64 * word
}

/// Instructions of one evaluation on a Cortex-M4F, by the cost model.
pub fn evaluation_instructions(size: &ElasticSize) -> u64 {
    let n = size.joints as f64;
    let sliding = if size.prismatic > 0 { 1.0 } else { 0.0 };
    // Chain twice, gravity terms of an upright arm (any other takes some 200 more), twist, bound.
    let mut count = 947.0 + n * (347.5 + n * 8.0) - 34.0 * sliding * n;
    // Trust.
    count += 30.0 + 37.0 * n;
    count += 67.5 * size.ripple as f64;
    if size.curve_orders > 0 {
        count += (n - size.prismatic as f64) * (77.0 + 14.7 * size.curve_orders as f64);
    }
    if size.points > 0 {
        count += point_instructions(size);
    }
    if size.landmarks > 0 {
        let l = size.landmarks as f64;
        count += 270.0 + 122.0 * n + l * (90.0 + 16.0 * n + l * 4.0);
    }
    count as u64
}

/// Bytes of a number as postcard writes lengths.
const fn varint(value: usize) -> usize {
    let mut bytes = 1;
    let mut rest = value >> 7;
    while rest > 0 {
        bytes += 1;
        rest >>= 7;
    }
    bytes
}

/// Bytes of the blob of an arm without coupling, all of whose joints have limits. `texts` are the lengths of robot name,
/// serial number, model, trainer version and date.
pub fn blob_bytes(size: &ElasticSize, texts: [usize; 5]) -> usize {
    let (n, floats) = (size.joints, 4);
    let text = |lengths: &[usize]| -> usize { lengths.iter().map(|l| varint(*l) + l).sum() };
    // Kind, `Option` and two limits; the trained range.
    let joints = 1 + n * 10 + 1 + n * 8;
    let frames = 2 * (1 + (n + 1) * 12 * floats);
    // No coupling, units, range of the payload, warnings.
    let rest = 1 + 3 + 9 + 4;
    // Number of the variant, bound, gravity.
    let mut elastic = 1 + 2 * floats + 3 * floats;
    elastic += 1 + n * (n + 1) / 2 * 3 * floats;
    elastic += 1 + n * 4 * floats;
    elastic += 1 + size.ripple * (1 + 3 * floats);
    let processes = if size.points > 0 { n } else { 0 };
    elastic += 1 + processes * (1 + n * floats + 3 * floats);
    elastic += 1 + size.groups * floats;
    let rows = floats * size.words;
    let mut variance = 1;
    if size.landmarks > 0 {
        let words: usize = (0..size.landmarks).map(|l| landmark_words(n, l)).sum();
        variance += 4 * floats + 1 + n * floats + 1 + varint(floats * words) + floats * words;
    }
    // A number for each group of each set, all below 128.
    let sets = 1 + processes * (1 + size.groups);
    let curves = floats * coefficient_count(n, size.curve_orders);
    let correction = elastic + varint(rows) + rows + sets + varint(curves) + curves;
    let (robot, provenance) = texts.split_at(2);
    // SHA-256, number of poses (of up to 127), gauge, no tools, accepted causes.
    let host = text(provenance) + 32 + 1 + 2 * 12 * 8 + 1 + 4;
    let model = text(robot) + joints + frames + rest + correction + variance;
    HEADER_LENGTH + model + varint(host) + host
}
