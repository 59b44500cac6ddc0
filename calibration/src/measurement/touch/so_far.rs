//! A touch file that is still being written, and the plan that it follows.

use std::path::Path;

use nalgebra::Vector3;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;

use crate::input_error::InputError;
use crate::measurement::joint_targets::OwnTarget;
use crate::measurement::observation::{InstrumentNoise, Observation};
use crate::measurement::sample::{ToolName, samples};
use crate::measurement::set::MeasurementSet;
use crate::measurement::table::quoted;
use crate::measurement::touch::rows::TIP_ANYWHERE;
use crate::measurement::touch::set::{FeatureKind, Reading, Tip, TouchRow, TouchSet};
use crate::measurement::touch::{FEATURE, chain};
use crate::numeric::rotation::turn;
use crate::robot::Robot;

impl TouchSet {
    /// Reads the rows measured so far: like [`TouchSet::parse`], but without the checks that need a complete file.
    ///
    /// # Errors
    /// Returns an [`InputError`] about the first row that is invalid.
    pub fn parse_so_far(
        touches: (&Path, &[u8]),
        features: (&Path, &[u8]),
        robot: &Robot,
    ) -> Result<Self, InputError> {
        Ok(Self::parse_rows(touches, features, robot, false)?.0)
    }

    /// Reads a plan of touches. A reading that only the touch itself can supply may be empty; it is replaced by that of the
    /// nominal arm.
    ///
    /// # Errors
    /// Those of [`TouchSet::parse`], and an [`InputError`] for features whose reading cannot be predicted.
    pub fn parse_plan(
        (path, bytes): (&Path, &[u8]),
        features: (&Path, &[u8]),
        robot: &Robot,
    ) -> Result<Self, InputError> {
        let (mut out, _) = Self::parse_rows((path, bytes), features, robot, true)?;
        let chain = chain(path, robot)?;
        let mut rows = std::mem::take(&mut out.rows);
        for row in &mut rows {
            row.reading = out.foreseen(row, &chain)?;
        }
        out.rows = rows;
        out.check_touches(&chain)?;
        Ok(out)
    }

    /// Returns the reading that the nominal arm would give if the plan leaves it empty.
    fn foreseen(&self, row: &TouchRow, chain: &Poe<f64>) -> Result<Reading, InputError> {
        let flange = chain.forward(&row.serial_joints);
        let refused = |feature: usize, found: &str, expected: &str| {
            let name = quoted(&self.features[feature].name);
            Err(
                InputError::new(&self.path, format!("{name}, {found}"), expected)
                    .at_line(row.line)
                    .at_column(self.feature_column, FEATURE),
            )
        };
        Ok(match row.reading {
            Reading::Anchor {
                feature,
                value: 0.0,
            } => match self.features[feature].kind {
                FeatureKind::Anchor {
                    position: Some(at), ..
                } => Reading::Anchor {
                    feature,
                    value: (flange.transform_point(&self.tips[row.tip].position) - at).norm(),
                },
                _ => {
                    let expected = "position_mm of an anchor that is planned";
                    return refused(feature, "whose position is not stated", expected);
                }
            },
            Reading::Level { feature, gravity } if gravity == Vector3::zeros() => {
                let FeatureKind::Level { rotation, .. } = self.features[feature].kind else {
                    return Ok(row.reading);
                };
                let sensor_from_flange = turn(rotation);
                let down = flange.rotation.transpose() * -Vector3::z();
                Reading::Level {
                    feature,
                    gravity: sensor_from_flange.rotation * down,
                }
            }
            Reading::Board { feature, .. } => {
                let expected = "a point, a plane, a sphere, an anchor or a level";
                return refused(feature, "which is a board", expected);
            }
            reading => reading,
        })
    }

