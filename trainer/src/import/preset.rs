//! Presets: maps of columns for files of known layouts, in `import_presets/`.
//!
//! A preset states the meaning and the unit of every column. Only the separator, the decimal mark and the encoding are
//! detected in the file itself. A preset lists the drivers whose joint columns it accepts; the tables listed under
//! `optional` are left out where the header lacks their columns. `#` in the columns of a `reference` is every number from 1 on.

use std::path::Path;

use toml::{Table as Toml, Value};

use crate::import::column_map::drivers::Driver;
use crate::import::column_map::{ColumnName, Encoding, Layout, Separator};
use crate::import::marks::{Marks, shown};
use crate::import::spreadsheet::is_zip;
use crate::import::text::{Table, decoded, fields, heading, stated_separator};
use crate::import::units::Unit;
use poegp_calibration::input_error::InputError;

/// Number of lines from which the layout is detected.
const LOOKED_AT: usize = 50;

/// A map of columns for files of one kind.
#[derive(Clone, Copy, Debug)]
pub struct Preset {
    /// Name on the command line.
    pub name: &'static str,
    text: &'static str,
}

/// All presets.
pub const PRESETS: [Preset; 4] = [
    Preset {
        name: "poegp",
        text: include_str!("../../import_presets/poegp.toml"),
    },
    Preset {
        name: "kuka",
        text: include_str!("../../import_presets/kuka.toml"),
    },
    Preset {
        name: "spatial-analyzer",
        text: include_str!("../../import_presets/spatial-analyzer.toml"),
    },
    Preset {
        name: "leica",
        text: include_str!("../../import_presets/leica.toml"),
    },
];

impl Preset {
    /// The preset with this name.
    pub fn named(name: &str) -> Option<Self> {
        PRESETS.into_iter().find(|preset| preset.name == name)
    }

    /// Returns one line that describes the files of this preset.
    pub fn about(self) -> String {
        let about = self.table().remove("about");
        about.map_or_else(String::new, |about| about.as_str().unwrap_or("").to_owned())
    }

    /// Returns the only preset whose columns are all in the header of `path`; `None` where no preset or several match. A
    /// list of points has no header, so its preset has to be named.
    pub fn matching(path: &Path, bytes: &[u8]) -> Option<Self> {
        let fits = |preset: &Self| {
            preset
                .resolved(&[(path, bytes)])
                .is_ok_and(|Resolved { map, header, .. }| {
                    let mut names = map.values().flat_map(names);
                    header.len() > 2 && names.all(|name| header.iter().any(|h| h == name))
                })
        };
        let mut fitting = PRESETS.into_iter().filter(fits);
        fitting.next().filter(|_| fitting.next().is_none())
    }

    /// Returns the map for points and joints, or for each of several files, as TOML; and an error if its decimal mark is a
    /// guess.
    ///
    /// # Errors
    /// [`InputError`] when a file is not a table of text.
    pub fn maps(
        self,
        files: &[(&Path, &[u8])],
    ) -> Result<Vec<(String, Option<InputError>)>, InputError> {
        let files_of_a_map = match self.table().contains_key("points") {
            true => files.len(),
            false => 1,
        };
        let of = |files: &[(&Path, &[u8])]| {
            let Resolved { map, doubt, .. } = self.resolved(files)?;
            Ok((format!("# {}: {}\n{map}", self.name, self.about()), doubt))
        };
        files.chunks(files_of_a_map).map(of).collect()
    }

    fn table(self) -> Toml {
        // The tests read every preset.
        self.text.parse().unwrap_or_default()
    }

    /// Returns the map with the detected layout.
    fn resolved(self, files: &[(&Path, &[u8])]) -> Result<Resolved, InputError> {
        let mut map = self.table();
        map.remove("about");
        let optional = map.remove("optional");
        let (expected, what) = match map.contains_key("points") {
            true => (2, "two files, the points and then the joints"),
            false => (1, "one file"),
        };
        if files.len() != expected {
            let found = match files.len() {
                1 => "1 file to import".to_owned(),
                count => format!("{count} files to import"),
            };
            let expected = format!("{what}, for the preset `{}`", self.name);
            return Err(InputError::new(files[0].0, found, expected));
        }
        let mut header = Vec::new();
        let mut tables = Vec::new();
        for (key, (path, bytes)) in ["file", "joints_file"].into_iter().zip(files) {
            let stated = map.remove(key).unwrap_or(Value::Table(Toml::new()));
            let mut layout: Layout = stated.try_into().unwrap_or_default();
            detect(&mut layout, path, bytes)?;
            let table = Table::parse(path, bytes, &layout)?;
            header = table
                .header
                .as_ref()
                .map_or_else(Vec::new, |line| line.fields.clone());
            let bare: Vec<String> = header
                .iter()
                .map(|name| heading(name).0.to_owned())
                .collect();
            header.extend(bare);
            tables.push((key, table, layout));
        }
        let has = |name: &str| header.iter().any(|there| there == name);
        if let Some(Value::Table(joints)) = map.get_mut("joints")
            && let Some(Value::Array(drivers)) = joints.remove("drivers")
        {
            let drivers = drivers.iter().filter_map(Value::as_str);
            let drivers: Vec<Driver> = drivers.filter_map(Driver::named).collect();
            let fits = |driver: &&Driver| driver.columns(has).iter().all(|name| has(name));
            let fitting: Vec<&Driver> = drivers.iter().filter(fits).collect();
            if let [one, other, ..] = fitting.as_slice()
                && let Some((path, _)) = files.last()
            {
                let found = format!("joints of two drivers, {:?} and {:?}", one.name, other.name);
                let expected = "one driver, or joints.driver = \"…\" in a map";
                return Err(InputError::new(path, found, expected));
            }
            if let Some(driver) = fitting.first().copied().or(drivers.first()) {
                let columns = driver.columns(has).into_iter().map(Value::String);
                joints.insert("columns".to_owned(), Value::Array(columns.collect()));
                joints.insert("unit".to_owned(), driver.unit.name().into());
            }
        }
        let optional: Option<Vec<String>> = optional.and_then(|keys| keys.try_into().ok());
        for key in optional.unwrap_or_default() {
            if map
                .get(&key)
                .is_some_and(|table| !names(table).iter().all(|name| has(name)))
            {
                map.remove(&key);
            }
        }
        if let Some(Value::Array(references)) = map.remove("reference") {
            let every = references.iter().flat_map(|one| numbered(one, has));
            let every: Vec<Value> = every.collect();
            map.extend((!every.is_empty()).then(|| ("reference".to_owned(), every.into())));
        }
        let (mut doubt, mut layouts) = (None, Toml::new());
        let last = tables.len() - 1;
        for (index, (key, table, mut layout)) in tables.into_iter().enumerate() {
            let mut marks = Marks::default();
            // The points are in the first file, everything else is in the last.
            let here = |name: &str| index == if name == "points" { 0 } else { last };
            for (name, value) in map.iter().filter(|(name, _)| here(name.as_str())) {
                for column in numbers(name, value)
                    .iter()
                    .filter_map(|c| table.find(c).ok())
                {
                    marks.add(&table, column, is_angle(name, value));
                }
            }
            doubt = doubt.or(marks.decide(&table, &mut layout, key));
            layouts.extend(
                Toml::try_from(&layout)
                    .ok()
                    .map(|l| (key.to_owned(), l.into())),
            );
        }
        map.extend(layouts);
        Ok(Resolved { map, header, doubt })
    }
}

