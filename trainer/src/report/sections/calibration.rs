//! Results of the calibration itself: parameters, outliers, the choice of the model, the file for the controller, and the
//! provenance of all of it.

use maud::{Markup, html};
use serde::Serialize;

use crate::report::{HeldOutSummary, Number, Provenance, ReportData, Section, sentence};
use poegp_calibration::identification::identifiability::IdentifyReport;
use poegp_calibration::learning::elastic::warm_up::WarmUpReport;
use poegp_calibration::model::frame_changes::FrameChange;
use poegp_calibration::trust::Finding;
use poegp_calibration::validation::device_budget::BudgetTrial;
use poegp_calibration::validation::model_selection as select;

/// Number of held-out poses that are listed.
const WORST: usize = 10;
/// Number of standard deviations beyond which a change is called certain.
const CERTAIN: f64 = 3.0;

/// An outlier of the training, in the JSON document and on the page.
#[derive(Clone, Debug, Serialize)]
pub struct ListedOutlier {
    /// Line in the training file.
    pub line: usize,
    /// How it was found.
    pub reason: &'static str,
    /// Distance of the measurement, as χ².
    pub chi_squared: f64,
    /// Distance of its position in standard deviations.
    pub position_sigmas: f64,
    /// Distance of its rotation in standard deviations; `None` where no rotation was measured.
    pub rotation_sigmas: Option<f64>,
    /// Whether the measurement was left out.
    pub rejected: bool,
}

impl ListedOutlier {
    /// Describes the larger of the distances of position and rotation, in standard deviations.
    pub fn distance(&self) -> String {
        let rotation = self.rotation_sigmas.unwrap_or(0.0);
        match rotation > self.position_sigmas {
            true => format!("rotation {rotation:.0} σ"),
            false => format!("position {:.0} σ", self.position_sigmas),
        }
    }
}

/// Gear ripple of one joint, in the order of the JSON document's `elastic.ripple`.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Ripple {
    /// Number of the joint, from 1.
    pub joint: usize,
    /// Cycles per turn of the joint.
    pub cycles_per_turn: f64,
    /// Amplitude in µrad.
    pub amplitude_urad: f64,
}

/// Returns the section on the arm's parameters: deviations of the frames from the nominal model with their uncertainty,
/// unidentified directions, own-joint curve, warm-up and gear ripple.
pub fn parameters(
    identifiability: Option<&IdentifyReport>,
    changes: &[FrameChange],
    ripple: &[Ripple],
    curve: Option<(f64, f64, usize)>,
    warm_up: Option<&WarmUpReport>,
) -> Section {
    let mut section = Section::new("parameters", "What was wrong with the arm");
    let Some(identifiability) = identifiability else {
        return section.missing("Not shown: the identifiability could not be computed.");
    };
    section = identified(section, identifiability);
    section = differences(section, identifiability, changes);
    if !identifiability.correlations.is_empty() {
        section = correlated(section, identifiability);
    }
    if let Some(curve) = curve {
        section = own_joint_curve(section, curve);
    }
    if let Some(found) = warm_up {
        section = warmed_up(section, found);
    }
    if !ripple.is_empty() {
        section = gear_ripple(section, ripple);
    }
    section
}

/// Adds how many parameters the poses determine, and what they do not.
fn identified(mut section: Section, identifiability: &IdentifyReport) -> Section {
    section = section.text(html! {
        "Of " (Number::count(identifiability.parameters, "/identifiability/parameters")) " geometric parameters these poses identify "
        (Number::count(identifiability.rank, "/identifiability/rank")) ". "
        @if identifiability.redundant > 0 {
            (Number::count(identifiability.redundant, "/identifiability/redundant"))
            " are redundant in any data: turning or shifting a frame along its joint changes nothing. "
        }
        @if identifiability.unidentified > 0 {
            b { (Number::count(identifiability.unidentified, "/identifiability/unidentified")) " are unidentified: other poses would determine them." }
        } @else {
            "All parameters that poses can determine are identified."
        }
    });
    if !identifiability.findings.is_empty() {
        section = section.block(html! {
            ul class="plain" { @for finding in &identifiability.findings { li { (finding.text) "." } } }
        });
    }
    section
}

