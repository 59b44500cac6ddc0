//! The plan to measure: a plan of `trainer plan`, of touches or of poses for a tracker, and how its rows are read.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use poegp_calibration::input_error::InputError;
use poegp_calibration::measurement;
use poegp_calibration::measurement::folds::same_configurations;
use poegp_calibration::measurement::joint_targets::read_targets;
use poegp_calibration::measurement::sample::samples;
use poegp_calibration::measurement::touch::TouchRow;
use poegp_calibration::measurement::touch::{
    FeatureKind, TouchSet, features_beside, is_touch_file,
};
use poegp_calibration::model::Method;
use poegp_calibration::planning::candidates::decimals;
use poegp_calibration::planning::constraints::Constraints;
use poegp_calibration::planning::next::Chooser;
use poegp_calibration::robot::{ClassPrior, in_file_units};
use poegp_calibration::trust::{self, Tier};
use poegp_calibration::validation::model_selection::{FEW_FACTOR, UNCERTAIN};

use crate::cli::failure::Failure;
use crate::cli::inputs::Arm;
use crate::cli::measure::journal::first_line;
use crate::cli::terminal::print::note;

/// A plan of rows to measure.
pub struct Planned {
    /// Rows of the plan, with the readings that the nominal arm would give.
    pub set: TouchSet,
    /// Columns of a new measurement file, unless the measured rows have others.
    pub header: String,
    features: Option<(PathBuf, Vec<u8>)>,
}

impl Planned {
    /// Reads a plan, and for touches the description of the features.
    ///
    /// # Errors
    /// [`InputError`] with file, line and column.
    pub fn read(
        path: &Path,
        features: Option<&Path>,
        positions: bool,
        arm: &Arm,
    ) -> Result<Self, Failure> {
        let wanted = "a plan of `trainer plan` (CSV)";
        let bytes =
            std::fs::read(path).map_err(|error| InputError::unreadable(path, &error, wanted))?;
        let text = String::from_utf8_lossy(&bytes);
        let header = first_line(&text).unwrap_or_default().to_owned();
        let planned = match features.is_some() || is_touch_file(path) {
            true if positions => {
                let text =
                    "--positions: found a plan of touches, expected one of poses for a tracker";
                return Err(Failure::Usage(text.to_owned()));
            }
            true => Self::of_touches(path, &bytes, features, header, arm)?,
            false => Self::of_poses(path, positions, header, arm)?,
        };
        for text in &planned.set.notes {
            note(format_args!("{}: {text}", path.display()));
        }
        Ok(planned)
    }

    fn of_touches(
        path: &Path,
        bytes: &[u8],
        features: Option<&Path>,
        mut header: String,
        arm: &Arm,
    ) -> Result<Self, Failure> {
        let features = features.map_or_else(|| features_beside(path), Path::to_path_buf);
        let text = std::fs::read(&features).map_err(|error| {
            InputError::unreadable(&features, &error, "the features of the plan (TOML)")
                .with_help("name the file of the features with --features FILE")
        })?;
        let set = TouchSet::parse_plan((path, bytes), (&features, &text), &arm.robot)?;
        let has = |name: &str| header.split(',').any(|column| column.trim() == name);
        let of_kind = |is: fn(&FeatureKind) -> bool| set.features.iter().any(|f| is(&f.kind));
        let mut added = String::new();
        if of_kind(|kind| matches!(kind, FeatureKind::Anchor { .. }))
            && !(has("value_mm") || has("value_m"))
        {
            added += ",value_mm";
        }
        if of_kind(|kind| matches!(kind, FeatureKind::Level { .. })) && !has("gx") {
            added += ",gx,gy,gz";
        }
        header += &added;
        Ok(Self {
            set,
            header,
            features: Some((features, text)),
        })
    }

    fn of_poses(
        path: &Path,
        positions: bool,
        mut header: String,
        arm: &Arm,
    ) -> Result<Self, Failure> {
        let (targets, notes) = read_targets(path, &arm.robot)?;
        let target = Constraints::none(&arm.robot)?.flange_from_target;
        let mut set = TouchSet::of_targets(path, targets, &arm.robot, &arm.nominal, &target);
        if positions {
            set = set.positions_alone();
        }
        set.notes = notes;
        let has = |name: &str| header.split(',').any(|column| column.trim() == name);
        if !(has("x_mm") || has("x_m")) {
            header += match positions {
                true => ",x_mm,y_mm,z_mm",
                false => ",x_mm,y_mm,z_mm,qw,qx,qy,qz",
            };
        }
        Ok(Self {
            set,
            header,
            features: None,
        })
    }

    /// Returns the path of the file that describes the features; `None` for poses of a tracker.
    pub fn features(&self) -> Option<&Path> {
        self.features.as_ref().map(|(path, _)| path.as_path())
    }

