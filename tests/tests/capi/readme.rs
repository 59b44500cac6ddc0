//! The programs in `runtime/capi/README.md` compile without a warning and do what the page states.

use std::fs;

use poegp_protocol::link::cyclic::{CyclicAnswer, MAX_CYCLIC, encode_answer};

use crate::c::{Machine, capi, compile, compile_cpp, run_on_host};

/// What precedes the README's program.
const BEFORE: &str = r#"
#include <math.h>
#include <stdio.h>
#include <string.h>
#include "poegp.h"

static float sent[POEGP_MAX_JOINTS];
static uint32_t remarks;
static int32_t last_code;
static int exchanges, wanted;

static void send(const float *joints)
{
    for (int i = 0; i < 6; i++) {
        sent[i] = joints[i];
    }
}
static void note(int32_t code, uint32_t status)
{
    last_code = code;
    remarks = status;
}
static int wants_another_model(void)
{
    return wanted;
}
static poegp_model_t *other_model(void);

/* The answers of a device, in turn. Answer 100 comes a cycle late, behind garbage; 150 to 154, 250 to 399 and 405 never
   come. */
static const uint8_t answer_frames[CYCLES][POEGP_CYCLIC_BYTES] = {ANSWERS};
static size_t line_bytes;
static int answered, asked = -1;
static void write_line(const uint8_t *bytes, size_t count)
{
    (void)bytes;
    line_bytes = count;
    asked++;
    if ((asked >= 150 && asked < 155) || (asked >= 250 && asked < 400) || asked == 405) {
        answered = asked + 1;
    }
}
static size_t read_line_to_zero(uint8_t *bytes, size_t room)
{
    static int garbage = 3;
    if (asked == 100 || answered > asked) {
        return 0;
    }
    if (asked == 101 && garbage-- > 0) {
        memset(bytes, 7, 5);
        return 5;
    }
    memcpy(bytes, answer_frames[answered++], room);
    return (size_t)ANSWER_BYTES;
}
"#;

const AFTER: &str = r#"
static poegp_model_t *other_model(void)
{
    exchanges++;
    wanted = 0;
    return model;
}

static uint8_t blob[65536];

int main(int count, char **arguments)
{
    FILE *file = count == 2 ? fopen(arguments[1], "rb") : NULL;
    size_t length = file == NULL ? 0 : fread(blob, 1, sizeof blob, file);
    int32_t code = set_up(blob, length);
    float joints[6] = {0.3f, -0.2f, 0.4f, 0.1f, 0.7f, -0.5f};
    for (int i = 0; i < 2000; i++) {
        cycle(joints, 1.0f, 1, 1);
    }
    poegp_corrected_t corrected;
    poegp_correct(model, joints, 6, 1.0f, &corrected);
    int same = 1, differs = 0;
    for (int i = 0; i < 6; i++) {
        same &= sent[i] == corrected.joints[i];
        differs |= sent[i] != joints[i];
    }
    printf("on %d: %d %d %u\n", (int)code, same, differs, (unsigned)(remarks == corrected.status));
    wanted = 1;
    cycle(joints, 1.0f, 1, 1);
    int early = exchanges;
    for (int i = 0; i < 2000; i++) {
        cycle(joints, 1.0f, 0, 1);
    }
    same = 1;
    for (int i = 0; i < 6; i++) {
        same &= sent[i] == joints[i];
    }
    printf("off %d: %d %d %d\n", (int)last_code, same, early, exchanges);
    double wide_joints[6] = {0.3, -0.2, 0.4, 0.1, 0.7, -0.5};
    const double tool[12] = {1, 0, 0, 0.1, 0, 1, 0, 0, 0, 0, 1, 0.2};
    const double nowhere[12] = {1, 0, 0, 90.0, 0, 1, 0, 0, 0, 0, 1, 0};
    code = set_up_wide(blob, length);
    poegp_forward_f64_t wanted, reached;
    poegp_forward_f64(wide_model, tool, wide_joints, 6, 1.0, &wanted);
    wanted.base_from_tool[3] += 0.001;
    int followed = follow(wanted.base_from_tool, tool, 1.0, wide_joints);
    poegp_forward_f64(wide_model, tool, wide_joints, 6, 1.0, &reached);
    double off = 0.0;
    for (int i = 0; i < 12; i++) {
        off = fmax(off, fabs(reached.base_from_tool[i] - wanted.base_from_tool[i]));
    }
    int lost = follow(nowhere, tool, 1.0, wide_joints);
    printf("wide %d: %d %d %d\n", (int)code, followed, off < 2e-7, lost);
    double correction = 0.0, largest = 0.0, least = 1.0;
    int held = 0, used = 0;
    for (int k = 0; k < CYCLES; k++) {
        joints[0] = 0.3f + 1e-4f * (float)k;
        cycle_with_device((uint16_t)k, joints, 1.0f);
        double now = (double)sent[0] - (double)joints[0];
        largest = fmax(largest, fabs(now - correction));
        held += fabs(now - correction) < 1e-7 && k > 60 && k < 250;
        least = k == 399 ? now : least;
        used += fabs(now - 1e-3) < 1e-7 && k >= 500;
        correction = now;
    }
    printf("device %d: %.1f %d %.4f %d\n", (int)line_bytes, 1e6 * largest, held, least, used);
    return 0;
}
"#;

