//! `trainer check --report`: whether the calibration holds, by what margin, and what has moved.
//!
//! Nothing is held out here, because every pose of a check is fresh. The numbers are those of the JSON document.

use maud::{Markup, html};

use crate::cli::check::document::CheckJson;
use crate::cli::check::programs::CorrectedProgram;
use crate::cli::check::wording;
use crate::cli::terminal::warnings::{self, WARNING};
use crate::report::chart::{Axis, Brush, Plot, Series};
use crate::report::data::drawn;
use crate::report::sections::headline::tile;
use crate::report::sections::poses::{joint_columns, joint_fields, left_out};
use crate::report::{
    Column, Number, Page, Provenance, Section, capitalised, rounded, sections, sentence,
};
use poegp_calibration::identification::identifiability::list;
use poegp_calibration::measurement::MeasurementSet;
use poegp_calibration::numeric::statistics::Summary;
use poegp_calibration::verification::result::{Change, Estimate, RowError, Sensitivity};
use poegp_protocol::JointKind;

/// Renders the report of a check.
///
/// `set` holds the measured rows, `kinds` the kinds of the model's joints, and `date` the day of the calibration.
pub fn page(d: &CheckJson<'_>, set: &MeasurementSet, kinds: &[JointKind], date: &str) -> String {
    let f = &d.findings;
    let found = Changes {
        at: "",
        looked_at: "base, tool, a joint or the payload",
        changes: &f.changes,
        false_alarm_rate: f.false_alarm_rate,
        unknown_error: wording::unknown_error(f, d.method, d.training_poses),
        sensitivity: &f.sensitivity,
    };
    let noise = html! {
        @match (f.noise_mm, f.unexplained.as_ref()) {
            (Some(noise_mm), rest) => {
                "Scatter that the model does not explain: " (Number::new(noise_mm, 4, "/noise_mm")) " mm per axis"
                @if let Some(noise_mm) = rest.and_then(|rest| rest.noise_mm) {
                    " (the model states " (Number::new(noise_mm, 4, "/unexplained/noise_mm")) " mm)"
                }
                "; model error estimated from these rows: " (Number::new(f.model_mm, 4, "/model_mm")) " mm per axis."
            }
            (None, rest) => {
                "Scatter and error of the model together: " (Number::new(f.scatter_mm, 4, "/scatter_mm")) " mm per axis"
                @if let Some(rest) = rest {
                    " (the model states " (Number::new(rest.expected_mm, 4, "/unexplained/expected_mm")) " mm)"
                }
                "; this model does not separate the two."
            }
        }
    };
    titled(&d.provenance, d.method, date)
        .with(headline(d))
        .with(sections::verdict(
            &d.certificate,
            &warnings::texts(),
            None,
            None,
        ))
        .with(errors(d))
        .with(sections::uncertainty_budget(&d.certificate))
        .with_all(f.is_searched.then(|| moved(&found)))
        .with_all(programs(&d.programs))
        .with_all(f.is_searched.then(|| sensitivity(&found, noise)))
        .with(poses(d, set, kinds))
        .with(sections::provenance(&d.provenance))
        .render()
}

/// The changes that a check found, as the reports of both kinds of check show them.
pub(super) struct Changes<'a> {
    /// Pointer to the findings in the JSON document.
    pub at: &'static str,
    /// Description of the parts that the check tests for a change.
    pub looked_at: &'static str,
    pub changes: &'a [Change],
    pub false_alarm_rate: f64,
    /// Note for a model that does not know its own error.
    pub unknown_error: Option<String>,
    pub sensitivity: &'a [Sensitivity],
}

pub(super) fn titled(p: &Provenance, method: &str, date: &str) -> Page {
    Page::new(
        format!("Check of {}", p.arm()),
        format!(
            "{}, against the calibration of {date} (`{method}`), poegp trainer {}",
            p.date, p.version
        ),
    )
}

