//! `trainer check`: do a few fresh measurements say that the calibration still holds?

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use poegp_runtime::math::se3::Pose;
use serde::Serialize;

use crate::cli::check_words as words;
use crate::cli::evaluate;
use crate::cli::evaluate::TestData;
use crate::cli::report::Report;
use crate::cli::{
    Failure, check_outputs, check_page, drift, file_name, json_text, origin, write_outputs,
};
use crate::report::{FileFacts, Provenance};
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::input_error::InputError;
use poegp_calibration::numeric::statistics::Summary;
use poegp_calibration::verification as check;
use poegp_calibration::verification::CheckError;
use poegp_calibration::verification::result::Report as Findings;

/// Farther apart than this, mm, measurements and predictions are not of the same frame.
const SAME_FRAME_MM: f64 = 10.0;
/// Share of `--max-mm` by which a drift may move the target before it matters.
const DRIFT_SHARE: f64 = 0.5;
/// Rates of false alarms for which there are draws enough.
const RATES: (f64, f64) = (0.001, 0.2);

/// `trainer check`.
#[derive(Debug, Args)]
#[command(
    after_help = "Ten to twenty poses, spread over the joints as in training. The calibration does not hold (exit code 1) when \
    --max-mm is not met, or when a drift was found that moves the target by more than --max-drift-mm in the mean.\n\n\
    Example: trainer check arm.blob monday.csv --max-mm 0.15\n\
    Example: trainer check arm.blob monday.csv --max-mm 0.15 --report monday.html\n\
    Example: trainer check arm.blob monday.csv --max-mm 0.15 --refit-base   (the tracker was set up anew)"
)]
pub struct Check {
    /// The model.
    pub blob: PathBuf,
    /// Fresh measurements of the arm.
    pub measurements: PathBuf,
    /// Largest position error with which the calibration holds, the measurement's own noise included.
    #[arg(long, value_name = "MM")]
    pub max_mm: f64,
    /// Which error is compared with it.
    #[arg(long, value_enum, default_value_t = Statistic::Mean)]
    pub statistic: Statistic,
    /// Largest mean displacement of the target by a drift that was found (default: half of --max-mm).
    #[arg(long, value_name = "MM")]
    pub max_drift_mm: Option<f64>,
    /// Share of unchanged arms in which a drift is found nevertheless.
    #[arg(long, value_name = "RATE", default_value_t = 0.01)]
    pub false_alarms: f64,
    /// The instrument was set up anew: fit the base frame to these measurements, then look for the rest.
    #[arg(long)]
    pub refit_base: bool,
    /// The target was mounted anew: fit the tool frame to these measurements, then look for the rest.
    #[arg(long)]
    pub refit_tool: bool,
    /// Take the instrument's drift out of every pose, from its reference points (columns ref1_x_mm …).
    #[arg(long)]
    pub correct_drift: bool,
    /// Standard deviation of one position component, at least (default: sigma_mm of the file, else none).
    #[arg(long, value_name = "MM")]
    pub position_sigma_mm: Option<f64>,
    /// The same of one rotation component (default: sigma_mrad of the file, else none).
    #[arg(long, value_name = "MRAD")]
    pub orientation_sigma_mrad: Option<f64>,
    /// A page for whoever asks: holds or not, errors against the bound, what has moved, as HTML.
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
    /// The findings as JSON (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// What `--max-mm` is the bound of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Statistic {
    /// The mean: of few poses it is known best.
    Mean,
    /// The 95th percentile.
    P95,
    /// The largest.
    Max,
}

impl Statistic {
    pub fn of(self, summary: &Summary) -> f64 {
        match self {
            Self::Mean => summary.mean,
            Self::P95 => summary.p95,
            Self::Max => summary.max,
        }
    }

    pub fn name(self) -> &'static str {
        match self {
            Self::Mean => "mean",
            Self::P95 => "95 %",
            Self::Max => "largest",
        }
    }
}

