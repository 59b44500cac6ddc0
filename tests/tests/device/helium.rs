//! What a Cortex-M55 costs, in instructions that repeat exactly, and what of that no vector can take.

use poegp_tests::device::Device;
use poegp_tests::emulator::{Clock, Machine, instructions};
use poegp_tests::firmware_build::{Board, firmware_of};
use poegp_tests::record::assert_recorded;
use poegp_tests::sample::{Elastic, Sample, SampleCorrection};

/// Neither ripple nor curves.
const BARE: Elastic = Elastic {
    points: 100,
    ripple: 0,
    ..Elastic::PLAIN
};

/// Without inducing points and their groups: what is left is for scalar code.
const NO_POINTS: Elastic = Elastic {
    points: 0,
    groups: 0,
    ..BARE
};

/// Most instructions of a pose and of a corrected command.
fn pose_and_command(device: &mut Device, correction: SampleCorrection) -> [f64; 2] {
    let sample = Sample::plain(31, correction);
    let tick_hz = device.load(&sample.blob()).unwrap().tick_hz;
    let mut most = [0, 0];
    for query in sample.queries(60) {
        most[0] = most[0].max(device.evaluate(&query).unwrap().ticks);
        most[1] = most[1].max(device.correct(&query).unwrap().ticks);
    }
    most.map(|ticks| instructions(ticks, tick_hz))
}

/// The limits of a command have 3 000 for the limited step, which came with the smooth command.
#[test]
fn instructions_on_a_cortex_m55() {
    let [mut m4, mut m55] = [Board::Mps2An386, Board::Mps3An547].map(|board| {
        let elf = &firmware_of(board)
            .unwrap_or_else(|error| panic!("{error}"))
            .elf;
        let (clock, flash_image) = (Clock::Counting, None);
        Device::on(&Machine {
            board,
            elf,
            clock,
            flash_image,
        })
        .unwrap()
    });
    println!("instructions of a pose and of a command, six joints:");
    println!("| model | Cortex-M4F | Cortex-M55 |");
    println!("|---|---|---|");
    let mut beyond = Vec::new();
    let none = [f64::INFINITY; 2];
    for (name, correction, limits) in [
        ("chain alone", SampleCorrection::None, none),
        (
            "paper, 300 points",
            SampleCorrection::Folded(300),
            [6_000.0, f64::INFINITY],
        ),
        (
            "elastic without points",
            SampleCorrection::Elastic(NO_POINTS),
            none,
        ),
        (
            "elastic, 100 points, no ripple",
            SampleCorrection::Elastic(BARE),
            [7_000.0, 15_500.0],
        ),
        (
            "elastic, 200 points",
            SampleCorrection::Elastic(Elastic::PLAIN),
            none,
        ),
        (
            "elastic, 200 points, standard deviation",
            SampleCorrection::Elastic(Elastic::WITH_STD),
            none,
        ),
    ] {
        let before = pose_and_command(&mut m4, correction);
        let counts = pose_and_command(&mut m55, correction);
        println!(
            "| {name} | {:.0}, {:.0} | {:.0}, {:.0} |",
            before[0], before[1], counts[0], counts[1]
        );
        if counts[0] > limits[0] || counts[1] > limits[1] {
            beyond.push((name, counts));
        }
        if std::env::var_os("POEGP_X").is_none() {
            assert_recorded(&format!("Cortex-M55, pose, {name}"), counts[0]);
            assert_recorded(&format!("Cortex-M55, command, {name}"), counts[1]);
        }
    }
    assert!(beyond.is_empty(), "{beyond:?}");
}
