//! What the image takes, and what is not in it.

use poegp_tests::firmware::firmware;
use poegp_tests::image::Image;
use poegp_tests::sample::{Elastic, Sample, Support};

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
        "{} bytes is no firmware",
        image.flash
    );
    assert!(image.flash <= 128 * KIB, "{}", image.flash);
    assert!(image.static_ram <= 128 * KIB, "{}", image.static_ram);
}

#[test]
fn stack_stays_small() {
    let mut device = device();
    let sample = Sample::plain(40, Support::Shared(300));
    device.load(&sample.blob()).unwrap();
    for query in sample.queries(8) {
        device.evaluate(&query).unwrap();
        device.trace(&query).unwrap();
    }
    device
        .load(&Sample::plain(41, Support::PerOutput(300)).blob())
        .unwrap();
    let before = device.statistics().unwrap().stack_bytes;
    for (joints, elastic) in [(7, Elastic::OWN), (6, Elastic::TIED)] {
        let sample = Sample {
            joints,
            ..Sample::plain(42, Support::Elastic(elastic))
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
    // The background's deepest call with a cycle on top of it.
    assert!(u64::from(stack) <= 20 * KIB, "{stack}");
    let ram = image().static_ram + u64::from(stack);
    println!("RAM with two models and the stack: {ram} bytes");
    assert!(ram <= 128 * KIB, "{ram}");
}

#[test]
fn has_no_software_f64_no_heap_and_no_formatting() {
    let image = image();
    // Run-time ABI for the Arm architecture, section 4.1: every operation on `double` the FPU does not have.
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

/// Functions that end in a panic. The signature's curve indexes tables, and is inlined into `signature::verify`, which
/// runs in the background once for each model.
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