    /// Returns the set with only the features for which `keep` is true, their rows and the distances between them. A
    /// tracker's rows stay.
    #[must_use]
    pub fn with_features(&self, keep: &[bool]) -> Self {
        let new: Vec<usize> = keep
            .iter()
            .scan(0, |next, kept| {
                let index = *next;
                *next += usize::from(*kept);
                Some(index)
            })
            .collect();
        let moved = |row: &TouchRow| {
            let mut row = row.clone();
            match &mut row.reading {
                Reading::Tracker(_) => {}
                Reading::Point { feature }
                | Reading::Plane { feature, .. }
                | Reading::Sphere { feature, .. }
                | Reading::Anchor { feature, .. }
                | Reading::Level { feature, .. }
                | Reading::Board { feature, .. } => *feature = new[*feature],
            }
            row
        };
        let is_kept = |row: &&TouchRow| row.reading.feature().is_none_or(|f| keep[f]);
        let mut out = self.clone();
        out.rows = self.rows.iter().filter(is_kept).map(moved).collect();
        let mut kept = keep.iter();
        out.features.retain(|_| kept.next() == Some(&true));
        out.distances.retain(|d| d.between.iter().all(|f| keep[*f]));
        for distance in &mut out.distances {
            distance.between = distance.between.map(|f| new[f]);
        }
        out
    }

    /// Creates a set of a tracker's measurements, in which nothing was touched.
    ///
    /// # Errors
    /// Returns an [`InputError`] if there are more tools than a blob holds.
    pub fn of_poses(set: &MeasurementSet, robot: &Robot) -> Result<Self, InputError> {
        let mut names = Vec::new();
        let samples = samples(set, robot, &mut names)?;
        let row = |(sample, measured): (_, &crate::measurement::Measurement)| {
            let sample: crate::measurement::sample::InstrumentSample = sample;
            TouchRow {
                line: measured.line,
                joints: sample.joints,
                serial_joints: sample.serial_joints,
                payload_kg: sample.payload_kg,
                tip: sample.tool,
                reading: Reading::Tracker(sample.observation),
                declared_noise: sample.declared_noise,
            }
        };
        let tip = |name| Tip {
            name,
            position: Vector3::zeros(),
            sigma: TIP_ANYWHERE,
        };
        Ok(Self {
            path: set.path.clone(),
            features_path: set.path.clone(),
            feature_column: 0,
            joint_columns: set.joint_columns.clone(),
            rows: samples
                .into_iter()
                .zip(&set.measurements)
                .map(row)
                .collect(),
            features: Vec::new(),
            tips: names.into_iter().map(tip).collect(),
            distances: Vec::new(),
            prior: None,
            camera: None,
            notes: set.notes.clone(),
            sha256: [set.sha256, set.sha256],
        })
    }

    /// Creates a tracker's plan, with the poses that the target of the nominal arm would have.
    pub fn of_targets(
        path: &Path,
        targets: Vec<OwnTarget>,
        robot: &Robot,
        nominal: &Poe<f64>,
        flange_from_target: &Pose<f64>,
    ) -> Self {
        let row = |(line, joints, payload_kg): OwnTarget| {
            let serial_joints = robot.serial_joints(&joints);
            let pose = nominal.forward(&serial_joints) * *flange_from_target;
            TouchRow {
                line,
                serial_joints,
                joints,
                payload_kg,
                tip: 0,
                reading: Reading::Tracker(Observation::Pose(pose)),
                declared_noise: InstrumentNoise::UNKNOWN,
            }
        };
        Self {
            path: path.to_path_buf(),
            features_path: path.to_path_buf(),
            feature_column: 0,
            joint_columns: Vec::new(),
            rows: targets.into_iter().map(row).collect(),
            features: Vec::new(),
            tips: vec![Tip {
                name: ToolName::default(),
                position: flange_from_target.translation,
                sigma: TIP_ANYWHERE,
            }],
            distances: Vec::new(),
            prior: None,
            camera: None,
            notes: Vec::new(),
            sha256: [[0; 32]; 2],
        }
    }

    /// Returns the rows as a tracker would see them with a single reflector: positions only.
    #[must_use]
    pub fn positions_alone(mut self) -> Self {
        for row in &mut self.rows {
            if let Reading::Tracker(observation) = &mut row.reading {
                *observation = Observation::Position(observation.position());
            }
        }
        self
    }
}