fn headline(d: &CheckJson<'_>) -> Section {
    let f = &d.findings;
    let s = &f.errors.position_mm;
    let error = Number::mm(
        d.statistic.of(s),
        format!("/position_mm/{}", d.statistic.key()),
    );
    let lead = html! {
        p class="lead" {
            (holds(d.holds))
            "On " (Number::count(f.errors.poses, "/poses")) " fresh poses the " (d.statistic.name())
            " position error is " b { (error) " mm" } "; " (Number::mm(d.max_mm, "/max_mm")) " mm are allowed. "
            @if let Some(moved) = &f.during { "Moved during the check: " (wording::during(moved)) ". " }
            @if f.is_searched { (changed(&f.changes, &f.effect_mm, d.max_drift_mm, "the target", "")) }
            @else { (wording::NOT_SEARCHED) }
            @if let Some(text) = d.orientation().filter(|text| !text.starts_with(WARNING)) { " " (sentence(&text)) }
        }
    };
    let tiles = html! {
        div class="tiles" {
            (tile("Mean position error", "mm", Number::mm(s.mean, "/position_mm/mean"), None))
            (tile("95 % of poses are within", "mm", Number::mm(s.p95, "/position_mm/p95"), None))
            (tile("Largest position error", "mm", Number::mm(s.max, "/position_mm/max"), None))
            @if let Some(o) = &f.errors.orientation_mrad {
                (tile("Mean orientation error", "mrad", Number::new(o.mean, 3, "/orientation_mrad/mean"), None))
            }
        }
    };
    let mut section = Section::new("result", "").block(lead).block(tiles);
    if let Some(line) = &d.fitted {
        section = section.text(html! { (line) });
    }
    advised(section, &d.advice)
}

pub(super) fn holds(holds: bool) -> Markup {
    html! {
        @if holds { b class="calibrated" { "The calibration holds. " } }
        @else { b class="nominal" { "The calibration does not hold. " } }
    }
}

/// Names the parts that were found to have changed, and how far that moves `what`.
pub(super) fn changed(
    changes: &[Change],
    effect_mm: &Summary,
    most_mm: f64,
    what: &str,
    at: &str,
) -> Markup {
    let parts: Vec<String> = changes.iter().map(|c| wording::part(c.part)).collect();
    html! {
        @if parts.is_empty() {
            "No change was detected."
        } @else {
            "A change of " (list(&parts)) " was detected, which moves " (what) " by "
            (Number::mm(effect_mm.mean, format!("{at}/effect_mm/mean"))) " mm on average; "
            (Number::mm(most_mm, "/max_drift_mm")) " mm are allowed."
        }
    }
}

pub(super) fn advised(section: Section, advice: &[String]) -> Section {
    if advice.is_empty() {
        return section;
    }
    section.block(html! {
        p { "What to do next:" }
        ul { @for advice in advice { li { (advice) } } }
    })
}

fn errors(d: &CheckJson<'_>) -> Section {
    let f = &d.findings;
    let row = |row: &RowError| (row.line, row.position_mm);
    let rows: Vec<(usize, f64)> = f.rows.iter().map(row).collect();
    let axes = [
        "fresh pose, in the order of the rows",
        "position error (mm)",
    ];
    let (plot, above) = drawn_rows(&rows, axes, &f.outlier_lines, d.max_mm);
    let finding = html! {
        @if above == 0 { "All poses are within the tolerance of the " (d.statistic.name()) }
        @else { (above) " of " (rows.len()) " poses exceed the tolerance of the " (d.statistic.name()) }
    };
    let mut table = vec![summed("error now", &f.errors.position_mm, "/position_mm")];
    if !f.changes.is_empty() || f.during.is_some() {
        table.push(summed("of it drift", &f.effect_mm, "/effect_mm"));
        table.push(summed("without drift", &f.without_mm, "/without_mm"));
    }
    let section = Section::new("errors", "The errors")
        .figure(
            finding,
            plot.render("position error of every pose of the check"),
            &format!(
                "Each dot is a pose; the other colour marks outliers. The line is the tolerance.{}",
                left_out(rows.len())
            ),
        )
        .table_beside(&["position, mm", "mean", "95 %", "largest"], table)
        .answers();
    with_outlier_lines(section, &f.outlier_lines, "Measurements", "Measure again.")
}

