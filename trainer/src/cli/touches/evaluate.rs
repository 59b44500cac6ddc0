//! `trainer evaluate` with touches: the arm stays as the blob has it, and features, tips and instrument are fitted to the
//! touches.

use crate::cli::evaluate::Evaluate;
use crate::cli::failure::Failure;
use crate::cli::inputs::{file_name, is_training_data, training_data_warning};
use crate::cli::output::kind::Kind;
use crate::cli::output::{check_outputs, document_text, write_texts};
use crate::cli::terminal::print::{Printer, warning};
use crate::cli::terminal::warnings;
use crate::cli::touches::document::EvaluateTouchesJson;
use crate::cli::touches::{
    nominal_robot, print_distances, print_noise, read, refuse_options, table, with_payload,
};
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::measurement::touch::features_beside;
use poegp_calibration::model::touches::findings::outliers_text;
use poegp_calibration::validation::touches::evaluate_touches;

/// Evaluates a model, writes the outputs and prints the result.
pub fn run(a: &Evaluate) -> Result<(), Failure> {
    refuse_others(a)?;
    let json = a.json.as_deref();
    let beside = features_beside(&a.test);
    let features = a.features.as_deref();
    check_outputs(
        &[(json, Kind::Json)],
        &[&a.blob, &a.test, features.unwrap_or(&beside)],
    )?;
    let loaded = BlobModel::read(&a.blob)?;
    let document = evaluated(a, &loaded)?;
    let text = document_text(&document)?;
    write_texts(&[(json, Some(&text))])?;
    print(Printer::for_outputs(&[json]), a, &document);
    Ok(())
}

/// Refuses options that have no meaning for touches.
fn refuse_others(a: &Evaluate) -> Result<(), Failure> {
    let given = [
        (a.predictions.is_some(), "--predictions"),
        (a.frames.fit_base, "--fit-base"),
        (a.frames.fit_tool.is_some(), "--fit-tool"),
        (a.frames.correct_drift, "--correct-drift"),
        (!a.accepted.accept.is_empty(), "--accept"),
    ];
    refuse_options(&a.test, &given)
}

/// Evaluates `loaded`, which takes the place of the blob in `a`, with touches in a file; returns the JSON document.
///
/// # Errors
/// [`Failure`] about the inputs.
pub fn document(a: &Evaluate, loaded: &BlobModel) -> Result<String, Failure> {
    document_text(&evaluated(a, loaded)?)
}

fn evaluated<'a>(a: &Evaluate, loaded: &'a BlobModel) -> Result<EvaluateTouchesJson<'a>, Failure> {
    refuse_others(a)?;
    let robot = nominal_robot(loaded);
    let set = read(&a.test, a.features.as_deref(), &robot)?;
    with_payload(loaded, &set)?;
    let nominal = robot.chain().map_err(|e| Failure::Usage(e.to_string()))?;
    let found = evaluate_touches(&set, &nominal, robot.coupling.as_ref(), &[loaded]);
    let nothing = || Failure::Usage("no model was evaluated".to_owned());
    let document = EvaluateTouchesJson {
        version: env!("CARGO_PKG_VERSION"),
        method: loaded.host().provenance.method,
        training_data: is_training_data(loaded, set.sha256[0]),
        name: file_name(&a.test),
        touches: found.into_iter().next().ok_or_else(nothing)?,
    };
    last_warnings(a, &document).iter().for_each(warnings::add);
    Ok(document)
}

fn print(report: Printer, a: &Evaluate, document: &EvaluateTouchesJson<'_>) {
    let found = &document.touches;
    report.line(format_args!(
        "Model `{}` on {} touches ({} equations, {} states of the arm): root mean square of one component.\n",
        document.method, found.rows, found.equations, found.states
    ));
    let features = found.features.iter().chain(&found.tracker).collect();
    table(report, &[("model", features)]);
    print_distances(report, &found.distances, "by the model");
    print_noise(report, &found.noise);
    report.line(format_args!(
        "  over all rows, the misses of the model are {:.2} times those of the nominal model",
        found.ratio
    ));
    report.line(FITTED);
    if found.flagged > 0 {
        report.line(format_args!(
            "{} of {} states are outside the trained ranges of the model.",
            found.flagged, found.states
        ));
    }
    last_warnings(a, document).iter().for_each(warning);
}

/// Warnings that are printed after the results.
fn last_warnings(a: &Evaluate, document: &EvaluateTouchesJson<'_>) -> Vec<String> {
    let (file, found) = (a.test.display(), &document.touches);
    let of_training =
        (document.training_data).then(|| training_data_warning(&a.test, a.blob.display()));
    let outliers = outliers_text(&found.outliers, found.rows).map(|text| format!("{file}: {text}"));
    let is_worse = (found.ratio >= 1.0).then(|| {
        format!(
            "{file}: the nominal model misses these touches by less than the model does: the model is of another arm, or its \
             measurements do not show what these touches do"
        )
    });
    [of_training, outliers, is_worse]
        .into_iter()
        .flatten()
        .collect()
}

/// Note about the fitted parameters.
pub const FITTED: &str = "Features and tips were fitted to these touches, for the nominal model and for the model alike, \
which makes both look slightly better. Touches show neither where the base is nor how the tool is turned.";
