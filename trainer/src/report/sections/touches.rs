//! Results of a calibration by touches: the expected error of the arm, the touched features, and what the touches cannot
//! see.

use maud::{Markup, html};

use crate::report::chart::{BoxOf, Series, boxes};
use crate::report::sections::headline::tile;
use crate::report::{Number, Section};
use poegp_calibration::identification::touch::unseen::Unseen;
use poegp_calibration::model::touches::summary::{
    DistanceSummary, FeatureSummary, NoiseSummary, TouchOutlier, TouchSummary,
};
use poegp_calibration::validation::touches::TouchResidual;

/// Number of features of one unit beyond which the boxes of the nominal model are left out.
const MOST_PAIRS: usize = 8;

/// Returns the section with the expected error before and after, and how it was found.
pub fn touch_headline(summary: &TouchSummary) -> Section {
    let at = |name: &str| format!("/touches/{name}");
    let (before, after) = (&summary.before, &summary.after);
    let section = Section::new("result", "");
    let lead = html! {
        p class="lead" {
            "After " (Number::count(summary.rows, at("rows"))) " touches, the model is expected to predict the tool to within "
            b class="calibrated" { (Number::mm(after.mean_mm, at("after/mean_mm"))) " mm" } " on average and "
            (Number::mm(after.p95_mm, at("after/p95_mm"))) " mm for 95 of 100 poses; with the nominal model, to within "
            b class="nominal" { (Number::mm(before.mean_mm, at("before/mean_mm"))) " mm" } " and "
            (Number::mm(before.p95_mm, at("before/p95_mm"))) " mm."
        }
    };
    let mm = |what: &str, value: f64| Number::mm(value, at(what));
    let [nominal, calibrated] = summary.left_out;
    let unit = summary.left_out_unit;
    let tiles = html! {
        div class="tiles" {
            (tile("Expected position error, mean", "mm", mm("after/mean_mm", after.mean_mm), Some(mm("before/mean_mm", before.mean_mm))))
            (tile("95 % of poses are within", "mm", mm("after/p95_mm", after.p95_mm), Some(mm("before/p95_mm", before.p95_mm))))
            (tile("A touch left out misses by", unit, mm("left_out/1", calibrated), Some(mm("left_out/0", nominal))))
        }
    };
    let how = html! {
        p {
            @if summary.tracker.is_empty() { "No tracker measured this arm. " }
            "The expected errors are computed for poses over the work volume, after the best registration of base
            and tool: from the stated noise, from the misses beyond it, and from how far an arm of this class is from its
            nominal model. These errors include what the touches do not determine; a verdict states that separately, after ±, so its
            error is smaller. A touch left out is predicted by all others; that error was measured, not computed."
        }
    };
    section.block(lead).block(tiles).block(how)
}

/// Returns the section with the table of the touched features, and the residual of each touch.
pub fn touched(summary: &TouchSummary, residuals: &[TouchResidual]) -> Section {
    let row = |list: &str, (i, f): (usize, &FeatureSummary)| {
        let at = |name: &str| format!("/touches/{list}/{i}/{name}");
        vec![
            html! { (f.name) },
            html! { (f.kind) },
            html! { (Number::count(f.rows, at("rows"))) },
            html! { (Number::count(f.rejected, at("rejected"))) },
            html! { (Number::mm(f.rms[0], at("rms/0"))) " " (f.unit) },
            html! { (Number::mm(f.rms[1], at("rms/1"))) " " (f.unit) },
            html! { (Number::percent(f.share, at("share"))) " %" },
        ]
    };
    let features = summary.features.iter().enumerate();
    let tracker = summary.tracker.iter().enumerate();
    let rows = features
        .map(|f| row("features", f))
        .chain(tracker.map(|f| row("tracker", f)));
    let mut section = Section::new("features", "What was touched")
        .text(html! {
            "Root mean square of one component of the misses, with the nominal arm and as calibrated. Features and tips are
            fitted in both. The share is that of all squares, in units of the noise: one feature with nearly all of it was moved, or is two
            features under one name."
        })
        .table(
            &["feature", "kind", "rows", "left out", "nominal", "calibrated", "share"],
            rows.collect(),
        );
    for unit in units(residuals) {
        section = plotted(section, residuals, unit);
    }
    let row = |(i, n): (usize, &NoiseSummary)| {
        let at = |name: &str| format!("/touches/noise/{i}/{name}");
        vec![
            html! { (n.kind) },
            html! { (Number::mm(n.stated, at("stated"))) " " (n.unit) },
            html! { (Number::mm(n.beyond, at("beyond"))) " " (n.unit) },
        ]
    };
    section
        .text(html! { "The noise of one component of a reading, as stated, and what was found beyond it: seats, gears and play." })
        .table(
            &["reading", "stated", "beyond"],
            summary.noise.iter().enumerate().map(row).collect(),
        )
}

/// Returns the units of residuals; lengths come first.
pub fn units(residuals: &[TouchResidual]) -> Vec<&str> {
    let mut units: Vec<&str> = residuals.iter().map(|r| r.unit).collect();
    units.sort_unstable_by_key(|unit| (*unit != "mm", *unit));
    units.dedup();
    units
}

