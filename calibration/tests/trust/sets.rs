//! Good sets: simulated ones from the repository and the simulator, and measured ones if they are available.

use std::path::{Path, PathBuf};

use nalgebra::{Matrix3, Matrix3x6, Matrix6, Vector6};
use poegp_calibration::identification::base_tools;
use poegp_calibration::measurement::sample::samples;
use poegp_calibration::measurement::{self, MeasurementSet};
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_calibration::simulation::{Scenario, Simulator, to_csv};
use poegp_calibration::trust::Cause;

use crate::table::Table;

/// Where the orientations of a set come from.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Orientations {
    /// The file has them.
    Measured,
    /// They were measured, but the file leaves them out.
    Hidden,
    /// They are the nominal arm's, and the file leaves them out.
    Computed,
}

/// A set without a mistake.
#[derive(Clone)]
pub struct Good {
    pub name: String,
    pub robot: Robot,
    /// The table always has orientations, even if the file leaves them out, since a mistake may need them.
    pub table: Table,
    pub orientations: Orientations,
    /// Scatter of one position component in mm that an elastic model leaves.
    pub scatter_mm: f64,
    /// Causes that are true of the set itself.
    pub exempt: Vec<Cause>,
}

impl Good {
    /// Returns the file that a table of this set becomes.
    pub fn text(&self, table: &Table) -> String {
        let mut table = table.clone();
        if self.positions_only() {
            table.positions_only();
        }
        table.text()
    }

    /// Returns whether the file has no orientations.
    pub fn positions_only(&self) -> bool {
        self.orientations != Orientations::Measured
    }

    /// Returns the sum of the links' lengths in metres.
    pub fn reach(&self) -> f64 {
        let lengths = self
            .robot
            .parent_from_joint
            .iter()
            .map(|f| f.translation.norm());
        lengths.sum()
    }

    pub fn is_simulated(&self) -> bool {
        !self.name.starts_with("measured")
    }

    /// Returns whether this is the set with one reflector over a narrow grid, where a model of the arm fits nearly
    /// anything.
    pub fn is_narrow(&self) -> bool {
        self.name.contains("motoman")
    }

    /// Returns the indices of the joints that move by more than three degrees.
    pub fn moving(&self) -> Vec<usize> {
        let columns = self.table.joints();
        let span = |c: usize| {
            let values = self.table.numbers(c);
            let (least, most) = extremes(&values);
            most - least
        };
        (0..columns.len())
            .filter(|j| span(columns[*j]) > 3.0)
            .collect()
    }

    /// Returns whether some point of the flange stays within a millimetre: positions around such a point fit any scale.
    pub fn turns_about_a_point(&self) -> bool {
        let chain = self.robot.chain().expect("a chain");
        let flange = |row: usize| {
            let joints = self.table.joints_rad(row);
            chain.forward(&self.robot.serial_joints(&joints))
        };
        // R p + t = c for a point p of the flange and a point c of the base.
        let (mut normal, mut right) = (Matrix6::zeros(), Vector6::zeros());
        for row in 0..self.table.len() {
            let f = flange(row);
            let mut a = Matrix3x6::zeros();
            a.fixed_columns_mut::<3>(0).copy_from(&f.rotation);
            a.fixed_columns_mut::<3>(3).copy_from(&-Matrix3::identity());
            normal += a.transpose() * a;
            right -= a.transpose() * f.translation;
        }
        normal += Matrix6::identity() * 1e-9;
        let Some(x) = normal.cholesky().map(|c| c.solve(&right)) else {
            return false;
        };
        let (p, c) = (x.fixed_rows::<3>(0), x.fixed_rows::<3>(3));
        (0..self.table.len()).all(|row| {
            let f = flange(row);
            (f.rotation * p + f.translation - c).norm() < 1e-3
        })
    }

    /// Returns the set reduced to these rows.
    pub fn of_rows(&self, rows: &[usize]) -> Self {
        Self {
            table: self.table.subset(rows),
            ..self.clone()
        }
    }

    /// Returns the set as it would have been measured with one reflector.
    pub fn with_positions_only(mut self) -> Self {
        self.name += "/positions";
        self.orientations = Orientations::Hidden;
        self
    }
}

/// Returns the minimum and maximum.
pub fn extremes(values: &[f64]) -> (f64, f64) {
    let least = values.iter().copied().fold(f64::INFINITY, f64::min);
    let most = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    (least, most)
}