/// A preset's map for given files.
struct Resolved {
    map: Toml,
    /// Header of the last file.
    header: Vec<String>,
    /// Why the decimal mark is not certain.
    doubt: Option<InputError>,
}

/// Returns a reference point for each number in place of `#` whose columns the header has.
fn numbered(point: &Value, has: impl Fn(&str) -> bool) -> Vec<Value> {
    let of = |k: usize| {
        let mut point = point.clone();
        let columns = point.get_mut("columns").and_then(Value::as_array_mut)?;
        for column in columns {
            *column = column.as_str()?.replace('#', &k.to_string()).into();
        }
        names(&point).iter().all(|name| has(name)).then_some(point)
    };
    (1..).map_while(of).collect()
}

/// Returns the columns with numbers that a table of a map, or a list of such tables, names.
fn numbers(key: &str, table: &Value) -> Vec<ColumnName> {
    if let Some(tables) = table.as_array() {
        return tables
            .iter()
            .flat_map(|table| numbers(key, table))
            .collect();
    }
    let several = table.get("columns").and_then(Value::as_array);
    let one = table
        .get("column")
        .filter(|_| !matches!(key, "session" | "target"));
    let all = one.into_iter().chain(several.into_iter().flatten());
    all.filter_map(|column| column.clone().try_into().ok())
        .collect()
}

/// Returns whether the numbers of a table of a map are angles, or parts of an orientation.
fn is_angle(key: &str, table: &Value) -> bool {
    let unit = table.get("unit").and_then(Value::as_str).unwrap_or("");
    key == "orientation" || (key == "joints" && matches!(unit, "deg" | "rad"))
}

/// Returns the columns that a table of a map names.
fn names(table: &Value) -> Vec<&str> {
    let one = ["column", "name"]
        .into_iter()
        .filter_map(|key| table.get(key));
    let several = table.get("columns").and_then(Value::as_array);
    one.chain(several.into_iter().flatten())
        .filter_map(Value::as_str)
        .collect()
}

/// Detects encoding and separator: the one that the file states, or the one with the most numbers in rows of equal width.
fn detect(layout: &mut Layout, path: &Path, bytes: &[u8]) -> Result<(), InputError> {
    if is_zip(bytes) {
        return Ok(());
    }
    layout.encoding = if bytes.starts_with(&[0xff, 0xfe]) || bytes.starts_with(&[0xfe, 0xff]) {
        Encoding::Utf16
    } else if std::str::from_utf8(bytes).is_ok() {
        Encoding::Utf8
    } else {
        Encoding::Latin1
    };
    let text = decoded(path, bytes, layout.encoding)?;
    if let Some(separator) = stated_separator(path, &text)? {
        layout.separator = separator;
        return Ok(());
    }
    let is_comment = |line: &str| {
        layout
            .comments
            .iter()
            .any(|mark| line.starts_with(mark.as_str()))
    };
    let lines = text
        .split(['\n', '\r'])
        .map(str::trim)
        .filter(|line| !line.is_empty() && !is_comment(line));
    let lines: Vec<&str> = lines.take(LOOKED_AT).collect();
    let mut best = 0;
    for separator in [
        Separator::Semicolon,
        Separator::Tab,
        Separator::Comma,
        Separator::Space,
    ] {
        let tried = Layout {
            separator,
            ..layout.clone()
        };
        let rows = lines
            .iter()
            .filter_map(|line| fields(path, 0, line, &tried).ok());
        let rows: Vec<_> = rows
            .filter(|row| row.iter().any(|field| !field.is_empty()))
            .collect();
        let Some(width) = rows.last().map(Vec::len).filter(|width| *width > 1) else {
            continue;
        };
        let rows = rows.iter().filter(|row| row.len() == width);
        let numbers = rows
            .flatten()
            .filter(|field| shown(field).is_some())
            .count();
        if numbers > best {
            (best, layout.separator) = (numbers, separator);
        }
    }
    Ok(())
}