/// Adds the table of the differences of all frames from the nominal model.
fn differences(
    section: Section,
    identifiability: &IdentifyReport,
    changes: &[FrameChange],
) -> Section {
    let rows = identifiability.standard_deviations.iter().enumerate();
    let rows = rows.filter_map(|(i, deviation)| {
        let at = changes.iter().position(|c| c.frame == deviation.frame)?;
        let change = &changes[at];
        let field = |value: f64, sd: f64, kind: &str, axis: usize| {
            let changed = Number::new(value, 3, format!("/frames/{at}/{kind}/{axis}"));
            let pointer = format!("/identifiability/standard_deviations/{i}/{kind}/{axis}");
            let sd_shown = Number::new(sd, 3, pointer);
            html! {
                @if value.abs() > CERTAIN * sd && value.abs() >= 5e-4 { b { (changed) } } @else { (changed) }
                " ± " (sd_shown)
            }
        };
        let lengths = (0..3).map(|a| field(change.mm[a], deviation.mm[a], "mm", a));
        let angles = (0..3).map(|a| field(change.mrad[a], deviation.mrad[a], "mrad", a));
        let name = html! { (change.frame) };
        Some(std::iter::once(name).chain(lengths).chain(angles).collect())
    });
    let rows: Vec<Vec<Markup>> = rows.collect();
    if rows.is_empty() || changes.iter().all(|c| c.is_zero()) {
        section.missing(
            "This model assumes that the nominal model is right: its only parameters are base and tool frames.",
        )
    } else {
        let header = [
            "frame",
            "x (mm)",
            "y (mm)",
            "z (mm)",
            "about x (mrad)",
            "about y (mrad)",
            "about z (mrad)",
        ];
        section.table(&header, rows).text(html! {
            "Difference of each frame from the nominal model, ± one standard deviation; bold where it is significant. A link \
             is what "
            "follows the joint of its number, in the axes of that joint, z along it; base and tool are in the axes of \
             the "
            "base and of the last joint. An error that could belong to either of two neighbouring frames is shared between them."
        })
    }
}

/// Adds the pairs of directions that the poses hardly distinguish.
fn correlated(section: Section, identifiability: &IdentifyReport) -> Section {
    let pairs = identifiability
        .correlations
        .iter()
        .enumerate()
        .map(|(i, c)| {
            let r = Number::new(c.r, 3, format!("/identifiability/correlations/{i}/r"));
            vec![html! { (c.first) " and " (c.second) }, html! { (r) }]
        });
    section
        .text(html! { "Strongly correlated, because they move the tool in almost the same way:" })
        .table(&["pair", "correlation"], pairs.collect())
}

/// Adds the own-joint curve: its amplitude in µrad, its lengthscale in degrees and its number of orders.
fn own_joint_curve(
    section: Section,
    (amplitude, length_scale, orders): (f64, f64, usize),
) -> Section {
    let at = |name: &str| format!("/elastic/own_joint_curve/{name}");
    section.text(html! {
        "Own-joint curve: the error of each joint as a function of its own angle, with a standard deviation of "
        (Number::new(amplitude, 0, at("amplitude_urad"))) " µrad, a lengthscale of "
        (Number::new(length_scale, 1, at("length_scale_deg"))) "° and up to "
        (Number::count(orders, at("orders"))) " cycles per turn."
    })
}

/// Adds how the arm warmed up.
fn warmed_up(section: Section, found: &WarmUpReport) -> Section {
    let at = |name: &str| format!("/elastic/warm_up/{name}");
    section.text(html! {
        "Warm-up: while the arm was measured, targets moved by up to "
        (Number::new(found.largest_mm, 3, at("largest_mm"))) " mm, "
        @if let Some(time) = found.time_constant {
            "with a time constant of " (Number::new(time, 0, at("time_constant"))) " " (found.unit.name()) ". "
        } @else {
            "steadily. "
        }
        @if found.removed {
            "It was removed from the measurements: the model describes the arm at the last row."
        } @else {
            "The model describes an average over the rows."
        }
    })
}

/// Adds the table of the gear ripple.
fn gear_ripple(section: Section, ripple: &[Ripple]) -> Section {
    let rows = ripple.iter().enumerate().map(|(i, r)| {
        let at = |name: &str| format!("/elastic/ripple/{i}/{name}");
        vec![
            html! { "joint " (Number::count(r.joint, at("joint"))) },
            html! { (Number::new(r.cycles_per_turn, 1, at("cycles_per_turn"))) },
            html! { (Number::new(r.amplitude_urad, 0, at("amplitude_urad"))) },
        ]
    });
    section
        .text(
            html! { "Gear ripple: the error that the gears add to the joint, which the model corrects." },
        )
        .table(
            &["joint", "cycles per turn", "amplitude (µrad)"],
            rows.collect(),
        )
}