pub fn robot(spec: &str) -> Robot {
    Robot::load(spec, &LoadOptions::default()).unwrap_or_else(|e| panic!("{e}"))
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

const SCENARIOS: [(&str, Scenario, f64); 4] = [
    ("paper", Scenario::Paper, 0.03),
    ("rich", Scenario::WithBacklash, 0.045),
    ("wild", Scenario::Nonlinear, 0.07),
    ("full", Scenario::PaperFullRange, 0.03),
];

/// Returns the simulated sets of the repository.
pub fn simulated_files() -> Vec<Good> {
    let robot = robot("abb-irb4400-serial");
    let set = |(name, _, scatter_mm): &(&str, Scenario, f64)| {
        let path = root().join(format!("tests/data/simulated/irb4400_{name}_s0_train.csv"));
        let text = std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{path:?}: {e}"));
        Good {
            name: format!("file/{name}"),
            robot: robot.clone(),
            table: Table::parse(&text),
            orientations: Orientations::Measured,
            scatter_mm: *scatter_mm,
            exempt: Vec::new(),
        }
    };
    SCENARIOS.iter().map(set).collect()
}

/// Returns a robot description in the repository that is not built in.
pub fn description(name: &str) -> String {
    let path = root().join("tests/data/robots").join(name);
    path.display().to_string()
}

/// Returns the folder of measured sets: `POEGP_MEASURED_DATA`, otherwise a folder beside the repository.
fn measured_folder() -> PathBuf {
    std::env::var_os("POEGP_MEASURED_DATA")
        .map_or_else(|| root().join("../shared/data/real"), PathBuf::from)
}

/// Returns a description that comes with the measured sets, if it is available.
pub fn model(name: &str) -> Option<String> {
    let folder = measured_folder();
    let paths = [folder.join(name), folder.join("../models").join(name)];
    let found = paths.iter().find(|p| p.is_file());
    found.map(|p| p.display().to_string())
}

/// Returns a simulated set; `spec` is a robot by name or path, `scenario` an index into all scenarios.
pub fn simulated(spec: &str, scenario: usize, seed: u64, rows: usize) -> Good {
    let robot = robot(spec);
    let (name, scenario, scatter_mm) = SCENARIOS[scenario];
    let payloads: &[f64] = match spec {
        "abb-irb120" => &[0.5, 1.0, 2.0, 3.0],
        "kuka-iiwa7" | "ur5" => &[1.0, 2.0, 3.0, 5.0],
        _ => &[1.0, 2.5, 3.5, 5.0, 7.5],
    };
    let poses = Simulator::new(&robot, scenario, payloads, seed).measure(rows);
    let spec = Path::new(spec).file_stem().unwrap_or_default();
    Good {
        name: format!("{}/{name}", spec.display()),
        table: Table::parse(&to_csv(&robot, &poses, false, name)),
        robot,
        orientations: Orientations::Measured,
        scatter_mm,
        exempt: Vec::new(),
    }
}

/// Measured sets: file, robot, scatter in mm.
const MEASURED: [(&str, &str, f64); 5] = [
    ("abb_irb120_faro_700", "abb-irb120", 0.05),
    ("kuka_iiwa7_304", "kuka-iiwa7", 0.17),
    ("kuka_iiwa7_payload_0_and_2500g", "kuka-iiwa7", 0.2),
    (
        "motoman_right_position_only",
        "motoman_ma1400_right.urdf",
        0.05,
    ),
    ("ur10_tmac_b", "ur10", 0.25),
];

/// Returns the measured sets that are available, and the names of the others.
pub fn measured() -> (Vec<Good>, Vec<String>) {
    let folder = measured_folder();
    let (mut sets, mut missing) = (Vec::new(), Vec::new());
    for (name, spec, scatter_mm) in MEASURED {
        let spec = model(spec).unwrap_or_else(|| spec.to_owned());
        let path = folder.join(format!("{name}.csv"));
        let Ok(text) = std::fs::read_to_string(&path) else {
            missing.push(name.to_owned());
            continue;
        };
        let robot = robot(&spec);
        let mut table = Table::parse(&text);
        let orientations = if table.orientation().is_none() {
            add_orientations(&mut table, &robot);
            Orientations::Computed
        } else {
            Orientations::Measured
        };
        let still = name.starts_with("motoman") || name.contains("payload");
        sets.push(Good {
            name: format!("measured/{name}"),
            robot,
            table,
            orientations,
            scatter_mm,
            exempt: if still {
                vec![Cause::Still]
            } else {
                Vec::new()
            },
        });
    }
    (sets, missing)
}

/// Reads a text as the program does.
pub fn read(
    robot: &Robot,
    text: &str,
) -> Result<MeasurementSet, Box<poegp_calibration::input_error::InputError>> {
    let set = measurement::parse("measurements.csv", text.as_bytes())?;
    set.check(robot)?;
    Ok(set)
}

/// Adds the nominal arm's orientations, with base and tool fitted, to a set with positions only.
fn add_orientations(table: &mut Table, robot: &Robot) {
    let set = read(robot, &table.text()).unwrap_or_else(|e| panic!("{e}"));
    let samples = samples(&set, robot, &mut Vec::new()).unwrap_or_else(|e| panic!("{e}"));
    let chain = robot.chain().expect("a chain");
    let ends = base_tools::fit_base_and_tools(&chain, &samples);
    for name in ["qw", "qx", "qy", "qz"] {
        table.add_column(name, "1");
    }
    let columns = table.orientation().expect("just added");
    for (row, sample) in samples.iter().enumerate() {
        let pose = ends.instrument_from_base
            * chain.forward(&sample.serial_joints)
            * ends.flange_from_targets[sample.tool];
        let (w, v) = pose.quaternion();
        for (column, value) in columns.into_iter().zip([w, v[0], v[1], v[2]]) {
            table.write(row, column, value, 9);
        }
    }
}