/// What `--json` writes.
#[derive(Serialize)]
pub struct Document<'a> {
    version: &'static str,
    pub model: &'a str,
    pub name: String,
    /// Whether the calibration holds: the exit code.
    pub holds: bool,
    pub statistic: Statistic,
    pub max_mm: f64,
    pub bound_met: bool,
    pub max_drift_mm: f64,
    /// Whether a drift was found that moves the target by more than that.
    pub drift_matters: bool,
    pub base_refitted: bool,
    pub tool_refitted: bool,
    #[serde(flatten)]
    pub findings: &'a Findings,
    /// What to do next.
    pub advice: Vec<String>,
    pub provenance: Provenance,
}

pub fn run(a: &Check) -> Result<(), Failure> {
    let outputs = [a.json.as_deref(), a.report.as_deref()];
    check_outputs(&outputs, &[&a.blob, &a.measurements])?;
    let options = options(a)?;
    let loaded = BlobModel::read(&a.blob)?;
    let data = evaluate::read(&loaded, &a.measurements, drift::correction(a.correct_drift))?;
    let tools = tools(a, &loaded, &data)?;
    let lines: Vec<usize> = data.set.measurements.iter().map(|m| m.line).collect();
    let findings = check::check(&loaded, &data.samples, tools, &lines, &options)
        .map_err(|error| refused(&a.measurements, error))?;
    same_frame(a, &findings)?;
    let error = a.statistic.of(&findings.errors.position_mm);
    let max_drift_mm = a.max_drift_mm.unwrap_or(DRIFT_SHARE * a.max_mm);
    let bound_met = error <= a.max_mm;
    let drift_matters = !findings.changes.is_empty() && findings.effect_mm.mean > max_drift_mm;
    let blob = loaded.blob();
    let document = Document {
        version: env!("CARGO_PKG_VERSION"),
        model: loaded.host().provenance.method,
        name: file_name(&a.measurements),
        holds: bound_met && !drift_matters,
        statistic: a.statistic,
        max_mm: a.max_mm,
        bound_met,
        max_drift_mm,
        drift_matters,
        base_refitted: a.refit_base,
        tool_refitted: a.refit_tool,
        findings: &findings,
        advice: words::advice(&findings, bound_met, drift_matters, a.max_mm),
        provenance: Provenance {
            command: crate::report::provenance::command_line(),
            version: env!("CARGO_PKG_VERSION"),
            date: origin(data.set.sha256, blob.robot.serial_number, Vec::new()).date,
            seed: None,
            robot: blob.robot.name.to_owned(),
            serial_number: blob.robot.serial_number.to_owned(),
            files: vec![
                FileFacts::of_set("fresh measurements", &data.set),
                FileFacts::of_bytes("model", a.blob.display().to_string(), loaded.bytes()),
            ],
        },
    };
    let json = json_text(&document)?;
    let page = a.report.as_deref().map(|path| {
        (
            path,
            check_page::page(&document, loaded.host().provenance.date),
        )
    });
    let mut files: Vec<(&Path, &[u8])> = Vec::new();
    files.extend(page.iter().map(|(path, html)| (*path, html.as_bytes())));
    files.extend(a.json.as_deref().map(|path| (path, json.as_bytes())));
    write_outputs(&files)?;
    print(
        Report::beside(&outputs),
        a,
        &document,
        loaded.host().provenance.date,
    );
    if document.holds {
        return Ok(());
    }
    let mut reasons = Vec::new();
    if !bound_met {
        reasons.push(format!(
            "its {} position error is {error:.4} mm, above {} mm",
            a.statistic.name(),
            a.max_mm
        ));
    }
    if drift_matters {
        reasons.push(format!(
            "a drift moves the target by {:.4} mm in the mean, above {max_drift_mm} mm",
            findings.effect_mm.mean
        ));
    }
    Err(Failure::Quality(format!(
        "the calibration does not hold: {}\nhelp: {}",
        reasons.join(", and "),
        document.advice.join("; ")
    )))
}

fn options(a: &Check) -> Result<check::Options, Failure> {
    let positive = |name: &str, value: Option<f64>| match value {
        Some(x) if !(x > 0.0 && x.is_finite()) => Err(Failure::Usage(format!(
            "{name} {x}: expected a number above 0"
        ))),
        _ => Ok(()),
    };
    positive("--max-mm", Some(a.max_mm))?;
    positive("--max-drift-mm", a.max_drift_mm)?;
    if !(RATES.0..=RATES.1).contains(&a.false_alarms) {
        return Err(Failure::Usage(format!(
            "--false-alarms {}: expected a rate from {} to {}, as 0.01 for one check in a hundred",
            a.false_alarms, RATES.0, RATES.1
        )));
    }
    Ok(check::Options {
        false_alarms: a.false_alarms,
        refit_base: a.refit_base,
        refit_tool: a.refit_tool,
        instrument: super::instrument_noise(a.position_sigma_mm, a.orientation_sigma_mrad)?,
    })
}

