//! Data of a report: the errors of several models at the same held-out poses.

use poegp_protocol::JointKind;
use serde::Serialize;

use poegp_calibration::measurement::MeasurementSet;
use poegp_calibration::numeric::statistics::{ErrorSummary, distinct, evenly_spaced};
use poegp_calibration::validation::cross_validation::ModelComparison;
use poegp_calibration::validation::held_out::{Coverage, HeldOutPose, coverage, summary};
use poegp_calibration::validation::learning_curve::Point;

/// How poses are held out.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum HoldOutMethod {
    /// Every training pose is predicted by a model that was trained without it.
    CrossValidation {
        /// Number of folds.
        folds: usize,
        /// Seed of the draw of the folds.
        seed: u64,
    },
    /// The poses are in files that are not trained on.
    TestSets,
}

/// A held-out pose as in its file.
#[derive(Clone, Debug)]
pub struct Row {
    /// Name of the file.
    pub file: String,
    /// Line in the file, from 1.
    pub line: usize,
    /// Joints of the controller, in rad or m.
    pub joints: Vec<f64>,
    /// Payload in kg.
    pub payload_kg: Option<f64>,
    /// Session and target where there are several; else empty.
    pub tool: String,
}

/// Errors of one model at all rows.
#[derive(Clone, Debug)]
pub struct Method {
    /// Name of the method.
    pub name: String,
    /// Errors in the order of the rows.
    pub poses: Vec<HeldOutPose>,
}

impl Method {
    /// Returns the position errors in mm.
    pub fn errors(&self) -> Vec<f64> {
        self.poses.iter().map(|p| p.error.position_mm).collect()
    }
}

/// Held-out errors, pose by pose.
#[derive(Clone, Debug)]
pub struct ReportData {
    /// How the poses were held out.
    pub how: HoldOutMethod,
    /// Rows of the held-out poses.
    pub rows: Vec<Row>,
    /// Number of training rows that no fold holds out, because their session or target has too few others.
    pub never_held_out: usize,
    /// Errors of each model, simplest model first; every model has as many poses as there are rows.
    pub methods: Vec<Method>,
    /// Index of the model that the report calls "before".
    pub nominal: usize,
    /// Index of the model that the report is about.
    pub calibrated: usize,
    /// Kinds of the joints.
    pub kinds: Vec<JointKind>,
    /// Held-out errors of the calibrated model with fewer training poses; empty when they were not computed.
    pub learning: Vec<Point>,
}

/// The errors of one model.
#[derive(Clone, Debug, Serialize)]
pub struct MethodSummary {
    /// Name of the method.
    pub method: String,
    /// Errors of the model.
    #[serde(flatten)]
    pub errors: ErrorSummary,
    /// Coverage of its predicted standard deviations.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub coverage: Option<Coverage>,
}

/// Errors of the report's model at some of the poses.
#[derive(Clone, Debug, Serialize)]
pub struct SubsetSummary {
    /// Name of the subset: a file, a session and target, or a payload in kg.
    pub name: String,
    /// Errors at these poses.
    #[serde(flatten)]
    pub errors: ErrorSummary,
}

/// The part `held_out` of a JSON document.
#[derive(Clone, Debug, Serialize)]
pub struct HeldOutSummary {
    /// `cross-validation` or `test sets`.
    pub how: &'static str,
    /// Number of folds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub folds: Option<usize>,
    /// Seed of the draw of folds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// Number of training rows that no fold holds out, if there are any.
    #[serde(skip_serializing_if = "is_zero")]
    pub never_held_out: usize,
    /// Errors before the calibration: base and tool fitted, the nominal arm.
    pub nominal: MethodSummary,
    /// Errors of the report's model.
    pub calibrated: MethodSummary,
    /// Errors of all models, simplest first.
    pub methods: Vec<MethodSummary>,
    /// Errors by file, where there are several.
    pub files: Vec<SubsetSummary>,
    /// Errors by session and target, where there are several.
    pub tools: Vec<SubsetSummary>,
    /// Errors by payload, where there are several.
    pub payloads: Vec<SubsetSummary>,
    /// Errors with fewer training poses.
    pub learning_curve: Vec<Point>,
}

/// Largest number of poses with dots in plots and a row in the table of the poses: the page stays below 1 MB.
pub const DRAWN: usize = 700;

