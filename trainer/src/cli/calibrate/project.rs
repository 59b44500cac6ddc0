//! The project file: all settings that repeat a calibration, in TOML.
//!
//! Paths are relative to the project file. The checksums, payloads and tools that it states must match the data. Options
//! on the command line override it.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use toml::{Spanned, Value};

use crate::cli::calibrate::args::date;
use crate::cli::calibrate::gauge::GaugeTable;
use crate::cli::tolerance::ToleranceTable;
use crate::report::FileSummary;
use crate::report::certificate::{Instrument, Record};
use poegp_calibration::input_error::{InputError, is_printable, number};
use poegp_calibration::measurement::MeasurementSet;
use poegp_calibration::measurement::sample::ToolName;
use poegp_calibration::model::config::Config;
use poegp_calibration::numeric::statistics::distinct;
use poegp_calibration::robot::BUILT_IN;
use poegp_calibration::robot::toml_source::TomlSource;
use poegp_calibration::trust::Cause;

/// Version of the file format.
pub const VERSION: u32 = 1;

/// The contents of a project file.
#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct File {
    pub version: Spanned<u32>,
    /// Version of the trainer that wrote the file.
    pub trainer: Option<String>,
    /// Day of the calibration, kept in the blob.
    pub date: Option<Spanned<String>>,
    pub robot: RobotTable,
    pub data: DataTable,
    #[serde(default)]
    pub calibration: Config,
    #[serde(default, skip_serializing_if = "GaugeTable::is_empty")]
    pub gauge: GaugeTable,
    #[serde(default, skip_serializing_if = "ToleranceTable::is_empty")]
    pub tolerance: ToleranceTable,
    #[serde(default, skip_serializing_if = "is_default")]
    pub instrument: Instrument,
    #[serde(default, skip_serializing_if = "is_default")]
    pub record: Record,
    #[serde(default)]
    pub output: OutputTable,
}

fn is_default<T: Default + PartialEq>(table: &T) -> bool {
    *table == T::default()
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields, expecting = "a table [robot] with its keys")]
pub struct RobotTable {
    pub description: String,
    pub base: Option<String>,
    pub tip: Option<String>,
    #[serde(default)]
    pub serial_number: String,
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields, expecting = "a table [data] with its keys")]
pub struct DataTable {
    pub train: String,
    /// Description of the features, if `train` is a touch file.
    pub features: Option<String>,
    #[serde(default)]
    pub tests: Vec<String>,
    #[serde(default)]
    pub correct_drift: bool,
    /// Causes of refusals or warnings that the user accepts.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub accept: Vec<Cause>,
    /// Payloads of the training data in kg, ascending.
    pub payloads_kg: Option<Spanned<Vec<f64>>>,
    /// Tools of the training data, in the order of their first rows.
    pub tools: Option<Spanned<Vec<String>>>,
    /// Checksums, keyed by file names as they are written in the project file.
    #[serde(default)]
    pub sha256: BTreeMap<Spanned<String>, Spanned<String>>,
}

#[derive(Default, Deserialize, Serialize)]
#[serde(deny_unknown_fields, expecting = "a table [output] with its keys")]
pub struct OutputTable {
    pub blob: Option<String>,
    /// SHA-256 of the blob that was produced when the file was written.
    pub blob_sha256: Option<String>,
    pub report: Option<String>,
    pub json: Option<String>,
}

/// A project file after reading, with its text for error messages.
pub struct Project {
    pub path: PathBuf,
    text: String,
    pub file: File,
}

/// Whether a path names a project file: TOML is a project, anything else is measurements.
pub fn is_project(path: &Path) -> bool {
    path.extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("toml"))
}

