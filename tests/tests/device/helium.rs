//! The cost on a Cortex-M55, in instructions that repeat exactly, and the part of it that vector instructions cannot
//! reduce.

use poegp_tests::device::Device;
use poegp_tests::emulator::{Clock, Machine, instructions};
use poegp_tests::firmware_build::{Board, firmware_of};
use poegp_tests::record::assert_recorded;
use poegp_tests::sample::{Elastic, Sample, SampleCorrection};

/// A correction with neither ripple nor curves.
const BARE: Elastic = Elastic {
    points: 100,
    ripple: 0,
    ..Elastic::PLAIN
};

/// A correction without inducing points and groups; only scalar code remains.
const NO_POINTS: Elastic = Elastic {
    points: 0,
    groups: 0,
    ..BARE
};

/// Cost of a command that is corrected in part beyond one that is corrected fully or not at all, on a Cortex-M4F.
const CONTINUOUS: f64 = 4_232.0;

/// Returns the most instructions of a pose, and of a corrected command.
fn pose_and_command(device: &mut Device, sample: &Sample) -> [f64; 2] {
    let tick_hz = device.load(&sample.blob()).unwrap().tick_hz;
    let mut most = [0, 0];
    for query in sample.queries(20) {
        most[0] = most[0].max(device.evaluate(&query).unwrap().ticks);
        most[1] = most[1].max(device.correct(&query).unwrap().ticks);
    }
    most.map(|ticks| instructions(ticks, tick_hz))
}

fn device(board: Board) -> Device {
    let firmware = firmware_of(board).unwrap_or_else(|error| panic!("{error}"));
    Device::on(&Machine {
        board,
        elf: &firmware.elf,
        clock: Clock::Counting,
        flash_image: None,
    })
    .unwrap()
}

#[test]
fn instructions_on_a_cortex_m55() {
    let mut devices = [Board::Mps3An547, Board::Mps2An386].map(device);
    println!("instructions, six joints:");
    println!("| what | Cortex-M55 | Cortex-M4F |");
    println!("|---|---|---|");
    let mut figures = Vec::new();
    let (mut without, mut shares) = ([0.0; 2], Vec::new());
    let plain = |correction| Sample::plain(31, correction);
    let elastic = |elastic| plain(SampleCorrection::Elastic(elastic));
    let paper = plain(SampleCorrection::Folded(100));
    for (name, sample) in [
        ("chain alone", plain(SampleCorrection::None)),
        ("paper, 100 points", paper),
        (
            "paper, 100 points, standard deviation",
            Sample {
                landmarks: 48,
                ..paper
            },
        ),
        ("paper, 300 points", plain(SampleCorrection::Folded(300))),
        ("elastic without points", elastic(NO_POINTS)),
        ("elastic, 100 points, no ripple", elastic(BARE)),
        (
            "elastic, 100 points, four ripple terms",
            elastic(Elastic { ripple: 4, ..BARE }),
        ),
        (
            "elastic, 100 points, own-joint curves",
            elastic(Elastic {
                curve_orders: 64,
                ..BARE
            }),
        ),
        ("elastic, 200 points", elastic(Elastic::PLAIN)),
        (
            "elastic, 200 points, standard deviation",
            elastic(Elastic::WITH_STD),
        ),
    ] {
        let [helium, scalar] = devices.each_mut();
        let [pose, command] = pose_and_command(helium, &sample);
        let [scalar_pose, scalar_command] = pose_and_command(scalar, &sample);
        println!("| pose, {name} | {pose:.0} | {scalar_pose:.0} |");
        println!("| command, {name} | {command:.0} | {scalar_command:.0} |");
        if sample == elastic(BARE) {
            assert!(pose <= 7_000.0, "{pose}");
            assert!(command <= 12_500.0 + CONTINUOUS, "{command}");
        }
        if sample.correction == SampleCorrection::Folded(300) {
            assert!(pose <= 6_000.0, "{pose}");
        }
        let most = match sample.correction {
            SampleCorrection::Elastic(elastic) => (elastic.landmarks > 0).then_some(0.25),
            _ => (sample.landmarks > 0).then_some(0.40),
        };
        if let Some(most) = most {
            let share = [(pose, command), (scalar_pose, scalar_command)];
            for ((with, command), without) in share.into_iter().zip(without) {
                let share = (with - without) / command;
                assert!(share <= most, "{share}");
                shares.push(format!("{share:.3}"));
            }
        }
        without = [pose, scalar_pose];
        figures.push((format!("pose, {name}"), pose, scalar_pose));
        figures.push((format!("command, {name}"), command, scalar_command));
    }
    println!(
        "standard deviations as a share of a command, each on both: {}",
        shares.join(", ")
    );
    let pose = |name: &str| {
        let of = |(what, ..): &&(String, f64, f64)| *what == format!("pose, {name}");
        figures
            .iter()
            .find(of)
            .map(|(_, _, scalar)| *scalar)
            .unwrap()
    };
    let bare = pose("elastic, 100 points, no ripple");
    let each_term = (pose("elastic, 100 points, four ripple terms") - bare) / 4.0;
    let each_curve = (pose("elastic, 100 points, own-joint curves") - bare) / 6.0;
    println!(
        "Cortex-M4F, a pose: {each_term:.1} a term of ripple, {each_curve:.1} a curve of 64 orders"
    );
    assert!(each_term <= 70.0 && each_curve <= 450.0);
    for (what, instructions, _) in figures {
        assert_recorded(&what, instructions);
    }
}
