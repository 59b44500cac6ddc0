//! `trainer compare --report` of touches: which model misses the same touches by the least, and where.

use maud::{Markup, html};

use crate::cli::touches::document::{CompareTouchesJson, ModelJson};
use crate::report::chart::{BoxOf, Series, boxes};
use crate::report::{Number, Page, Section, sections};
use poegp_calibration::model::touches::summary::{DistanceSummary, FeatureSummary, TouchOutlier};
use poegp_calibration::validation::touches::TouchResidual;

/// Returns the pointer to a part of a model's touches in the JSON document.
fn at(model: usize, name: &str) -> String {
    format!("/models/{model}/touches/{name}")
}

/// Renders the report. There must be at least one model.
pub fn page(d: &CompareTouchesJson) -> String {
    let p = &d.provenance;
    Page::new(
        format!("Models of {} compared by touches", p.robot),
        format!("{}, {}, poegp trainer {}", p.date, d.name, p.version),
    )
    .with(result(d))
    .with(features(d))
    .with(distances(d))
    .with(outliers(d))
    .with(sections::provenance(p))
    .render()
}

/// Returns the index of the model with the smallest misses.
fn best(d: &CompareTouchesJson) -> usize {
    let ratio = |model: usize| d.models[model].touches.ratio;
    let all = 0..d.models.len();
    all.min_by(|a, b| ratio(*a).total_cmp(&ratio(*b)))
        .unwrap_or_default()
}

fn result(d: &CompareTouchesJson) -> Section {
    let best = best(d);
    let (model, touches) = (&d.models[best], &d.models[best].touches);
    let ratio = Number::new(touches.ratio, 2, at(best, "ratio"));
    let lead = html! {
        p class="lead" {
            "Of the models compared, " b class="calibrated" { (model.file) } " describes these "
            (Number::count(touches.rows, at(best, "rows"))) " touches best: over all rows, its misses are " b { (ratio) " times" }
            " those of the nominal model. "
            @if touches.ratio >= 1.0 { "No model is better than the nominal model." }
        }
    };
    let row = |(i, m): (usize, &ModelJson)| -> Vec<Markup> {
        vec![
            html! { @if i == best { b { (m.file) } } @else { (m.file) } },
            html! { code { (m.method) } },
            html! { (Number::new(m.touches.ratio, 2, at(i, "ratio"))) },
            html! {
                (Number::count(m.touches.flagged, at(i, "flagged"))) " of " (Number::count(m.touches.states, at(i, "states")))
            },
        ]
    };
    let mut section = Section::new("result", "").block(lead).table(
        &[
            "model",
            "method",
            "misses (nominal = 1)",
            "states flagged by the device",
        ],
        d.models.iter().enumerate().map(row).collect(),
    );
    for model in d.models.iter().filter(|model| model.training_data) {
        section = section.text(html! {
            b { "Warning: " } (model.file) " was calibrated with these touches. Its misses of other touches are larger."
        });
    }
    section.text(html! {
        "Each arm stays as its file says. Features, tips and the instrument are fitted for each model and for the nominal model alike, so
        the misses differ by the arm alone."
    })
}

fn features(d: &CompareTouchesJson) -> Section {
    let first = &d.models[0].touches;
    let mut header = vec!["feature", "kind", "rows", "left out", "nominal"];
    header.extend(d.models.iter().map(|model| model.file.as_str()));
    let row = |list: &str, k: usize, f: &FeatureSummary| -> Vec<Markup> {
        let at = |model: usize, name: &str| at(model, &format!("{list}/{k}/{name}"));
        let rms = |(model, m): (usize, &ModelJson)| {
            let own = match list {
                "tracker" => &m.touches.tracker,
                _ => &m.touches.features,
            };
            html! { (Number::mm(own[k].rms[1], at(model, "rms/1"))) " " (f.unit) }
        };
        let mut fields = vec![
            html! { (f.name) },
            html! { (f.kind) },
            html! { (Number::count(f.rows, at(0, "rows"))) },
            html! { (Number::count(f.rejected, at(0, "rejected"))) },
            html! { (Number::mm(f.rms[0], at(0, "rms/0"))) " " (f.unit) },
        ];
        fields.extend(d.models.iter().enumerate().map(rms));
        fields
    };
    let touched = first.features.iter().enumerate();
    let tracker = first.tracker.iter().enumerate();
    let rows = touched
        .map(|(k, f)| row("features", k, f))
        .chain(tracker.map(|(k, f)| row("tracker", k, f)));
    let mut section = Section::new("features", "What was touched")
        .text(html! { "Root mean square of one component of the misses, for the nominal arm and for each model." })
        .table(&header, rows.collect());
    for unit in sections::units(&first.residuals) {
        section = plotted(section, d, unit);
    }
    section
}

