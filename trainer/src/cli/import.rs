//! `trainer import`.

use std::path::{Path, PathBuf};

use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use serde_json::{Value, json};

use crate::cli::failure::Failure;
use crate::cli::output::kind::Kind;
use crate::cli::output::{check_not_filled_in, check_outputs, summary_text, write_texts};
use crate::cli::terminal::print::{Printer, is_stdout, note};
use crate::import::column_map::Map;
use crate::import::preset::{PRESETS, Preset};
use crate::import::{Imported, Row, import_bytes, sockets};
use poegp_calibration::input_error::InputError;
use poegp_calibration::measurement::touch::features_beside;

/// Number of rows that are printed as they were understood.
const SHOWN: usize = 3;

/// `trainer import`.
#[derive(Debug, Args)]
#[command(
    after_help = "A column map states the meaning and the unit of each column. A preset is a map for a known file; without --map and \
    --preset, the preset whose columns are all in the header is used, if there is exactly one.\n\n\
    Examples:\n  trainer import log.csv --preset kuka --out measured.csv\n  \
    trainer import monday.csv tuesday.csv --session-per-file --out measured.csv\n  \
    trainer import points.txt joints.csv --preset spatial-analyzer --out measured.csv\n  \
    trainer import tracker.txt --map map.toml --out measured.csv\n  \
    trainer import data/panda --preset mukca --distance 50 --out touches.csv"
)]
pub struct Import {
    /// Measurements: one file, or several of one campaign in the order of time. If the joints are in a second
    /// file, first the poses or points, then the joints. With the preset mukca, a folder.
    #[arg(required = true, num_args = 1.., value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// Column map (TOML).
    #[arg(long, value_name = "FILE", conflicts_with = "preset")]
    pub map: Option<PathBuf>,
    /// Column map that comes with the program.
    #[arg(long, value_name = "NAME", value_parser = preset())]
    pub preset: Option<Chosen>,
    /// Distance in mm between hole 0 and hole 1 of every place, with the preset mukca.
    #[arg(long, value_name = "MM", value_parser = distance)]
    pub distance: Option<f64>,
    /// Write the map that was used, as the start of a map of your own.
    #[arg(long, value_name = "FILE", conflicts_with = "map")]
    pub write_map: Option<PathBuf>,
    /// Name the session of each file's rows after the file, because the target was remounted for each.
    #[arg(long)]
    pub session_per_file: bool,
    /// Measurement file to write (`-`: standard output); for touches also the features, NAME.toml beside
    /// NAME.csv.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Write the number of rows, the first three of them and the notes as JSON (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// Name of the preset that reads folders of socket touches.
const SOCKETS: &str = "mukca";

/// The preset that `--preset` names.
#[derive(Clone, Copy, Debug)]
pub enum Chosen {
    /// A column map.
    Map(Preset),
    /// The reader of folders with socket touches.
    Sockets,
}

/// Creates the parser of a preset's name.
fn preset() -> impl TypedValueParser<Value = Chosen> {
    let maps = PRESETS.map(|preset| PossibleValue::new(preset.name).help(preset.about()));
    let sockets = "Folders of MUKCa: PLACE/hole_0.csv, PLACE/hole_1.csv with joints in radians, no header; becomes a touch file";
    let sockets = PossibleValue::new(SOCKETS).help(sockets);
    PossibleValuesParser::new(maps.into_iter().chain([sockets])).try_map(|name| {
        match name.as_str() {
            SOCKETS => Ok(Chosen::Sockets),
            _ => Preset::named(&name).map(Chosen::Map).ok_or("not a preset"),
        }
    })
}

/// Parses a distance of 1 mm or more.
fn distance(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(mm) if mm >= 1.0 && f64::is_finite(mm) => Ok(mm),
        Ok(metres) if metres > 0.0 => Err("expected 1 mm or more: is this in metres?".to_owned()),
        _ => Err("expected a distance in mm".to_owned()),
    }
}