/// Returns the section on outliers of the training with their lines, and on the largest held-out errors. Without a training,
/// `found` is an error with the sentence that says so.
pub fn outliers(
    evidence: &ReportData,
    summary: &HeldOutSummary,
    found: Result<&[ListedOutlier], &str>,
) -> Section {
    let mut section = Section::new("outliers", "Outliers");
    section = match found {
        Err(why) => section.missing(why),
        Ok([]) => section.text(html! { "No training pose contradicts all others." }),
        Ok(found) => {
            let row = |(i, o): (usize, &ListedOutlier)| {
                let at = |name: &str| format!("/outliers/{i}/{name}");
                vec![
                    html! { "line " (Number::count(o.line, at("line"))) ": " (o.reason) },
                    html! { (Number::new(o.position_sigmas, 1, at("position_sigmas"))) },
                    html! {
                        @match o.rotation_sigmas {
                            Some(sigmas) => { (Number::new(sigmas, 1, at("rotation_sigmas"))) }
                            None => { "–" }
                        }
                    },
                    html! { @if o.rejected { "left out" } @else { "kept" } },
                ]
            };
            let rejected = found.iter().filter(|o| o.rejected).count();
            section
                .text(html! {
                    (found.len()) @if found.len() == 1 { " training pose contradicts" } @else { " training poses contradict" }
                    " all others"
                    @if rejected > 0 { " and did not take part in the calibration." }
                    @else { ". Measure them again, or calibrate without --outliers keep." }
                })
                .table(
                    &["training file", "position (σ)", "rotation (σ)", ""],
                    found.iter().enumerate().map(row).collect(),
                )
        }
    };
    let errors = evidence.calibrated().errors();
    let mut order: Vec<usize> = (0..errors.len()).collect();
    order.sort_by(|a, b| errors[*b].total_cmp(&errors[*a]).then(a.cmp(b)));
    let several = summary.files.len() > 1;
    let p95 = summary.calibrated.errors.position_mm.p95;
    let row = |i: &usize| {
        let row = &evidence.rows[*i];
        let error = if *i == order[0] {
            let largest = Number::mm(errors[*i], "/held_out/calibrated/position_mm/max");
            html! { (largest) }
        } else {
            html! { (format!("{:.3}", errors[*i])) }
        };
        vec![
            html! { @if several { (row.file) " " } "line " (row.line) },
            error,
            html! { (format!("{:.1}", errors[*i] / p95)) },
            html! { (format!("{:.3}", evidence.nominal().errors()[*i])) },
        ]
    };
    section
        .text(html! {
            "The largest held-out errors; 95 of 100 poses are within "
            (Number::mm(p95, "/held_out/calibrated/position_mm/p95")) " mm:"
        })
        .table(
            &["row", "error (mm)", "in units of the 95 %", "before (mm)"],
            order.iter().take(WORST).map(row).collect(),
        )
}

