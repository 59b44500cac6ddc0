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
use poegp_runtime::gp::joint_processes::JointProcesses;

/// An elastic model by its sizes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ElasticSize {
    /// Joints of the arm.
    pub joints: usize,
    /// How many of them slide.
    pub prismatic: usize,
    /// Support points, of all sets together where each joint has its own.
    pub support: usize,
    /// Payload groups.
    pub groups: usize,
    /// Whether all joints have one set of length scales.
    pub tied: bool,
    /// Terms of gear ripple.
    pub ripple: usize,
    /// Orders of each joint's own-joint curve; 0 for none.
    pub curve_orders: usize,
    /// Landmarks of the standard deviation; 0 for none.
    pub landmarks: usize,
    /// Of support sets of its own for each joint.
    pub sets: Option<SetSizes>,
}

/// Support sets of all joints by their sizes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SetSizes {
    /// Words of the rows.
    pub words: usize,
    /// Payload groups that have rows, counted in every set.
    pub blocks: usize,
}

impl SetSizes {
    /// Of a model with support sets; `None` without them.
    pub fn of(processes: &JointProcesses<f64>) -> Option<Self> {
        let mut out = Self {
            words: 0,
            blocks: 0,
        };
        for set in &processes.sets {
            out.words += set.words();
            out.blocks += set.points().iter().filter(|points| **points > 0).count();
        }
        (!processes.sets.is_empty()).then_some(out)
    }

    /// Of kernels that look at all joints, with points of every payload in every set.
    pub fn largest(joints: usize, points: usize, groups: usize) -> Self {
        Self {
            words: points * (2 * joints + 1),
            blocks: (joints * groups).min(points),
        }
    }
}

impl ElasticSize {
    /// That of a blob with `support` points; `None` when it has no elastic correction.
    pub fn of_blob(blob: &Blob<'_>, support: usize) -> Option<Self> {
        let Correction::Elastic(elastic) = &blob.correction else {
            return None;
        };
        let sliding = |j: &&poegp_protocol::blob::Joint| j.kind == JointKind::Prismatic;
        Some(Self {
            joints: blob.robot.joints.len(),
            prismatic: blob.robot.joints.iter().filter(sliding).count(),
            support,
            groups: elastic.groups.len(),
            tied: elastic.tied,
            ripple: elastic.ripple.len(),
            curve_orders: elastic.curves.len() / (8 * blob.robot.joints.len().max(1)),
            landmarks: blob
                .variance
                .as_ref()
                .map_or(0, |v| usize::from(v.landmarks)),
            sets: (!elastic.sets.is_empty()).then(|| SetSizes {
                words: elastic.rows.len() / 4,
                blocks: elastic.sets.iter().flatten().filter(|p| **p > 0).count(),
            }),
        })
    }

    /// Whether the device has an unrolled loop for the support points of this arm.
    fn unrolled(&self) -> bool {
        self.prismatic == 0 && matches!(self.joints, 5..=7)
    }
}

/// Instructions of one row of a support set of so many words; more when a joint of the arm slides.
pub fn set_row_instructions(words: usize, sliding: bool) -> f64 {
    if sliding {
        37.6 + 11.49 * words as f64
    } else {
        14.5 + 2.1 * words as f64
    }
}

/// Instructions of one payload group of a support set beside its rows.
pub fn set_block_instructions(sliding: bool) -> f64 {
    if sliding { 51.4 } else { 56.0 }
}

/// Instructions of support sets.
fn set_instructions(size: &ElasticSize, sets: &SetSizes) -> f64 {
    let (sliding, n) = (size.prismatic > 0, size.joints as f64);
    // Every joint scales the query by the rates of the joints that it looks at.
    let mean_words = sets.words as f64 / size.support.max(1) as f64;
    let each = if sliding {
        172.0 + 74.5 * n
    } else {
        164.0 + n * (97.0 + 7.6 * mean_words)
    };
    let row = set_row_instructions(0, sliding);
    let word = set_row_instructions(1, sliding) - row;
    each + sets.blocks as f64 * set_block_instructions(sliding)
        + size.support as f64 * row
        + sets.words as f64 * word
}