/// Adds boxes of the residuals of each feature with this unit.
fn plotted(section: Section, residuals: &[TouchResidual], unit: &str) -> Section {
    let own = || residuals.iter().filter(|r| r.unit == unit && r.belongs);
    let name = |r: &TouchResidual| r.feature.clone().unwrap_or_else(|| "tracker".to_owned());
    let mut names: Vec<String> = Vec::new();
    for residual in own() {
        let name = name(residual);
        if !names.contains(&name) {
            names.push(name);
        }
    }
    let pairs = names.len() <= MOST_PAIRS;
    let mut all = Vec::new();
    for feature in &names {
        let errors = |i: usize| -> Vec<f64> {
            let rows = own().filter(|r| name(r) == *feature);
            rows.map(|r| r.error[i]).collect()
        };
        if pairs {
            let label = format!("{feature}, nominal");
            all.extend(BoxOf::new(label, Series::Nominal, &errors(0)));
        }
        all.extend(BoxOf::new(feature.clone(), Series::Calibrated, &errors(1)));
    }
    if all.is_empty() {
        return section;
    }
    let what = html! {
        "Miss of each touch" @if pairs { ", " span class="key nominal" { "nominal" } " and " span class="key \
        calibrated" { "calibrated" } }
    };
    section.figure(
        what,
        boxes(&format!("miss ({unit})"), &all, "Misses of the touches of each feature"),
        "Boxes: the middle half of the touches; whiskers 5 and 95 %, diamond the mean, dot the largest. Computed from \
        the file for the controller, in its single precision.",
    )
}

/// Returns the section with known distances: as stated, nominal, as calibrated, and as all other touches give them.
pub fn distances(summary: &TouchSummary) -> Section {
    let section = Section::new("distances", "Known distances");
    if summary.distances.is_empty() {
        return section.missing(
            "None was stated. A distance between two features, 200 mm or more, measured with a caliper, shows the size of the arm.",
        );
    }
    let row = |(i, d): (usize, &DistanceSummary)| {
        let at = |name: &str| format!("/touches/distances/{i}/{name}");
        vec![
            html! { (d.between[0]) " to " (d.between[1]) },
            html! { (Number::mm(d.stated_mm, at("stated_mm"))) " ± " (Number::mm(d.sigma_mm, at("sigma_mm"))) },
            html! { (Number::mm(d.error_mm[0], at("error_mm/0"))) },
            html! { (Number::mm(d.error_mm[1], at("error_mm/1"))) },
            html! {
                @match d.measured_mm {
                    Some([mm, sigma]) => {
                        (Number::mm(mm, at("measured_mm/0"))) " ± " (Number::mm(sigma, at("measured_mm/1")))
                    }
                    None => "–",
                }
            },
        ]
    };
    section
        .table(
            &[
                "between",
                "stated (mm)",
                "nominal − stated (mm)",
                "calibrated − stated (mm)",
                "touches alone (mm)",
            ],
            summary.distances.iter().enumerate().map(row).collect(),
        )
        .text(html! {
            "“Touches alone” is the distance by all touches and the other distances. A stated distance that differs \
            from it by five standard deviations is refused."
        })
}

/// Returns the section on what the touches cannot identify, in text and mm.
pub fn unseen(summary: &TouchSummary) -> Section {
    let section = Section::new("unseen", "What touches do not show");
    let always = html! {
        "Touches show neither where the base frame is nor the zero of the first joint, which has the same effect. They show neither how the
        tool is turned nor the zero of the last joint, which has the same effect. Measurements of a tracker show all of these. Programs that
        are taught in their own frames need none of them."
    };
    if summary.unseen.is_empty() {
        return section
            .text(always)
            .text(html! { "Apart from these, the touches show everything that moves the tool." });
    }
    let item = |(i, u): (usize, &Unseen)| {
        let mm = Number::mm(u.mm, format!("/touches/unseen/{i}/mm"));
        html! { li { b { (mm) " mm" } ": " (u.text) } }
    };
    section
        .block(html! { ul class="plain" { @for u in summary.unseen.iter().enumerate() { (item(u)) } } })
        .text(always)
}

/// Returns the section on touches that contradict the others, and on the arm compared with its class.
pub fn touch_outliers(summary: &TouchSummary) -> Section {
    let section = Section::new("outliers", "Outliers");
    if summary.outliers.is_empty() {
        return section.text(html! { "No touch contradicts the others." });
    }
    let row = |(i, o): (usize, &TouchOutlier)| {
        let at = |name: &str| format!("/touches/outliers/{i}/{name}");
        vec![
            html! { "line " (Number::count(o.line, at("line"))) },
            html! { (o.feature.as_deref().unwrap_or("tracker")) },
            html! { (Number::mm(o.error, at("error"))) " " (o.unit) },
        ]
    };
    section
        .text(html! { "These rows are outliers and were left out:" })
        .table(
            &["row", "feature", "misses by"],
            summary.outliers.iter().enumerate().map(row).collect(),
        )
}

/// Returns the section on how far the arm is from its nominal model.
pub fn class(summary: &TouchSummary) -> Section {
    let field = |which: usize, i: usize| -> Markup {
        let pointer = format!("/touches/class/{which}/{i}");
        html! { (Number::mm(summary.class[which][i], pointer)) }
    };
    let row = |name: &str, i: usize| vec![html! { (name) }, field(0, i), field(1, i)];
    let section = Section::new("class", "How far this arm is from its nominal model").table(
        &["standard deviation", "of its class", "by the touches"],
        vec![
            row("offset of a link (mm)", 0),
            row("direction of an axis (mrad)", 1),
            row("zero of a joint (mrad)", 2),
        ],
    );
    match summary.beyond_class {
        Some(factor) => section.text(html! {
            "By these touches, it is " (Number::new(factor, 1, "/touches/beyond_class")) " times as far from its nominal model as its class."
        }),
        None => section.missing("The touches determine too few parameters to say whether it is one of its class."),
    }
}
