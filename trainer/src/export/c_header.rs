//! The model as C constants: the bytes of the blob for `runtime/capi`, and the chain for programs that do not use it.

use std::fmt::Write;

use poegp_protocol::JointKind;

use crate::export::CalibratedChain;
use crate::export::describe::accuracy;
use poegp_calibration::blob::predict::BlobModel;

/// Number of bytes on a line.
const BYTES: usize = 16;

/// Returns the text of the header. The names that it defines begin with `stem`, in lower case and reduced to the characters
/// that C allows.
///
/// The header is valid in C99 and later, and in C++. Everything is `static const`, so that each file that includes the
/// header pays only for what it uses.
pub fn text(loaded: &BlobModel, chain: &CalibratedChain, stem: &str) -> String {
    let name = identifier(stem);
    let upper = name.to_uppercase();
    let host = loaded.host();
    let blob = loaded.blob();
    let n = chain.joints.len();
    let mut out = String::from("/*\n");
    for line in chain.provenance.iter().chain(&accuracy(chain)) {
        // No name given by a user may end the comment.
        let _ = writeln!(out, " * {}", line.replace("*/", "* /").replace("/*", "/ *"));
    }
    let _ = write!(
        out,
        " *\n * Written by `trainer export --c-header`. {name}_blob is the whole model: give it to poegp_load of poegp.h.\n \
         * {name}_parent_from_joint is its calibrated chain alone, without correction.\n */\n\
         #ifndef {upper}_MODEL_H\n#define {upper}_MODEL_H\n\n\
         #if defined(__cplusplus)\n#define {upper}_ALIGNED alignas(8) static const\n\
         #elif defined(__STDC_VERSION__) && __STDC_VERSION__ >= 201112L\n\
         #define {upper}_ALIGNED static const _Alignas(8)\n\
         #elif defined(__GNUC__)\n#define {upper}_ALIGNED static const __attribute__((aligned(8)))\n\
         #else\n#define {upper}_ALIGNED static const\n#endif\n\n"
    );
    let bytes = loaded.bytes();
    let _ = writeln!(
        out,
        "/* Bytes of the blob. */\n#define {upper}_BLOB_BYTES {}u\n\
         {upper}_ALIGNED unsigned char {name}_blob[{upper}_BLOB_BYTES] = {{",
        bytes.len()
    );
    for line in bytes.chunks(BYTES) {
        let line: Vec<String> = line.iter().map(|b| format!("0x{b:02x}")).collect();
        let _ = writeln!(out, "    {},", line.join(", "));
    }
    let _ = write!(
        out,
        "}};\n\n/* Joints, base first. */\n#define {upper}_JOINTS {n}\n"
    );
    let kinds = chain
        .joints
        .iter()
        .map(|j| u8::from(j.kind == JointKind::Prismatic).to_string());
    let _ = writeln!(
        out,
        "/* 0: turns about the z axis of its frame, rad; 1: moves along it, m. */\n\
         static const unsigned char {name}_is_prismatic[{upper}_JOINTS] = {{{}}};\n",
        kinds.collect::<Vec<_>>().join(", ")
    );
    let (origin, frames): (_, Vec<[f32; 12]>) = match chain.fit {
        None => (
            "The blob's own numbers.",
            blob.geometry.calibrated.iter().copied().collect(),
        ),
        Some(_) => (
            "Not those inside the blob.",
            chain
                .frames
                .iter()
                .map(|frame| frame.cast().to_rows())
                .collect(),
        ),
    };
    let _ = writeln!(
        out,
        "/* The fixed frames of the calibrated chain, 3x4 row by row, metres: the pose of the target in the base frame is\n \
         * F0 Z(q1) F1 Z(q2) ... Z(qn) Fn. {origin} */\n\
         static const float {name}_parent_from_joint[{upper}_JOINTS + 1][12] = {{"
    );
    for frame in &frames {
        let _ = writeln!(out, "    {{{}}},", floats(frame));
    }
    out += "};\n";
    let c = &blob.robot.coupling;
    if !c.is_empty() {
        let _ = writeln!(
            out,
            "\n/* Joint values of the chain from the controller's, q = C * controller, row by row. */\n\
             static const float {name}_coupling[{upper}_JOINTS * {upper}_JOINTS] = {{{}}};",
            floats(c)
        );
    }
    let _ = writeln!(
        out,
        "\n/* The base frame seen from the instrument of the calibration, 3x4 row by row, metres. */\n\
         static const double {name}_instrument_from_base[12] = {{{}}};",
        doubles(&host.gauge.instrument_from_base)
    );
    let _ = writeln!(
        out,
        "/* Frame of the target in the flange frame, flange_from_target. */\n\
         static const double {name}_flange_from_target[12] = {{{}}};",
        doubles(&host.gauge.flange_from_target)
    );
    let _ = write!(out, "\n#endif\n");
    out
}

/// Formats numbers with debug formatting, which always has a point or an exponent, and digits enough to restore every bit.
fn floats(numbers: &[f32]) -> String {
    let texts: Vec<String> = numbers.iter().map(|x| format!("{x:?}f")).collect();
    texts.join(", ")
}

fn doubles(numbers: &[f64]) -> String {
    let texts: Vec<String> = numbers.iter().map(|x| format!("{x:?}")).collect();
    texts.join(", ")
}

/// Returns a name that C allows: letters, digits, underscores, no digit or underscore first.
fn identifier(stem: &str) -> String {
    let mut name: String = stem
        .chars()
        .map(|c| {
            if c.is_ascii_alphanumeric() {
                c.to_ascii_lowercase()
            } else {
                '_'
            }
        })
        .collect();
    name = name.trim_matches('_').to_owned();
    if !name.starts_with(|c: char| c.is_ascii_alphabetic()) {
        name.insert_str(0, "model_");
    }
    name
}

#[cfg(test)]
mod tests {
    use super::identifier;

    #[test]
    fn names_are_what_c_allows() {
        for (stem, name) in [
            ("arm", "arm"),
            ("Cell 7-left", "cell_7_left"),
            ("7", "model_7"),
            ("", "model_"),
            ("größe", "gr__e"),
        ] {
            assert_eq!(identifier(stem), name);
        }
    }
}
