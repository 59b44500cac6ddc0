//! Whether the predicted standard deviations are right: errors in units of their predicted standard deviations.

use maud::html;

use crate::report::chart::{Axis, Plot, Series};
use crate::report::{HeldOutSummary, Number, ReportData, Section};
use poegp_calibration::validation::held_out::HeldOutPose;

/// Largest |z| of the histogram, and below it the number of bins.
const WIDEST: f64 = 4.0;
const BINS: usize = 32;
/// Difference of a share from its expected value above which the share is called wrong.
const TOLERANCE: f64 = 0.05;

fn standardised(poses: &[HeldOutPose]) -> Vec<f64> {
    let of = |p: &HeldOutPose| -> Vec<f64> {
        let Some(sigma) = p.sigma else {
            return Vec::new();
        };
        let pairs = p.residual.iter().zip(sigma).take(p.components());
        pairs
            .filter(|(_, s)| *s > 0.0)
            .map(|(e, s)| e / s)
            .collect()
    };
    poses.iter().flat_map(of).collect()
}

/// Returns the section with a histogram of z-scores beside the normal distribution, and predicted against actual coverage.
pub fn uncertainty(evidence: &ReportData, summary: &HeldOutSummary) -> Section {
    let section = Section::new("uncertainty", "Predictive uncertainty");
    let z = standardised(&evidence.calibrated().poses);
    let (Some(coverage), false) = (&summary.calibrated.coverage, z.is_empty()) else {
        return section.missing(
            "Not shown: this model has no predicted standard deviations to compare with.",
        );
    };
    let width = 2.0 * WIDEST / BINS as f64;
    let mut counts = vec![0.0; BINS];
    for z in &z {
        let bin = ((z.clamp(-WIDEST, WIDEST) + WIDEST) / width) as usize;
        counts[bin.min(BINS - 1)] += 1.0;
    }
    let edge = |i: usize| -WIDEST + width * i as f64;
    let bars: Vec<(f64, f64, f64)> = (0..BINS)
        .map(|i| (edge(i), edge(i + 1), counts[i]))
        .collect();
    let peak = z.len() as f64 * width / (2.0 * std::f64::consts::PI).sqrt();
    let normal = |x: f64| (x, peak * (-0.5 * x * x).exp());
    let normal: Vec<(f64, f64)> = (0..=80)
        .map(|i| normal(-WIDEST + WIDEST / 40.0 * f64::from(i)))
        .collect();
    let most = counts.iter().copied().fold(peak, f64::max);
    let mut histogram = Plot::new(
        Axis::linear("error / predicted standard deviation", -WIDEST, WIDEST),
        Axis::linear("error components", 0.0, 1.05 * most),
    );
    histogram.bars(Series::Calibrated, &bars);
    histogram.line(Series::Reference, &normal, false);

    let mut sizes: Vec<f64> = z.iter().map(|z| z.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    let within = |limit: f64| sizes.partition_point(|z| *z <= limit) as f64 / sizes.len() as f64;
    let shares: Vec<(f64, f64)> = TWO_SIDED
        .iter()
        .map(|(share, limit)| (100.0 * share, 100.0 * within(*limit)))
        .collect();
    let mut calibration = Plot::new(
        Axis::linear("predicted share within (%)", 0.0, 100.0),
        Axis::linear("actual share within (%)", 0.0, 100.0),
    );
    calibration.line(Series::Reference, &[(0.0, 0.0), (100.0, 100.0)], false);
    calibration.line(Series::Calibrated, &shares, true);

    let (one, two) = (coverage.all.one_sigma, coverage.all.two_sigma);
    let at = |name: &str| format!("/held_out/calibrated/coverage/{name}");
    // The axes are those of positions, then those of rotations.
    let components = match coverage.axes.len() {
        ..=3 => "those of positions",
        _ => "those of positions and rotations together",
    };
    let finding = if two < 0.95 - TOLERANCE || one < 0.683 - 1.5 * TOLERANCE {
        "The predicted standard deviations are too small: "
    } else if one > 0.683 + 1.5 * TOLERANCE {
        "The predicted standard deviations are too large: "
    } else {
        "The predicted standard deviations are right: "
    };
    section
        .figure(
            html! {
                (finding) (Number::percent(one, at("one_sigma")))
                " % of the error components, " (components) ", are within one predicted standard deviation, where 68 % should be"
            },
            histogram.render("Histogram of standardised errors and the normal distribution"),
            "Dashed: the normal distribution. Errors beyond ±4 are counted in the last bars.",
        )
        .figure(
            html! {
                (Number::percent(two, at("two_sigma")))
                " % are within 1.96 predicted standard deviations, where 95 % should be"
            },
            calibration.render("Predicted against actual shares"),
            "On the dashed line predictions are right; below it the model is overconfident, above it underconfident.",
        )
        .text(html! {
            "The predicted standard deviation of a new measurement is " (Number::mm(coverage.mean_sigma_mm, at("mean_sigma_mm")))
            " mm along one axis on average, noise of the instrument included."
        })
}

/// Shares of a normal distribution (first) within ± the second number.
const TWO_SIDED: [(f64, f64); 8] = [
    (0.1, 0.125_661),
    (0.3, 0.385_320),
    (0.5, 0.674_490),
    (0.683, 1.000_642),
    (0.8, 1.281_552),
    (0.9, 1.644_854),
    (0.95, 1.959_964),
    (0.99, 2.575_829),
];
