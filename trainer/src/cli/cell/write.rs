//! Writes the project file of a calibration.
//!
//! Every option is written out, defaults too: a later version may have others.

use std::path::{Component, Path, PathBuf};

use clap::ValueEnum;
use toml::{Table, Value};

use crate::cli::arguments::Calibrate;
use crate::cli::cell::stated;
use crate::report::FileFacts;
use poegp_calibration::blob::write::Provenance;
use poegp_calibration::measurement::MeasurementSet;
use poegp_calibration::measurement::sample::ToolName;
use poegp_calibration::robot::BUILT_IN;

/// The project file at `path` that does again what `a` asks for, and made `blob`.
pub fn text(
    a: &Calibrate,
    path: &Path,
    set: &MeasurementSet,
    tests: &[MeasurementSet],
    origin: &Provenance,
    blob: &[u8],
) -> String {
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let name = |path: &Path| Value::from(relative(folder, path));
    let mut sums = Table::new();
    let mut sum = |facts: FileFacts, path: &Path| {
        sums.insert(relative(folder, path), facts.sha256.into());
    };
    let mut robot = Table::new();
    let spec = &a.robot.robot;
    if BUILT_IN.contains(&spec.as_str()) {
        robot.insert("description".into(), spec.as_str().into());
    } else {
        robot.insert("description".into(), name(Path::new(spec)));
        if let Ok(bytes) = std::fs::read(spec) {
            sum(FileFacts::of_bytes("", "", &bytes), Path::new(spec));
        }
    }
    put(&mut robot, "base", a.robot.base.clone());
    put(&mut robot, "tip", a.robot.tip.clone());
    put(&mut robot, "serial_number", Some(a.serial_number.clone()));
    put(&mut robot, "gravity_m_s2", Some(a.fit.gravity.0.to_vec()));

    let mut instrument = Table::new();
    put(
        &mut instrument,
        "position_sigma_mm",
        a.fit.position_sigma_mm,
    );
    put(
        &mut instrument,
        "orientation_sigma_mrad",
        a.fit.orientation_sigma_mrad,
    );
    put(&mut instrument, "correct_drift", Some(a.correct_drift));

    sum(FileFacts::of_set("", set), &a.train);
    for (path, test) in a.tests.iter().zip(tests) {
        sum(FileFacts::of_set("", test), path);
    }
    let (payloads, tools) = stated(set);
    let mut data = Table::new();
    data.insert("train".into(), name(&a.train));
    let names: Vec<Value> = a.tests.iter().map(|path| name(path)).collect();
    put(&mut data, "tests", (!names.is_empty()).then_some(names));
    put(
        &mut data,
        "payloads_kg",
        (!payloads.is_empty()).then_some(payloads),
    );
    // One tool without a name says nothing.
    let named = tools.len() > 1 || tools != [ToolName::default().to_string()];
    put(&mut data, "tools", named.then_some(tools));
    data.insert("sha256".into(), sums.into());

    let mut model = Table::new();
    put(&mut model, "method", word(a.model));
    for (key, flag) in [
        ("per_output", a.fit.per_output),
        ("tied", a.fit.tied),
        ("no_device_sigma", a.fit.no_device_sigma),
        ("weighted", a.fit.weighted),
    ] {
        put(&mut model, key, Some(flag));
    }
    match (a.fit.support_per_output, a.fit.support.0) {
        (Some(total), _) => put(&mut model, "support_per_output", Some(i64::from(total))),
        (None, Some(count)) => put(&mut model, "support", i64::try_from(count).ok()),
        (None, None) => put(&mut model, "support", Some("all")),
    }
    put(&mut model, "outliers", word(a.fit.outliers));
    let whole = |n: u64| i64::try_from(n).ok();
    put(
        &mut model,
        "max_instructions",
        a.max_instructions.and_then(whole),
    );
    let bytes = a.max_flash_bytes.and_then(|n| i64::try_from(n).ok());
    put(&mut model, "max_flash_bytes", bytes);
    put(&mut model, "max_correction_mm", a.max_correction_mm);
    put(&mut model, "max_correction_mrad", a.max_correction_mrad);

    let mut output = Table::new();
    output.insert("blob".into(), name(&a.out));
    let sum = FileFacts::of_bytes("", "", blob).sha256;
    put(&mut output, "blob_sha256", Some(sum));
    put(&mut output, "report", a.report.as_deref().map(name));
    let json = a
        .json
        .as_deref()
        .filter(|path| !crate::cli::report::is_stdout(path));
    put(&mut output, "json", json.map(name));

    let mut file = format!(
        "# A calibration: `trainer calibrate` does the same again with this file. Paths are relative to it.\n\
         version = 1\ntrainer = \"{}\"\ndate = \"{}\"\n",
        env!("CARGO_PKG_VERSION"),
        origin.date
    );
    for (title, table) in [
        ("robot", robot),
        ("instrument", instrument),
        ("data", data),
        ("model", model),
        ("output", output),
    ] {
        let mut whole = Table::new();
        whole.insert(title.into(), table.into());
        file += &format!("\n{whole}");
    }
    file
}

fn put<T: Into<Value>>(table: &mut Table, key: &str, value: Option<T>) {
    if let Some(value) = value {
        table.insert(key.to_owned(), value.into());
    }
}

fn word(value: impl ValueEnum) -> Option<String> {
    value
        .to_possible_value()
        .map(|value| value.get_name().to_owned())
}

/// `path` as seen from `folder`, with slashes; as it is where that cannot be said.
fn relative(folder: &Path, path: &Path) -> String {
    let place = |path: &Path| -> Option<PathBuf> {
        let parent = match path.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent,
            _ => Path::new("."),
        };
        Some(std::fs::canonicalize(parent).ok()?.join(path.file_name()?))
    };
    let both = std::fs::canonicalize(folder).ok().zip(place(path));
    let Some((from, to)) = both else {
        return path.to_string_lossy().into_owned();
    };
    let (from, to): (Vec<Component>, Vec<Component>) =
        (from.components().collect(), to.components().collect());
    let common = from.iter().zip(&to).take_while(|(a, b)| a == b).count();
    // Another drive.
    if common == 0 {
        return path.to_string_lossy().into_owned();
    }
    let up = std::iter::repeat_n("..".to_owned(), from.len() - common);
    let down = to[common..]
        .iter()
        .map(|part| part.as_os_str().to_string_lossy().into_owned());
    up.chain(down).collect::<Vec<_>>().join("/")
}