impl Project {
    /// Reads a project file and checks it against the data files that it names.
    pub fn read(path: &Path) -> Result<Self, InputError> {
        let text = std::fs::read_to_string(path)
            .map_err(|error| InputError::unreadable(path, &error, "a project file"))?;
        let file = toml::from_str(&text).map_err(|error| {
            TomlSource {
                file: path,
                text: &text,
            }
            .refused(&error, "a project file in TOML")
            .with_help("`trainer calibrate … --write-project FILE` writes a complete project file")
        })?;
        let project = Self {
            path: path.to_owned(),
            text,
            file,
        };
        let version = &project.file.version;
        if *version.get_ref() != VERSION {
            let found = format!("version {}", version.get_ref());
            return Err(project
                .error(
                    version.span(),
                    "version",
                    found,
                    format!("version {VERSION}"),
                )
                .with_help("a newer trainer wrote this file: use that version"));
        }
        if let Some(day) = &project.file.date
            && let Err(expected) = date(day.get_ref())
        {
            let expected = expected.trim_start_matches("expected ");
            let found = format!("{:?}", day.get_ref());
            return Err(project.error(day.span(), "date", found, expected));
        }
        project.check_texts()?;
        project.check_values()?;
        project.check_data()?;
        Ok(project)
    }

    /// Whether the file names a calibration method.
    pub fn names_method(&self) -> bool {
        let table: Option<toml::Table> = toml::from_str(&self.text).ok();
        table.is_some_and(|t| {
            t.get("calibration")
                .is_some_and(|c| c.get("method").is_some())
        })
    }

    /// Converts a path of the project file to one relative to the working folder.
    pub fn resolve(&self, name: &str) -> PathBuf {
        self.path.parent().unwrap_or(Path::new("")).join(name)
    }

    /// Returns the robot description: the name of a built-in robot, or a path.
    pub fn robot(&self) -> String {
        let name = &self.file.robot.description;
        match BUILT_IN.contains(&name.as_str()) {
            true => name.clone(),
            false => self.resolve(name).to_string_lossy().into_owned(),
        }
    }