/// Instructions of one evaluation on a Cortex-M4F, by the cost model.
pub fn evaluation_instructions(size: &ElasticSize) -> u64 {
    let n = size.joints as f64;
    let sliding = if size.prismatic > 0 { 1.0 } else { 0.0 };
    // Chain twice, gravity terms of an upright arm (any other takes some 200 more), twist, bound.
    let mut count = 947.0 + n * (347.5 + n * 8.0) - 34.0 * sliding * n;
    // Trust.
    count += 30.0 + 37.0 * n;
    if size.unrolled() && !size.tied && size.sets.is_none() {
        count += 80.0;
    }
    count += 67.5 * size.ripple as f64;
    if size.curve_orders > 0 {
        count += (n - size.prismatic as f64) * (77.0 + 14.7 * size.curve_orders as f64);
    }
    if let Some(sets) = &size.sets {
        return (count + set_instructions(size, sets)) as u64;
    }
    // Own length scales are two joints in each pass, and the last of an odd number in one of its own.
    let (pairs, last) = ((size.joints / 2) as f64, (size.joints % 2) as f64);
    // The factor of a payload group for each joint, and the way into its loops.
    count += size.groups as f64
        * match (size.unrolled(), size.tied) {
            (true, false) => 69.0 + 43.5 * n,
            // With half of the cost of an odd number of points.
            (true, true) => 99.0 + 14.0 * n,
            (false, false) => 14.0 + 42.5 * n,
            (false, true) => 45.0 * n - 4.0,
        };
    let point = match (size.unrolled(), size.tied) {
        (true, false) => 5.0 + 3.0 * n + pairs * (35.0 + 4.0 * n) + last * (22.0 + 2.0 * n),
        (true, true) => 13.75 + 6.75 * n,
        (false, false) => 29.3 + 79.7 * n,
        (false, true) => 82.5 + 27.5 * n,
    };
    if size.support > 0 {
        count += 65.0;
    }
    if size.landmarks > 0 {
        let l = size.landmarks as f64;
        count += 318.0 + 84.0 * n + l * (92.0 + 16.0 * n + l * 4.0);
    }
    (count + size.support as f64 * point) as u64
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

/// Bytes of the blob of an arm without coupling, all of whose joints have limits, and whose support points are spread
/// evenly over the groups. `texts` are the lengths of robot name, serial number, model, trainer version and date.
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
    elastic += 1 + n * (1 + n * floats + 3 * floats);
    elastic += 1;
    elastic += 1;
    for group in 0..size.groups {
        let upto = |index: usize| size.support * index / size.groups;
        elastic += floats + varint(upto(group + 1) - upto(group));
    }
    let rows = floats * size.sets.map_or(size.support * 3 * n, |sets| sets.words);
    let mut variance = 1;
    if size.landmarks > 0 {
        let words: usize = (0..size.landmarks).map(|l| landmark_words(n, l)).sum();
        variance += 3 * floats + 1 + varint(floats * words) + floats * words;
    }
    // A number for each group of each set, all below 128.
    let sets = 1 + size.sets.map_or(0, |_| n * (1 + size.groups));
    let curves = floats * coefficient_count(n, size.curve_orders);
    let correction = elastic + varint(rows) + rows + sets + varint(curves) + curves;
    let (robot, provenance) = texts.split_at(2);
    // SHA-256, number of poses (of up to 127), gauge, no tools, accepted causes.
    let host = text(provenance) + 32 + 1 + 2 * 12 * 8 + 1 + 4;
    let model = text(robot) + joints + frames + rest + correction + variance;
    HEADER_LENGTH + model + varint(host) + host
}
