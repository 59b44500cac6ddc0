//! Tolerances that an arm must meet, on the command line and in a project file.

use clap::Args;
use poegp_calibration::validation::conformity::{COVERAGE, Evidence, Tolerances, Verdict};
use serde::{Deserialize, Serialize};

use crate::cli::args::positive;
use crate::cli::failure::Failure;
use crate::cli::terminal::print::{Printer, note};
use crate::report::certificate::{Certificate, Statement};
use crate::report::sections;

/// Tolerances of the command line.
#[derive(Args, Clone, Debug, Default)]
pub struct ToleranceArgs {
    /// Position error that 95 of 100 poses must not exceed. Report, JSON and exit code state whether the arm
    /// conforms (ISO 14253-1).
    #[arg(long, value_name = "MM", value_parser = positive)]
    pub tolerance_mm: Option<f64>,
    /// Rotation error that 95 of 100 poses must not exceed.
    #[arg(long, value_name = "MRAD", value_parser = positive)]
    pub tolerance_mrad: Option<f64>,
    /// Probability that the stated uncertainty covers the true error (default: 0.95).
    #[arg(long, value_name = "SHARE", value_parser = coverage)]
    pub coverage: Option<f64>,
}

/// The table `[tolerance]` of a project file.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Serialize)]
#[serde(
    deny_unknown_fields,
    expecting = "a table [tolerance] with position_mm, orientation_mrad and coverage"
)]
pub struct ToleranceTable {
    pub position_mm: Option<f64>,
    pub orientation_mrad: Option<f64>,
    pub coverage: Option<f64>,
}

impl ToleranceArgs {
    /// Whether any of these options was given.
    pub fn is_given(&self) -> bool {
        self.tolerance_mm.is_some() || self.tolerance_mrad.is_some() || self.coverage.is_some()
    }

    /// Completes the options of the command line with a project's table. Also returns the keys of the table that the command
    /// line overrides.
    pub fn completed(&self, table: &ToleranceTable) -> (Tolerances, Vec<&'static str>) {
        let given = [
            (
                self.tolerance_mm,
                table.position_mm,
                "tolerance.position_mm",
            ),
            (
                self.tolerance_mrad,
                table.orientation_mrad,
                "tolerance.orientation_mrad",
            ),
            (self.coverage, table.coverage, "tolerance.coverage"),
        ];
        let overridden = |(given, stated, key): &(Option<f64>, Option<f64>, _)| {
            (given.is_some() && stated.is_some()).then_some(*key)
        };
        let [position_mm, orientation_mrad, coverage] =
            given.map(|(given, stated, _)| given.or(stated));
        let tolerances = Tolerances {
            position_mm,
            orientation_mrad,
            coverage: coverage.unwrap_or(COVERAGE),
        };
        (tolerances, given.iter().filter_map(overridden).collect())
    }
}

impl ToleranceTable {
    /// Creates the table of a project file from tolerances.
    pub fn new(tolerances: &Tolerances) -> Self {
        Self {
            position_mm: tolerances.position_mm,
            orientation_mrad: tolerances.orientation_mrad,
            coverage: (tolerances.coverage != COVERAGE).then_some(tolerances.coverage),
        }
    }

    /// Whether the table states nothing.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Checks the ranges. The error holds a key whose value is out of range, that value, and the expected range.
    pub fn check(&self) -> Result<(), (&'static str, f64, &'static str)> {
        let is_size = |x: f64| x > 0.0 && x.is_finite();
        let sizes = [
            ("position_mm", self.position_mm),
            ("orientation_mrad", self.orientation_mrad),
        ];
        for (key, value) in sizes {
            if let Some(value) = value.filter(|value| !is_size(*value)) {
                return Err((key, value, "a number above 0"));
            }
        }
        match self.coverage.filter(|share| !is_coverage(*share)) {
            Some(share) => Err(("coverage", share, SHARES)),
            None => Ok(()),
        }
    }
}

const SHARES: &str = "a number from 0.5 to 0.999";

fn is_coverage(share: f64) -> bool {
    (0.5..=0.999).contains(&share)
}

fn coverage(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(share) if is_coverage(share) => Ok(share),
        _ => Err(format!("expected {SHARES}")),
    }
}

/// Prints a note about the entries that a certificate lacks, if a verdict was asked for.
pub fn note_missing(certificate: &Certificate, statement: &Statement) {
    if statement.tolerances.is_stated() && !certificate.missing.is_empty() {
        note(format_args!(
            "the certificate lacks {}; add this in a project file, under [instrument], [record] and [robot]",
            certificate.missing.join(", ")
        ));
    }
}

/// Prints the verdict, and the entries that the certificate lacks.
pub fn print(report: Printer, certificate: &Certificate, statement: &Statement) {
    note_missing(certificate, statement);
    let conformity = certificate.conformity.as_ref();
    if let Some(line) = conformity.and_then(sections::verdict_line) {
        report.line(format_args!("  verdict: {line}"));
    }
}

/// Fails if a tolerance was asked for and is not shown to be met.
pub fn outcome(certificate: Option<&Certificate>, statement: &Statement) -> Result<(), Failure> {
    if !statement.tolerances.is_stated() {
        return Ok(());
    }
    let found = certificate.and_then(|c| c.conformity.as_ref());
    let more = match found.map(|c| (c.verdict, c.evidence)) {
        _ if found.is_some_and(|c| c.withheld.is_some()) => "",
        Some((Some(Verdict::Undecided), Evidence::Touches)) => "; more touches narrow the ± range",
        Some((Some(Verdict::Undecided), _)) => "; more held-out poses narrow the ± range",
        _ => "",
    };
    match found.map(|c| (c.verdict, sections::verdict_line(c))) {
        Some((Some(Verdict::Conforms), _)) => Ok(()),
        Some((_, Some(line))) => Err(Failure::Quality(format!(
            "the tolerance is not shown to be met: {line}\nhelp: all files were written{more}"
        ))),
        _ => Err(Failure::Quality(
            "the tolerance is not shown to be met: too few poses were held out\nhelp: all files were written; give at \
             least 10 poses that differ"
                .into(),
        )),
    }
}
