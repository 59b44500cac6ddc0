//! The headline for a customer: one sentence and a few numbers.

use maud::{Markup, html};

use crate::report::{HeldOutSummary, HoldOutMethod, Number, ReportData, Section, never_held_out};
use poegp_calibration::numeric::statistics::ErrorSummary;

/// Returns the section with the sentence, and tiles with mean and 95 % of position and orientation, before and after.
pub fn headline(evidence: &ReportData, summary: &HeldOutSummary) -> Section {
    let (before, after) = (&summary.nominal.errors, &summary.calibrated.errors);
    let mean = |which: &str| format!("/held_out/{which}/position_mm/mean");
    let p95 = |which: &str| format!("/held_out/{which}/position_mm/p95");
    let calibrated = evidence.nominal != evidence.calibrated;
    let (b, a) = (&before.position_mm, &after.position_mm);
    let lead = html! {
        p class="lead" {
            "On " (Number::count(after.poses, "/held_out/calibrated/poses"))
            " poses that it had not seen, the calibrated model predicts the tool to within "
            b class="calibrated" { (Number::mm(a.mean, mean("calibrated"))) " mm" } " on average and "
            (Number::mm(a.p95, p95("calibrated"))) " mm for 95 % of these poses"
            @if calibrated {
                "; before the calibration, to within " b class="nominal" { (Number::mm(b.mean, mean("nominal"))) " mm" }
                " and " (Number::mm(b.p95, p95("nominal"))) " mm."
            } @else {
                ". Only base and tool were fitted: there is nothing simpler to compare it with."
            }
        }
    };
    let tiles = html! {
        div class="tiles" {
            (error_tile("Mean position error", "mm", 3, before, after, |e| Some(e.position_mm.mean), &mean, calibrated))
            (error_tile("95 % of poses are within", "mm", 3, before, after, |e| Some(e.position_mm.p95), &p95, calibrated))
            @if after.orientation_mrad.is_some() {
                (error_tile("Mean orientation error", "mrad", 3, before, after, |e| e.orientation_mrad.map(|o| o.mean),
                    &|which| format!("/held_out/{which}/orientation_mrad/mean"), calibrated))
            }
            (error_tile("Largest position error", "mm", 3, before, after, |e| Some(e.position_mm.max),
                &|which| format!("/held_out/{which}/position_mm/max"), calibrated))
        }
    };
    let how = match evidence.how {
        HoldOutMethod::CrossValidation { folds, .. } => html! {
            "Held out: the rows were divided into " (Number::count(folds, "/held_out/folds"))
            " folds, and each pose was predicted by a model that was calibrated without its fold; equal poses stay together."
            @if let Some(text) = never_held_out(summary.never_held_out) { " " (text) }
        },
        HoldOutMethod::TestSets => html! {
            "Held out: these poses are in files of their own that no model was calibrated with."
        },
    };
    let before_means = html! {
        p { (how) " “Before” is the nominal robot, with base and tool frames fitted to the same training poses. Every error is the
            distance between the measured pose, noise included, and the pose that the file for the controller predicts, in the
            controller's single precision." }
    };
    Section::new("result", "")
        .block(lead)
        .block(tiles)
        .block(before_means)
}

#[expect(clippy::too_many_arguments, reason = "one line for each tile")]
fn error_tile(
    name: &str,
    unit: &str,
    decimals: usize,
    before: &ErrorSummary,
    after: &ErrorSummary,
    of: impl Fn(&ErrorSummary) -> Option<f64>,
    pointer: &dyn Fn(&str) -> String,
    calibrated: bool,
) -> Markup {
    let before = of(before).filter(|_| calibrated);
    let before = before.map(|b| Number::new(b, decimals, pointer("nominal")));
    match of(after) {
        Some(after) => tile(
            name,
            unit,
            Number::new(after, decimals, pointer("calibrated")),
            before,
        ),
        None => html! { div class="tile" { h3 { (name) } } },
    }
}

/// Returns a tile with a number, and with its value before the calibration.
pub fn tile(name: &str, unit: &str, after: Number, before: Option<Number>) -> Markup {
    let times = before.as_ref().map(|b| (b.value, after.value));
    let times = times.filter(|(b, a)| *a > 0.0 && b > a);
    html! {
        div class="tile" {
            h3 { (name) }
            div class="value" { (after) " " span { (unit) } }
            @if let Some(before) = before {
                p {
                    "before: " (before) " " (unit)
                    @if let Some((b, a)) = times { " (" (format!("{:.1}", b / a)) " times as large)" }
                }
            }
        }
    }
}