/// Plots a number of mm for each line of a file; also returns how many are above `most`.
pub(super) fn drawn_rows(
    rows: &[(usize, f64)],
    [across, up]: [&str; 2],
    outlier_lines: &[usize],
    most: f64,
) -> (Plot, usize) {
    let all: Vec<f64> = rows.iter().map(|(_, mm)| *mm).collect();
    let mut reach = all.clone();
    reach.push(most);
    let mut plot = Plot::new(
        Axis::linear(across, 0.0, all.len().max(1) as f64),
        Axis::errors(up, &reach),
    );
    let shown = drawn(&all);
    for (series, wanted) in [(Series::Calibrated, false), (Series::Nominal, true)] {
        let of = shown
            .iter()
            .enumerate()
            .filter(|(_, i)| outlier_lines.contains(&rows[**i].0) == wanted);
        let at = |(row, i): (usize, &usize)| (row, (*i as f64 + 0.5, all[*i]));
        plot.poses(series, Brush::Range, of.map(at));
    }
    plot.level(Series::Reference, most, "allowed");
    let above = all.iter().filter(|mm| **mm > most).count();
    (plot, above)
}

/// Formats a table row with mean, 95th percentile and maximum.
pub(super) fn summed(name: &str, s: &Summary, at: &str) -> Vec<Markup> {
    let field = |value: f64, key: &str| {
        let number = Number::mm(value, format!("{at}/{key}"));
        html! { (number) }
    };
    vec![
        html! { (name) },
        field(s.mean, "mean"),
        field(s.p95, "p95"),
        field(s.max, "max"),
    ]
}

pub(super) fn with_outlier_lines(
    section: Section,
    lines: &[usize],
    what: &str,
    remedy: &str,
) -> Section {
    if lines.is_empty() {
        return section;
    }
    let listed: Vec<String> = lines.iter().map(ToString::to_string).collect();
    section.text(html! {
        (what) " that are outliers: line" @if lines.len() > 1 { "s" } " " (listed.join(", ")) ". " (remedy)
    })
}

/// Lists every pose that the plot shows: line, error, joints.
fn poses(d: &CheckJson<'_>, set: &MeasurementSet, kinds: &[JointKind]) -> Section {
    let rows = &d.findings.rows;
    let all: Vec<f64> = rows.iter().map(|row| row.position_mm).collect();
    let mut columns = vec![
        Column::Name("row".into()),
        Column::Error("position error (mm)".into()),
    ];
    columns.extend(joint_columns(kinds));
    let row = |i: usize| {
        let RowError { line, position_mm } = rows[i];
        let measured = set.measurements.iter().find(|m| m.line == line);
        let joints = measured.map_or(&[][..], |m| &m.joints);
        let mut fields = vec![
            html! { "line " (line) },
            html! { (rounded(position_mm, 4)) },
        ];
        fields.extend(joint_fields(kinds, joints));
        fields
    };
    let shown = drawn(&all).into_iter().map(row).collect();
    Section::new("all-poses", "Pose by pose")
        .text(html! { "What the plot shows for a dot: its line in the file, its error and its joints." (left_out(all.len())) })
        .poses(&columns, shown, Some("The poses of the check"))
}

pub(super) fn moved(f: &Changes<'_>) -> Section {
    let mut section = Section::new("moved", "Detected changes");
    if let Some(text) = &f.unknown_error {
        section = section.text(sentence(&capitalised(text)));
    }
    let rate = html! {
        "Of a hundred checks of an unchanged arm, "
        (Number::percent(f.false_alarm_rate, format!("{}/false_alarm_rate", f.at))) " would report a change."
    };
    if f.changes.is_empty() {
        return section
            .missing(format!("No drift of {} was found.", f.looked_at))
            .text(rate);
    }
    let mut rows = Vec::new();
    for (i, change) in f.changes.iter().enumerate() {
        // It belongs to the whole change, not to a component.
        let p = html! {
            @if change.p_value < wording::LEAST_P { "< " (wording::LEAST_P) }
            @else { (Number::new(change.p_value, 4, format!("{}/changes/{i}/p_value", f.at))) }
        };
        if sizes(change).is_empty() {
            let undetermined = html! { (wording::UNDETERMINED) };
            rows.push(vec![
                html! { (wording::part(change.part)) },
                undetermined,
                p.clone(),
            ]);
        }
        for (k, (what, estimate, unit, decimals, key)) in sizes(change).into_iter().enumerate() {
            let location = format!("{}/changes/{i}/{key}", f.at);
            rows.push(vec![
                html! { (wording::part(change.part)) " " (what) },
                html! {
                    (Number::new(estimate.value, decimals, format!("{location}/value"))) " ± "
                    (Number::new(estimate.plus_minus, decimals, format!("{location}/plus_minus"))) " " (unit)
                },
                html! { @if k == 0 { (p) } },
            ]);
        }
    }
    section = section
        .table(&["part", "change, ± is 95 %", "p"], rows)
        .text(rate);
    for change in f.changes.iter().filter(|c| !c.or_else.is_empty()) {
        let others: Vec<String> = change.or_else.iter().map(|p| wording::part(*p)).collect();
        section = section.text(html! {
            "These measurements would fit a change of " (list(&others)) " just as well as one of "
            (wording::part(change.part)) "."
        });
    }
    section
}