/// Number of cycles with a device.
const CYCLES: u16 = 600;

/// Returns the bytes of a cyclic answer as a C initialiser, and their number: the correction of the first joint comes in within
/// 50 cycles, up to 1 mrad. Answers 200 and 410 are those to bad input, with other joints.
fn answer(sequence: u16) -> (String, usize) {
    let first = 0.3 + 1e-4 * f32::from(sequence) + 2e-5 * f32::from(sequence.min(50));
    let is_bad = [200, 410].contains(&sequence);
    let first = if is_bad { 0.0 } else { first };
    let answer = CyclicAnswer {
        joints: [first, -0.2, 0.4, 0.1, 0.7, -0.5].into_iter().collect(),
        applied: 1.0,
        position_error: 0.0,
        rotation_error: 0.0,
        status: if is_bad { 16 } else { 0 },
    };
    let mut out = [0; MAX_CYCLIC];
    let bytes = encode_answer(sequence, &answer, &mut out).unwrap();
    let list: String = bytes.iter().map(|byte| format!("{byte}, ")).collect();
    (format!("{{{list}}},\n"), bytes.len())
}

#[test]
fn the_program_of_the_readme() {
    let readme = fs::read_to_string(capi().join("README.md")).unwrap();
    let blocks: Vec<&str> = readme
        .split("```c\n")
        .skip(1)
        .map(|rest| rest.split("```").next().unwrap())
        .collect();
    assert_eq!(blocks.len(), 4);
    let cycle = blocks[1].lines().count();
    assert!(cycle <= 15, "a cycle of {cycle} lines");
    let folder = tempfile::Builder::new().prefix("poegp-").tempdir().unwrap();
    let source = folder.path().join("readme.c");
    let answers: String = (0..CYCLES).map(|k| answer(k).0).collect();
    let before = BEFORE
        .replace("ANSWERS", &answers)
        .replace("ANSWER_BYTES", &answer(0).1.to_string());
    let after = AFTER.replace("CYCLES", &CYCLES.to_string());
    let before = before.replace("CYCLES", &CYCLES.to_string());
    fs::write(&source, [before, blocks.concat(), after].concat()).unwrap();
    let program = folder.path().join("readme");
    compile(Machine::Host, &source, &[], &program);
    let said = run_on_host(&program, &capi().join("examples/arm.blob"));
    assert_eq!(
        said,
        "on 0: 1 1 1\noff 0: 1 0 1\nwide 0: 1 1 0\ndevice 37: 20.0 189 0.0000 100\n"
    );
}

/// The program around the README's part for C++.
const MAIN_CPP: &str = r#"
#include <cstdio>

static std::uint8_t blob[65536];

int main(int count, char **arguments)
{
    std::FILE *file = count == 2 ? std::fopen(arguments[1], "rb") : nullptr;
    const std::size_t bytes = file == nullptr ? 0 : std::fread(blob, 1, sizeof blob, file);
    const bool ready = set_up(blob, bytes);
    const std::array<double, 6> joints = {0.3, -0.2, 0.4, 0.1, 0.7, -0.5};
    std::array<double, 6> sent = joints;
    for (int i = 0; i < 2000; i++) {
        sent = cycle(joints, 1.0, true);
    }
    const auto corrected = arm.correct(joints, 1.0);
    std::printf("%d %d %d\n", ready, sent[1] == corrected->joints[1], sent[1] != joints[1]);
    return 0;
}
"#;

#[test]
fn the_program_of_the_readme_in_cpp() {
    let readme = fs::read_to_string(capi().join("README.md")).unwrap();
    let (_, block) = readme.split_once("```cpp\n").unwrap();
    let block = block.split("```").next().unwrap();
    let folder = tempfile::Builder::new().prefix("poegp-").tempdir().unwrap();
    let source = folder.path().join("readme.cpp");
    let program = folder.path().join("readme");
    fs::write(&source, [block, MAIN_CPP].concat()).unwrap();
    compile_cpp(&source, &["-fno-exceptions", "-fno-rtti"], &program);
    assert_eq!(
        run_on_host(&program, &capi().join("examples/arm.blob")),
        "1 1 1\n"
    );
}
