//! What the runtime answers, in the words of the golden files.

use core::fmt::Write;

use poegp_protocol::blob::{self, Blob};
use poegp_runtime::model::{Model, words_for};
use poegp_runtime::trace::Stages;

/// Room for rows of inducing points; no bit depends on it.
const WORDS: usize = if cfg!(feature = "full-size") {
    words_for(300)
} else {
    512
};

/// The longest line is that of seven joints and all stages.
type Line = heapless::String<640>;

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
    for case in CASES {
        // Looked at where it is: taken out of the result it would be on the stack twice.
        match &blob::decode(case.blob) {
            Ok(blob) => print_case(case, blob, every, &mut show)?,
            Err(_) => return Err("a blob cannot be decoded"),
        }
    }
    Ok(())
}

// Not inlined: the model is not yet on the stack while a blob is decoded.
#[inline(never)]
fn print_case(
    case: &Case,
    blob: &Blob<'_>,
    every: usize,
    show: &mut impl FnMut(&str),
) -> Result<(), &'static str> {
    let mut model = Model::<f32, WORDS>::new();
    model.load_decoded(blob).map_err(|_| "a model is refused")?;
    for write in [write_bits as WriteLine, write_trust, write_command] {
        for query in case.queries.iter().step_by(every) {
            print_line(case, query, &model, write, show)?;
        }
    }
    Ok(())
}

/// Writes what is asked of `model` at a query behind the name of the case.
type WriteLine = fn(&mut Line, &str, &Model<f32, WORDS>, &[f32], f32) -> core::fmt::Result;

#[inline(never)]
fn print_line(
    case: &Case,
    query: &[u32],
    model: &Model<f32, WORDS>,
    write: WriteLine,
    show: &mut impl FnMut(&str),
) -> Result<(), &'static str> {
    let mut asked = [0.0; 16];
    for (value, bits) in asked.iter_mut().zip(query) {
        *value = f32::from_bits(*bits);
    }
    let asked = asked.get(..query.len()).unwrap_or(&[]);
    let (payload_kg, joints) = asked.split_last().ok_or("a query is empty")?;
    let mut line = Line::new();
    write(&mut line, case.name, model, joints, *payload_kg).map_err(|_| "a line is too long")?;
    show(&line);
    Ok(())
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
    write_words(line, stages.motions().iter().flatten().copied())?;
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
    write!(
        line,
        " | {:08x} | {status:02x}",
        answer.position_error.to_bits()
    )
}
