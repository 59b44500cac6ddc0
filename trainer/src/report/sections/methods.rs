//! Errors of each model, their distribution, and the gain of more poses.

use maud::{Markup, html};

use crate::report::chart::{Axis, BoxOf, Plot, Series, boxes};
use crate::report::sections::BOX;
use crate::report::{HeldOutSummary, Number, ReportData, Section};
use poegp_calibration::numeric::statistics::extremes;

/// Number of bins of the histogram for each factor of ten.
const BINS_PER_DECADE: f64 = 10.0;

fn series(evidence: &ReportData, method: usize) -> Series {
    if method == evidence.calibrated {
        Series::Calibrated
    } else if method == evidence.nominal {
        Series::Nominal
    } else {
        Series::Other
    }
}

/// Returns the section with box plots of all models, as in the paper's Figures 1, 3 and 4, and their numbers.
pub fn methods(evidence: &ReportData, summary: &HeldOutSummary) -> Section {
    let section = Section::new("models", "Model comparison");
    let of = evidence.methods.iter().enumerate();
    let drawn: Vec<BoxOf> = of
        .filter_map(|(i, m)| BoxOf::new(m.name.as_str(), series(evidence, i), &m.errors()))
        .collect();
    let (a, b) = (
        &summary.calibrated.errors.position_mm,
        &summary.nominal.errors.position_mm,
    );
    let finding = html! {
        @if evidence.methods.len() > 1 && evidence.nominal != evidence.calibrated {
            "The correction by " code { (summary.calibrated.method) } " takes the mean error from "
            (Number::mm(b.mean, "/held_out/nominal/position_mm/mean")) " to "
            (Number::mm(a.mean, "/held_out/calibrated/position_mm/mean")) " mm"
        } @else {
            code { (summary.calibrated.method) } " has a mean error of " (Number::mm(a.mean, "/held_out/calibrated/position_mm/mean")) " mm"
        }
    };
    let row = |(i, m): (usize, &crate::report::data::MethodSummary)| -> Vec<Markup> {
        let p = &m.errors.position_mm;
        let at = |name: &str| format!("/held_out/methods/{i}/position_mm/{name}");
        let name = if i == evidence.calibrated {
            html! { b { (m.method) } }
        } else {
            html! { (m.method) }
        };
        let orientation = m.errors.orientation_mrad.map(|o| {
            Number::mm(
                o.mean,
                format!("/held_out/methods/{i}/orientation_mrad/mean"),
            )
        });
        vec![
            name,
            html! { (Number::mm(p.mean, at("mean"))) },
            html! { (Number::mm(p.p95, at("p95"))) },
            html! { (Number::mm(p.max, at("max"))) },
            html! { @match orientation { Some(o) => { (o) } None => { "–" } } },
        ]
    };
    section
        .figure(
            finding,
            boxes("position error (mm), held out", &drawn, "Box plots of the position error of each model"),
            BOX,
        )
        .table_beside(
            &["model", "mean (mm)", "95 % (mm)", "largest (mm)", "mean (mrad)"],
            summary.methods.iter().enumerate().map(row).collect(),
        )
        .text(html! {
            code { "base-tool" } " fits base and tool and assumes that the nominal model is right; " code { "poe" }
            " fits the whole geometry; " code { "poe-gp" } " and " code { "poe-gp-load" }
            " add what geometry cannot explain as a smooth function of the joints (and payload); " code { "elastic" }
            " models joint compliance, gears and payload; " code { "parametric" } " is " code { "elastic" }
            " without its processes and own-joint curves."
        })
}

/// Returns the section with histogram and cumulative curve, before and after.
pub fn distribution(evidence: &ReportData, summary: &HeldOutSummary) -> Section {
    let (before, after) = (evidence.nominal().errors(), evidence.calibrated().errors());
    let (smallest, largest) = extremes(before.iter().chain(&after).copied());
    let x = Axis::log("position error (mm), held out", smallest, largest);
    let both = evidence.nominal != evidence.calibrated;
    let bars = [&before, &after].map(|values| histogram(&x, values));
    let most = bars.iter().flatten().map(|b| b.2).fold(1.0, f64::max);
    let mut histogram = Plot::new(x.clone(), Axis::linear("poses", 0.0, 1.05 * most));
    let mut cumulative = Plot::new(x, Axis::linear("poses within (%)", 0.0, 100.0));
    for (series, values, bars, wanted) in [
        (Series::Nominal, &before, &bars[0], both),
        (Series::Calibrated, &after, &bars[1], true),
    ] {
        if wanted {
            histogram.bars(series, bars);
            cumulative.line(series, &cumulated(values), false);
        }
    }
    cumulative.level(Series::Reference, 95.0, "95 %");
    let (a, b) = (
        &summary.calibrated.errors.position_mm,
        &summary.nominal.errors.position_mm,
    );
    let [median, p95] = ["median", "p95"].map(|n| format!("/held_out/calibrated/position_mm/{n}"));
    Section::new("distribution", "Error distribution")
        .text(keys(both))
        .figure(
            html! {
                "Half of the poses are within " (Number::mm(a.median, median)) " mm"
                @if both { ", nominal within " (Number::mm(b.median, "/held_out/nominal/position_mm/median")) " mm" }
            },
            histogram.render("Histogram of the position errors"),
            "Bins are equally wide on the logarithmic scale.",
        )
        .figure(
            html! {
                "95 of 100 poses are within " (Number::mm(a.p95, p95)) " mm"
                @if both { ", nominal within " (Number::mm(b.p95, "/held_out/nominal/position_mm/p95")) " mm" }
            },
            cumulative.render("Share of the poses within an error"),
            "Find the required tolerance on the axis and read how many poses are within it.",
        )
}

