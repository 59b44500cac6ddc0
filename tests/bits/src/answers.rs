//! What the runtime answers, in the words of the golden files.

use core::fmt::Write;

use poegp_protocol::blob;
use poegp_runtime::model::{Model, Stages, words_for};

/// Room for support rows; no bit depends on it.
const WORDS: usize = if cfg!(feature = "full-size") {
    words_for(300)
} else {
    1_000
};

/// The longest line: 100 words.
type Line = heapless::String<1_024>;

/// A model and what it is asked: the controller's joints and the payload, as bits.
struct Case {
    name: &'static str,
    blob: &'static [u8],
    queries: &'static [&'static [u32]],
}

static CASES: &[Case] = &include!(concat!(env!("OUT_DIR"), "/cases.rs"));

/// Hands every line of every case to `show`, for every `every`-th query.
///
/// # Errors
/// What cannot be with the committed files: a blob that is refused, a line that is too long.
pub fn print(every: usize, mut show: impl FnMut(&str)) -> Result<(), &'static str> {
    let mut model = Model::<f32, WORDS>::new();
    for case in CASES {
        load(&mut model, case.blob)?;
        for write in [write_bits, write_trust, write_command] {
            for query in case.queries.iter().step_by(every) {
                let mut asked = [0.0; 16];
                for (value, bits) in asked.iter_mut().zip(*query) {
                    *value = f32::from_bits(*bits);
                }
                let asked = asked.get(..query.len()).unwrap_or(&[]);
                let (payload_kg, joints) = asked.split_last().ok_or("a query is empty")?;
                let mut line = Line::new();
                write(&mut line, case.name, &model, joints, *payload_kg)
                    .map_err(|_| "a line is too long")?;
                show(&line);
            }
        }
    }
    Ok(())
}

// Not inlined: the decoded blob is gone from the stack before the first evaluation.
#[inline(never)]
fn load(model: &mut Model<f32, WORDS>, bytes: &[u8]) -> Result<(), &'static str> {
    let blob = blob::decode(bytes).map_err(|_| "a blob cannot be decoded")?;
    model.load(&blob).map_err(|_| "a model is refused")
}

fn write_words(line: &mut Line, values: impl IntoIterator<Item = f32>) -> core::fmt::Result {
    values
        .into_iter()
        .try_for_each(|value| write!(line, " {:08x}", value.to_bits()))
}

#[inline(never)]
fn write_bits(
    line: &mut Line,
    name: &str,
    model: &Model<f32, WORDS>,
    joints: &[f32],
    payload_kg: f32,
) -> core::fmt::Result {
    let mut stages = Stages::new();
    let result = model.evaluate_in_stages(joints, payload_kg, &mut stages);
    write!(line, "bits {name}")?;
    write_words(line, joints.iter().copied().chain([payload_kg]))?;
    line.write_str(" |")?;
    write_words(line, stages.motions().iter().flat_map(|m| [m.sin, m.cos]))?;
    line.write_str(" |")?;
    write_words(line, stages.mean.iter().take(6).copied())?;
    line.write_str(" |")?;
    write_words(line, stages.chain.to_rows())?;
    line.write_str(" |")?;
    write_words(line, result.correction.to_array())?;
    line.write_str(" |")?;
    write_words(line, result.pose.to_rows())?;
    write!(line, " | {:08x}", result.status.bits())
}

#[inline(never)]
fn write_trust(
    line: &mut Line,
    name: &str,
    model: &Model<f32, WORDS>,
    joints: &[f32],
    payload_kg: f32,
) -> core::fmt::Result {
    let result = model.evaluate(joints, payload_kg);
    write!(line, "trust {name} {:08x}", result.trust.to_bits())?;
    match result.position_sigma {
        Some(sigma) => write!(line, " {:08x}", sigma.to_bits()),
        None => line.write_str(" -"),
    }
}

#[inline(never)]
fn write_command(
    line: &mut Line,
    name: &str,
    model: &Model<f32, WORDS>,
    joints: &[f32],
    payload_kg: f32,
) -> core::fmt::Result {
    let answer = model.correct(joints, payload_kg);
    write!(line, "command {name}")?;
    // As many as were asked for, as the device answers.
    let corrected = (0..joints.len()).map(|joint| answer.joints.get(joint).copied());
    write_words(line, corrected.map(Option::unwrap_or_default))?;
    let status = answer.status.bits();
    write!(line, " | {:08x} | {status:02x}", answer.position_error.to_bits())
}