/// Converts folders of socket touches to a touch file and the description of its features.
fn run_sockets(a: &Import) -> Result<(), Failure> {
    let [folder] = a.files.as_slice() else {
        return Err(Failure::Usage(format!(
            "--preset {SOCKETS}: found {} files to import, expected one folder",
            a.files.len()
        )));
    };
    if a.map.is_some() || a.write_map.is_some() {
        return Err(Failure::Usage(format!(
            "found --map or --write-map with a folder, expected --preset {SOCKETS} alone: it has no map of columns"
        )));
    }
    if a.session_per_file {
        return Err(Failure::Usage(
            "--session-per-file: expected with files of measurements, found a folder of touches"
                .to_owned(),
        ));
    }
    let features = match is_stdout(&a.out) {
        true => {
            return Err(Failure::Usage(
                "--out -: expected a file name, because the features are written beside it"
                    .to_owned(),
            ));
        }
        false => features_beside(&a.out),
    };
    let outputs = [
        (Some(a.out.as_path()), Kind::Imported),
        (Some(features.as_path()), Kind::FilledIn),
        (a.json.as_deref(), Kind::Json),
    ];
    let outputs = check_outputs(&outputs, &[folder])?;
    let sockets = sockets::read(folder, a.distance)?;
    let rows: usize = sockets.features.iter().map(|(_, rows)| rows).sum();
    let of_features: serde_json::Map<String, Value> = sockets
        .features
        .iter()
        .map(|(name, rows)| (name.clone(), (*rows).into()))
        .collect();
    let summary = summary_text(json!({ "touches": rows, "features": of_features }))?;
    check_not_filled_in(&[(&features, sockets.toml.as_bytes())])?;
    write_texts(&[
        (Some(&a.out), Some(&sockets.csv)),
        (Some(&features), Some(&sockets.toml)),
        (a.json.as_deref(), Some(&summary)),
    ])?;
    let report = Printer::for_outputs(&outputs);
    report.line(format_args!(
        "Imported {rows} touches of {} sockets into {} and {}",
        sockets.features.len(),
        a.out.display(),
        features.display()
    ));
    if a.distance.is_none() {
        note(
            "no distance between two sockets is stated, and touches alone do not show the size of an arm: give \
             --distance MM",
        );
    }
    note(format_args!(
        "enter the nominal position of the ball in the flange frame in {}: tip_mm",
        features.display()
    ));
    Ok(())
}

pub fn run(a: &Import) -> Result<(), Failure> {
    let is_folder = a.preset.is_none() && a.map.is_none() && a.files[0].is_dir();
    let chosen = match a.preset {
        Some(Chosen::Sockets) => return run_sockets(a),
        None if is_folder => return run_sockets(a),
        Some(Chosen::Map(preset)) => Some(preset),
        None => None,
    };
    if a.distance.is_some() {
        return Err(Failure::Usage(format!(
            "--distance: expected only with --preset {SOCKETS}"
        )));
    }
    let mut inputs: Vec<&Path> = a.files.iter().map(PathBuf::as_path).collect();
    inputs.extend(a.map.as_deref());
    let outputs = [
        (Some(a.out.as_path()), Kind::Imported),
        (a.json.as_deref(), Kind::Json),
        (a.write_map.as_deref(), Kind::FilledIn),
    ];
    let outputs = check_outputs(&outputs, &inputs)?;
    let report = Printer::for_outputs(&outputs);
    let read = |path: &PathBuf| {
        std::fs::read(path)
            .map_err(|error| InputError::unreadable(path, &error, "a measurement file"))
    };
    let map = a.map.as_deref().map(Map::read).transpose()?;
    let bytes = a.files.iter().map(read).collect::<Result<Vec<_>, _>>()?;
    let (maps, text, doubt) = match map {
        Some(map) => (vec![map], String::new(), None),
        None => {
            let preset = match chosen {
                Some(preset) => preset,
                None => matching(&a.files, &bytes)?,
            };
            let files: Vec<(&Path, &[u8])> = a
                .files
                .iter()
                .zip(&bytes)
                .map(|(path, bytes)| (path.as_path(), bytes.as_slice()))
                .collect();
            let (texts, doubts): (Vec<_>, Vec<_>) = preset.maps(&files)?.into_iter().unzip();
            let path = a
                .write_map
                .clone()
                .unwrap_or_else(|| format!("<preset {}>", preset.name).into());
            let maps = texts.iter().map(|text| Map::parse(&path, text));
            let maps = maps.collect::<Result<Vec<_>, _>>()?;
            let first = texts.into_iter().next().unwrap_or_default();
            (maps, first, doubts.into_iter().flatten().next())
        }
    };
    let written = a.write_map.as_deref().map(|path| (path, text.as_bytes()));
    check_not_filled_in(written.as_slice())?;
    let imported = match doubt {
        Some(error) => Err(error),
        None => {
            let maps: Vec<&Map> = maps.iter().collect();
            import_bytes(&a.files, &bytes, &maps, a.session_per_file)
        }
    };
    // The map of a preset that does not fit is the start of one that does.
    if imported.is_err() {
        write_texts(&[(a.write_map.as_deref(), Some(&text))])?;
    }
    let imported = imported?;
    let summary = summary_text(summary(&imported))?;
    write_texts(&[
        (Some(&a.out), Some(&imported.csv)),
        (a.json.as_deref(), Some(&summary)),
        (a.write_map.as_deref(), Some(&text)),
    ])?;
    imported.notes.iter().for_each(note);
    let to = match is_stdout(&a.out) {
        true => String::new(),
        false => format!(" into {}", a.out.display()),
    };
    report.line(format_args!(
        "Imported {} measurements{to}",
        imported.rows.len()
    ));
    show(report, &imported.rows);
    Ok(())
}