/// Returns the indices of the rows that are drawn, in order: all, or [`DRAWN`] of them. A tenth of these are the rows with
/// the largest errors; the others are evenly spread over the remaining rows.
pub fn drawn(errors: &[f64]) -> Vec<usize> {
    if errors.len() <= DRAWN {
        return (0..errors.len()).collect();
    }
    let mut order: Vec<usize> = (0..errors.len()).collect();
    order.sort_by(|a, b| errors[*b].total_cmp(&errors[*a]).then(a.cmp(b)));
    let (largest, others) = order.split_at_mut(DRAWN / 10);
    others.sort_unstable();
    let rest = DRAWN - largest.len();
    let mut out = [largest.to_vec(), evenly_spaced(others, rest)].concat();
    out.sort_unstable();
    out
}

/// Largest number of payloads that are listed separately; more are grouped in steps of a kilogram.
const PAYLOADS: usize = 12;

impl ReportData {
    /// Creates the data from a comparison, on the training rows (`sets` has their file) or on its test sets (`sets` has
    /// those). "Before" is `base-tool`, else the first model. The report is about the model of least mean error, or the last
    /// one if `about_last`. Returns `None` when there is no model or no held-out pose.
    pub fn new(
        how: HoldOutMethod,
        sets: &[&MeasurementSet],
        models: &[ModelComparison],
        kinds: &[JointKind],
        about_last: bool,
    ) -> Option<Self> {
        let poses = |model: &ModelComparison| -> Vec<HeldOutPose> {
            match (&how, &model.cross_validation) {
                (HoldOutMethod::CrossValidation { .. }, Some(folds)) => folds.poses.clone(),
                (HoldOutMethod::CrossValidation { .. }, None) => Vec::new(),
                (HoldOutMethod::TestSets, _) => {
                    model.sets.iter().flat_map(|s| s.poses.clone()).collect()
                }
            }
        };
        let methods: Vec<Method> = models
            .iter()
            .map(|model| Method {
                name: model.model.to_owned(),
                poses: poses(model),
            })
            .collect();
        let mut rows: Vec<Row> = sets.iter().flat_map(|set| rows(set)).collect();
        let mut never_held_out = 0;
        if let (HoldOutMethod::CrossValidation { .. }, Some(folds)) = (
            &how,
            models.first().and_then(|m| m.cross_validation.as_ref()),
        ) {
            never_held_out = rows.len().saturating_sub(folds.rows.len());
            let held_out = folds.rows.iter().filter_map(|i| rows.get(*i).cloned());
            rows = held_out.collect();
        }
        if rows.is_empty() || methods.iter().any(|m| m.poses.len() != rows.len()) {
            return None;
        }
        let base_tool = poegp_calibration::model::Method::BaseTool.name();
        let mean = |m: &Method| summary(&m.poses).position_mm.mean;
        let best =
            (0..methods.len()).min_by(|a, b| mean(&methods[*a]).total_cmp(&mean(&methods[*b])))?;
        Some(Self {
            how,
            rows,
            never_held_out,
            nominal: methods
                .iter()
                .position(|m| m.name == base_tool)
                .unwrap_or(0),
            calibrated: if about_last { methods.len() - 1 } else { best },
            methods,
            kinds: kinds.to_vec(),
            learning: Vec::new(),
        })
    }

    /// Returns the errors of the model that the report calls "before".
    pub fn nominal(&self) -> &Method {
        &self.methods[self.nominal]
    }

    /// Returns the errors of the report's model.
    pub fn calibrated(&self) -> &Method {
        &self.methods[self.calibrated]
    }

    /// Returns the indices of the rows that plots and the table of the poses show.
    pub fn drawn(&self) -> Vec<usize> {
        drawn(&self.calibrated().errors())
    }

    /// Groups the rows by a name: returns the names in the order of their first row, each with the indices of its rows.
    pub fn parts(&self, name: impl Fn(&Row) -> String) -> Vec<(String, Vec<usize>)> {
        let mut out: Vec<(String, Vec<usize>)> = Vec::new();
        for (i, row) in self.rows.iter().enumerate() {
            let name = name(row);
            match out.iter_mut().find(|(n, _)| *n == name) {
                Some((_, members)) => members.push(i),
                None => out.push((name, vec![i])),
            }
        }
        out
    }

