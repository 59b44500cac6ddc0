//! The keys of a project file, and the options that they stand for.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::ops::Range;
use std::path::Path;

use serde::Deserialize;
use toml::{Spanned, Value};

use poegp_calibration::input_error::InputError;
use poegp_calibration::robot::BUILT_IN;
use poegp_calibration::robot::toml_source::TomlSource;

/// Of the shape that is read here.
const VERSION: u32 = 1;

/// A value that the command line looks at.
type Any = Option<Spanned<Value>>;
type Flag = Option<Spanned<bool>>;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    version: Spanned<u32>,
    trainer: Option<Spanned<String>>,
    date: Any,
    robot: RobotTable,
    #[serde(default)]
    instrument: InstrumentTable,
    data: DataTable,
    #[serde(default)]
    model: ModelTable,
    #[serde(default)]
    output: OutputTable,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, expecting = "a table [robot] with its keys")]
struct RobotTable {
    description: Spanned<String>,
    base: Any,
    tip: Any,
    serial_number: Any,
    gravity_m_s2: Any,
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields, expecting = "a table [instrument] with its keys")]
struct InstrumentTable {
    position_sigma_mm: Any,
    orientation_sigma_mrad: Any,
    correct_drift: Flag,
}

/// The table `data`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields, expecting = "a table [data] with its keys")]
pub struct DataTable {
    pub train: Spanned<String>,
    #[serde(default)]
    tests: Vec<Spanned<String>>,
    /// Payloads of the training data in kg, ascending.
    pub payloads_kg: Option<Spanned<Vec<f64>>>,
    /// Tools of the training data in their order.
    pub tools: Option<Spanned<Vec<String>>>,
    /// Checksums by the names of the files, as they are written here.
    #[serde(default)]
    pub sha256: BTreeMap<Spanned<String>, Spanned<String>>,
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields, expecting = "a table [model] with its keys")]
struct ModelTable {
    method: Any,
    per_output: Flag,
    tied: Flag,
    no_device_sigma: Flag,
    support: Any,
    support_per_output: Any,
    outliers: Any,
    weighted: Flag,
    max_instructions: Any,
    max_flash_bytes: Any,
    max_correction_mm: Any,
    max_correction_mrad: Any,
}

/// The table `output`.
#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields, expecting = "a table [output] with its keys")]
pub struct OutputTable {
    /// Where the blob goes.
    pub blob: Option<Spanned<String>>,
    /// SHA-256 of the blob that was made when the file was written.
    pub blob_sha256: Option<Spanned<String>>,
    report: Option<Spanned<String>>,
    json: Option<Spanned<String>>,
}

/// A project file.
pub struct Cell<'a> {
    path: &'a Path,
    text: String,
    file: File,
}

/// An option that the file gives.
pub struct Given {
    /// Its long name.
    pub option: &'static str,
    /// The key, as `model.support`.
    pub key: String,
    /// None for a flag.
    pub value: Option<OsString>,
    /// Whether it has to be typed to have this effect: a flag that is false has no option.
    pub typed: bool,
    /// Bytes of the value in the file.
    pub place: Range<usize>,
}

impl<'a> Cell<'a> {
    /// Reads a project file.
    pub fn read(path: &'a Path) -> Result<Self, InputError> {
        let text = std::fs::read_to_string(path)
            .map_err(|error| InputError::unreadable(path, &error, "a project file"))?;
        let file: File = toml::from_str(&text).map_err(|error| {
            let toml = TomlSource {
                file: path,
                text: &text,
            };
            toml.refused(&error, "a project file in TOML").with_help(
                "docs/guide/projects.md has all keys; `trainer calibrate … --write-cell FILE` writes a complete one",
            )
        })?;
        let cell = Self { path, text, file };
        let version = &cell.file.version;
        if *version.get_ref() != VERSION {
            let found = format!("version {}", version.get_ref());
            return Err(cell
                .error(
                    version.span(),
                    "version",
                    found,
                    format!("version {VERSION}"),
                )
                .with_help("a newer trainer has written this file: use that one"));
        }
        Ok(cell)
    }

