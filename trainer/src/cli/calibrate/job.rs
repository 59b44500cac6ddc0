//! One calibration job: the settings of the project file, if there is one, overridden by the command line.

use std::path::{Path, PathBuf};

use crate::cli::args::{ChainArgs, MethodChoice, differences};
use crate::cli::calibrate::args::Calibrate;
use crate::cli::calibrate::gauge::GaugeArgs;
use crate::cli::calibrate::project::{File, Project, is_project};
use crate::cli::failure::Failure;
use crate::cli::output::kind::Kind;
use crate::cli::output::{Output, is_same_file};
use crate::cli::terminal::print::{note, stated_by};
use crate::cli::tolerance::ToleranceTable;
use crate::report::certificate::Statement;
use poegp_calibration::input_error::InputError;
use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_calibration::robot::BUILT_IN;
use poegp_calibration::trust::Cause;
use poegp_calibration::validation::device_budget::Budget;

const VERSION: &str = env!("CARGO_PKG_VERSION");

/// All settings of a calibration. Paths are relative to the working folder.
#[derive(Clone, Debug)]
pub struct Job {
    pub robot: String,
    pub chain: ChainArgs,
    pub train: PathBuf,
    /// Bytes of the measurement table if it is not in a file; then `train` is only its name.
    pub table: Option<Vec<u8>>,
    /// Description of the features, for a touch file.
    pub features: Option<PathBuf>,
    /// Records of sister arms that were calibrated by touches.
    pub prior: Vec<PathBuf>,
    pub tests: Vec<PathBuf>,
    pub correct_drift: bool,
    pub gauge: GaugeArgs,
    /// Causes of refusals or warnings that the user accepts.
    pub accept: Vec<Cause>,
    pub config: Config,
    /// Whether the training data choose the method.
    pub auto: bool,
    pub budget: Budget,
    pub serial_number: String,
    pub date: Option<String>,
    pub out: PathBuf,
    /// Tolerances that the arm must meet, and who measures it with which instrument.
    pub statement: Statement,
    pub report: Option<PathBuf>,
    pub json: Option<PathBuf>,
    pub controller_csv: Option<PathBuf>,
    pub write_project: Option<PathBuf>,
    pub project: Option<PathBuf>,
    /// SHA-256 that the project file states for the blob; `None` if an option changes the calibration.
    pub blob_sha256: Option<String>,
}

impl Job {
    /// Combines the project file with the command line, and notes which settings the command line overrides.
    pub fn new(a: &Calibrate) -> Result<Self, Failure> {
        Self::of(a, false)
    }

    /// Creates the job as [`Job::new`] does for a caller that takes the results from memory: the job has no outputs, not even
    /// those of the project file.
    pub fn in_memory(a: &Calibrate) -> Result<Self, Failure> {
        Self::of(a, true)
    }

    fn of(a: &Calibrate, is_in_memory: bool) -> Result<Self, Failure> {
        let project = match is_project(&a.train) {
            true => Some(Project::read(&a.train)?),
            false => None,
        };
        let is_named = project.as_ref().is_some_and(Project::names_method);
        let auto = match a.method {
            Some(MethodChoice(method)) => method.is_none(),
            None => !is_named,
        };
        let mut config = project
            .as_ref()
            .map_or_else(Config::default, |p| p.file.calibration);
        let stated = config;
        a.fit.overlay(&mut config);
        if let Some(MethodChoice(Some(method))) = a.method {
            config.method = method;
        }
        // The automatic choice has weights of its own.
        a.fit.note_unused(match auto {
            true => &[Method::BaseTool, Method::Elastic],
            false => std::slice::from_ref(&config.method),
        });
        config.max_correction_mm = a.max_correction_mm.or(config.max_correction_mm);
        config.max_correction_mrad = a.max_correction_mrad.or(config.max_correction_mrad);
        config
            .validate()
            .map_err(|error| Failure::Usage(error.to_string()))?;
        let missing = |option| {
            Failure::Usage(format!(
                "found no {option}, expected {option} or a project file"
            ))
        };
        let mut job = Self {
            robot: a.robot.clone().unwrap_or_default(),
            chain: a.chain.clone(),
            train: a.train.clone(),
            table: None,
            features: a.features.clone(),
            prior: a.prior.clone(),
            tests: a.tests.clone(),
            correct_drift: a.correct_drift,
            gauge: a.gauge.clone(),
            accept: a.accepted.accept.clone(),
            config,
            auto,
            budget: Budget {
                instructions: a.max_instructions,
                bytes: a.max_blob_bytes,
            },
            serial_number: a.serial_number.clone().unwrap_or_default(),
            date: a.date.clone(),
            out: a.out.clone().unwrap_or_default(),
            statement: Statement {
                tolerances: a.tolerance.completed(&ToleranceTable::default()).0,
                noise: config.instrument_noise(),
                ..Statement::default()
            },
            report: a.report.clone(),
            json: a.json.clone(),
            controller_csv: a.controller_csv.clone(),
            write_project: a.write_project.clone(),
            project: None,
            blob_sha256: None,
        };
        match project {
            Some(project) => job.complete(a, &stated, project, is_in_memory)?,
            None if a.robot.is_none() => return Err(missing("--robot")),
            None if a.out.is_none() && !is_in_memory => return Err(missing("--out")),
            None => {}
        }
        if is_in_memory {
            job.out = PathBuf::from("(in memory)");
            job.report = None;
            job.json = None;
        }
        Ok(job)
    }

