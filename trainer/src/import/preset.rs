//! Presets: maps of columns for files of known layouts, in `import_presets/`.
//!
//! A preset states the meaning and the unit of every column. Only the separator, the decimal mark and the encoding are
//! detected in the file itself. A preset lists the drivers whose joint columns it accepts; the tables listed under
//! `optional` are left out where the header lacks their columns.

use std::path::Path;

use toml::{Table as Toml, Value};

use crate::import::column_map::drivers::Driver;
use crate::import::column_map::{Decimal, Encoding, Layout, Separator};
use crate::import::spreadsheet::is_zip;
use crate::import::text::{Table, decoded, fields, heading, is_number};
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
                .is_ok_and(|(map, header)| {
                    let mut names = map.values().flat_map(names);
                    header.len() > 2 && names.all(|name| header.iter().any(|h| h == name))
                })
        };
        let mut fitting = PRESETS.into_iter().filter(fits);
        fitting.next().filter(|_| fitting.next().is_none())
    }

    /// Returns the map for these files as TOML.
    ///
    /// # Errors
    /// [`InputError`] when a file is not a table of text.
    pub fn map(self, files: &[(&Path, &[u8])]) -> Result<String, InputError> {
        let (map, _) = self.resolved(files)?;
        Ok(format!("# {}: {}\n{map}", self.name, self.about()))
    }

    fn table(self) -> Toml {
        // The tests read every preset.
        self.text.parse().unwrap_or_default()
    }

    /// Returns the map with the detected layout, and the header of the last file.
    fn resolved(self, files: &[(&Path, &[u8])]) -> Result<(Toml, Vec<String>), InputError> {
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
        for (key, (path, bytes)) in ["file", "joints_file"].into_iter().zip(files) {
            let stated = map.remove(key).unwrap_or(Value::Table(Toml::new()));
            let mut layout: Layout = stated.try_into().unwrap_or_default();
            detect(&mut layout, path, bytes)?;
            let table = Table::parse(path, bytes, &layout)?;
            header = table.header.map_or_else(Vec::new, |line| line.fields);
            let bare: Vec<String> = header
                .iter()
                .map(|name| heading(name).0.to_owned())
                .collect();
            header.extend(bare);
            map.extend(
                Toml::try_from(&layout)
                    .ok()
                    .map(|l| (key.to_owned(), l.into())),
            );
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
        Ok((map, header))
    }
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

/// Detects encoding, separator and decimal mark: the combination with the most rows of equal width, and among those the
/// one with the most numbers.
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
        for decimal in [Decimal::Point, Decimal::Comma] {
            if (separator, decimal) == (Separator::Comma, Decimal::Comma) {
                continue;
            }
            let tried = Layout {
                separator,
                decimal,
                ..layout.clone()
            };
            let rows: Vec<_> = lines
                .iter()
                .filter_map(|line| fields(path, 0, line, &tried).ok())
                .collect();
            let Some(width) = rows.last().map(Vec::len).filter(|width| *width > 1) else {
                continue;
            };
            let rows = rows.iter().filter(|row| row.len() == width);
            let numbers = rows
                .flatten()
                .filter(|field| is_number(field, decimal))
                .count();
            if numbers > best {
                best = numbers;
                (layout.separator, layout.decimal) = (separator, decimal);
            }
        }
    }
    Ok(())
}