/// The frames of the tools that the samples name; those that are fitted anyway begin anywhere.
fn tools(a: &Check, loaded: &BlobModel, data: &TestData) -> Result<Vec<Pose<f64>>, Failure> {
    let mut tools: Vec<Pose<f64>> = loaded.tools().iter().map(|(_, pose)| *pose).collect();
    for name in data.names.iter().skip(tools.len()) {
        let the_only_one = loaded.tools().is_empty() && data.names.len() == 1;
        if !a.refit_tool && !the_only_one {
            return Err(InputError::new(
                &a.measurements,
                format!("{name}, which was mounted after the calibration"),
                "a tool that the blob knows",
            )
            .with_help("give --refit-tool to fit its frame to these measurements first")
            .into());
        }
        tools.push(Pose::identity());
    }
    Ok(tools)
}

fn refused(path: &Path, error: CheckError) -> Failure {
    match error {
        CheckError::TooFew {
            poses,
            equations,
            needed,
        } => InputError::new(
            path,
            format!("{poses} poses ({equations} equations)"),
            format!("at least {needed}: base, tool, joints and the noise are all found from them"),
        )
        .with_help("ten to twenty poses, spread over the joints, are a good check")
        .into(),
        CheckError::Unsolvable | CheckError::UnknownTool(_) => {
            InputError::new(path, error.to_string(), "fresh measurements of this arm").into()
        }
    }
}

/// Refuses measurements that are not of the frame of the calibration: nothing that is linear can be said of them.
fn same_frame(a: &Check, findings: &Findings) -> Result<(), Failure> {
    let median = findings.errors.position_mm.median;
    if median <= SAME_FRAME_MM {
        return Ok(());
    }
    let error = InputError::new(
        &a.measurements,
        format!("positions {median:.1} mm from what the model predicts, in the median"),
        format!("measurements in the frame of the calibration, within {SAME_FRAME_MM} mm"),
    );
    Err(match (a.refit_base, a.refit_tool) {
        (false, _) => error.with_help(
            "if the instrument was set up anew give --refit-base, if the target was mounted anew --refit-tool",
        ),
        (true, false) => {
            error.with_help("if the target was mounted anew, too, give --refit-tool as well")
        }
        (true, true) => error.with_help("are these measurements of this arm, in this order of joints?"),
    }
    .into())
}

fn print(report: Report, a: &Check, d: &Document<'_>, date: &str) {
    let f = d.findings;
    report.line(format_args!(
        "Model `{}` of {date} on {} fresh poses: position in mm, orientation in mrad.\n",
        d.model, f.errors.poses
    ));
    let row = |name: &str, s: &Summary, orientation: String| {
        let mut row = vec![name.to_owned()];
        row.extend([s.mean, s.p95, s.max].map(|x| format!("{x:.4}")));
        row.push(orientation);
        row
    };
    let mut rows = vec![row(
        "error now",
        &f.errors.position_mm,
        f.errors.orientation_cell(),
    )];
    if !f.changes.is_empty() {
        rows.push(row("of it drift", &f.effect_mm, String::new()));
        rows.push(row("without drift", &f.without_mm, String::new()));
    }
    report.table(&["", "mean", "p95", "max", "orientation"], &rows);
    report.line("");
    for line in words::fitted(a.refit_base, a.refit_tool) {
        report.line(line);
    }
    for line in words::findings(f) {
        report.line(line);
    }
    for line in words::sensitivity(f) {
        report.line(line);
    }
    if d.holds {
        report.line(format_args!(
            "The calibration holds: its {} position error is {:.4} mm, {} mm are allowed.",
            a.statistic.name(),
            a.statistic.of(&f.errors.position_mm),
            a.max_mm
        ));
        for advice in &d.advice {
            report.line(format_args!("  {advice}"));
        }
    }
}
