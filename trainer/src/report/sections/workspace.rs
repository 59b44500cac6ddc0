//! Where in the workspace the errors are: three projections, before and after, with arrows.

use maud::{Markup, html};

use crate::report::chart::{Axis, Plot, Series, plain, round_125};
use crate::report::sections::methods::keys;
use crate::report::{HeldOutSummary, Number, ReportData, Section};
use poegp_calibration::validation::held_out::HeldOutPose;

/// Length of an arrow that 95 % of the errors stay below, as a share of the widest side.
const ARROW: f64 = 0.11;
/// Sides of a drawing, and what its labels take of them.
const SIDE: f64 = 300.0;
const LABELS: (f64, f64) = (66.0, 50.0);
/// Room around the poses, as a share of the widest side.
const MARGIN: f64 = 0.06;
/// The views: the two axes that are seen, and from where.
const VIEWS: [(usize, usize, &str); 3] = [
    (0, 1, "from above"),
    (0, 2, "from the side"),
    (1, 2, "from the front"),
];
/// Poses that are needed to say something about neighbours.
const FEWEST: usize = 20;
/// Mean cosine between neighbours' errors above which the errors are called systematic.
const SYSTEMATIC: f64 = 0.3;

/// Three projections, before and after.
pub fn workspace(evidence: &ReportData, summary: &HeldOutSummary) -> Section {
    let both = evidence.nominal != evidence.calibrated;
    let section = Section::new("workspace", "Where in the workspace").small_figures();
    let (low, high) = extent(&evidence.calibrated().poses);
    let widest = (0..3).map(|i| high[i] - low[i]).fold(0.0, f64::max);
    if widest.is_nan() || widest <= 0.0 {
        return section.missing("Not shown: all poses are at one place.");
    }
    let mut section = section
        .text(html! {
            (keys(both)) ". Every arrow begins where a held-out pose was measured and points from where the model says that the "
            "tool is to where it was seen, enlarged; x, y, z are the axes of the robot's base."
        })
        .text(neighbours(evidence));
    let mut shown = vec![(
        Series::Calibrated,
        evidence.calibrated(),
        &summary.calibrated,
        "calibrated",
    )];
    if both {
        shown.insert(
            0,
            (
                Series::Nominal,
                evidence.nominal(),
                &summary.nominal,
                "nominal",
            ),
        );
    }
    let side = widest * (1.0 + 2.0 * MARGIN);
    let (across, up) = (SIDE - LABELS.0, SIDE - LABELS.1);
    for (series, method, summary, which) in shown {
        let p95 = summary.errors.position_mm.p95;
        let factor = round_125(ARROW * widest / p95.max(1e-9), false);
        for (u, v, view) in VIEWS {
            let names = ["x", "y", "z"];
            // One scale for both axes and all views: as many mm to a unit along as across.
            let axis = |i: usize, length: f64| {
                let middle = 0.5 * (low[i] + high[i]);
                Axis::linear(
                    format!("{} (mm)", names[i]),
                    middle - 0.5 * length,
                    middle + 0.5 * length,
                )
            };
            let least = across.min(up);
            let mut plot = Plot::new(axis(u, side * across / least), axis(v, side * up / least))
                .sized(SIDE, SIDE);
            plot.arrows(
                series,
                method.poses.iter().map(|p| {
                    let [x, y] = [u, v].map(|i| 1e3 * p.position[i]);
                    let [dx, dy] = [u, v].map(|i| 1e3 * factor * p.residual[i]);
                    [x, y, dx, dy]
                }),
            );
            let mean = summary.errors.position_mm.mean;
            section = section.figure(
                html! {
                    (capitalised(which)) ", " (view) ": "
                    (Number::mm(mean, format!("/held_out/{which}/position_mm/mean"))) " mm in the mean"
                },
                plot.render(&format!("Errors over the workspace {which}, {view}")),
                &format!("Arrows are {} times as long as the error.", plain(factor)),
            );
        }
    }
    section
}

/// Whether errors of neighbouring poses point the same way: what is systematic could still be learnt, noise could not.
fn neighbours(evidence: &ReportData) -> Markup {
    let agreement = |poses: &[HeldOutPose]| -> Option<f64> {
        let distance = |a: &HeldOutPose, b: &HeldOutPose| -> f64 {
            (0..3)
                .map(|i| (a.position[i] - b.position[i]).powi(2))
                .sum()
        };
        let length =
            |p: &HeldOutPose| -> f64 { p.residual[..3].iter().map(|x| x * x).sum::<f64>().sqrt() };
        let cosine = |(i, a): (usize, &HeldOutPose)| -> Option<f64> {
            let others = poses.iter().enumerate().filter(|(j, _)| *j != i);
            let nearest = others.map(|(_, b)| b);
            let b = nearest.min_by(|b, c| distance(a, b).total_cmp(&distance(a, c)))?;
            let product: f64 = (0..3).map(|k| a.residual[k] * b.residual[k]).sum();
            Some(product / (length(a) * length(b))).filter(|c| c.is_finite())
        };
        let all: Vec<f64> = poses.iter().enumerate().filter_map(cosine).collect();
        (all.len() >= FEWEST).then(|| all.iter().sum::<f64>() / all.len() as f64)
    };
    let Some(after) = agreement(&evidence.calibrated().poses) else {
        return html! { "There are too few poses to say whether errors of neighbours agree." };
    };
    let verdict = if after > SYSTEMATIC {
        "much of what is left is systematic, and more poses or a richer model could still learn it"
    } else {
        "what is left is mostly noise of instrument and arm, which no model can learn"
    };
    html! {
        "Between each pose and its nearest neighbour the errors have a mean cosine of "
        @if evidence.nominal != evidence.calibrated {
            @if let Some(before) = agreement(&evidence.nominal().poses) { (format!("{before:.2}")) " before and " }
        }
        (crate::report::rounded(after, 2)) " after the calibration (1: they point the same way, 0: at random): " (verdict) "."
    }
}

fn capitalised(word: &str) -> String {
    let mut letters = word.chars();
    let first = letters.next().map(char::to_uppercase);
    first.into_iter().flatten().chain(letters).collect()
}

/// Smallest and largest measured coordinates in mm.
fn extent(poses: &[HeldOutPose]) -> ([f64; 3], [f64; 3]) {
    let fold = |start: f64, take: fn(f64, f64) -> f64| {
        [0, 1, 2].map(|i| poses.iter().map(|p| 1e3 * p.position[i]).fold(start, take))
    };
    (
        fold(f64::INFINITY, f64::min),
        fold(f64::NEG_INFINITY, f64::max),
    )
}
