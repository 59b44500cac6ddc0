//! The call graph of every board's image: its deepest stack, compared with the budget and with what the emulator's painted
//! stack shows, and which code its exceptions can reach.
//!
//! ```text
//!  main ── PendSV or SysTick, of one priority ── the link's interrupt ── a fault
//! ```
//!
//! Each level can interrupt the deepest call of the level before it, on top of a frame that the processor stores.

use std::collections::BTreeSet;

use poegp_tests::firmware_build::{Board, Variant, firmware_with};
use poegp_tests::record::assert_recorded;
use poegp_tests::sample::{Elastic, Sample, SampleCorrection};
use poegp_tests::stack::{CallGraph, EXCEPTION_FRAME};

use crate::device;

/// Bytes of stack that every board must have.
const BUDGET: u64 = 22 * 1_024;

/// The name of a level, and the exceptions that belong to it.
type Level = (&'static str, fn(usize) -> bool);

/// Numbers of exceptions by level (ARMv7-M Architecture Reference Manual, B1.5.2). In a level only the deepest counts.
const LEVELS: [Level; 4] = [
    ("start, then the background", |number| number == 1),
    ("PendSV, SysTick", |number| matches!(number, 14 | 15)),
    ("the link's interrupt, any other", |number| {
        !matches!(number, 1 | 3 | 14 | 15)
    }),
    ("a fault", |number| number == 3),
];

/// Returns every image for a robot: each board's, and that of the STM32F405 with its link over SPI.
fn products() -> impl Iterator<Item = (Board, Variant)> {
    let images = Board::ALL.map(|board| (board, Variant::Product));
    images
        .into_iter()
        .chain([(Board::Stm32F405, Variant::SpiLink)])
}

fn bound(board: Board, variant: Variant) -> u64 {
    let firmware = firmware_with(board, variant).unwrap_or_else(|error| panic!("{error}"));
    let graph = CallGraph::read(&firmware.elf).unwrap_or_else(|error| panic!("{error}"));
    println!("{}, {variant:?}, {}:", board.name(), firmware.toolchain);
    let mut sum = EXCEPTION_FRAME * (LEVELS.len() as u64 - 1);
    for (level, belongs) in LEVELS {
        let roots = graph.vectors.iter().enumerate();
        let roots = roots.filter(|(number, address)| belongs(*number) && **address != 0);
        let deepest = roots.map(|(_, address)| graph.deepest(*address).unwrap());
        let deepest = deepest.max_by_key(|deepest| deepest.bytes).unwrap();
        println!("  {:6} bytes: {level}", deepest.bytes);
        for (name, frame) in &deepest.chain {
            println!("    {frame:6} {name}");
        }
        sum += deepest.bytes;
    }
    println!("  {sum:6} bytes in all, exception frames included; the budget is {BUDGET}");
    sum
}

#[test]
fn the_deepest_call_fits_the_stack() {
    for (board, variant) in products() {
        let bound = bound(board, variant);
        assert!(bound <= BUDGET, "{}, {variant:?}: {bound}", board.name());
        assert_recorded(
            "deepest stack, bound by the call graph (bytes)",
            bound as f64,
        );
    }
}

/// Neither the cycle nor the link's interrupt can panic. The background can, because the signature's curve indexes tables.
#[test]
fn no_panic_is_reached_but_by_the_background() {
    for (board, variant) in products() {
        let firmware = firmware_with(board, variant).unwrap_or_else(|error| panic!("{error}"));
        let graph = CallGraph::read(&firmware.elf).unwrap_or_else(|error| panic!("{error}"));
        let (mut cycle, mut background) = (BTreeSet::new(), 0);
        for (number, &address) in graph.vectors.iter().enumerate() {
            if address == 0 {
                continue;
            }
            let reached = graph.reached(address).unwrap();
            let is_panic = |name: &&&str| name.contains("panic");
            let panics: Vec<&&str> = reached.iter().filter(is_panic).collect();
            if number == 1 {
                background = panics.len();
                continue;
            }
            assert!(
                panics.is_empty(),
                "{}, {variant:?}: exception {number}: {panics:?}",
                board.name()
            );
            cycle.extend(reached);
        }
        println!(
            "{}, {variant:?}: {} functions below the exceptions, none of a panic; {background} of a panic below the start",
            board.name(),
            cycle.len()
        );
        assert!(cycle.len() > 20, "{}", cycle.len());
        assert!(background > 0, "the search finds no panic at all");
    }
}

/// The emulator's painted stack would reveal a bound that is too small.
#[test]
fn no_stack_was_ever_deeper() {
    let bound = bound(Board::Mps2An386, Variant::Product);
    let mut device = device();
    for kind in [Elastic::PLAIN, Elastic::WITH_STD] {
        let sample = Sample {
            joints: 7,
            ..Sample::plain(46, SampleCorrection::Elastic(kind))
        };
        device.load(&sample.blob()).unwrap();
        for query in sample.queries(20) {
            device.trace(&query).unwrap();
            device.correct(&query).unwrap();
        }
    }
    let painted = u64::from(device.statistics().unwrap().stack_bytes);
    println!("painted {painted} of at most {bound} bytes");
    assert!(painted <= bound, "{painted}");
    assert!(2 * painted > bound, "{painted}: the bound is far too large");
}