pub(super) fn programs(programs: &[CorrectedProgram]) -> Option<Section> {
    if programs.is_empty() {
        return None;
    }
    let row = |(i, p): (usize, &CorrectedProgram)| {
        let moves = |statistic: fn(&Summary) -> f64, key: &str| {
            let moves = p.moves_mm.as_ref();
            html! { @if let Some(mm) = moves {
                (Number::mm(statistic(mm), format!("/programs/{i}/moves_mm/{key}")))
            } }
        };
        vec![
            html! { (p.program) },
            html! { (p.state()) },
            moves(|mm| mm.mean, "mean"),
            moves(|mm| mm.max, "max"),
        ]
    };
    let rows = programs.iter().enumerate().map(row).collect();
    let section = Section::new("programs", "Corrected programs")
        .text(html! { "How far the targets of each would move if this model corrected it now." })
        .table(&["program", "", "mean, mm", "largest"], rows);
    Some(section)
}

/// Lists the sizes of a change: name, estimate, unit, number of decimals, pointer in the JSON document.
fn sizes(c: &Change) -> Vec<(String, Estimate, &'static str, usize, String)> {
    let mut out = Vec::new();
    let mut one = |what: &str, estimate: &Option<Estimate>, unit, decimals, key: &str| {
        if let Some(estimate) = estimate {
            out.push((what.to_owned(), *estimate, unit, decimals, key.to_owned()));
        }
    };
    one("shifted by", &c.shift_mm, "mm", 3, "shift_mm");
    for (i, (axis, e)) in ["x", "y", "z"].iter().zip(&c.shift_xyz_mm).enumerate() {
        let what = format!("shifted along its {axis}");
        one(&what, e, "mm", 3, &format!("shift_xyz_mm/{i}"));
    }
    one("turned by", &c.turn_mrad, "mrad", 3, "turn_mrad");
    for (i, (axis, e)) in ["x", "y", "z"].iter().zip(&c.turn_xyz_mrad).enumerate() {
        let what = format!("turned about its {axis}");
        one(&what, e, "mrad", 3, &format!("turn_xyz_mrad/{i}"));
    }
    one("is off by", &c.offset_deg, "°", 4, "offset_deg");
    one("is off by", &c.offset_mm, "mm", 4, "offset_mm");
    one("differs by", &c.mass_kg, "kg", 3, "mass_kg");
    one("larger by", &c.size_ppm, "ppm", 0, "size_ppm");
    out
}

pub(super) fn sensitivity(f: &Changes<'_>, noise: Markup) -> Section {
    let row = |(i, s): (usize, &Sensitivity)| {
        let (unit, decimals) = match s.unit {
            "deg" => ("°", 4),
            unit => (unit, 3),
        };
        vec![
            html! { (wording::part(s.part)) },
            html! {
                @match s.smallest {
                    Some(smallest) => { (Number::new(smallest, decimals, format!("{}/sensitivity/{i}/smallest", f.at))) " " (unit) }
                    None => { "none, however large" }
                }
            },
            html! { @if let Some(other) = s.looks_like { (wording::part(other)) } },
        ]
    };
    Section::new("sensitivity", "What this check can detect")
        .text(html! {
            "The smallest changes, in the worst direction, that these poses detect in nine cases of ten. " (noise)
        })
        .table(
            &["part", "smallest change", "looks the same as"],
            f.sensitivity.iter().enumerate().map(row).collect(),
        )
}