    /// An error at a place of the file.
    pub fn error(
        &self,
        place: Range<usize>,
        key: &str,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> InputError {
        let toml = TomlSource {
            file: self.path,
            text: &self.text,
        };
        toml.error(place, key, found, expected)
    }

    /// The version of the trainer that the file names.
    pub fn trainer(&self) -> Option<&str> {
        self.file.trainer.as_ref().map(|v| v.get_ref().as_str())
    }

    /// The table `output`.
    pub fn output(&self) -> &OutputTable {
        &self.file.output
    }

    /// The table `data`.
    pub fn data(&self) -> &DataTable {
        &self.file.data
    }

    /// All files that are read, as they are written here.
    pub fn files(&self) -> impl Iterator<Item = &String> {
        let data = &self.file.data;
        [&self.file.robot.description, &data.train]
            .into_iter()
            .chain(&data.tests)
            .map(Spanned::get_ref)
    }

    /// The options that it stands for; paths become those of `folder`.
    pub fn options(&self, folder: &Path) -> Vec<Given> {
        let File {
            robot,
            instrument,
            data,
            model,
            output,
            ..
        } = &self.file;
        let path = |option, key: &str, name: &Spanned<String>| Given {
            option,
            key: key.to_owned(),
            value: Some(folder.join(name.get_ref()).into_os_string()),
            typed: true,
            place: name.span(),
        };
        let description = &robot.description;
        let mut out = vec![path("robot", "robot.description", description)];
        if BUILT_IN.contains(&description.get_ref().as_str()) {
            out[0].value = Some(description.get_ref().into());
        }
        out.extend(
            data.tests
                .iter()
                .map(|name| path("test", "data.tests", name)),
        );
        let outputs = [
            ("out", "output.blob", &output.blob),
            ("report", "output.report", &output.report),
            ("json", "output.json", &output.json),
        ];
        out.extend(
            outputs
                .into_iter()
                .filter_map(|(option, key, name)| Some(path(option, key, name.as_ref()?))),
        );
        let values: [(&str, &'static str, &Any); 15] = [
            ("", "date", &self.file.date),
            ("robot.", "base", &robot.base),
            ("robot.", "tip", &robot.tip),
            ("robot.", "serial-number", &robot.serial_number),
            ("robot.", "gravity", &robot.gravity_m_s2),
            (
                "instrument.",
                "position-sigma-mm",
                &instrument.position_sigma_mm,
            ),
            (
                "instrument.",
                "orientation-sigma-mrad",
                &instrument.orientation_sigma_mrad,
            ),
            ("model.", "model", &model.method),
            ("model.", "support", &model.support),
            ("model.", "support-per-output", &model.support_per_output),
            ("model.", "outliers", &model.outliers),
            ("model.", "max-instructions", &model.max_instructions),
            ("model.", "max-flash-bytes", &model.max_flash_bytes),
            ("model.", "max-correction-mm", &model.max_correction_mm),
            ("model.", "max-correction-mrad", &model.max_correction_mrad),
        ];
        for (table, option, value) in values {
            let Some(value) = value else { continue };
            let name = match option {
                "model" => "method".to_owned(),
                "gravity" => "gravity_m_s2".to_owned(),
                _ => option.replace('-', "_"),
            };
            out.push(Given {
                option,
                key: format!("{table}{name}"),
                value: Some(words(value.get_ref()).into()),
                typed: true,
                place: value.span(),
            });
        }
        let flags = [
            ("instrument.", "correct-drift", &instrument.correct_drift),
            ("model.", "per-output", &model.per_output),
            ("model.", "tied", &model.tied),
            ("model.", "no-device-sigma", &model.no_device_sigma),
            ("model.", "weighted", &model.weighted),
        ];
        for (table, option, flag) in flags {
            let Some(flag) = flag else { continue };
            out.push(Given {
                option,
                key: format!("{table}{}", option.replace('-', "_")),
                value: None,
                typed: *flag.get_ref(),
                place: flag.span(),
            });
        }
        out
    }
}

/// A value as it would be typed.
fn words(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Array(values) => values.iter().map(words).collect::<Vec<_>>().join(","),
        other => other.to_string(),
    }
}
