//! `--report`: the reports of `calibrate` and `compare`.

use crate::cli::calibrate::document::{CalibrateJson, TouchJson};
use crate::cli::calibrate::elastic_summary::ElasticSummary;
use crate::cli::terminal::warnings;
use crate::report::certificate::Certificate;
use crate::report::sections;
use crate::report::{HeldOutSummary, Page, Provenance, ReportData, Section};
use poegp_calibration::validation::touches::TouchResidual;

/// Creates a page with its title and the line below it.
fn page(what: &str, provenance: &Provenance) -> Page {
    Page::new(
        format!("{what} {}", provenance.arm()),
        format!("{}, poegp trainer {}", provenance.date, provenance.version),
    )
}

/// Renders the report of `calibrate`.
pub fn of_calibration(
    document: &CalibrateJson,
    evidence: &ReportData,
    summary: &HeldOutSummary,
) -> String {
    let elastic = document.elastic.as_ref();
    let limit = (document.correction_limit_mm, document.correction_limit_mrad);
    let serial_number = &document.provenance.serial_number;
    let next = document.next_steps.as_ref();
    let mut page = page("Calibration of", &document.provenance);
    if let Some(certificate) = &document.certificate {
        let live = document.controller.as_ref().map(|found| &found.live);
        page = page.with(sections::verdict(
            certificate,
            &warnings::texts(),
            live,
            next,
        ));
    }
    page = page
        .with(sections::headline(evidence, summary))
        .with(sections::next_steps(next));
    if let Some(certificate) = &document.certificate {
        page = page
            .with(sections::uncertainty_budget(certificate))
            .with(sections::record(certificate, serial_number));
    }
    sections::held_out(page, evidence, summary)
        .with(sections::parameters(
            document.identifiability.as_ref(),
            &document.frames,
            elastic.map_or(&[], |elastic| &elastic.ripple),
            elastic.and_then(ElasticSummary::listed_curve),
            elastic.and_then(|elastic| elastic.warm_up.as_ref()),
        ))
        .with(sections::controller(document.controller.as_ref()))
        .with(sections::outliers(
            evidence,
            summary,
            Ok(&document.outliers),
        ))
        .with(sections::choice(
            document.chosen.as_deref().zip(document.choice.as_deref()),
            &document.warnings,
            document.budget.as_deref(),
        ))
        .with(sections::device(
            &document.blob,
            limit,
            document.single_precision_loss_um,
        ))
        .with(sections::provenance(&document.provenance))
        .render()
}

/// Renders the report of `calibrate` by touches; `residuals` are those of the blob.
pub fn of_touches(document: &TouchJson, residuals: &[TouchResidual]) -> String {
    let found = &document.touches;
    let limit = (document.correction_limit_mm, document.correction_limit_mrad);
    let mut page = page("Calibration of", &document.provenance);
    if let Some(certificate) = &document.certificate {
        let live = Some(&document.controller.live);
        page = page.with(sections::verdict(
            certificate,
            &warnings::texts(),
            live,
            None,
        ));
    }
    page = page.with(sections::touch_headline(found));
    if let Some(certificate) = &document.certificate {
        page = page
            .with(sections::uncertainty_budget(certificate))
            .with(sections::record(
                certificate,
                &document.provenance.serial_number,
            ));
    }
    page.with(sections::touched(found, residuals))
        .with(sections::distances(found))
        .with(sections::unseen(found))
        .with(sections::touch_outliers(found))
        .with(sections::class(found))
        .with(sections::controller(Some(&document.controller)))
        .with(sections::device(
            &document.blob,
            limit,
            document.single_precision_loss_um,
        ))
        .with(sections::provenance(&document.provenance))
        .render()
}

/// Renders the report of `compare`.
pub fn of_comparison(
    provenance: &Provenance,
    evidence: &ReportData,
    summary: &HeldOutSummary,
    certificate: &Certificate,
) -> String {
    let page = page("Comparison of models for", provenance)
        .with(sections::verdict(
            certificate,
            &warnings::texts(),
            None,
            None,
        ))
        .with(sections::headline(evidence, summary))
        .with(sections::uncertainty_budget(certificate));
    sections::held_out(page, evidence, summary)
        .with(sections::outliers(
            evidence,
            summary,
            Err("Outliers among the training poses are in the report of `trainer calibrate`."),
        ))
        .with(Section::new("parameters", "What is not here").missing(
            "A comparison makes models to compare them and keeps none. The parameters of the arm, the choice of the model \
             and the file for the controller are in the report of `trainer calibrate --report`.",
        ))
        .with(sections::provenance(provenance))
        .render()
}
