//! The header of `trainer export --c-header` compiles as C99 without a warning, and the library loads its blob.

use std::fs;
use std::process::Command;

use poegp_calibration::blob::predict::BlobModel;
use poegp_runtime::math::se3::Pose;
use poegp_trainer::export::{CalibratedChain, c_header};

use crate::c::{Machine, capi, compile, run_on_host};

const PROGRAM: &str = r#"
#include <stdio.h>
#include "poegp.h"
#include "cell-7.h"

static union {
    unsigned char bytes[POEGP_MODEL_BYTES];
    double aligned[POEGP_MODEL_BYTES / sizeof(double)];
} memory;

int main(void)
{
    poegp_model_t *model;
    int32_t code = poegp_init(memory.bytes, sizeof memory.bytes, &model);
    if (code == POEGP_OK) {
        code = poegp_load(model, cell_7_blob, CELL_7_BLOB_BYTES);
    }
    printf("%d %d %u\n", (int)code, CELL_7_JOINTS, (unsigned)((size_t)cell_7_blob % 8));
    for (int frame = 0; frame <= CELL_7_JOINTS; frame++) {
        for (int i = 0; i < 12; i++) {
            printf("%a\n", (double)cell_7_parent_from_joint[frame][i]);
        }
    }
    return code;
}
"#;

/// Parses `%a` output of a number that single precision holds exactly.
fn hexadecimal(text: &str) -> f32 {
    let (sign, digits) = match text.strip_prefix('-') {
        Some(rest) => (-1.0, rest),
        None => (1.0, text),
    };
    let (mantissa, exponent) = digits
        .strip_prefix("0x")
        .and_then(|rest| rest.split_once('p'))
        .unwrap();
    let (whole, part) = mantissa.split_once('.').unwrap_or((mantissa, ""));
    let all = i64::from_str_radix(&format!("{whole}{part}"), 16).unwrap() as f64;
    let shift = exponent.parse::<i32>().unwrap() - 4 * part.len() as i32;
    (sign * all * f64::from(shift).exp2()) as f32
}

#[test]
fn exported_header() {
    let bytes = fs::read(capi().join("examples/arm.blob")).unwrap();
    let loaded = BlobModel::from_bytes(bytes).unwrap();
    let folder = tempfile::Builder::new().prefix("poegp-").tempdir().unwrap();
    let chain = CalibratedChain::of(&loaded);
    let header = c_header::text(&loaded, &chain, "cell-7");
    fs::write(folder.path().join("cell-7.h"), header).unwrap();

    let alone = folder.path().join("alone.c");
    fs::write(&alone, "#include \"cell-7.h\"\n#include \"cell-7.h\"\nint joints(void);\nint joints(void) { return CELL_7_JOINTS + cell_7_blob[0]; }\n").unwrap();
    let output = Command::new("cc")
        .args(["-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror", "-c"])
        .arg(&alone)
        .arg("-o")
        .arg(folder.path().join("alone.o"))
        .output()
        .unwrap_or_else(|error| panic!("cc: {error}; apt-get install gcc (Debian)"));
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );

    let source = folder.path().join("program.c");
    fs::write(&source, PROGRAM).unwrap();
    let program = folder.path().join("program");
    compile(Machine::Host, &source, &[folder.path()], &program);
    let said = run_on_host(&program, folder.path());
    let mut lines = said.lines();
    assert_eq!(lines.next(), Some("0 6 0"), "{said}");
    let frame = |frame: &Pose<f64>| frame.cast::<f32>().to_rows();
    let frames: Vec<f32> = chain.frames.iter().flat_map(frame).collect();
    let printed: Vec<f32> = lines.map(hexadecimal).collect();
    assert_eq!(printed.len(), frames.len());
    for (a, b) in printed.iter().zip(&frames) {
        assert_eq!(a.to_bits(), b.to_bits());
    }
}
