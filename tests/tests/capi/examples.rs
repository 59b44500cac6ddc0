//! `runtime/capi/examples` must give the same bits in C on the workstation, in C on the device, and in Rust.

use std::fmt::Write;
use std::fs;
use std::path::PathBuf;

use poegp_protocol::blob;
use poegp_protocol::limits::MAX_JOINTS;
use poegp_protocol::link::Query;
use poegp_protocol::link::cyclic::{MAX_CYCLIC, decode_answer, encode_command};
use poegp_runtime::filter::{CommandFilter, FilterSettings};
use poegp_runtime::guard::status::Status;
use poegp_runtime::model::{Model, words_for};
use poegp_tests::image::Image;

use crate::c::{Machine, capi, compile, run_on_device, run_on_host};

/// Queries of each kind in `answers.h`.
const QUESTIONS: usize = 19;
/// Cycles of the path in `answers.h`.
const CYCLES: usize = 160;
const KIB: u64 = 1_024;
/// Number of joints of the example's arm.
const JOINTS: usize = 6;

struct Program {
    path: PathBuf,
    _directory: tempfile::TempDir,
}

fn example(machine: Machine, name: &str) -> Program {
    let directory = tempfile::Builder::new().prefix("poegp-").tempdir().unwrap();
    let path = directory.path().join(name);
    let folder = capi().join("examples");
    compile(
        machine,
        &folder.join(name).with_extension("c"),
        &[&folder],
        &path,
    );
    Program {
        path,
        _directory: directory,
    }
}

/// Compares every line with the runtime's answer to the query in it.
fn assert_answers(said: &str) {
    let bytes = fs::read(capi().join("examples/arm.blob")).unwrap();
    let decoded = blob::decode(&bytes).unwrap();
    let mut model = Box::new(Model::<f32, { words_for(64) }>::new());
    model.load_decoded(&decoded).unwrap();
    let mut lines = said.lines();
    let crc = blob::stored_crc(&bytes).unwrap();
    assert_eq!(
        lines.next(),
        Some(&*format!(
            "robot {}, crc {crc:08x}, joints 6, inducing points 25",
            decoded.robot.name
        ))
    );
    let mut filter = CommandFilter::new();
    filter
        .configure(&FilterSettings::with_period(0.05))
        .unwrap();
    let (mut evaluated, mut corrected, mut commanded, mut trusted) = (0, 0, 0, 0);
    let mut framed = 0;
    let mut ways = [0; 4];
    for line in lines.filter(|line| !line.starts_with("stack")) {
        if line.starts_with("counts") {
            let counts = filter.counts();
            let numbers = [
                counts.held,
                counts.lost,
                counts.doubled,
                counts.bad,
                counts.guarded,
            ];
            let expected = numbers.map(|number| number.to_string()).join(" ");
            assert_eq!(line, format!("counts {expected}"));
            assert!(counts.lost > 0 && counts.doubled > 0 && counts.bad > 0);
            continue;
        }
        if line.starts_with("frame") || line.starts_with("answer") {
            assert_frame(line);
            framed += 1;
            continue;
        }
        let question = line.split(" |").next().unwrap();
        let mut words: Vec<&str> = question.split(' ').collect();
        let verb = words.remove(0);
        let decimal = |word: &str| word.parse::<u32>().unwrap();
        let (cycles, engage) = match verb {
            "command" => (
                decimal(words.pop().unwrap()),
                decimal(words.pop().unwrap()) != 0,
            ),
            _ => (0, false),
        };
        let mut values: Vec<f32> = words
            .iter()
            .map(|word| f32::from_bits(u32::from_str_radix(word, 16).unwrap()))
            .collect();
        let payload = values.pop().unwrap();
        let fits = values.len() == JOINTS;
        let mut last = String::new();
        let (status, answer) = match verb {
            "evaluate" => {
                evaluated += 1;
                let result = model.evaluate(&values, payload);
                let mut answer = result.pose.to_rows().to_vec();
                answer.extend(result.correction.to_array());
                (result.status, answer)
            }
            "correct" => {
                corrected += 1;
                let result = model.correct(&values, payload);
                let mut answer = result.joints.to_vec();
                answer.extend([result.applied, result.position_error, result.rotation_error]);
                (result.status, answer)
            }
            "command" => {
                commanded += 1;
                let payload = filter.payload(payload, cycles);
                // What leaves out a joint that was sent before is no command.
                if values.len() != JOINTS && ![0, values.len()].contains(&filter.joints()) {
                    values = vec![f32::NAN; 9];
                }
                let result = model.correct(&values, payload);
                let sent = filter.step(&values, &result.joints, result.status, engage, cycles);
                let mut answer = sent.joints.to_vec();
                answer.extend([sent.weight, result.applied]);
                answer.extend([result.position_error, result.rotation_error]);
                write!(last, " {}", u8::from(filter.disengaged())).unwrap();
                let blends = sent.status.contains(Status::BLENDING);
                ways[usize::from(engage) + 2 * usize::from(blends)] += 1;
                let status = sent.status.with_if(!engage, Status::BYPASSED);
                (status, answer)
            }
            _ => panic!("{line}"),
        };
        trusted += usize::from(status.is_ok());
        // POEGP_ERROR_JOINTS, or done.
        let code = if fits { 0 } else { 8 };
        let mut expected = format!("{question} | {code} {}", status.bits());
        for value in answer {
            assert!(value.is_finite(), "{line}");
            write!(expected, " {:08x}", value.to_bits()).unwrap();
        }
        assert_eq!(line, expected + &last);
    }
    assert_eq!((evaluated, corrected), (QUESTIONS, QUESTIONS));
    assert_eq!(commanded, CYCLES);
    assert_eq!(framed, QUESTIONS + 3);
    // The filter was under way and arrived, in both directions.
    assert!(ways.iter().all(|cycles| *cycles >= 5), "{ways:?}");
    assert!(
        trusted >= 4,
        "only {trusted} answers are within the trained ranges"
    );
}