    /// Returns the chooser of the next row, before anything is measured.
    pub fn chooser(&self, arm: &Arm, gravity: Vector3<f64>, class: ClassPrior) -> Chooser<'_> {
        Chooser::new(&arm.robot, &arm.nominal, &self.set, gravity, class)
    }

    /// Returns the plan with no rows, as before the first measurement.
    pub fn without_rows(&self) -> TouchSet {
        let mut out = self.set.clone();
        out.rows.clear();
        out
    }

    /// Parses the rows that were measured so far.
    ///
    /// # Errors
    /// [`InputError`] about the first invalid row.
    pub fn so_far(&self, path: &Path, bytes: &[u8], arm: &Arm) -> Result<TouchSet, InputError> {
        match &self.features {
            Some((features, text)) => {
                TouchSet::parse_so_far((path, bytes), (features, text), &arm.robot)
            }
            None => {
                let set = measurement::parse(path, bytes)?;
                set.check(&arm.robot)?;
                TouchSet::of_poses(&set, &arm.robot)
            }
        }
    }

    /// Returns the number of rows below which an expected error may be far from the true one.
    pub fn uncertain_below(&self) -> usize {
        match self.features {
            Some(_) => 0,
            None => UNCERTAIN,
        }
    }

    /// Checks that the rows are enough for `calibrate`, and for an expected error to be relied on. Of a tracker's rows, those
    /// at the indices `without` do not count.
    ///
    /// # Errors
    /// [`InputError`] that says how many are needed.
    pub fn whole(
        &self,
        (path, bytes): (&Path, &[u8]),
        without: &[usize],
        arm: &Arm,
    ) -> Result<(), InputError> {
        let Some((features, text)) = &self.features else {
            let mut set = self.so_far(path, bytes, arm)?;
            let mut row = 0..;
            (set.rows).retain(|_| row.next().is_none_or(|row| !without.contains(&row)));
            let equations: usize = set.rows.iter().map(|row| row.reading.equations()).sum();
            let needed = 6 * Method::Elastic.min_poses(arm.robot.joints.len());
            if equations < needed {
                let found = format!("{equations} equations");
                return Err(InputError::new(path, found, format!("at least {needed}")));
            }
            let joints: Vec<&[f64]> = set.rows.iter().map(|row| row.joints.as_slice()).collect();
            let poses: BTreeSet<usize> = same_configurations(&joints, &arm.robot.kinds())
                .into_iter()
                .collect();
            if poses.len() < UNCERTAIN {
                let found = format!("fewer than {UNCERTAIN} different poses");
                let expected = format!(
                    "at least {UNCERTAIN}: with fewer, an expected error may be wrong by a factor of {FEW_FACTOR}"
                );
                return Err(InputError::new(path, found, expected));
            }
            return Ok(());
        };
        TouchSet::parse((path, bytes), (features, text), &arm.robot).map(|_| ())
    }

    /// Parses the touches as `calibrate` does; `None` if there are too few, and for rows of a tracker.
    pub fn complete(&self, (path, bytes): (&Path, &[u8]), arm: &Arm) -> Option<TouchSet> {
        let (features, text) = self.features.as_ref()?;
        TouchSet::parse((path, bytes), (features, text), &arm.robot).ok()
    }

    /// Returns why `calibrate` takes a tracker's rows for those of another robot; `None` if it does not.
    ///
    /// # Errors
    /// [`InputError`] about the first invalid row.
    pub fn refusal(
        &self,
        path: &Path,
        bytes: &[u8],
        arm: &Arm,
        gravity: Vector3<f64>,
    ) -> Result<Option<String>, InputError> {
        let text = String::from_utf8_lossy(bytes);
        let lines = text.lines().filter(|line| first_line(line).is_some());
        if self.features.is_some() || lines.count() < 2 {
            return Ok(None);
        }
        let set = measurement::parse(path, bytes)?;
        let samples = samples(&set, &arm.robot, &mut Vec::new())?;
        let found = trust::identify(&arm.robot, &set, &samples, gravity);
        Ok(found.of(Tier::Refused).next().map(|f| f.text.clone()))
    }

    /// Describes what to measure for a row: the feature, the joints in the units of files, the payload.
    pub fn asked(&self, row: &TouchRow, arm: &Arm) -> Asked {
        let joints = arm.robot.joints.iter().zip(&row.joints);
        let feature = row.reading.feature();
        Asked {
            line: row.line,
            feature: feature.map(|feature| self.set.features[feature].name.clone()),
            joints: joints
                .map(|(joint, q)| decimals(in_file_units(joint.kind, *q)))
                .collect(),
            payload_kg: row.payload_kg,
        }
    }
}

/// The row to measure next, as it is shown to the user.
pub struct Asked {
    /// Line of the row in the plan.
    pub line: usize,
    /// Feature to touch; `None` for a pose of a tracker.
    pub feature: Option<String>,
    /// Joint values in degrees or millimetres.
    pub joints: Vec<String>,
    /// Mass of the payload to mount, kg.
    pub payload_kg: Option<f64>,
}

impl Asked {
    /// Returns what identifies the row in the file of measured rows: a line alone is another row of another plan.
    pub fn name(&self) -> String {
        format!("line {} at {}", self.line, self.joints.join(","))
    }
}
