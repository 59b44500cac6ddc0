//! `trainer compare`.

use serde::Serialize;

use super::arguments::{Compare, FitArguments};
use super::{
    Arm, Failure, check_outputs, device_failure, enough_poses, file_name, origin, progress, table,
    write_json,
};
use crate::calibration::{Method, Options};
use crate::compare::{ModelComparison, Task, TestSet, applicable};
use crate::elastic::fit::ElasticOptions;
use crate::gp::fit::Sharing;

/// What `--json` writes.
#[derive(Serialize)]
pub struct Document<'a> {
    /// Version of the trainer.
    pub version: &'static str,
    /// Seed of the draw of folds.
    pub seed: u64,
    /// Options of the fit.
    pub per_output: bool,
    /// Options of the fit.
    pub weighted: bool,
    /// One entry for each method.
    pub models: &'a [ModelComparison],
}

impl FitArguments {
    /// The options of a calibration by `method`.
    pub fn options(&self, method: Method) -> Options {
        let sharing = if self.per_output {
            Sharing::PerOutput
        } else {
            Sharing::Shared
        };
        let elastic = ElasticOptions {
            tied: self.tied,
            support: self.support.0,
            gravity: nalgebra::Vector3::from_column_slice(&self.gravity),
            ..ElasticOptions::default()
        };
        Options {
            sharing,
            weighted: self.weighted,
            elastic,
            ..Options::new(method)
        }
    }
}

pub fn run(a: &Compare) -> Result<(), Failure> {
    check_outputs([&a.json])?;
    if a.folds == 1 {
        return Err(Failure::Usage(
            "--folds 1 leaves nothing to train on: use 0 for none, or at least 2".into(),
        ));
    }
    let arm = Arm::load(&a.robot)?;
    let (set, train) = arm.read(&a.train)?;
    let methods: Vec<Method> = if a.models.is_empty() {
        applicable(&train)
    } else {
        a.models.iter().map(|m| Method::from(*m)).collect()
    };
    if a.folds > train.len() {
        return Err(Failure::Usage(format!(
            "--folds {} for {} poses",
            a.folds,
            train.len()
        )));
    }
    // A fold may be larger than its share by one group of equal configurations; the calibration itself checks again.
    let smallest = if a.folds == 0 {
        train.len()
    } else {
        train.len() - train.len().div_ceil(a.folds)
    };
    for method in &methods {
        enough_poses(&a.train, smallest, *method, arm.robot.joints.len())?;
    }
    let mut tests = Vec::new();
    for path in &a.tests {
        tests.push(TestSet {
            name: file_name(path),
            samples: arm.read(path)?.1,
        });
    }
    let origin = origin(set.sha256, "");
    let task = Task {
        robot: &arm.robot,
        nominal: &arm.nominal,
        train: &train,
        tests: &tests,
        folds: a.folds,
        seed: a.seed,
        origin: &origin,
    };
    let bar = progress::bar(methods.len() * task.calibrations(), "comparing");
    let mut models = Vec::new();
    for method in methods {
        bar.set_message(method.name());
        let result = task.run(&a.fit.options(method), &mut || bar.inc(1));
        models.push(result.map_err(|e| device_failure(&a.train, e.error))?);
    }
    bar.finish_and_clear();
    print(&models, a);
    if let Some(path) = &a.json {
        let document = Document {
            version: env!("CARGO_PKG_VERSION"),
            seed: a.seed,
            per_output: a.fit.per_output,
            weighted: a.fit.weighted,
            models: &models,
        };
        write_json(path, &document)?;
    }
    Ok(())
}

fn print(models: &[ModelComparison], a: &Compare) {
    println!("Held-out errors: position in mm, orientation in mrad.");
    if a.folds > 0 {
        println!(
            "{} folds drawn with seed {}; equal configurations are never split.",
            a.folds, a.seed
        );
    }
    println!();
    let mut rows = Vec::new();
    for model in models {
        let folds = model
            .cross_validation
            .iter()
            .map(|cv| ("cross-validation", &cv.all));
        let sets = model.sets.iter().map(|s| (s.name.as_str(), &s.errors));
        for (name, errors) in folds.chain(sets) {
            let p = &errors.position_mm;
            let mut row = vec![
                model.model.to_owned(),
                name.to_owned(),
                errors.poses.to_string(),
            ];
            row.extend([p.mean, p.median, p.p95, p.max].map(|x| format!("{x:.4}")));
            row.push(format!("{:.3}", errors.orientation_mrad.mean));
            rows.push(row);
        }
    }
    table::print(
        &[
            "model",
            "set",
            "poses",
            "mean",
            "median",
            "p95",
            "max",
            "orientation",
        ],
        &rows,
    );
}