/// Returns the section on the selection of the model and a budget, with the warnings.
pub fn choice(
    candidates: Option<(&str, &[select::Row])>,
    warnings: &[Finding],
    budget: Option<&[BudgetTrial]>,
) -> Section {
    let mut section = Section::new("choice", "Model selection");
    match candidates {
        None => {
            section = section.missing(
                "Not shown: the method was requested, and there are too few poses to compare it with simpler ones.",
            );
        }
        Some((reason, rows)) => {
            let row = |(i, r): (usize, &select::Row)| {
                let at = |name: &str| format!("/choice/{i}/{name}");
                vec![
                    html! { @if r.chosen { b { (r.candidate) } } @else { (r.candidate) } },
                    html! { (Number::mm(r.position_mm.mean, at("position_mm/mean"))) },
                    html! { (Number::mm(r.position_mm.p95, at("position_mm/p95"))) },
                    html! {
                        (Number::new(r.behind_best_mm, 4, at("behind_best_mm"))) " ± "
                        (Number::new(r.standard_error_mm, 4, at("standard_error_mm")))
                    },
                ]
            };
            section = section
                .text(html! {
                    (sentence(reason)) ". Held-out errors on this page that use the same folds flatter it a little; \
                                        those of test "
                    "files do not."
                })
                .table(
                    &["candidate", "mean (mm)", "95 % (mm)", "worse than the best by (mm)"],
                    rows.iter().enumerate().map(row).collect(),
                );
        }
    }
    for warning in warnings {
        section = section
            .text(html! { b { "Warning (" (warning.cause) "): " } (sentence(&warning.text)) "." });
    }
    if let Some(rows) = budget {
        let row = |(i, r): (usize, &BudgetTrial)| {
            let at = |name: &str| format!("/budget/{i}/{name}");
            let name = r.name;
            vec![
                html! { @if r.chosen { b { (name) } } @else { (name) } },
                html! { (Number::count(r.inducing_points, at("inducing_points"))) },
                html! { (Number::new(r.instructions as f64, 0, at("instructions"))) },
                html! { (Number::count(r.bytes, at("bytes"))) },
                html! { (Number::mm(r.position_mm.mean, at("position_mm/mean"))) },
            ]
        };
        section = section
            .text(html! { "Sized to the budget of the controller:" })
            .table(
                &[
                    "model",
                    "inducing points",
                    "instructions",
                    "bytes",
                    "mean (mm)",
                ],
                rows.iter().enumerate().map(row).collect(),
            );
    }
    section
}

/// A blob in the JSON document.
#[derive(Clone, Debug, Serialize)]
pub struct BlobSummary {
    /// Path as it was typed.
    pub file: String,
    /// Size in bytes, of the file and in flash.
    pub bytes: usize,
    /// Number of inducing points.
    pub inducing_points: usize,
    /// Upper bound on the instructions of one command on a Cortex-M4F.
    pub instructions: u32,
}

/// Loss of single precision in the JSON document, in µm.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct LossJson {
    /// Mean over the training poses.
    pub mean: f64,
    /// Largest loss.
    pub max: f64,
}

/// Returns the section on the file for the controller and its cost on the device; `limit` is that of the correction, in mm
/// and mrad.
pub fn device(summary: &BlobSummary, (mm, mrad): (f64, f64), loss: LossJson) -> Section {
    let LossJson { mean, max } = loss;
    Section::new("device", "The file for the controller").block(html! {
        dl {
            dt { "file" } dd { (summary.file) }
            dt { "size, also in flash" } dd { (Number::count(summary.bytes, "/blob/bytes")) " bytes" }
            dt { "inducing points" } dd { (Number::count(summary.inducing_points, "/blob/inducing_points")) }
            dt { "one command" } dd {
                "at most " (Number::new(f64::from(summary.instructions), 0, "/blob/instructions")) " instructions of a Cortex-M4F"
            }
            dt { "largest correction" } dd {
                @if mm > 0.0 || mrad > 0.0 {
                    (Number::mm(mm, "/correction_limit_mm")) " mm and " (Number::mm(mrad, "/correction_limit_mrad"))
                    " mrad; larger corrections are scaled back to it"
                } @else { "none: this model corrects the geometry only" }
            }
            dt { "single-precision loss" } dd {
                (Number::new(mean, 3, "/single_precision_loss_um/mean")) " µm on average, "
                (Number::new(max, 3, "/single_precision_loss_um/max")) " µm at most"
            }
        }
    })
}

/// Returns the section with files and their checksums, command, version, seed and date.
pub fn provenance(provenance: &Provenance) -> Section {
    let row = |f: &crate::report::FileSummary| {
        vec![
            html! { (f.file) },
            html! { (f.role) },
            html! { @match f.rows { Some(rows) => { (rows) } None => { "" } } },
            html! { span class="hash" { (f.sha256) } },
        ]
    };
    Section::new("provenance", "Provenance")
        .block(html! {
            dl {
                dt { "robot" } dd { (provenance.robot) }
                @if !provenance.serial_number.is_empty() { dt { "serial number" } dd { (provenance.serial_number) } }
                dt { "date" } dd { (provenance.date) }
                dt { "program" } dd { "poegp trainer " (provenance.version) }
                @if let Some(seed) = provenance.seed { dt { "seed of all draws" } dd { (seed) } }
                dt { "command" } dd { code { (provenance.command) } }
            }
        })
        .table(
            &["file", "used as", "rows", "SHA-256"],
            provenance.files.iter().map(row).collect(),
        )
}
