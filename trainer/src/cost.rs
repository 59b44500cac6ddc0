//! What an elastic model costs on the device, before it is made.
//!
//! Instructions of one evaluation on the Cortex-M4F, fitted to the counts of the emulated device (QEMU `-icount`,
//! `-C target-cpu=cortex-m4`, opt-level 3, LTO, rustc 1.95): within 5 % for arms of three to seven joints, within 10 %
//! when the firmware is built with Debian's 1.96; `tests/tests/device/cost.rs` measures again and prints. Instructions,
//! not cycles. Bytes are exact: the format's own lengths.

use poegp_protocol::JointKind;
use poegp_protocol::blob::{Blob, Correction, HEADER_LENGTH};
use poegp_runtime::deflection::landmark_words;

/// An elastic model by its sizes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ElasticSize {
    /// Joints of the arm.
    pub joints: usize,
    /// How many of them slide.
    pub prismatic: usize,
    /// Support points.
    pub support: usize,
    /// Payload groups.
    pub groups: usize,
    /// Whether all joints have one set of length scales.
    pub tied: bool,
    /// Terms of gear ripple.
    pub ripple: usize,
    /// Landmarks of the standard deviation; 0 for none.
    pub landmarks: usize,
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
            landmarks: blob
                .variance
                .as_ref()
                .map_or(0, |v| usize::from(v.landmarks)),
        })
    }

    /// Whether the device has an unrolled loop for the support points of this arm.
    fn unrolled(&self) -> bool {
        self.prismatic == 0 && matches!(self.joints, 5..=7)
    }
}

/// Instructions of one evaluation.
pub fn instructions(size: &ElasticSize) -> u64 {
    let n = size.joints as f64;
    let sliding = if size.prismatic > 0 { 1.0 } else { 0.0 };
    // Chain twice, gravity terms, twist, bound.
    let mut count = 1_260.0 + n * (490.5 + n * 16.5) - 13.0 * sliding * n;
    // Trust.
    count += 30.0 + 37.0 * n;
    if size.unrolled() && !size.tied {
        count += 45.5 * n;
    }
    count += 67.5 * size.ripple as f64;
    // Own length scales are two joints in each pass.
    let passes = size.joints.div_ceil(2) as f64;
    // The factor of a payload group for each joint, and the way into its loops.
    count += size.groups as f64
        * match (size.unrolled(), size.tied) {
            (true, false) => 125.0 * passes,
            (true, true) => 38.0 + 12.2 * n,
            (false, false) => 14.0 + 42.5 * n,
            (false, true) => 45.0 * n - 4.0,
        };
    let point = match (size.unrolled(), size.tied) {
        (true, false) => 168.7 + n * (13.07 * passes - 23.7),
        (true, true) => 18.9 + 9.27 * n,
        (false, false) => 29.3 + 79.7 * n,
        (false, true) => 82.5 + 27.5 * n,
    };
    if size.support > 0 {
        count += 65.0;
    }
    if size.landmarks > 0 {
        let l = size.landmarks as f64;
        count += 363.0 + 84.0 * n + l * (92.0 + 16.0 * n + l * 4.0);
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
    let text: usize = texts.iter().map(|length| varint(*length) + length).sum();
    // Kind, `Option` and two limits; the trained range.
    let joints = 1 + n * 10 + 1 + n * 8;
    let frames = 2 * (1 + (n + 1) * 12 * floats) + 2 * 12 * 8;
    // No coupling, units, SHA-256, number of poses (of up to 127), range of the payload.
    let rest = 1 + 3 + 32 + 1 + 9;
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
    let rows = size.support * 3 * n * floats;
    // No named tools: a list of 0 bytes.
    let tools = 1;
    let mut variance = 0;
    if size.landmarks > 0 {
        let words: usize = (0..size.landmarks).map(|l| landmark_words(n, l)).sum();
        variance = 3 * floats + 1 + varint(floats * words) + floats * words;
    }
    HEADER_LENGTH + text + joints + frames + rest + elastic + varint(rows) + rows + tools + variance
}