/// Returns the key of the colours.
pub fn keys(both: bool) -> Markup {
    html! {
        @if both { span class="key nominal" { "● nominal" } "  " }
        span class="key calibrated" { "● calibrated" }
    }
}

fn histogram(x: &Axis, values: &[f64]) -> Vec<(f64, f64, f64)> {
    let decades = (x.upper / x.lower).log10();
    let bins = (decades * BINS_PER_DECADE).ceil().max(1.0) as usize;
    let edge = |i: usize| x.lower * (x.upper / x.lower).powf(i as f64 / bins as f64);
    let mut counts = vec![0.0; bins];
    for value in values {
        let bin = (x.location(*value) * bins as f64) as usize;
        counts[bin.min(bins - 1)] += 1.0;
    }
    (0..bins)
        .map(|i| (edge(i), edge(i + 1), counts[i]))
        .collect()
}

/// Returns the steps of the cumulative curve, at most two hundred.
fn cumulated(values: &[f64]) -> Vec<(f64, f64)> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let points = sorted.len().min(200);
    let point = |i: usize| {
        let share = i as f64 / (points - 1).max(1) as f64;
        (
            poegp_calibration::numeric::statistics::percentile(&sorted, share),
            100.0 * share,
        )
    };
    (0..points).map(point).collect()
}

/// Returns the section with the held-out error for a growing part of the training poses.
pub fn learning(summary: &HeldOutSummary) -> Section {
    let section = Section::new("learning", "Learning curve");
    let curve = &summary.learning_curve;
    let (Some(last), true) = (curve.last(), curve.len() >= 2) else {
        return section.missing("Not shown: there are too few training poses to hold some out.");
    };
    let previous = &curve[curve.len() - 2];
    let mean = |i: usize| curve[i].errors.position_mm.mean;
    let line = |of: &dyn Fn(usize) -> f64| -> Vec<(f64, f64)> {
        let x = |i: usize| curve[i].trained_on as f64;
        (0..curve.len()).map(|i| (x(i), of(i))).collect()
    };
    let p95 = |i: usize| curve[i].errors.position_mm.p95;
    let most = (0..curve.len()).map(p95).fold(0.0, f64::max);
    let mut plot = Plot::new(
        Axis::log(
            "training poses",
            0.999 * curve[0].trained_on as f64,
            last.trained_on as f64,
        ),
        Axis::linear("position error (mm)", 0.0, 1.1 * most),
    );
    plot.line(Series::Other, &line(&p95), true);
    plot.line(Series::Calibrated, &line(&mean), true);
    let gain = 1.0 - last.errors.position_mm.mean / previous.errors.position_mm.mean;
    let at = |i: usize| format!("/held_out/learning_curve/{i}");
    let end = curve.len() - 1;
    let row = |(i, p): (usize, &poegp_calibration::validation::learning_curve::Point)| {
        vec![
            html! { (Number::count(p.trained_on, format!("{}/trained_on", at(i)))) },
            html! { (Number::mm(p.errors.position_mm.mean, format!("{}/position_mm/mean", at(i)))) },
            html! { (Number::mm(p.errors.position_mm.p95, format!("{}/position_mm/p95", at(i)))) },
        ]
    };
    section
        .figure(
            html! {
                "From "
                (Number::count(previous.trained_on, format!("{}/trained_on", at(end - 1)))) " to "
                (Number::count(last.trained_on, format!("{}/trained_on", at(end)))) " training poses, the mean error "
                @if gain >= 0.0 { "fell" } @else { "rose" } " by " (format!("{:.0}", 100.0 * gain.abs())) " %"
                @if gain < -0.05 { ": look for bad rows" }
            },
            plot.render("Held-out error by the number of training poses"),
            "Blue: mean. Grey: 95 % of the poses. All sizes were tested on the same held-out poses.",
        )
        .table_beside(
            &["training poses", "mean (mm)", "95 % (mm)"],
            curve.iter().enumerate().map(row).collect(),
        )
}
