//! The size of the image, and what it must not contain.

use poegp_protocol::link::{MAX_CHUNK, Query, Request, Response};
use poegp_tests::device::Device;
use poegp_tests::firmware_build::firmware;
use poegp_tests::image::Image;
use poegp_tests::record::assert_recorded;
use poegp_tests::sample::{Elastic, Sample, SampleCorrection, odd_queries};
use poegp_trainer::signing::SecretKey;

use crate::device;

const KIB: u64 = 1_024;

fn image() -> Image {
    let firmware = firmware().unwrap_or_else(|error| panic!("{error}"));
    println!("image of {}", firmware.toolchain);
    Image::read(&firmware.elf).unwrap()
}

#[test]
fn fits_its_budgets() {
    let image = image();
    println!(
        "flash {} bytes, static RAM {} bytes",
        image.flash, image.static_ram
    );
    assert!(
        image.flash > 10 * KIB,
        "{} bytes are too few for the firmware",
        image.flash
    );
    assert!(image.flash <= 144 * KIB, "{}", image.flash);
    assert!(image.static_ram <= 128 * KIB, "{}", image.static_ram);
    assert_recorded("flash, signatures included (bytes)", image.flash as f64);
    assert_recorded(
        "static RAM, two models of 400 points and a blob in transfer (bytes)",
        image.static_ram as f64,
    );
}

#[test]
fn stack_stays_small() {
    let mut device = device();
    let sample = Sample::plain(40, SampleCorrection::Shared(300));
    device.load(&sample.blob()).unwrap();
    for query in sample.queries(8) {
        device.evaluate(&query).unwrap();
        device.trace(&query).unwrap();
    }
    device
        .load(&Sample::plain(41, SampleCorrection::PerOutput(300)).blob())
        .unwrap();
    let before = device.statistics().unwrap().stack_bytes;
    for (joints, elastic) in [(7, Elastic::PLAIN), (6, Elastic::WITH_STD)] {
        let sample = Sample {
            joints,
            ..Sample::plain(42, SampleCorrection::Elastic(elastic))
        };
        device.load(&sample.blob()).unwrap();
        for query in sample.queries(4) {
            device.evaluate(&query).unwrap();
            device.trace(&query).unwrap();
        }
    }
    let stack = device.statistics().unwrap().stack_bytes;
    println!("stack {stack} bytes, {before} before an elastic model");
    assert!(stack > 1_000, "{stack} bytes: was the stack painted?");
    // The deepest call of the background with a cycle on top of it.
    assert!(u64::from(stack) <= 22 * KIB, "{stack}");
    let ram = image().static_ram + u64::from(stack);
    println!("RAM with two models and the stack: {ram} bytes");
    assert!(ram <= 128 * KIB, "{ram}");
}

/// Covers the deepest calls: signatures interrupted by cycles, flash, and corrections and traces of the longest arm.
#[test]
fn stack_stays_small_with_signatures() {
    let mut device = device();
    let key = SecretKey::generate().unwrap();
    device.client().provision(key.public().bytes()).unwrap();
    device.client().set_signer(key.signer());
    let seven = |seed, kind| Sample {
        joints: 7,
        ..Sample::plain(seed, SampleCorrection::Elastic(kind))
    };
    for sample in [
        Sample::plain(43, SampleCorrection::PerOutput(300)),
        seven(44, Elastic::PLAIN),
        seven(45, Elastic::WITH_STD),
    ] {
        let signed = key.sign(&sample.blob(), 1).unwrap();
        device.load(&signed).unwrap();
        let mut damaged = signed.clone();
        damaged[signed.len() / 2] ^= 1;
        for refused in [&signed[..signed.len() - 1], &damaged] {
            device.load(refused).unwrap_err();
        }
        // Chance decides where in a signature a cycle comes, so there are enough cycles to meet its deepest calls.
        let mut cycles = 0;
        for _ in 0..100 {
            cycles += cycles_during_a_signature(&mut device, &signed, &sample.queries(20));
            if cycles >= 8 {
                break;
            }
        }
        println!("{cycles} cycles during signatures");
        assert!(cycles >= 8, "{cycles}");
        for query in odd_queries() {
            device.evaluate(&query).unwrap();
            device.correct(&query).unwrap();
        }
    }
    let model = device.identify().unwrap().model.unwrap();
    device.client().roll_back(model.blob_crc).unwrap();
    let stack = u64::from(device.statistics().unwrap().stack_bytes);
    let ram = image().static_ram + stack;
    println!("stack {stack} bytes with signatures; RAM with two models and the stack: {ram} bytes");
    assert!(stack <= 22 * KIB, "{stack}");
    assert!(ram <= 128 * KIB, "{ram}");
}

