//! Errors against each joint, and against the payload.

use maud::html;

use crate::report::chart::{Axis, Brush, Plot, Series, boxes};
use crate::report::sections::methods::keys;
use crate::report::sections::poses::{joint_unit, left_out};
use crate::report::sections::{BOX, boxes_of, mean_and_error};
use crate::report::{HeldOutSummary, Number, ReportData, Section};
use poegp_calibration::numeric::statistics::extremes;
use poegp_calibration::robot::still_span;

/// Number of bins of a joint's range.
const BINS: usize = 8;
/// Least number of poses of a bin whose mean is shown.
const FEWEST: usize = 3;

/// Returns means over bins of `x`: middle of the bin, mean of `y` and number of poses.
fn binned(x: &[f64], y: &[f64]) -> Vec<(f64, f64, usize)> {
    let (low, high) = extremes(x.iter().copied());
    let width = (high - low) / BINS as f64;
    let mut sums = [(0.0, 0.0, 0_usize); BINS];
    for (x, y) in x.iter().zip(y) {
        let bin = (((x - low) / width) as usize).min(BINS - 1);
        sums[bin] = (sums[bin].0 + x, sums[bin].1 + y, sums[bin].2 + 1);
    }
    let filled = sums.iter().filter(|s| s.2 >= FEWEST);
    filled
        .map(|(x, y, n)| (x / *n as f64, y / *n as f64, *n))
        .collect()
}

/// Returns whether the means of bins differ by more than random errors do: χ² beyond three standard deviations of itself.
fn depends(bins: &[(f64, f64, usize)], y: &[f64]) -> bool {
    let (mean, standard_error) = mean_and_error(y);
    let variance = standard_error.powi(2) * y.len() as f64;
    let chi_squared: f64 = bins
        .iter()
        .map(|(_, m, n)| *n as f64 * (m - mean).powi(2) / variance)
        .sum();
    let freedom = bins.len().saturating_sub(1) as f64;
    variance > 0.0 && chi_squared > freedom + 3.0 * (2.0 * freedom).sqrt()
}

/// Returns the section with one plot for each joint, with dots and the means of bins, before and after.
pub fn joints(evidence: &ReportData) -> Section {
    let both = evidence.nominal != evidence.calibrated;
    let (before, after) = (evidence.nominal().errors(), evidence.calibrated().errors());
    let mut section = Section::new("joints", "Against each joint")
        .small_figures()
        .text(html! {
            (keys(both)) ". Dots are held-out poses, lines the means over an eighth of the joint's range. A line that rises "
            "and falls with a joint is an effect of that joint that remains." (left_out(evidence.rows.len()))
        })
        .answers();
    let drawn = evidence.drawn();
    let value = |joint: usize, factor: f64| -> Vec<f64> {
        evidence
            .rows
            .iter()
            .map(|row| row.joints.get(joint).copied().unwrap_or(0.0) * factor)
            .collect()
    };
    let mut unmoved = Vec::new();
    for (joint, kind) in evidence.kinds.iter().enumerate() {
        let (unit, factor, _) = joint_unit(*kind);
        let x = value(joint, factor);
        let (low, high) = extremes(x.iter().copied());
        if high - low <= still_span(*kind) * factor {
            unmoved.push(joint + 1);
            continue;
        }
        let (smallest, largest) = extremes(before.iter().chain(&after).copied());
        let y = Axis::log("error (mm)", smallest, largest);
        let label = format!("joint {} ({unit})", joint + 1);
        let mut plot = Plot::new(Axis::linear(label, low, high), y).sized(300.0, 220.0);
        let means = binned(&x, &after);
        let line = |bins: &[(f64, f64, usize)]| -> Vec<(f64, f64)> {
            bins.iter().map(|(x, y, _)| (*x, *y)).collect()
        };
        let mut dots = |series: Series, errors: &[f64]| {
            let at = |(row, i): (usize, &usize)| (row, (x[*i], errors[*i]));
            plot.poses(series, Brush::Range, drawn.iter().enumerate().map(at));
        };
        if both {
            dots(Series::Nominal, &before);
        }
        dots(Series::Calibrated, &after);
        if both {
            plot.line(Series::Nominal, &line(&binned(&x, &before)), false);
        }
        plot.line(Series::Calibrated, &line(&means), false);
        let (smallest, largest) = extremes(means.iter().map(|m| m.1));
        section = section.figure(
            html! {
                @if means.len() > 1 {
                    @if depends(&means, &after) { "The error still depends on joint " }
                    @else { "The error hardly depends on joint " }
                    (joint + 1) " (" (format!("{smallest:.3}")) " to " (format!("{largest:.3}")) " mm)"
                } @else {
                    "Joint " (joint + 1)
                }
            },
            plot.render(&format!("Error against joint {}", joint + 1)),
            "",
        );
    }
    let names: Vec<String> = unmoved.iter().map(ToString::to_string).collect();
    match names.as_slice() {
        [] => section,
        [one] => section.missing(format!(
            "Joint {one} did not move in these poses: nothing can be said about it."
        )),
        names => section.missing(format!(
            "Joints {} did not move in these poses: nothing can be said about them.",
            names.join(", ")
        )),
    }
}

