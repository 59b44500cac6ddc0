//! Folders of socket touches as MUKCa records them: PLACE/hole_0.csv, PLACE/hole_1.csv …, with the joints of one touch in each
//! row, in radians, base first, without a header.
//!
//! Each file is one socket, so the folders become a touch file with the features PLACE/0, PLACE/1 … and its description. The
//! distance between the first two sockets of every site is that of the printed base, where it is stated.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use crate::import::write::quoted;
use poegp_calibration::input_error::InputError;

/// What messages call the expected folder.
const WHOLE: &str = "a folder with hole_0.csv …, or with folders of such files";
/// Largest number of files of a site, each numbered by one digit.
const MOST_HOLES: usize = 10;
/// Largest angle of a joint, in rad: larger numbers are taken for degrees.
const FARTHEST: f64 = 4.0 * std::f64::consts::PI;

/// Touches read from folders.
#[derive(Debug)]
pub struct Sockets {
    /// The touch file.
    pub csv: String,
    /// The description of its features.
    pub toml: String,
    /// The features with their numbers of rows.
    pub features: Vec<(String, usize)>,
}

/// One socket of a site.
struct Hole {
    feature: String,
    rows: Vec<Vec<String>>,
}

/// Reads `folder`: one site with its files, or a folder of sites. `distance_mm` is the distance between hole 0 and hole 1
/// of each site.
///
/// # Errors
/// [`InputError`] names file, line and column of the first thing that is not as it should be.
pub fn read(folder: &Path, distance_mm: Option<f64>) -> Result<Sockets, InputError> {
    let mut holes = Vec::new();
    for site in sites(folder)? {
        let name = site.file_name().map_or_else(
            || "place".to_owned(),
            |name| name.to_string_lossy().into_owned(),
        );
        for number in 0..MOST_HOLES {
            let file = site.join(format!("hole_{number}.csv"));
            if file.is_file() {
                holes.push(Hole {
                    feature: format!("{name}/{number}"),
                    rows: rows(&file, holes.first())?,
                });
            }
        }
    }
    let Some(first) = holes.first() else {
        return Err(InputError::new(folder, "no hole_0.csv", WHOLE));
    };
    let joints = first.rows[0].len();
    let names: Vec<String> = (1..=joints).map(|i| format!("q{i}_rad")).collect();
    let mut csv = format!("# imported socket touches\nfeature,{}\n", names.join(","));
    for hole in &holes {
        for row in &hole.rows {
            let name = quoted(&hole.feature);
            let _: std::fmt::Result = writeln!(csv, "{name},{}", row.join(","));
        }
    }
    Ok(Sockets {
        csv,
        toml: description(&holes, distance_mm),
        features: holes
            .into_iter()
            .map(|hole| (hole.feature, hole.rows.len()))
            .collect(),
    })
}

/// Returns the folder itself where it has a file of touches, else its subfolders that have one, by name.
fn sites(folder: &Path) -> Result<Vec<PathBuf>, InputError> {
    let has_touches = |folder: &Path| folder.join("hole_0.csv").is_file();
    if has_touches(folder) {
        return Ok(vec![
            folder
                .canonicalize()
                .unwrap_or_else(|_| folder.to_path_buf()),
        ]);
    }
    let unreadable = |error: &std::io::Error| InputError::unreadable(folder, error, WHOLE);
    let mut out = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(|error| unreadable(&error))? {
        let path = entry.map_err(|error| unreadable(&error))?.path();
        let is_site = (0..MOST_HOLES).any(|n| path.join(format!("hole_{n}.csv")).is_file());
        if is_site {
            out.push(path);
        }
    }
    out.sort();
    Ok(out)
}

/// Returns the touches of a file, with their digits unchanged. Refuses another number of joints than in `before`.
fn rows(file: &Path, before: Option<&Hole>) -> Result<Vec<Vec<String>>, InputError> {
    let text = std::fs::read_to_string(file)
        .map_err(|error| InputError::unreadable(file, &error, "the joints of one touch per row"))?;
    let mut out: Vec<Vec<String>> = Vec::new();
    for (number, line) in (1..).zip(text.lines()) {
        if line.trim().is_empty() {
            continue;
        }
        let fields: Vec<String> = line
            .split(',')
            .map(|field| field.trim().to_owned())
            .collect();
        for (column, field) in (1..).zip(&fields) {
            let found = || format!("{field:?}");
            let error = |found: String, expected: &str| {
                InputError::new(file, found, expected)
                    .at_line(number)
                    .at_column(column, format!("q{column}_rad"))
            };
            match field.parse::<f64>() {
                Ok(angle) if angle.abs() <= FARTHEST => {}
                Ok(_) => {
                    return Err(error(found(), "a joint in radians")
                        .with_help("are these degrees? Such a file has radians and no header"));
                }
                Err(_) => return Err(error(found(), "a joint in radians, and no header")),
            }
        }
        let first = out
            .first()
            .or_else(|| before.and_then(|hole| hole.rows.first()));
        if let Some(first) = first
            && first.len() != fields.len()
        {
            let found = format!("a row of {} joints", fields.len());
            let expected = format!("{}, as in the rows before", first.len());
            return Err(InputError::new(file, found, expected).at_line(number));
        }
        out.push(fields);
    }
    match out.is_empty() {
        true => Err(InputError::new(
            file,
            "an empty file",
            "the joints of one touch per row",
        )),
        false => Ok(out),
    }
}

/// Returns the description of the features, with the length of the printed base.
fn description(holes: &[Hole], distance_mm: Option<f64>) -> String {
    let mut out = "version = 1\n\n[noise]\ntouch_mm = 0.05\n\n\
                   # Where the ball is in the flange frame, nominal: the better it is known, the fewer touches are needed.\n\
                   [[target]]\nname = \"tip\"\ntip_mm = [0, 0, 0]\nsigma_mm = 200\n"
        .to_owned();
    let text = |text: &str| format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\""));
    for hole in holes {
        let name = text(&hole.feature);
        out += &format!("\n[[feature]]\nname = {name}\nkind = \"point\"\n");
    }
    if let Some(mm) = distance_mm {
        for hole in holes {
            let Some(site) = hole.feature.strip_suffix("/0") else {
                continue;
            };
            let other = format!("{site}/1");
            if holes.iter().any(|hole| hole.feature == other) {
                out += &format!(
                    "\n[[distance]]\nbetween = [{}, {}]\nmm = {mm}\nsigma_mm = 0.05\n",
                    text(&hole.feature),
                    text(&other)
                );
            }
        }
    }
    out
}
