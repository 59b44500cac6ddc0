//! The cost of an elastic model on the device, computed from the model's size before the model is made: the runtime's upper
//! bound on instructions, and the exact number of bytes of the blob.

use poegp_protocol::blob::HEADER_LENGTH;
use poegp_runtime::elastic::curve::coefficient_count;
use poegp_runtime::elastic::position_variance::landmark_words;
use poegp_runtime::gp::joint_processes::UNROLLED;
use poegp_runtime::model::cost::{CorrectionSize, ElasticSize, ModelSize, ProcessesSize};

/// Returns the size of the largest elastic model of an arm with `joints` joints, `sliding` of them prismatic, and `points`
/// inducing points of `groups` payloads: kernels of all joints, points of every payload for every joint, gravity in any
/// direction; no coupling, ripple, curves or landmarks.
pub fn largest(joints: usize, sliding: usize, points: usize, groups: usize) -> ModelSize {
    let sets = if points > 0 { joints } else { 0 };
    let mut size = ElasticSize {
        loaded_joints: joints - sliding,
        loaded_links: joints * joints.saturating_sub(1) / 2,
        groups,
        ..ElasticSize::default()
    };
    *processes_of(&mut size, joints) = ProcessesSize {
        sets,
        looked_at: sets * joints,
        points,
        words: points * (2 * joints + 1),
        blocks: (joints * groups).min(points),
    };
    if size.unrolled.sets > 0 {
        size.centred = sliding;
    }
    ModelSize {
        joints,
        sliding,
        coupling_terms: 0,
        coupled_joints: 0,
        correction: CorrectionSize::Elastic(size),
    }
}

/// Returns the sizes to which processes belong that depend on this number of joints.
fn processes_of(size: &mut ElasticSize, looked_at: usize) -> &mut ProcessesSize {
    if u8::try_from(looked_at).is_ok_and(|count| UNROLLED.contains(&count)) {
        &mut size.unrolled
    } else {
        &mut size.general
    }
}

/// Returns the size of the model's elastic correction; the default (empty) size if it has none.
pub fn elastic(size: &ModelSize) -> ElasticSize {
    match size.correction {
        CorrectionSize::Elastic(elastic) => elastic,
        _ => ElasticSize::default(),
    }
}

/// Returns `size` with its elastic correction changed by `change`.
pub fn with_elastic(size: &ModelSize, change: impl FnOnce(&mut ElasticSize)) -> ModelSize {
    let mut correction = elastic(size);
    change(&mut correction);
    ModelSize {
        correction: CorrectionSize::Elastic(correction),
        ..*size
    }
}

/// Returns the instructions of a command that one item costs, where `change` adds a thousand of these items to a model.
fn each(change: impl FnOnce(&mut ElasticSize)) -> f64 {
    let without = largest(6, 0, 1_000, 1);
    let with = with_elastic(&without, change);
    (f64::from(with.command_bound()) - f64::from(without.command_bound())) / 1_000.0
}

/// Returns the instructions of one inducing point whose row takes so many memory words.
pub fn row_instructions(words: usize) -> f64 {
    each(|size| {
        let size = processes_of(size, words / 2);
        size.points += 1_000;
        size.words += 1_000 * words;
    })
}

/// Returns the instructions of one payload group of a joint, without those of its rows.
pub fn block_instructions() -> f64 {
    each(|size| size.unrolled.blocks += 1_000)
}

/// Returns the number of bytes of `value` in the variable-length encoding that postcard uses for lengths.
const fn varint(value: usize) -> usize {
    let mut bytes = 1;
    let mut rest = value >> 7;
    while rest > 0 {
        bytes += 1;
        rest >>= 7;
    }
    bytes
}

/// Returns the number of bytes of the blob of an arm without coupling, all of whose joints have limits. `texts` are the
/// lengths of robot name, serial number, model, trainer version and date.
pub fn blob_bytes(arm: &ModelSize, texts: [usize; 5]) -> usize {
    let (n, floats) = (arm.joints, 4);
    let size = elastic(arm);
    let text = |lengths: &[usize]| -> usize { lengths.iter().map(|l| varint(*l) + l).sum() };
    // For each joint: its kind, `Option` and two limits; then its trained range.
    let joints = 1 + n * 10 + 1 + n * 8;
    let frames = 2 * (1 + (n + 1) * 12 * floats);
    // No coupling, units, range of the payload, warnings.
    let rest = 1 + 3 + 9 + 4;
    // Index of the enum variant, limit, gravity.
    let mut elastic = 1 + 2 * floats + 3 * floats;
    elastic += 1 + n * (n + 1) / 2 * 3 * floats;
    elastic += 1 + n * 4 * floats;
    elastic += 1 + size.ripple * (1 + 3 * floats);
    let processes = if size.points() > 0 { n } else { 0 };
    elastic += 1 + processes * (1 + n * floats + 3 * floats);
    elastic += 1 + size.groups * floats;
    let rows = floats * size.words();
    let mut variance = 1;
    if size.landmarks > 0 {
        let words: usize = (0..size.landmarks).map(|l| landmark_words(n, l)).sum();
        variance += 4 * floats + 1 + n * floats + 1 + varint(floats * words) + floats * words;
    }
    // One count for each group of each set; every count is below 128 and so takes one byte.
    let sets = 1 + processes * (1 + size.groups);
    let curves = floats * coefficient_count(n, size.curve_orders);
    let correction = elastic + varint(rows) + rows + sets + varint(curves) + curves;
    let (robot, provenance) = texts.split_at(2);
    // SHA-256, number of poses (one byte up to 127), gauge, no tools, accepted causes.
    let gauge = 2 * 12 * 8 + 2 + 1 + n * 2 * floats + 1 + floats;
    let host = text(provenance) + 32 + 1 + gauge + 1 + 4;
    let model = text(robot) + joints + frames + rest + correction + variance;
    HEADER_LENGTH + model + varint(host) + host
}
