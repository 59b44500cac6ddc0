//! `trainer check --report` of touches: whether the calibration holds, by how much touches miss, and what has moved.

use maud::html;

use crate::cli::check::document::CheckTouchesJson;
use crate::cli::check::page::{
    Changes, advised, changed, drawn_rows, holds, moved, programs, sensitivity, summed, titled,
    with_outlier_lines,
};
use crate::cli::check::wording;
use crate::cli::terminal::warnings;
use crate::report::data::drawn;
use crate::report::sections::headline::tile;
use crate::report::sections::poses::{joint_columns, joint_fields, left_out};
use crate::report::{Column, Number, Section, rounded, sections};
use poegp_calibration::measurement::touch::TouchSet;
use poegp_calibration::verification::touches::TouchMiss;
use poegp_protocol::JointKind;

/// Renders the report of a check by touches.
///
/// `set` holds the touches, `kinds` the kinds of the model's joints, and `date` the day of the calibration.
pub fn page(d: &CheckTouchesJson<'_>, set: &TouchSet, kinds: &[JointKind], date: &str) -> String {
    let f = &d.touches;
    let found = Changes {
        at: "/touches",
        looked_at: "a joint, the payload or the size",
        changes: &f.changes,
        false_alarm_rate: f.false_alarm_rate,
        unknown_error: wording::unknown_error_by_touches(f),
        sensitivity: &f.sensitivity,
    };
    let noise = html! {
        "Noise of these touches: " (Number::new(f.noise_factor, 2, "/touches/noise_factor")) " times the stated one; model error estimated from
        these rows: " (Number::new(f.model_mm, 4, "/touches/model_mm")) " mm per axis. "
        @match f.size_ppm {
            Some(ppm) => { "They show a change of the arm's size from " (Number::new(ppm, 0, "/touches/size_ppm")) " ppm. " }
            None => { "They show no change of the arm's size: state one known distance of 200 mm or more. " }
        }
        (wording::TOUCHES_DO_NOT_SHOW)
    };
    titled(&d.provenance, d.method, date)
        .with(touch_headline(d))
        .with(misses(d))
        .with(moved(&found))
        .with_all(programs(&d.programs))
        .with(sensitivity(&found, noise))
        .with(rows_of_touches(d, set, kinds))
        .with(sections::provenance(&d.provenance))
        .render()
}

fn touch_headline(d: &CheckTouchesJson<'_>) -> Section {
    let (f, s) = (&d.touches, &d.touches.miss_mm);
    let miss = Number::mm(
        d.statistic.of(s),
        format!("/touches/miss_mm/{}", d.statistic.key()),
    );
    let warned = warnings::texts();
    let lead = html! {
        p class="lead" {
            (holds(d.holds))
            "Each of " (Number::count(f.rows, "/touches/rows")) " new touches was predicted from all others. The " (d.statistic.name())
            " miss is " b { (miss) " mm" } "; " (Number::mm(d.max_mm, "/max_mm")) " mm are allowed. "
            (changed(&f.changes, &f.effect_mm, d.max_drift_mm, "the tip", "/touches"))
        }
        @if !warned.is_empty() { (sections::warning_list(&warned)) }
    };
    let tiles = html! {
        div class="tiles" {
            (tile("A touch misses by, mean", "mm", Number::mm(s.mean, "/touches/miss_mm/mean"), None))
            (tile("95 % of touches are within", "mm", Number::mm(s.p95, "/touches/miss_mm/p95"), None))
            (tile("Largest miss", "mm", Number::mm(s.max, "/touches/miss_mm/max"), None))
        }
    };
    advised(
        Section::new("result", "").block(lead).block(tiles),
        &d.advice,
    )
}

fn misses(d: &CheckTouchesJson<'_>) -> Section {
    let f = &d.touches;
    let rows = lengths(&f.misses);
    let axes = ["new touch, in the order of the rows", "miss (mm)"];
    let (plot, above) = drawn_rows(&rows, axes, &f.outlier_lines, d.max_mm);
    let finding = html! {
        @if above == 0 { "All touches are within the tolerance of the " (d.statistic.name()) }
        @else { (above) " of " (rows.len()) " touches exceed the tolerance of the " (d.statistic.name()) }
    };
    let mut table = vec![summed("miss now", &f.miss_mm, "/touches/miss_mm")];
    if !f.changes.is_empty() {
        let (by, left) = (&f.effect_mm, &f.without_mm);
        table.push(summed("the tip moved by drift", by, "/touches/effect_mm"));
        table.push(summed("miss without drift", left, "/touches/without_mm"));
    }
    let section = Section::new("errors", "Misses of the touches")
        .figure(
            finding,
            plot.render("miss of every touch of the check"),
            &format!(
                "Each dot is a touch; the other colour marks outliers. The line is the tolerance.{}",
                left_out(rows.len())
            ),
        )
        .table_beside(&["mm", "mean", "95 %", "largest"], table)
        .answers();
    with_outlier_lines(section, &f.outlier_lines, "Touches", "Touch again.")
}

/// Returns the lines and misses of the touches that measure a length.
fn lengths(misses: &[TouchMiss]) -> Vec<(usize, f64)> {
    let length = |miss: &TouchMiss| Some((miss.line, miss.mm?));
    misses.iter().filter_map(length).collect()
}

/// Lists every touch that the plot shows: line, feature, miss, joints.
fn rows_of_touches(d: &CheckTouchesJson<'_>, set: &TouchSet, kinds: &[JointKind]) -> Section {
    let misses: Vec<&TouchMiss> = d.touches.misses.iter().filter(|m| m.mm.is_some()).collect();
    let all: Vec<f64> = misses.iter().filter_map(|m| m.mm).collect();
    let mut columns = vec![
        Column::Name("row".into()),
        Column::Name("feature".into()),
        Column::Error("miss (mm)".into()),
    ];
    columns.extend(joint_columns(kinds));
    let row = |i: usize| {
        let miss = misses[i];
        let touched = set.rows.iter().find(|row| row.line == miss.line);
        let joints = touched.map_or(&[][..], |row| &row.joints);
        let mut fields = vec![
            html! { "line " (miss.line) },
            html! { (miss.feature.as_deref().unwrap_or("tracker")) },
            html! { (rounded(all[i], 4)) },
        ];
        fields.extend(joint_fields(kinds, joints));
        fields
    };
    let shown = drawn(&all).into_iter().map(row).collect();
    Section::new("all-poses", "Touch by touch")
        .text(html! { "What the plot shows for a dot: its line in the file, its feature, its miss and its joints." (left_out(all.len())) })
        .poses(&columns, shown, Some("The touches of the check"))
}