/// Compares a line about cyclic frames with what `protocol` writes and reads.
fn assert_frame(line: &str) {
    let (question, answer) = line.split_once(" | ").unwrap();
    let words: Vec<&str> = question.split(' ').skip(1).collect();
    let decimal = |word: &&str| word.parse::<u32>().unwrap();
    let mut expected = String::new();
    if line.starts_with("frame") {
        let (sequence, numbers) = words.split_last().unwrap();
        let mut values: Vec<f32> = numbers
            .iter()
            .map(|word| f32::from_bits(u32::from_str_radix(word, 16).unwrap()))
            .collect();
        let payload_kg = values.pop().unwrap();
        let joints = heapless::Vec::from_slice(&values).unwrap_or_default();
        if joints.is_empty() {
            assert_eq!(answer, "8 0", "{line}");
            return;
        }
        let (query, mut out) = (Query { joints, payload_kg }, [0; MAX_CYCLIC]);
        let bytes = encode_command(decimal(sequence) as u16, &query, &mut out).unwrap();
        write!(expected, "0 {}", bytes.len()).unwrap();
        bytes
            .iter()
            .for_each(|byte| write!(expected, " {byte}").unwrap());
    } else {
        let mut bytes: Vec<u8> = words.iter().map(|word| decimal(word) as u8).collect();
        if bytes.last() == Some(&0) {
            bytes.pop();
        }
        let (code, numbers) = match decode_answer(&mut bytes) {
            Ok((sequence, answer)) => {
                let mut joints = [0.0; MAX_JOINTS];
                joints[..answer.joints.len()].copy_from_slice(&answer.joints);
                let numbers = [answer.applied, answer.position_error, answer.rotation_error];
                assert_eq!((sequence, answer.joints.len()), (0x1234, 6));
                ((0, answer.status), (joints, numbers, 6, sequence))
            }
            Err(_) => ((7, 0), ([0.0; MAX_JOINTS], [0.0; 3], 0, 0)),
        };
        let (joints, numbers, count, sequence) = numbers;
        write!(expected, "{} {}", code.0, code.1).unwrap();
        for value in joints.iter().chain(&numbers) {
            write!(expected, " {:08x}", value.to_bits()).unwrap();
        }
        write!(expected, " {count} {sequence}").unwrap();
    }
    assert_eq!(answer, expected, "{line}");
}