    /// Completes relative paths with `folder`, the working folder at the time when they were given.
    pub fn within(&mut self, folder: &Path) {
        if !BUILT_IN.contains(&self.robot.as_str()) {
            self.robot = folder.join(&self.robot).to_string_lossy().into_owned();
        }
        if self.table.is_none() {
            self.train = folder.join(&self.train);
        }
        let one = self.features.iter_mut().chain(&mut self.project);
        for path in one.chain(&mut self.prior).chain(&mut self.tests) {
            *path = folder.join(&path);
        }
        self.gauge.within(folder);
    }

    pub fn outputs(&self) -> [Output<'_>; 5] {
        [
            (Some(&self.out), Kind::Model),
            (self.json.as_deref(), Kind::Json),
            (self.report.as_deref(), Kind::Report),
            (self.write_project.as_deref(), Kind::Project),
            (self.controller_csv.as_deref(), Kind::ControllerCsv),
        ]
    }

    /// Whether the blob with this SHA-256 is the one that the project file states.
    pub fn repeats(&self, sha256: &str) -> Option<bool> {
        let stated = self.blob_sha256.as_ref();
        stated.map(|stated| stated.eq_ignore_ascii_case(sha256))
    }

    /// Fills in from the project file what the command line leaves open.
    fn complete(
        &mut self,
        a: &Calibrate,
        stated: &Config,
        project: Project,
        is_in_memory: bool,
    ) -> Result<(), Failure> {
        let file = &project.file;
        let (gauge, of_gauge) = a.gauge.completed(&file.gauge, |name| project.resolve(name));
        let mut overrides = self.overridden_content(a, stated, &project);
        overrides.extend(of_gauge.into_iter().map(str::to_owned));
        let is_whole = overrides.is_empty()
            && self.budget.is_unlimited()
            && a.chain.base.is_none()
            && a.chain.tip.is_none()
            && a.serial_number.is_none()
            && a.date.is_none()
            && a.gauge.is_empty();
        let (tolerances, of_tolerance) = a.tolerance.completed(&file.tolerance);
        overrides.extend(of_tolerance.into_iter().map(str::to_owned));
        self.statement = Statement {
            tolerances,
            noise: self.config.instrument_noise(),
            instrument: file.instrument.clone(),
            record: file.record.clone(),
        };
        overrides.extend(overridden_outputs(a, file));
        note_differences(&project, &overrides);
        self.gauge = gauge;
        self.complete_robot(a, &project);
        self.complete_data(&project);
        self.complete_outputs(a, &project, is_in_memory)?;
        let sha256 = &project.file.output.blob_sha256;
        self.blob_sha256 = sha256.clone().filter(|_| is_whole);
        self.project = Some(project.path);
        Ok(())
    }

    /// Returns the keys of the project file that the command line overrides and that change the calibration, without those
    /// of the gauge.
    fn overridden_content(&self, a: &Calibrate, stated: &Config, project: &Project) -> Vec<String> {
        let (robot, data) = (&project.file.robot, &project.file.data);
        let content = [
            (self.auto && project.names_method(), "calibration.method"),
            (a.robot.is_some(), "robot.description"),
            (a.chain.base.is_some() && robot.base.is_some(), "robot.base"),
            (a.chain.tip.is_some() && robot.tip.is_some(), "robot.tip"),
            (
                a.serial_number.is_some() && !robot.serial_number.is_empty(),
                "robot.serial_number",
            ),
            (a.date.is_some() && project.file.date.is_some(), "date"),
            (
                a.features.is_some() && data.features.is_some(),
                "data.features",
            ),
            (a.correct_drift && !data.correct_drift, "data.correct_drift"),
            (
                a.accepted.accept.iter().any(|c| !data.accept.contains(c)),
                "data.accept",
            ),
        ];
        let settings = differences(stated, &self.config).into_iter();
        let settings = settings.map(|key| format!("calibration.{key}"));
        settings.chain(given(&content)).collect()
    }

