//! What columns are, from their names, and their units.

use crate::import::guess::column;
use crate::import::guess::layout::is_number;
use crate::import::map::{ColumnName, Decimal};
use crate::import::text::Table;

/// How an orientation seems to be written.
#[derive(Clone, Copy, Debug)]
pub enum Rotation {
    Quaternion {
        w_first: bool,
        sure: bool,
    },
    Euler {
        order: &'static str,
        axes: &'static str,
        check: &'static str,
    },
    Vector,
    Matrix,
}

impl Rotation {
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Quaternion { .. } => "quaternion",
            Self::Euler { .. } => "euler",
            Self::Vector => "rotation-vector",
            Self::Matrix => "matrix",
        }
    }
}

/// The columns of a table, by what they seem to be.
#[derive(Debug, Default)]
pub struct Columns {
    /// How each is called in a map.
    names: Vec<ColumnName>,
    /// The unit that its name or the second header line states.
    units: Vec<Option<&'static str>>,
    pub joints: Vec<usize>,
    pub position: Option<Vec<usize>>,
    pub rotation: Option<(Rotation, Vec<usize>)>,
    pub pose: Option<Vec<usize>>,
    pub payload: Option<(usize, &'static str)>,
    pub session: Option<usize>,
    pub target: Option<usize>,
    pub sigma_position: Option<(usize, &'static str)>,
    pub sigma_orientation: Option<(usize, &'static str)>,
    pub references: Vec<(Vec<usize>, &'static str)>,
    /// A name of a point or a pose.
    pub label: Option<usize>,
}

/// Beginnings of names of joints; q last, as q1 to q4 may be a quaternion.
const JOINTS: [&str; 9] = [
    "j", "a", "axis", "achse", "joint", "jnt", "rax", "theta", "q",
];
/// What stands before x, y, z of something else than a position.
const NO_POSITION: [&str; 8] = [
    "q",
    "quat",
    "quaternion",
    "orient",
    "r",
    "rot",
    "rv",
    "true",
];

impl Columns {
    /// What the columns of a table are; `hints` are names that a comment has.
    pub fn of(table: &Table, hints: &[String]) -> Self {
        let width = table.width();
        let given = |i: usize| match table.name(i) {
            "" => hints.get(i).map_or("", String::as_str),
            name => name,
        };
        let mut out = Self::default();
        let mut names = Vec::new();
        for i in 0..width {
            let (name, unit) = taken_apart(given(i));
            names.push(name);
            let below = table
                .units
                .get(i)
                .map(|text| text.trim_matches(['[', ']', '(', ')']));
            out.units.push(unit.or(below.and_then(unit_of)));
            let once = (0..width)
                .filter(|j| table.name(*j) == table.name(i))
                .count()
                == 1;
            out.names.push(match table.name(i) {
                "" => ColumnName::Number(i + 1),
                name if once => ColumnName::Name(name.to_owned()),
                _ => ColumnName::Number(i + 1),
            });
        }
        let at = |wanted: &str| names.iter().position(|name| name == wanted);
        let group = |wanted: &[String]| {
            wanted
                .iter()
                .map(|name| at(name))
                .collect::<Option<Vec<usize>>>()
        };

        let numbered = |stem: &str| {
            (1..=8)
                .map_while(|n| at(&format!("{stem}{n}")))
                .collect::<Vec<usize>>()
        };
        out.joints = JOINTS
            .iter()
            .map(|stem| numbered(stem))
            .fold(Vec::new(), |best, next| {
                if next.len() > best.len() { next } else { best }
            });
        let with = |before: &str, letters: &[&str]| -> Vec<String> {
            letters
                .iter()
                .map(|letter| format!("{before}{letter}"))
                .collect()
        };
        // The shortest stem: x, y, z before tcp_x, tcp_y, tcp_z.
        let stems = names.iter().filter_map(|name| name.strip_suffix('x'));
        let mut stems: Vec<&str> = stems
            .filter(|stem| !NO_POSITION.contains(stem) && !stem.starts_with("ref"))
            .collect();
        stems.sort_by_key(|stem| stem.chars().count());
        out.position = stems
            .iter()
            .find_map(|stem| group(&with(stem, &["x", "y", "z"])));
        out.pose = ["m", "t", "r", "h"]
            .iter()
            .find_map(|stem| matrix(&at, stem, 4));
        out.rotation = rotation(&names, &group, &with, &at, &out.joints);
        if out.pose.is_some() {
            out.rotation = None;
        }
        for (name, unit) in names.iter().zip(&out.units) {
            let index = at(name).unwrap_or(0);
            match name.as_str() {
                "payload" | "load" | "mass" | "last" | "masse" => {
                    out.payload = Some((index, unit.filter(|u| *u == "g").unwrap_or("kg")));
                }
                "session" | "setup" => out.session = Some(index),
                "target" | "reflector" | "smr" => out.target = Some(index),
                "sigma" | "uncertainty" => match unit {
                    Some("mrad" | "rad" | "deg") => {
                        out.sigma_orientation = Some((index, unit.unwrap_or("mrad")));
                    }
                    _ => out.sigma_position = Some((index, unit.unwrap_or("mm"))),
                },
                "pose" | "posename" | "pointname" | "name" | "id" | "punkt" | "nr" | "no" => {
                    out.label = out.label.or(Some(index));
                }
                "point" if out.label.is_none() => out.label = Some(index),
                _ => {}
            }
        }
        out.references = (1..=9)
            .map_while(|k| group(&with(&format!("ref{k}"), &["x", "y", "z"])))
            .map(|point| {
                let unit = out.units[point[0]].unwrap_or("mm");
                (point, unit)
            })
            .collect();
        out.by_contents(table);
        out
    }

    /// What names do not say: a column of texts is a label, and without any names four numbers of norm 1 are a quaternion
    /// behind a position behind the joints.
    fn by_contents(&mut self, table: &Table) {
        let is_text = |i: usize| {
            table.rows.iter().all(|row| {
                row.cells
                    .get(i)
                    .is_some_and(|cell| !cell.is_empty() && !is_number(cell, table.decimal))
            })
        };
        let width = table.width();
        let texts: Vec<usize> = (0..width)
            .filter(|i| is_text(*i) && ![self.session, self.target].contains(&Some(*i)))
            .collect();
        let nameless = self
            .names
            .iter()
            .all(|name| matches!(name, ColumnName::Number(_)));
        let unknown = self.joints.is_empty() && self.position.is_none();
        // A list of points: SpatialAnalyzer's collection, group and target, or one name, and x, y, z.
        if nameless && unknown && !texts.is_empty() && width == texts.len() + 3 {
            self.position = Some((0..width).filter(|i| !texts.contains(i)).collect());
            if let [.., pose, target] = texts.as_slice() {
                (self.label, self.target) = (Some(*pose), Some(*target));
            } else {
                self.label = texts.first().copied();
            }
            return;
        }
        self.label = self.label.or(texts.first().copied());
        if self.rotation.is_some() || self.pose.is_some() {
            return;
        }
        let norm = |row: &[String], start: usize| -> f64 {
            row[start..start + 4]
                .iter()
                .map(|cell| number(cell, table.decimal).powi(2))
                .sum::<f64>()
        };
        let taken = |i: usize| {
            self.joints.contains(&i) || self.position.as_ref().is_some_and(|p| p.contains(&i))
        };
        let start = (0..=width.saturating_sub(4)).find(|start| {
            width >= 4
                && !(*start..start + 4).any(taken)
                && table
                    .rows
                    .iter()
                    .all(|row| (norm(&row.cells, *start) - 1.0).abs() < 2e-3)
        });
        let Some(start) = start else { return };
        let last = self.names.get(start + 3);
        let w_last =
            matches!(last, Some(ColumnName::Name(name)) if taken_apart(name).0.ends_with('w'));
        self.rotation = Some((
            Rotation::Quaternion {
                w_first: !w_last,
                sure: false,
            },
            (start..start + 4).collect(),
        ));
        let first = usize::from(self.label == Some(0));
        if nameless && unknown && start >= first + 4 {
            self.position = Some((start - 3..start).collect());
            self.joints = (first..start - 3).take(8).collect();
        }
    }

    /// A column as a map names it.
    pub fn text(&self, index: usize) -> String {
        column(&self.names[index])
    }

    /// A list of columns.
    pub fn list(&self, columns: &[usize]) -> String {
        let texts: Vec<String> = columns.iter().map(|index| self.text(*index)).collect();
        format!("[{}]", texts.join(", "))
    }

    /// The unit of lengths, and a comment when it was judged by their size.
    pub fn length_unit(&self, table: &Table, columns: &[usize]) -> (&'static str, &'static str) {
        match self.units[columns[0]] {
            Some(unit @ ("mm" | "m" | "um")) => (unit, ""),
            _ if largest(table, columns) > 20.0 => ("mm", "   # check: by the size of the numbers"),
            _ => ("m", "   # check: by the size of the numbers"),
        }
    }

    /// The unit of angles, likewise.
    pub fn angle_unit(&self, table: &Table, columns: &[usize]) -> (&'static str, &'static str) {
        match self.units[columns[0]] {
            Some(unit @ ("deg" | "rad" | "mrad" | "mm" | "m")) => (unit, ""),
            _ if largest(table, columns) > 2.0 * std::f64::consts::PI => {
                ("deg", "   # check: by the size of the numbers")
            }
            _ => ("rad", "   # check: by the size of the numbers"),
        }
    }
}

/// r11 … of a matrix with so many columns of three or four rows.
fn matrix(at: &dyn Fn(&str) -> Option<usize>, stem: &str, columns: usize) -> Option<Vec<usize>> {
    let rows = |rows: usize| {
        let places = (1..=rows).flat_map(|r| (1..=columns).map(move |c| (r, c)));
        places
            .map(|(r, c)| at(&format!("{stem}{r}{c}")))
            .collect::<Option<Vec<usize>>>()
    };
    if columns == 4 {
        rows(4).or_else(|| rows(3))
    } else {
        rows(3)
    }
}

fn rotation(
    names: &[String],
    group: &dyn Fn(&[String]) -> Option<Vec<usize>>,
    with: &dyn Fn(&str, &[&str]) -> Vec<String>,
    at: &dyn Fn(&str) -> Option<usize>,
    joints: &[usize],
) -> Option<(Rotation, Vec<usize>)> {
    for stem in ["q", "quat", "quaternion", "rot", "orient"] {
        if let Some(places) = group(&with(stem, &["w", "x", "y", "z"])) {
            // By name, so the order is sure; the file's own order of columns does not matter.
            return Some((
                Rotation::Quaternion {
                    w_first: true,
                    sure: true,
                },
                places,
            ));
        }
    }
    // ABB's q1 … q4 beside joints of another name.
    let abb: Vec<String> = (1..=4).map(|n| format!("q{n}")).collect();
    if let Some(places) = group(&abb)
        && !joints.contains(&places[0])
    {
        return Some((
            Rotation::Quaternion {
                w_first: true,
                sure: false,
            },
            places,
        ));
    }
    for stem in ["r", "m", "rot"] {
        if let Some(places) = matrix(at, stem, 3) {
            return Some((Rotation::Matrix, places));
        }
    }
    let known: [(&[&str], Rotation); 3] = [
        (
            &["a", "b", "c"],
            Rotation::Euler {
                order: "ZYX",
                axes: "intrinsic",
                check: "KUKA's A, B, C",
            },
        ),
        (
            &["roll", "pitch", "yaw"],
            Rotation::Euler {
                order: "XYZ",
                axes: "extrinsic",
                check: "roll, pitch, yaw about fixed axes",
            },
        ),
        (
            &["w", "p", "r"],
            Rotation::Euler {
                order: "XYZ",
                axes: "extrinsic",
                check: "FANUC's W, P, R",
            },
        ),
    ];
    for (letters, rotation) in known {
        if let Some(places) = group(&with("", letters)) {
            return Some((rotation, places));
        }
    }
    let places = ["r", "rot", "rv"]
        .iter()
        .find_map(|stem| group(&with(stem, &["x", "y", "z"])))?;
    let degrees = names
        .get(places[0])
        .is_some_and(|name| name.ends_with("deg"));
    Some(match degrees {
        true => (
            Rotation::Euler {
                order: "XYZ",
                axes: "extrinsic",
                check: "the order of rx, ry, rz",
            },
            places,
        ),
        false => (Rotation::Vector, places),
    })
}

/// What is between pose and target in the names of points: the mark that makes the fewest different targets, several of
/// them, in every name.
pub fn split(table: &Table, label: usize) -> Option<char> {
    let mut best: Option<(usize, char)> = None;
    for mark in ['_', '-', '.', '/', ':', ' '] {
        let names = table
            .rows
            .iter()
            .map(|row| row.cells.get(label).map_or("", String::as_str));
        let targets: Option<Vec<&str>> = names
            .map(|name| name.rsplit_once(mark).map(|(_, t)| t))
            .collect();
        let Some(mut targets) = targets else { continue };
        let all = targets.len();
        targets.sort_unstable();
        targets.dedup();
        if targets.len() < all && best.is_none_or(|(count, _)| targets.len() < count) {
            best = Some((targets.len(), mark));
        }
    }
    best.map(|(_, mark)| mark)
}

/// A name in lower case without marks, and the unit that it states.
fn taken_apart(name: &str) -> (String, Option<&'static str>) {
    let name = name.trim().to_lowercase();
    let (stem, stated) = match name.find(['[', '(', '<', '{']) {
        Some(start) => (
            &name[..start],
            name[start + 1..].trim_end_matches([']', ')', '>', '}']),
        ),
        None => match name.rsplit_once(['_', ' ', '.']) {
            Some((stem, unit)) if unit_of(unit).is_some() => (stem, unit),
            _ => (name.as_str(), ""),
        },
    };
    let plain: String = stem.chars().filter(|c| c.is_alphanumeric()).collect();
    (plain, unit_of(stated.trim()))
}

/// A unit by what people call it.
fn unit_of(text: &str) -> Option<&'static str> {
    Some(match text {
        "deg" | "°" | "grad" | "degree" | "degrees" => "deg",
        "rad" | "radian" | "radians" => "rad",
        "mrad" => "mrad",
        "mm" | "millimeter" | "millimetre" => "mm",
        "m" | "meter" | "metre" => "m",
        "um" | "µm" | "μm" => "um",
        "kg" => "kg",
        "g" => "g",
        _ => return None,
    })
}

fn number(cell: &str, decimal: Decimal) -> f64 {
    match decimal {
        Decimal::Point => cell.parse().unwrap_or(f64::NAN),
        Decimal::Comma => cell.replace(',', ".").parse().unwrap_or(f64::NAN),
    }
}

fn largest(table: &Table, columns: &[usize]) -> f64 {
    let cells = table
        .rows
        .iter()
        .flat_map(|row| columns.iter().filter_map(|i| row.cells.get(*i)));
    cells
        .map(|cell| number(cell, table.decimal).abs())
        .filter(|x| x.is_finite())
        .fold(0.0, f64::max)
}
