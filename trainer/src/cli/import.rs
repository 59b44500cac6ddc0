//! `trainer import`.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::{Value, json};

use crate::cli::report::{Report, is_stdout};
use crate::cli::{Failure, check_outputs, facts_text, write_outputs};
use crate::import::guess::{Guess, guess};
use crate::import::map::Map;
use crate::import::{Imported, Row, import};
use poegp_calibration::input_error::InputError;

/// Rows that are shown as they were understood.
const SHOWN: usize = 3;

/// `trainer import`.
#[derive(Debug, Args)]
#[command(
    after_help = "docs/guide/import.md has the keys of a map and an example of every shape.\n\n\
    Example: trainer import --guess tracker.txt --out map.toml\n\
    Example: trainer import tracker.txt --map map.toml --out measured.csv\n\
    Example: trainer import points.txt joints.csv --map map.toml --out measured.csv"
)]
pub struct Import {
    /// The file of measurements; for a list of points that file and then the file of joints.
    #[arg(required = true, num_args = 1..=2)]
    pub raws: Vec<PathBuf>,
    /// Which column is what (TOML).
    #[arg(
        long,
        value_name = "FILE",
        required_unless_present = "guess",
        conflicts_with = "guess"
    )]
    pub map: Option<PathBuf>,
    /// Propose a map, print it (or write it to --out), and show three rows as it understands them.
    #[arg(long)]
    pub guess: bool,
    /// Measurement file to write (`-`: standard output); with --guess the map.
    #[arg(long, value_name = "FILE", required_unless_present = "guess")]
    pub out: Option<PathBuf>,
    /// What was understood as JSON: rows, columns of the first three, notes; with --guess the map, too (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

pub fn run(a: &Import) -> Result<(), Failure> {
    let mut inputs: Vec<&Path> = a.raws.iter().map(PathBuf::as_path).collect();
    inputs.extend(a.map.as_deref());
    let outputs = [a.out.as_deref(), a.json.as_deref()];
    check_outputs(&outputs, &inputs)?;
    let report = Report::beside(&outputs);
    if a.guess {
        return propose(a, report);
    }
    let (Some(map), Some(out)) = (&a.map, &a.out) else {
        // clap asks for both.
        return Err(Failure::Usage(
            "expected --map and --out, or --guess".to_owned(),
        ));
    };
    let map = Map::read(map)?;
    let imported = import(&a.raws, &map)?;
    let facts = facts_text(facts(&imported, &map))?;
    let mut files: Vec<(&Path, &[u8])> = vec![(out, imported.csv.as_bytes())];
    files.extend(a.json.as_deref().map(|path| (path, facts.as_bytes())));
    write_outputs(&files)?;
    for note in &imported.notes {
        crate::cli::report::remark(note);
    }
    report.line(format_args!(
        "Imported {} measurements{}",
        imported.rows.len(),
        if is_stdout(out) {
            String::new()
        } else {
            format!(" into {}", out.display())
        }
    ));
    show(report, &imported.rows, &map);
    Ok(())
}

fn propose(a: &Import, report: Report) -> Result<(), Failure> {
    let read = |path: &PathBuf| {
        std::fs::read(path)
            .map_err(|error| InputError::unreadable(path, &error, "a measurement file"))
    };
    let bytes = a.raws.iter().map(read).collect::<Result<Vec<_>, _>>()?;
    let Guess {
        map: text,
        missing,
        columns,
    } = guess(&a.raws, &bytes)?;
    let path = a
        .out
        .clone()
        .unwrap_or_else(|| PathBuf::from("<proposed map>"));
    let tried = missing.is_empty().then(|| -> Result<_, InputError> {
        let map = Map::parse(&path, &text)?;
        let imported = import(&a.raws, &map)?;
        Ok((map, imported))
    });
    let mut document = match &tried {
        Some(Ok((map, imported))) => facts(imported, map),
        _ => json!({}),
    };
    document["map"] = text.as_str().into();
    document["missing"] = json!(missing);
    let document = facts_text(document)?;
    let mut files: Vec<(&Path, &[u8])> = Vec::new();
    files.extend(a.out.as_deref().map(|path| (path, text.as_bytes())));
    files.extend(a.json.as_deref().map(|path| (path, document.as_bytes())));
    write_outputs(&files)?;
    match &a.out {
        Some(out) => {
            if !is_stdout(out) {
                report.line(format_args!("Wrote {}", out.display()));
            }
        }
        None => report.line(text.trim_end()),
    }
    let Some(tried) = tried else {
        let found = format!("no columns that look like {}", missing.join(" and "));
        let one_file = if a.raws.len() == 1 {
            "; for a list of points give the file of joints, too"
        } else {
            ""
        };
        return Err(InputError::new(
            &a.raws[0],
            found,
            "names such as q1_deg, J1, A1, x_mm, X [mm], qw",
        )
        .with_help(format!(
            "complete the map by hand; the columns are {}{one_file}",
            columns.join(", ")
        ))
        .into());
    };
    match tried {
        Ok((map, imported)) => {
            report.line("");
            for note in &imported.notes {
                crate::cli::report::remark(note);
            }
            show(report, &imported.rows, &map);
            Ok(())
        }
        Err(error) => Err(Failure::Input(error)),
    }
}

/// What was understood, for other programs.
fn facts(imported: &Imported, map: &Map) -> Value {
    let shown: Vec<Value> = imported
        .rows
        .iter()
        .take(SHOWN)
        .map(|row| {
            let fields = row.fields(map);
            Value::Object(
                fields
                    .into_iter()
                    .map(|(name, text)| (name, Value::String(text)))
                    .collect(),
            )
        })
        .collect();
    json!({ "measurements": imported.rows.len(), "as_understood": shown, "notes": imported.notes })
}

/// The first rows as they were understood, a column for each.
fn show(report: Report, rows: &[Row], map: &Map) {
    let shown: Vec<Vec<(String, String)>> =
        rows.iter().take(SHOWN).map(|row| row.fields(map)).collect();
    let Some(first) = shown.first() else { return };
    let mut header = vec!["as understood".to_owned()];
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