/// Returns the section with boxes for each payload.
pub fn payloads(evidence: &ReportData, summary: &HeldOutSummary) -> Section {
    let section = Section::new("payload", "Against the payload");
    let parts = evidence.payloads();
    if parts.is_empty() {
        return section.missing(
            "Not shown: the measurements have no payload_kg column, so the model holds only for the payload that was \
             mounted.",
        );
    }
    if parts.len() == 1 {
        return section.missing(format!(
            "Not shown: all poses were measured with one payload, {} kg. The model holds for that payload only.",
            parts[0].0
        ));
    }
    let errors = evidence.calibrated().errors();
    let drawn = boxes_of(&parts, " kg", &errors);
    let means = || summary.payloads.iter().map(|p| p.errors.position_mm.mean);
    let (low, high) = extremes(means());
    let worst = means().position(|m| m == high).unwrap_or(0);
    let least = means().position(|m| m == low).unwrap_or(0);
    let spread: Vec<f64> = parts
        .iter()
        .map(|(_, members)| {
            let values: Vec<f64> = members.iter().map(|i| errors[*i]).collect();
            mean_and_error(&values).1
        })
        .collect();
    let distinct = high - low > 2.0 * spread[worst].hypot(spread[least]);
    let at = |i: usize| format!("/held_out/payloads/{i}/position_mm/mean");
    let row = |(i, part): (usize, &crate::report::data::SubsetSummary)| {
        let p = &part.errors.position_mm;
        let at = |name: &str| format!("/held_out/payloads/{i}/{name}");
        vec![
            html! { (part.name) " kg" },
            html! { (Number::count(part.errors.poses, at("poses"))) },
            html! { (Number::mm(p.mean, at("position_mm/mean"))) },
            html! { (Number::mm(p.p95, at("position_mm/p95"))) },
        ]
    };
    section.figure(
        html! {
            @if distinct {
                "The mean error depends on the payload: from " (Number::mm(low, at(least))) " mm at " (parts[least].0)
                " kg to " (Number::mm(high, at(worst))) " mm at " (parts[worst].0) " kg"
            } @else {
                "No payload stands out: the mean error is between " (Number::mm(low, at(least))) " and "
                (Number::mm(high, at(worst))) " mm"
            }
        },
        boxes("position error (mm), held out", &drawn, "Box plots of the position error by payload"),
        BOX,
    )
    .table_beside(
        &["payload", "poses", "mean (mm)", "95 % (mm)"],
        summary.payloads.iter().enumerate().map(row).collect(),
    )
}