    /// Groups the rows by payload in kg, lightest first; empty where a payload is not known.
    pub fn payloads(&self) -> Vec<(String, Vec<usize>)> {
        if self.rows.iter().any(|row| row.payload_kg.is_none()) {
            return Vec::new();
        }
        let payload = |row: &Row| row.payload_kg.unwrap_or(0.0);
        let values = distinct(self.rows.iter().map(payload));
        let gathered = |x: f64| {
            if values.len() > PAYLOADS {
                x.round()
            } else {
                x
            }
        };
        let mut parts = self.parts(|row| format!("{}", gathered(payload(row))));
        let first = |part: &(String, Vec<usize>)| gathered(payload(&self.rows[part.1[0]]));
        parts.sort_by(|a, b| first(a).total_cmp(&first(b)));
        parts
    }

    /// Returns the part `held_out` of the JSON document.
    pub fn summary(&self) -> HeldOutSummary {
        let method = |m: &Method| MethodSummary {
            method: m.name.clone(),
            errors: summary(&m.poses),
            coverage: coverage(&m.poses),
        };
        let several = |parts: Vec<(String, Vec<usize>)>| -> Vec<SubsetSummary> {
            if parts.len() < 2 {
                return Vec::new();
            }
            let part = |(name, members): (String, Vec<usize>)| SubsetSummary {
                name,
                errors: summary(members.iter().map(|i| &self.calibrated().poses[*i])),
            };
            parts.into_iter().map(part).collect()
        };
        let (folds, seed) = match self.how {
            HoldOutMethod::CrossValidation { folds, seed } => (Some(folds), Some(seed)),
            HoldOutMethod::TestSets => (None, None),
        };
        HeldOutSummary {
            how: match self.how {
                HoldOutMethod::CrossValidation { .. } => "cross-validation",
                HoldOutMethod::TestSets => "test sets",
            },
            folds,
            seed,
            never_held_out: self.never_held_out,
            nominal: method(self.nominal()),
            calibrated: method(self.calibrated()),
            methods: self.methods.iter().map(method).collect(),
            files: several(self.parts(|row| row.file.clone())),
            tools: several(self.parts(|row| row.tool.clone())),
            payloads: several(self.payloads()),
            learning_curve: self.learning.clone(),
        }
    }
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "as serde calls it")]
fn is_zero(number: &usize) -> bool {
    *number == 0
}

/// Returns a sentence on `rows` training rows that are in no fold, if there are any.
pub fn never_held_out(rows: usize) -> Option<String> {
    (rows > 0).then(|| {
        format!("Rows that are trained on but never held out, because their session or target has too few others: {rows}.")
    })
}

/// Returns the rows of a file.
pub fn rows(set: &MeasurementSet) -> Vec<Row> {
    let file = set.path.file_name().map_or_else(
        || set.path.display().to_string(),
        |name| name.to_string_lossy().into_owned(),
    );
    let row = |m: &poegp_calibration::measurement::Measurement| Row {
        file: file.clone(),
        line: m.line,
        joints: m.joints.clone(),
        payload_kg: m.payload_kg,
        tool: match (&m.session, &m.target) {
            (None, None) => String::new(),
            (Some(session), None) => session.clone(),
            (None, Some(target)) => target.clone(),
            (Some(session), Some(target)) => format!("{session}, {target}"),
        },
    };
    set.measurements.iter().map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_largest_errors_are_always_drawn() {
        for n in [0, 1, DRAWN, DRAWN + 1, 3 * DRAWN + 17] {
            // Large ones at random places.
            let errors: Vec<f64> = (0..n).map(|i| ((i * 7919) % 1009) as f64).collect();
            let shown = drawn(&errors);
            assert_eq!(shown.len(), n.min(DRAWN));
            assert!(shown.windows(2).all(|pair| pair[0] < pair[1]), "{n}");
            let mut sorted = errors.clone();
            sorted.sort_by(|a, b| b.total_cmp(a));
            let least = sorted.get(DRAWN / 10).copied().unwrap_or(-1.0);
            let mut large = (0..n).filter(|i| errors[*i] > least);
            assert!(large.all(|i| shown.contains(&i)), "{n}");
            // Nowhere a gap in the rows: those of the beginning, of the end and between.
            let gap = shown.windows(2).map(|pair| pair[1] - pair[0]).max();
            assert!(gap.unwrap_or(0) <= 2 * n.div_ceil(DRAWN), "{n}: {gap:?}");
        }
    }
}