    /// Fills in the robot, its serial number and the date.
    fn complete_robot(&mut self, a: &Calibrate, project: &Project) {
        let (file, robot) = (&project.file, &project.file.robot);
        if self.robot.is_empty() {
            self.robot = project.robot();
        }
        let or = |given: &mut Option<String>, stated: &Option<String>| {
            *given = given.take().or_else(|| stated.clone())
        };
        or(&mut self.chain.base, &robot.base);
        or(&mut self.chain.tip, &robot.tip);
        if a.serial_number.is_none() {
            self.serial_number.clone_from(&robot.serial_number);
        }
        or(
            &mut self.date,
            &file.date.as_ref().map(|date| date.get_ref().clone()),
        );
    }

    /// Fills in the measurements and what is accepted of them.
    fn complete_data(&mut self, project: &Project) {
        let data = &project.file.data;
        self.train = project.resolve(&data.train);
        if self.features.is_none() {
            self.features = data.features.as_ref().map(|name| project.resolve(name));
        }
        if self.tests.is_empty() {
            self.tests = data
                .tests
                .iter()
                .map(|name| project.resolve(name))
                .collect();
        }
        self.correct_drift |= data.correct_drift;
        self.accept.extend(&data.accept);
        self.accept.sort_unstable();
        self.accept.dedup();
    }

    /// Fills in the paths of the outputs.
    fn complete_outputs(
        &mut self,
        a: &Calibrate,
        project: &Project,
        is_in_memory: bool,
    ) -> Result<(), Failure> {
        let output = &project.file.output;
        if a.out.is_none() && !is_in_memory {
            let name = output.blob.as_ref().ok_or_else(|| {
                InputError::new(&project.path, "no output.blob", "the path of the blob")
                    .with_help("add `blob = \"arm.blob\"` under [output], or give --out FILE")
            })?;
            self.out = project.resolve(name);
        }
        // What the project names beside its blob is about that blob.
        let other = output
            .blob
            .as_ref()
            .filter(|name| !is_in_memory && !is_same_file(&project.resolve(name), &self.out));
        let mut kept = Vec::new();
        for (given, name, option) in [
            (&mut self.report, &output.report, "--report"),
            (&mut self.json, &output.json, "--json"),
        ] {
            match (&given, name) {
                (None, Some(name)) if other.is_some() => kept.push((option, project.resolve(name))),
                (None, Some(name)) => *given = Some(project.resolve(name)),
                _ => {}
            }
        }
        for (option, path) in kept {
            note(format_args!(
                "{} is not written, because it belongs to the project's blob and --out names another one: {option} FILE \
                 writes one of this blob",
                path.display()
            ));
        }
        Ok(())
    }
}

/// Returns the keys of the project file's outputs and tests that the command line overrides.
fn overridden_outputs(a: &Calibrate, file: &File) -> Vec<String> {
    let (data, output) = (&file.data, &file.output);
    let outputs = [
        (!a.tests.is_empty() && !data.tests.is_empty(), "data.tests"),
        (a.out.is_some() && output.blob.is_some(), "output.blob"),
        (
            a.report.is_some() && output.report.is_some(),
            "output.report",
        ),
        (a.json.is_some() && output.json.is_some(), "output.json"),
    ];
    given(&outputs).collect()
}

/// Returns the keys that are given.
fn given(keys: &[(bool, &str)]) -> impl Iterator<Item = String> {
    let named = |(is_given, key): &(bool, &str)| is_given.then(|| (*key).to_owned());
    keys.iter().filter_map(named)
}

/// Notes what differs from the project file: the keys that are overridden, and the version of the program.
fn note_differences(project: &Project, overrides: &[String]) {
    if !overrides.is_empty() {
        note(format_args!(
            "{} overrides {} of {}",
            stated_by(),
            overrides.join(", "),
            project.path.display()
        ));
    }
    let stated = project.file.trainer.as_ref();
    if let Some(then) = stated.filter(|then| *then != VERSION) {
        note(format_args!(
            "{} was written by trainer {then}, this is {VERSION}: results may differ, and the blob's bytes do, \
             because a blob contains the version of its trainer; install {then} to repeat them",
            project.path.display()
        ));
    }
}
