//! Examination of measurements before anything is fitted to them: which findings are reported, and which end the command.

use std::path::Path;

use clap::Args;
use nalgebra::Vector3;
use serde::Serialize;

use crate::cli::failure::Failure;
use crate::cli::input::Input;
use crate::cli::output::{document_text, write_texts};
use crate::cli::terminal::print::{note, warning};
use crate::cli::terminal::warnings;
use poegp_calibration::input_error::InputError;
use poegp_calibration::measurement::long::MOST_KEPT;
use poegp_calibration::measurement::sample::{InstrumentSample, samples};
use poegp_calibration::measurement::{self, MeasurementSet};
use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_calibration::numeric::statistics::evenly_spaced;
use poegp_calibration::robot::Robot;
use poegp_calibration::trust::{self, Cause, Finding, Findings, Tier};

/// Gravity in the base frame of an upright arm, m/s².
pub const GRAVITY: [f64; 3] = [0.0, 0.0, -9.81];

/// Causes that the user has looked into.
#[derive(Clone, Debug, Default, Args)]
pub struct AcceptArgs {
    /// Accept a cause of refusal or warning that you have looked into; may be repeated. A refusal becomes a
    /// warning, a warning a note. `calibrate` records the cause in the blob.
    #[arg(long, value_name = "CAUSE", value_parser = |name: &str| name.parse::<Cause>())]
    pub accept: Vec<Cause>,
}

/// A measurement file to be examined.
pub struct Examined<'a> {
    pub path: &'a Path,
    pub robot: &'a Robot,
    pub set: &'a MeasurementSet,
    pub samples: &'a [InstrumentSample],
    /// Gravity in the base frame, m/s².
    pub gravity: Vector3<f64>,
    /// Path of the command's JSON output.
    pub json: Option<&'a Path>,
    pub accept: &'a [Cause],
}

impl Examined<'_> {
    /// Examines measurements that `methods` are fitted to with the stated noise of `config`, and returns the warnings.
    ///
    /// # Errors
    /// [`Failure::Data`] for measurements that are refused.
    pub fn for_training(
        &self,
        methods: &[Method],
        config: &Config,
    ) -> Result<Vec<Finding>, Failure> {
        let with_noise = |s: &InstrumentSample| s.clone().with_noise(config.instrument_noise());
        let samples: Vec<InstrumentSample> = self.samples.iter().map(with_noise).collect();
        let fits_geometry = methods.iter().any(|m| *m != Method::BaseTool);
        self.settle(trust::examine(
            self.robot,
            self.set,
            &samples,
            self.gravity,
            fits_geometry,
        ))
    }

    /// Examines whether measurements that a model is judged by are of its robot, and returns the warnings. An arm far from its
    /// nominal model is a warning: the model may know that. Of many rows some are examined, evenly spread: the time grows
    /// with the square of their number.
    ///
    /// # Errors
    /// [`Failure::Data`] for measurements that are refused.
    pub fn for_judging(&self) -> Result<Vec<Finding>, Failure> {
        let samples = evenly_spaced(self.samples, MOST_KEPT);
        let mut set = self.set.clone();
        set.measurements = evenly_spaced(&set.measurements, MOST_KEPT);
        let mut findings = trust::identify(self.robot, &set, &samples, self.gravity);
        findings.accept(&[Cause::Frames]);
        self.settle(findings)
    }

    /// Reports the findings, and returns the warnings.
    ///
    /// # Errors
    /// [`Failure::Data`] if a finding is a refusal.
    pub fn settle(&self, findings: Findings) -> Result<Vec<Finding>, Failure> {
        settled(self.path, findings, self.accept, self.json)
    }
}

/// Reports the findings about a file, and returns the warnings. Refusals are also written to `json`, if it is given.
///
/// # Errors
/// [`Failure::Data`] if a finding is a refusal.
pub fn settled(
    path: &Path,
    mut findings: Findings,
    accept: &[Cause],
    json: Option<&Path>,
) -> Result<Vec<Finding>, Failure> {
    findings.accept(accept);
    let file = path.display();
    for finding in findings.of(Tier::Warning) {
        warnings::add_finding(finding);
        warning(format_args!("{file}: {} [{}]", finding.text, finding.cause));
    }
    for finding in findings.of(Tier::Note) {
        note(format_args!("{file}: {} [{}]", finding.text, finding.cause));
    }
    let of = |tier| -> Vec<Finding> { findings.of(tier).cloned().collect() };
    let (refused, warnings) = (of(Tier::Refused), of(Tier::Warning));
    if refused.is_empty() {
        return Ok(warnings);
    }
    let lines: Vec<String> = refused
        .iter()
        .map(|finding| format!("{file}: {} [{}]", finding.text, finding.cause))
        .collect();
    let document = RefusedJson {
        version: env!("CARGO_PKG_VERSION"),
        refused,
    };
    write_texts(&[(json, Some(&document_text(&document)?))])?;
    Err(Failure::Data(lines.join("\nerror: data refused: ")))
}

/// The JSON document that `--json` writes of refused measurements.
#[derive(Serialize)]
struct RefusedJson {
    version: &'static str,
    refused: Vec<Finding>,
}

/// Adds to an error of the reader the mistake that explains it, if one does: a joint beyond its limits may be reversed,
/// for instance.
pub fn explained(
    input: &Input<'_>,
    robot: &Robot,
    gravity: Vector3<f64>,
    error: InputError,
) -> InputError {
    let explanation = || {
        let set = match input.bytes {
            Some(bytes) => measurement::parse(input.path, bytes),
            None => measurement::read(input.path),
        };
        let set = set.ok()?;
        if set.joint_count() != robot.joints.len() {
            return None;
        }
        let samples = samples(&set, robot, &mut Vec::new()).ok()?;
        let findings = trust::identify(robot, &set, &samples, gravity);
        let mut refused = findings.of(Tier::Refused);
        let finding = refused.find(|f| f.cause.is_a_reading())?;
        Some(finding.text.clone())
    };
    match explanation() {
        Some(text) => error.with_help(text),
        None => error,
    }
}