    fn error(
        &self,
        span: Range<usize>,
        key: &str,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> InputError {
        TomlSource {
            file: &self.path,
            text: &self.text,
        }
        .error(span, key, found, expected)
    }

    /// Refuses texts that other lines of a report or of an exported file could be made of.
    fn check_texts(&self) -> Result<(), InputError> {
        fn bad(value: &Value) -> Option<&str> {
            match value {
                Value::String(text) => Some(text.as_str()).filter(|text| !is_printable(text)),
                Value::Array(values) => values.iter().find_map(bad),
                Value::Table(table) => table.values().find_map(bad),
                _ => None,
            }
        }
        let table: Option<Value> = toml::from_str(&self.text).ok();
        match table.as_ref().and_then(bad) {
            Some(text) => {
                let expected = "texts of one line, without control characters";
                Err(InputError::new(&self.path, format!("{text:?}"), expected))
            }
            None => Ok(()),
        }
    }

    /// Refuses values of the configuration that are out of range.
    fn check_values(&self) -> Result<(), InputError> {
        let file = &self.file;
        if let Err(e) = file.calibration.validate() {
            return Err(self.refused("calibration", e.key, e.found, e.expected));
        }
        if let Err((key, found, expected)) = file.tolerance.check() {
            return Err(self.refused("tolerance", key, found.to_string(), expected.to_owned()));
        }
        let stated = [
            (
                "expanded_uncertainty_mm",
                file.instrument.expanded_uncertainty_mm,
            ),
            (
                "expanded_uncertainty_mrad",
                file.instrument.expanded_uncertainty_mrad,
            ),
        ];
        for (key, value) in stated {
            if let Some(value) = value.filter(|x| !(*x >= 0.0 && x.is_finite())) {
                let expected = "a number of 0 or more".to_owned();
                return Err(self.refused("instrument", key, number(value), expected));
            }
        }
        match file.record.temperature_c.filter(|x| !x.is_finite()) {
            Some(value) => {
                let expected = "degrees Celsius".to_owned();
                Err(self.refused("record", "temperature_c", number(value), expected))
            }
            None => Ok(()),
        }
    }

    /// Creates the error about a value, with its position in the file.
    fn refused(&self, table: &str, key: &str, found: String, expected: String) -> InputError {
        #[derive(Default, Deserialize)]
        #[serde(default)]
        struct Spans {
            calibration: BTreeMap<String, Spanned<Value>>,
            tolerance: BTreeMap<String, Spanned<Value>>,
            instrument: BTreeMap<String, Spanned<Value>>,
            record: BTreeMap<String, Spanned<Value>>,
        }
        let spans: Spans = toml::from_str(&self.text).unwrap_or_default();
        let values = match table {
            "calibration" => &spans.calibration,
            "tolerance" => &spans.tolerance,
            "instrument" => &spans.instrument,
            _ => &spans.record,
        };
        let span = values.get(key).map(Spanned::span).unwrap_or_default();
        self.error(span, &format!("{table}.{key}"), found, expected)
    }

    /// Refuses data that do not match the checksums, payloads and tools that the file states.
    fn check_data(&self) -> Result<(), InputError> {
        let data = &self.file.data;
        for (name, stated) in &data.sha256 {
            let mut files = [&self.file.robot.description, &data.train]
                .into_iter()
                .chain(&data.features)
                .chain(&data.tests);
            if !files.any(|file| file == name.get_ref()) {
                let found = format!("a checksum of \"{}\"", name.get_ref());
                let expected =
                    "the robot, data.train, data.features or one of data.tests, written as there";
                return Err(self.error(name.span(), name.get_ref(), found, expected));
            }
            let path = self.resolve(name.get_ref());
            let bytes = std::fs::read(&path)
                .map_err(|error| InputError::unreadable(&path, &error, "a file of this project"))?;
            let sum = FileSummary::of_bytes("", "", &bytes).sha256;
            if !sum.eq_ignore_ascii_case(stated.get_ref()) {
                let found = format!(
                    "a checksum that {} does not have: its checksum is {sum}",
                    path.display()
                );
                return Err(self
                    .error(stated.span(), "sha256", found, "the checksum of that file")
                    .with_help(
                        "bring the old file back, or correct the checksum if the new file is meant",
                    ));
            }
        }
        if data.payloads_kg.is_none() && data.tools.is_none() {
            return Ok(());
        }
        // A file that cannot be read is reported by the command itself.
        let Ok(set) = poegp_calibration::measurement::read(self.resolve(&data.train)) else {
            return Ok(());
        };
        let (payloads, tools) = payloads_and_tools(&set);
        if let Some(stated) = data
            .payloads_kg
            .as_ref()
            .filter(|p| *p.get_ref() != payloads)
        {
            let expected = format!("{payloads:?}, as in {}", data.train);
            return Err(self.error(
                stated.span(),
                "payloads_kg",
                format!("{:?}", stated.get_ref()),
                expected,
            ));
        }
        if let Some(stated) = data.tools.as_ref().filter(|t| *t.get_ref() != tools) {
            let expected = format!("{tools:?}, as in {}", data.train);
            return Err(self.error(
                stated.span(),
                "tools",
                format!("{:?}", stated.get_ref()),
                expected,
            ));
        }
        Ok(())
    }
}

/// Returns the payloads of a measurement file in kg, ascending, and its tools in their order.
pub fn payloads_and_tools(set: &MeasurementSet) -> (Vec<f64>, Vec<String>) {
    let payloads = distinct(set.measurements.iter().filter_map(|m| m.payload_kg));
    let mut tools: Vec<String> = Vec::new();
    for m in &set.measurements {
        let name = ToolName {
            session: m.session.clone().unwrap_or_default(),
            target: m.target.clone().unwrap_or_default(),
        };
        let name = name.to_string();
        if !tools.contains(&name) {
            tools.push(name);
        }
    }
    (payloads, tools)
}

/// A data file with its checksum at the time when it was read.
pub struct Data<'a> {
    pub path: &'a Path,
    pub sha256: String,
}

impl<'a> Data<'a> {
    /// Creates the entry of a measurement file.
    pub fn of_set(path: &'a Path, set: &MeasurementSet) -> Self {
        let sha256 = FileSummary::of_set("", set).sha256;
        Self { path, sha256 }
    }
}
