//! `--write-project`: the complete configuration that was used, including defaults, because another version may have other
//! defaults.

use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};

use toml::Spanned;

use crate::cli::calibrate::job::Job;
use crate::cli::calibrate::project::{Data, DataTable, File, OutputTable, RobotTable, VERSION};
use crate::cli::output::transaction::folder_of;
use crate::cli::terminal::print::is_stdout;
use crate::cli::tolerance::ToleranceTable;
use crate::report::FileSummary;
use poegp_calibration::measurement::sample::ToolName;
use poegp_calibration::model::config::Config;
use poegp_calibration::robot::BUILT_IN;

/// The data files that a calibration has read.
pub struct Read<'a> {
    pub train: Data<'a>,
    /// Description of the features, if `train` is a touch file.
    pub features: Option<Data<'a>>,
    pub tests: Vec<Data<'a>>,
    /// Payloads and tools of the training data; empty for touches, which may have several of each.
    pub payloads_and_tools: (Vec<f64>, Vec<String>),
}

/// Returns the text of the project file at `path` that repeats the job, which made `blob` with the configuration
/// `calibration`.
pub fn text(
    a: &Job,
    path: &Path,
    read: Read<'_>,
    calibration: Config,
    date: &str,
    blob: &[u8],
) -> String {
    let folder = folder_of(path);
    let name = |path: &Path| relative(folder, path);
    let mut sums: BTreeMap<String, String> = BTreeMap::new();
    let mut description = a.robot.clone();
    if !BUILT_IN.contains(&description.as_str()) {
        let path = PathBuf::from(&description);
        description = name(&path);
        if let Ok(bytes) = std::fs::read(&path) {
            let sum = FileSummary::of_bytes("", "", &bytes).sha256;
            sums.insert(description.clone(), sum);
        }
    }
    let data = std::iter::once(&read.train).chain(&read.features);
    for data in data.chain(&read.tests) {
        sums.insert(name(data.path), data.sha256.clone());
    }
    let (payloads, tools) = read.payloads_and_tools;
    // A single unnamed tool needs no entry.
    let unnamed = ToolName::default().to_string();
    let named = tools.len() > 1 || tools.iter().any(|tool| *tool != unnamed);
    let sums = sums.into_iter();
    let file = File {
        version: spanned(VERSION),
        trainer: Some(env!("CARGO_PKG_VERSION").to_owned()),
        date: Some(spanned(date.to_owned())),
        robot: RobotTable {
            description,
            base: a.chain.base.clone(),
            tip: a.chain.tip.clone(),
            serial_number: a.serial_number.clone(),
        },
        data: DataTable {
            train: name(read.train.path),
            features: read.features.as_ref().map(|data| name(data.path)),
            tests: read.tests.iter().map(|data| name(data.path)).collect(),
            correct_drift: a.correct_drift,
            accept: a.accept.clone(),
            payloads_kg: (!payloads.is_empty()).then(|| spanned(payloads)),
            tools: named.then(|| spanned(tools)),
            sha256: sums
                .map(|(file, sum)| (spanned(file), spanned(sum)))
                .collect(),
        },
        calibration,
        gauge: a.gauge.table(name),
        tolerance: ToleranceTable::new(&a.statement.tolerances),
        instrument: a.statement.instrument.clone(),
        record: a.statement.record.clone(),
        output: OutputTable {
            blob: Some(name(&a.out)),
            blob_sha256: Some(FileSummary::of_bytes("", "", blob).sha256),
            report: a.report.as_deref().map(name),
            json: a.json.as_deref().filter(|path| !is_stdout(path)).map(name),
        },
    };
    format!(
        "# `trainer calibrate` with this file repeats the calibration. Paths are relative to the file.\n{}",
        // Cannot fail: every value can be written as TOML.
        toml::to_string(&file).unwrap_or_default()
    )
}

fn spanned<T>(value: T) -> Spanned<T> {
    Spanned::new(0..0, value)
}

/// Returns `path` relative to `folder`, with slashes; `path` itself if no relative path exists.
fn relative(folder: &Path, path: &Path) -> String {
    let absolute = |path: &Path| -> Option<PathBuf> {
        let folder = std::fs::canonicalize(folder_of(path)).ok()?;
        Some(folder.join(path.file_name()?))
    };
    let both = std::fs::canonicalize(folder).ok().zip(absolute(path));
    let Some((from, to)) = both else {
        return path.to_string_lossy().into_owned();
    };
    let (from, to): (Vec<Component>, Vec<Component>) =
        (from.components().collect(), to.components().collect());
    let common = from.iter().zip(&to).take_while(|(a, b)| a == b).count();
    // The paths are on different drives.
    if common == 0 {
        return path.to_string_lossy().into_owned();
    }
    let up = std::iter::repeat_n("..".to_owned(), from.len() - common);
    let down = to[common..]
        .iter()
        .map(|part| part.as_os_str().to_string_lossy().into_owned());
    up.chain(down).collect::<Vec<_>>().join("/")
}
