//! The cost of another inducing point on the device: instructions of one evaluation for M = 25 … 400.

use poegp_protocol::link::Refusal;
use poegp_tests::device::{Device, DeviceError};
use poegp_tests::emulator::{Clock, instructions};
use poegp_tests::sample::{Elastic, Sample, SampleCorrection};

const POINTS: [usize; 5] = [25, 50, 100, 200, 400];

/// Returns the instructions of one evaluation within the trained ranges; `None` if the blob does not fit the device.
fn count(device: &mut Device, correction: SampleCorrection) -> Option<f64> {
    let sample = Sample::plain(40, correction);
    match device.load(&sample.blob()) {
        Ok(_) => {}
        Err(DeviceError::Refused(Refusal::BlobTooLong { length, capacity })) => {
            println!("{correction:?}: a blob of {length} bytes, the device takes {capacity}");
            return None;
        }
        Err(error) => panic!("{correction:?}: {error}"),
    }
    let tick_hz = device.identify().unwrap().tick_hz;
    let ticks = device.evaluate(&sample.queries(1)[0]).unwrap().ticks;
    Some(instructions(ticks, tick_hz))
}

/// Returns the slope of log count over log M, by least squares.
fn exponent(sizes: &[usize], counts: &[f64]) -> f64 {
    let points: Vec<(f64, f64)> = sizes
        .iter()
        .zip(counts)
        .map(|(m, count)| ((*m as f64).ln(), count.ln()))
        .collect();
    let n = points.len() as f64;
    let mean_x = points.iter().map(|p| p.0).sum::<f64>() / n;
    let mean_y = points.iter().map(|p| p.1).sum::<f64>() / n;
    let product: f64 = points.iter().map(|p| (p.0 - mean_x) * (p.1 - mean_y)).sum();
    let square: f64 = points.iter().map(|p| (p.0 - mean_x).powi(2)).sum();
    product / square
}

#[test]
fn instructions_grow_with_the_inducing_points_and_no_faster() {
    let mut device = Device::start(Clock::Counting).unwrap_or_else(|error| panic!("{error}"));
    let mut lines = Vec::new();
    for name in ["paper, shared", "elastic"] {
        let (mut counts, mut cells) = (Vec::new(), Vec::new());
        for points in POINTS {
            if name == "paper, shared" {
                let found =
                    count(&mut device, SampleCorrection::Folded(points)).expect("512 points fit");
                cells.push(format!("{found:.0}"));
                counts.push(found);
                continue;
            }
            // With several groups, a few points would not fill all of them.
            let elastic = Elastic {
                points,
                groups: 1,
                ..Elastic::PLAIN
            };
            let correction = SampleCorrection::Elastic(elastic);
            let bound = Sample::plain(35, correction).size().pose_bound();
            match count(&mut device, correction) {
                Some(found) => {
                    cells.push(format!("{found:.0} ({bound})"));
                    counts.push(found);
                }
                None => cells.push(format!("does not fit ({bound})")),
            }
        }
        let sizes = &POINTS[..counts.len()];
        assert!(sizes.len() >= 4, "{name}: 200 points fit into the device");
        let exponent = exponent(sizes, &counts);
        lines.push(format!(
            "| {name} | {} | {exponent:.2} |",
            cells.join(" | ")
        ));
        // A constant plus a cost per point grows at most proportionally.
        assert!((0.1..=1.0).contains(&exponent), "{name}: {exponent}");
        let each: Vec<f64> = (1..sizes.len())
            .map(|i| (counts[i] - counts[i - 1]) / (sizes[i] - sizes[i - 1]) as f64)
            .collect();
        // The assembly takes two points per step, and a last odd point costs more than half a step. 25 points have such a
        // point, 50 have none, so that interval adds less. The first odd row of a set has instructions of its own, a few
        // more than half a step: one of six sets has an odd row with 25 points, two with 50, four with more.
        for cost in &each[1..] {
            assert!(
                (cost / each[1] - 1.0).abs() < 0.05,
                "{name}: {each:?} instructions a point"
            );
        }
        let odd = (each[1] - each[0]) * (sizes[1] - sizes[0]) as f64;
        let allowed = if name == "elastic" {
            -6.0 * 10.0..=6.0 * 10.0
        } else {
            -0.05 * each[1]..=5.0 * 150.0
        };
        assert!(
            allowed.contains(&odd),
            "{name}: {odd} instructions for odd numbers"
        );
    }
    println!("instructions of one evaluation (its bound in parentheses), Cortex-M4F:");
    println!("| | M = 25 | 50 | 100 | 200 | 400 | exponent |");
    println!("|---|---|---|---|---|---|---|");
    for line in lines {
        println!("{line}");
    }
}