/// Adds a box plot of all rows with this unit, with a box for the nominal model and one for each model.
fn plotted(section: Section, d: &CompareTouchesJson, unit: &str) -> Section {
    let errors = |residuals: &[TouchResidual], i: usize| -> Vec<f64> {
        let own = residuals.iter().filter(|r| r.unit == unit && r.belongs);
        own.map(|r| r.error[i]).collect()
    };
    let best = best(d);
    let mut all: Vec<BoxOf> = Vec::new();
    let drawn = errors(&d.models[0].touches.residuals, 0);
    all.extend(BoxOf::new("nominal", Series::Nominal, &drawn));
    for (i, model) in d.models.iter().enumerate() {
        let series = match i == best {
            true => Series::Calibrated,
            false => Series::Other,
        };
        let own = errors(&model.touches.residuals, 1);
        all.extend(BoxOf::new(model.file.as_str(), series, &own));
    }
    if all.is_empty() {
        return section;
    }
    section.figure(
        html! { "Miss of each touch, " span class="key nominal" { "nominal" } " and by each model" },
        boxes(&format!("miss ({unit})"), &all, "Misses of the touches, for each model"),
        "Box: the middle half of the touches, with the median. Whiskers: 5 and 95 %. Diamond: mean. Dot: largest.",
    )
}

fn distances(d: &CompareTouchesJson) -> Section {
    let section = Section::new("distances", "Known distances");
    let first = &d.models[0].touches.distances;
    if first.is_empty() {
        return section.missing(
            "None was stated. A distance between two features, 200 mm or more, measured with a caliper, shows the size of the arm.",
        );
    }
    let mut header = vec!["between", "stated (mm)", "nominal"];
    header.extend(d.models.iter().map(|model| model.file.as_str()));
    let row = |(k, distance): (usize, &DistanceSummary)| {
        let at = |model: usize, name: &str| at(model, &format!("distances/{k}/{name}"));
        let error = |(model, m): (usize, &ModelJson)| {
            let error = m.touches.distances[k].error_mm[1];
            html! { (Number::mm(error, at(model, "error_mm/1"))) }
        };
        let mut fields = vec![
            html! { (distance.between[0]) " to " (distance.between[1]) },
            html! { (Number::mm(distance.stated_mm, at(0, "stated_mm"))) " ± " (Number::mm(distance.sigma_mm, at(0, "sigma_mm"))) },
            html! { (Number::mm(distance.error_mm[0], at(0, "error_mm/0"))) },
        ];
        fields.extend(d.models.iter().enumerate().map(error));
        fields
    };
    section
        .text(html! { "By how many mm the touches find each distance larger than stated. Nothing is fitted to these distances here." })
        .table(&header, first.iter().enumerate().map(row).collect())
}

fn outliers(d: &CompareTouchesJson) -> Section {
    let section = Section::new("outliers", "Outliers");
    let first = &d.models[0].touches.outliers;
    if first.is_empty() {
        return section.text(html! { "No touch contradicts the others." });
    }
    let row = |(i, o): (usize, &TouchOutlier)| {
        vec![
            html! { "line " (Number::count(o.line, at(0, &format!("outliers/{i}/line")))) },
            html! { (o.feature.as_deref().unwrap_or("tracker")) },
            html! { (Number::mm(o.error, at(0, &format!("outliers/{i}/error")))) " " (o.unit) },
        ]
    };
    section
        .text(html! { "These rows are outliers by at least one of the models and were left out for all. They miss " (d.models[0].file) " by:" })
        .table(
            &["row", "feature", "misses by"],
            first.iter().enumerate().map(row).collect(),
        )
}