/// Uploads a blob again and asks for traces and corrections during its verification. Returns how many were answered.
fn cycles_during_a_signature(device: &mut Device, signed: &[u8], queries: &[Query]) -> usize {
    device.client().begin_upload(signed).unwrap();
    for (index, bytes) in signed.chunks(MAX_CHUNK).enumerate() {
        let offset = (MAX_CHUNK * index) as u32;
        let piece = Request::UploadChunk { offset, bytes };
        device.request(&piece).unwrap();
    }
    let (verify, frame) = device.frame(&Request::VerifyUpload);
    device.send_bytes(&frame).unwrap();
    let (mut verified, mut cycles) = (false, 0);
    for query in queries.iter().cycle() {
        for request in [
            Request::Trace(query.clone()),
            Request::Correct(query.clone()),
        ] {
            let (number, frame) = device.frame(&request);
            device.send_bytes(&frame).unwrap();
            loop {
                let (answered, response) = device.receive().unwrap().expect("an answer");
                verified |= answered == verify && matches!(response, Response::Verified(_));
                if answered == number {
                    break;
                }
            }
        }
        if verified {
            break;
        }
        cycles += 2;
    }
    cycles
}

#[test]
fn has_no_software_f64_no_heap_and_no_formatting() {
    let image = image();
    // Run-time ABI for the Arm architecture, section 4.1: all operations on `double`, which the FPU does not have.
    let doubles = image.named(&[
        "__aeabi_d",
        "__aeabi_f2d",
        "__aeabi_i2d",
        "__aeabi_ui2d",
        "__aeabi_l2d",
        "__aeabi_cd",
        "__adddf3",
        "__subdf3",
        "__muldf3",
        "__divdf3",
        "__extendsfdf2",
        "__truncdfsf2",
    ]);
    assert!(doubles.is_empty(), "{doubles:?}");
    let heap = image.named(&["__rust_alloc", "__rg_alloc", "malloc"]);
    assert!(heap.is_empty(), "{heap:?}");
    let formatting = image.named(&["core..fmt", "core3fmt", "4core3fmt"]);
    assert!(formatting.is_empty(), "{formatting:?}");
}

/// The callers of functions that end in a panic. Only `signature::verify` is one, since the inlined code of the signature's
/// curve indexes tables. It runs in the background once for each model.
#[test]
fn nothing_of_the_runtime_can_panic() {
    let image = image();
    let callers = image.callers("9panicking");
    println!("callers of a panic: {callers:#?}");
    let ours: Vec<_> = callers
        .iter()
        .filter(|(caller, _)| caller.contains("poegp_runtime") || caller.contains("poegp_protocol"))
        .filter(|(caller, _)| !caller.contains("signature6verify"))
        .collect();
    assert!(ours.is_empty(), "{ours:?}");
    assert!(
        !callers.is_empty(),
        "the search for callers finds nothing at all"
    );
}

/// The routines are those of `firmware/src/mem_intrinsics.rs`, not the compiler library's weak ones, which have another
/// size.
#[test]
fn copies_by_many_registers() {
    let image = image();
    for (name, bytes) in [("__aeabi_memclr4", 60), ("__aeabi_memcpy4", 76)] {
        let sizes: Vec<u64> = image
            .functions
            .iter()
            .filter(|function| function.name == name)
            .map(|function| function.size)
            .collect();
        assert_eq!(sizes, [bytes], "{name}");
    }
}