#[test]
fn c_on_the_workstation_answers_as_the_runtime() {
    let program = example(Machine::Host, "host");
    assert_answers(&run_on_host(
        &program.path,
        &capi().join("examples/arm.blob"),
    ));
}

#[test]
fn c_on_the_device_answers_as_the_runtime() {
    let program = example(Machine::Device, "device");
    let said = run_on_device(&program.path, false);
    assert_answers(&said);
    let stack = said.lines().last().unwrap().strip_prefix("stack ").unwrap();
    let stack: Vec<u64> = stack.split(' ').map(|word| word.parse().unwrap()).collect();
    println!(
        "stack from main on: {} bytes to load, {} to evaluate, correct and command",
        stack[0], stack[1]
    );
    assert!(stack[0] <= 20 * KIB, "{}", stack[0]);
    assert!((500..6 * KIB).contains(&stack[1]), "{}", stack[1]);
}

/// A linked C program must not have certain symbols anywhere. The program calls every function except those of signatures,
/// and the linker drops what it does not call.
#[test]
fn a_program_in_c_has_no_panic_no_heap_and_no_software_f64() {
    let program = example(Machine::Device, "device");
    let image = Image::read(&program.path).unwrap();
    println!(
        "example: flash {} bytes with a blob of 4.0 kB, static RAM {} bytes",
        image.flash, image.static_ram
    );
    assert!(image.flash <= 128 * KIB, "{}", image.flash);
    let ours = image.named(&[
        "poegp_evaluate",
        "poegp_correct",
        "poegp_command",
        "poegp_load",
    ]);
    assert_eq!(ours.len(), 4, "the search must find our symbols: {ours:?}");
    for part in [
        "panic",
        "unwrap_failed",
        "core3fmt",
        "core..fmt",
        "__rust_alloc",
        "malloc",
        "__aeabi_d",
        "__aeabi_f2d",
        "__aeabi_i2d",
        "__aeabi_ui2d",
        "__adddf3",
        "__muldf3",
        "__divdf3",
    ] {
        let found = image.named(&[part]);
        assert!(found.is_empty(), "{found:?}");
    }
}

/// The commands that make `examples/arm.blob`: an elastic model of a simulated robot with 25 inducing points.
const COMMANDS: &str = "
trainer simulate --robot abb-irb4400-serial --scenario wild --poses 120 --test-sets 1 --payloads 1,2.5,5 --seed 4 \\
    --out cell
trainer calibrate --robot abb-irb4400-serial cell/train.csv --inducing-points 25 --out arm.blob
";

/// `POEGP_BLESS=1` makes the blob again after the format has changed.
#[test]
fn the_blob_is_of_this_format() {
    let path = capi().join("examples/arm.blob");
    if std::env::var_os("POEGP_BLESS").is_some() {
        let folder = tempfile::Builder::new().prefix("poegp-").tempdir().unwrap();
        let manifest = concat!(env!("CARGO_MANIFEST_DIR"), "/../Cargo.toml");
        let trainer = format!(
            "trainer() {{ cargo run -q --release --manifest-path {manifest} -p poegp-trainer -- \"$@\"; }}"
        );
        let status = std::process::Command::new("sh")
            .args(["-e", "-c", &format!("{trainer}\n{COMMANDS}")])
            .current_dir(folder.path())
            .status()
            .unwrap();
        assert!(status.success(), "{status}");
        fs::copy(folder.path().join("arm.blob"), &path).unwrap();
    }
    let bytes = fs::read(&path).unwrap();
    let found = blob::decode(&bytes).map(|blob| blob::Host::decode(blob.host));
    assert!(
        matches!(found, Ok(Ok(_))),
        "{found:?}: POEGP_BLESS=1 cargo test -p poegp-tests --test capi blob"
    );
}
