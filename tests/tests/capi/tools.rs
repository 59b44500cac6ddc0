//! Tools and double precision: `tools.c` with the C functions and `tools.cpp` with `poegp.hpp` give the runtime's bits.

use std::path::Path;

use poegp_runtime::correct::CompiledCorrection;
use poegp_runtime::correct::inverse::CompiledInverse;
use poegp_runtime::filter::{CommandFilter, CompiledFilter, FilterSettings};
use poegp_runtime::math::se3::Pose;
use poegp_runtime::model::{Model, words_for};
use poegp_tests::workspace;

use crate::c::{Machine, capi, compile, compile_cpp, run_on_host};

/// Answers of each kind on the path.
const CYCLES: usize = 100;
/// Largest time of an inverse in a cycle, ns: the median of the best of twenty rounds.
const MOST_NS: f64 = 8_000.0;

/// A number whose bits are printed.
trait Bits: CompiledCorrection + CompiledFilter + CompiledInverse {
    fn of(digits: &str) -> Self;
    fn digits(self) -> String;
}

impl Bits for f32 {
    fn of(digits: &str) -> Self {
        Self::from_bits(u32::from_str_radix(digits, 16).unwrap())
    }
    fn digits(self) -> String {
        format!("{:08x}", self.to_bits())
    }
}

impl Bits for f64 {
    fn of(digits: &str) -> Self {
        Self::from_bits(u64::from_str_radix(digits, 16).unwrap())
    }
    fn digits(self) -> String {
        format!("{:016x}", self.to_bits())
    }
}

fn tool<T: Bits>() -> Pose<T> {
    let rows = [
        0.0, -1.0, 0.0, 0.05, 1.0, 0.0, 0.0, -0.1, 0.0, 0.0, 1.0, 0.2,
    ];
    Pose::from_rows(&rows.map(T::from_f64))
}

/// Compares every line with the runtime's answer to the query in it. Returns the number of lines.
fn assert_answers<'a, T: Bits>(lines: impl Iterator<Item = &'a str>) -> usize {
    let mut model = Box::new(Model::<T, { words_for(64) }>::new());
    let bytes = std::fs::read(capi().join("examples/arm.blob")).unwrap();
    model.load(&bytes).unwrap();
    let mut filter = CommandFilter::new();
    let period = T::from_f64(0.01);
    filter
        .configure(&FilterSettings::with_period(period))
        .unwrap();
    let mut count = 0;
    for line in lines {
        let question = line.split(" |").next().unwrap();
        let (verb, numbers) = question.split_once(' ').unwrap();
        let numbers: Vec<T> = numbers.split(' ').map(T::of).collect();
        let (q, kg) = (&numbers[..6], numbers[6]);
        let (status, answer) = match verb {
            "forward" => {
                let found = model.tool_pose(&tool(), q, kg);
                (
                    found.status,
                    [&found.pose.to_rows()[..], &[found.trust]].concat(),
                )
            }
            "jacobian" => {
                let found = model.tool_jacobian(&tool(), q, kg);
                let rows = (0..6).flat_map(|r| found.columns.map(|column| column[r]));
                (found.status, rows.collect())
            }
            "inverse" => {
                let wanted = Pose::from_rows(numbers[7..].first_chunk().unwrap());
                let found = model.tool_inverse(&wanted, &tool(), q, kg);
                let errors = [found.position_error, found.rotation_error];
                (found.status, [&found.joints[..], &errors].concat())
            }
            "correct" => {
                let found = model.correct(q, kg);
                let rest = [found.applied, found.position_error, found.rotation_error];
                (found.status, [&found.joints[..], &rest].concat())
            }
            "command" => {
                let kg = filter.payload(kg, 1);
                let found = model.correct(q, kg);
                let sent = filter.step(q, &found.joints, found.status, true, 1);
                (sent.status, [&sent.joints[..], &[sent.weight]].concat())
            }
            _ => panic!("{line}"),
        };
        let answer: String = answer
            .iter()
            .map(|value| format!(" {}", value.digits()))
            .collect();
        assert_eq!(line, format!("{question} | 0 {}{answer}", status.bits()));
        count += 1;
    }
    count
}

fn source(name: &str) -> std::path::PathBuf {
    workspace().join("tests/tests/capi").join(name)
}

fn blob() -> std::path::PathBuf {
    capi().join("examples/arm.blob")
}

/// C with `double` gives the runtime's bits; the test also bounds the time of an inverse.
#[test]
fn double_precision_in_c() {
    let folder = tempfile::Builder::new().prefix("poegp-").tempdir().unwrap();
    let program = folder.path().join("tools");
    compile(Machine::Host, &source("tools.c"), &[], &program);
    let said = run_on_host(&program, &blob());
    let (answers, times) = said.split_once("median ns ").unwrap();
    assert_eq!(assert_answers::<f64>(answers.lines()), 5 * CYCLES);
    let times: Vec<f64> = times
        .split_whitespace()
        .map(|ns| ns.parse().unwrap())
        .collect();
    println!(
        "double precision on this machine, median: poegp_forward_f64 {} ns, poegp_inverse_f64 {} ns",
        times[0], times[1]
    );
    assert!(times[1] <= MOST_NS, "{} ns", times[1]);
}

fn cpp(program: &Path, options: &[&str]) {
    compile_cpp(&source("tools.cpp"), options, program);
    let said = run_on_host(program, &blob());
    let (_, of_single) = said.split_once("precision 32\n").unwrap();
    let (of_single, of_double) = of_single.split_once("precision 64\n").unwrap();
    let (of_double, of_none) = of_double.split_once("none ").unwrap();
    assert_eq!(assert_answers::<f32>(of_single.lines()), 5 * CYCLES);
    assert_eq!(assert_answers::<f64>(of_double.lines()), 5 * CYCLES);
    assert_eq!(of_none.trim(), "1 1 0 0.6 a pointer is null");
}

/// The C++ header works with exceptions and RTTI, and without them, as controllers are often built.
#[test]
fn the_wrapper_in_cpp() {
    let folder = tempfile::Builder::new().prefix("poegp-").tempdir().unwrap();
    let program = folder.path().join("tools");
    cpp(
        &program,
        &["-fno-exceptions", "-fno-rtti", "-Wconversion", "-Wshadow"],
    );
    cpp(&program, &[]);
    // The program neither allocates memory nor throws.
    let symbols = std::process::Command::new("nm")
        .arg("-u")
        .arg(&program)
        .output()
        .unwrap();
    let symbols = String::from_utf8(symbols.stdout).unwrap();
    for part in ["_Znw", "_Zna", "__cxa_throw", "__cxa_allocate"] {
        assert!(!symbols.contains(part), "{part}");
    }
}
