//! What a support point more costs on the device: instructions of one evaluation for M = 25 … 400.

use poegp_tests::device::Device;
use poegp_tests::emulator::{Clock, instructions};
use poegp_tests::sample::{Elastic, Sample, Support};
use poegp_trainer::cost::{ElasticSize, instructions as predicted};

const POINTS: [usize; 5] = [25, 50, 100, 200, 400];

/// Instructions of one evaluation within the trained ranges.
fn count(device: &mut Device, support: Support) -> f64 {
    let sample = Sample::plain(40, support);
    device.load(&sample.blob()).unwrap();
    let tick_hz = device.identify().unwrap().tick_hz;
    let ticks = device.evaluate(&sample.queries(1)[0]).unwrap().ticks;
    instructions(ticks, tick_hz)
}

/// Slope of log count over log M, least squares over all sizes.
fn exponent(counts: &[f64]) -> f64 {
    let points: Vec<(f64, f64)> = POINTS
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
fn instructions_grow_with_the_support_points_and_no_faster() {
    let mut device = Device::start(Clock::Counting).unwrap_or_else(|error| panic!("{error}"));
    println!("instructions of one evaluation (predicted by trainer/src/cost.rs), Cortex-M4F:");
    println!("| | M = 25 | 50 | 100 | 200 | 400 | exponent |");
    println!("|---|---|---|---|---|---|---|");
    for name in [
        "paper, shared",
        "elastic, own length scales",
        "elastic, tied",
    ] {
        let mut counts = Vec::new();
        let mut cells = Vec::new();
        for points in POINTS {
            let elastic = Elastic {
                points,
                tied: name == "elastic, tied",
                ..Elastic::OWN
            };
            if name == "paper, shared" {
                counts.push(count(&mut device, Support::Shared(points)));
                cells.push(format!("{:.0}", counts[counts.len() - 1]));
                continue;
            }
            let found = count(&mut device, Support::Elastic(elastic));
            let size = ElasticSize {
                joints: 6,
                prismatic: 0,
                support: points,
                groups: elastic.groups,
                tied: elastic.tied,
                ripple: elastic.ripple,
                landmarks: 0,
            };
            counts.push(found);
            cells.push(format!("{found:.0} ({})", predicted(&size)));
        }
        let exponent = exponent(&counts);
        println!("| {name} | {} | {exponent:.2} |", cells.join(" | "));
        // A constant and a cost for each point: never more than proportional.
        assert!((0.1..=1.0).contains(&exponent), "{name}: {exponent}");
        let (first, last) = (counts[1] - counts[0], counts[4] - counts[3]);
        let each = (first / 25.0, last / 200.0);
        assert!(
            (each.1 / each.0 - 1.0).abs() < 0.05,
            "{name}: {each:?} instructions a point"
        );
    }
}