/// Finds the one preset that fits the headers of all files, and prints it.
fn matching(files: &[PathBuf], bytes: &[Vec<u8>]) -> Result<Preset, InputError> {
    let expected = "--preset NAME or --map FILE";
    let of = |(file, bytes): (&PathBuf, &Vec<u8>)| {
        Preset::matching(file, bytes).ok_or_else(|| {
            let presets: Vec<String> = PRESETS
                .iter()
                .map(|preset| format!("\n  {:18} {}", preset.name, preset.about()))
                .collect();
            let help = format!(
                "docs/guide/import.md explains maps; --write-map FILE writes the map of a preset. The presets:{}",
                presets.concat()
            );
            let found = "no header that fits exactly one preset";
            InputError::new(file, found, expected).with_help(help)
        })
    };
    let presets: Vec<Preset> = files.iter().zip(bytes).map(of).collect::<Result<_, _>>()?;
    let preset = presets[0];
    if let Some(k) = presets.iter().position(|other| other.name != preset.name) {
        let (other, first) = (presets[k].name, preset.name);
        let found = format!("a header of the preset `{other}`, after one of `{first}`");
        return Err(InputError::new(&files[k], found, expected));
    }
    note(format_args!("preset `{}`: {}", preset.name, preset.about()));
    Ok(preset)
}

/// Creates the JSON document: number of rows, first rows and notes.
fn summary(imported: &Imported) -> Value {
    let fields = |row: &Row| Value::from_iter(row.fields());
    let shown: Vec<Value> = imported.rows.iter().take(SHOWN).map(fields).collect();
    json!({ "measurements": imported.rows.len(), "first_rows": shown, "notes": imported.notes })
}

/// Prints the first rows as they were understood, with a column for each row.
fn show(report: Printer, rows: &[Row]) {
    let shown: Vec<Vec<(String, String)>> =
        rows.iter().take(SHOWN).map(|row| row.fields()).collect();
    let Some(first) = shown.first() else { return };
    let mut header = vec!["first rows".to_owned()];
    header.extend((1..=shown.len()).map(|k| format!("row {k}")));
    let lines: Vec<Vec<String>> = first
        .iter()
        .enumerate()
        .map(|(i, (name, _))| {
            let values = shown
                .iter()
                .map(|fields| fields.get(i).map_or_else(String::new, |f| f.1.clone()));
            [name.clone()].into_iter().chain(values).collect()
        })
        .collect();
    let header: Vec<&str> = header.iter().map(String::as_str).collect();
    report.table(&header, &lines);
}
