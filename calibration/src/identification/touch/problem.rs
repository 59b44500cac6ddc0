//! The problem of a fit to touches: states of the arm, tips, and the class of the arm.

use nalgebra::Vector3;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;

use crate::identification::base_tools::fit_base_and_tools;
use crate::identification::touch::arm::{Column, Group, Terms, TipStart, TouchArm};
use crate::identification::touch::noise::{Noise, TRACKER_NOISE};
use crate::identification::touch::sisters::SisterPrior;
use crate::measurement::observation::Observation;
use crate::measurement::sample::{Base, BaseSample, Instrument, InstrumentSample, Sample};
use crate::measurement::touch::{ClassPrior, Reading, TouchRow, TouchSet};
use crate::numeric::matrix::Mat;

/// Everything that a fit to touches starts from.
#[derive(Clone, Debug)]
pub struct TouchProblem<'a> {
    /// Rows, features and tips of the touch file.
    pub set: &'a TouchSet,
    /// Nominal chain, from base to flange.
    pub nominal: Poe<f64>,
    /// Joint coupling C of q_serial = C q.
    pub coupling: Option<Vec<Vec<f64>>>,
    /// Gravity in the base frame, m/s².
    pub gravity: Vector3<f64>,
    /// Class prior: how far an arm of the class is from its nominal model.
    pub class: ClassPrior,
    /// Prior by sister arms of the same nominal model.
    pub sisters: Option<SisterPrior>,
    /// Joint whose zero is not believed to be that of the class.
    pub lost_zero: Option<usize>,
    /// States of the arm: joints and payload, at rest with one tip.
    pub states: Vec<BaseSample>,
    /// Index into `states` of every row.
    pub state_of: Vec<usize>,
    /// For every state in which several readings share the errors of the joints, those of an image: how each joint moves the
    /// flange (6 × n: m and rad in the axes of the base).
    pub joint_motions: Vec<Option<Mat<f64>>>,
    /// Tips before the fit, followed by the flange.
    pub tips: Vec<TipStart>,
    /// instrument_from_base before the fit, if there are rows of a tracker.
    pub instrument: Option<Pose<f64>>,
}

impl<'a> TouchProblem<'a> {
    /// Creates the problem from the rows of `set`.
    pub fn new(
        set: &'a TouchSet,
        nominal: &Poe<f64>,
        coupling: Option<Vec<Vec<f64>>>,
        gravity: Vector3<f64>,
        class: ClassPrior,
    ) -> Self {
        let flange = set.tips.len();
        let mut states: Vec<BaseSample> = Vec::new();
        let mut seen: std::collections::HashMap<(Vec<u64>, Option<u64>, usize), usize> =
            std::collections::HashMap::new();
        let mut state_of = Vec::with_capacity(set.rows.len());
        for row in &set.rows {
            let tool = match row.reading {
                Reading::Level { .. } | Reading::Board { .. } => flange,
                _ => row.tip,
            };
            let bits = |x: f64| (x + 0.0).to_bits();
            let key = (
                row.joints.iter().map(|q| bits(*q)).collect(),
                row.payload_kg.map(bits),
                tool,
            );
            let state = *seen.entry(key).or_insert_with(|| {
                let unseen = Observation::Pose(Pose::identity());
                let mut sample =
                    Sample::new(row.joints.clone(), row.serial_joints.clone(), unseen, Base);
                (sample.payload_kg, sample.tool) = (row.payload_kg, tool);
                states.push(sample);
                states.len() - 1
            });
            state_of.push(state);
        }
        let mut tips: Vec<TipStart> = set
            .tips
            .iter()
            .map(|tip| TipStart {
                pose: Pose {
                    translation: tip.position,
                    ..Pose::identity()
                },
                is_free: true,
                turns: false,
            })
            .collect();
        let seen = set.rows.iter().filter_map(|row| match row.reading {
            Reading::Tracker(observation) => {
                let (joints, serial) = (row.joints.clone(), row.serial_joints.clone());
                let mut sample = Sample::new(joints, serial, observation, Instrument);
                sample.tool = row.tip;
                Some(sample)
            }
            _ => None,
        });
        let seen: Vec<InstrumentSample> = seen.collect();
        let instrument = (!seen.is_empty()).then(|| from_tracker(nominal, &seen, &mut tips));
        tips.push(TipStart {
            pose: Pose::identity(),
            is_free: false,
            turns: false,
        });
        let mut out = Self {
            set,
            nominal: *nominal,
            coupling,
            gravity,
            class,
            sisters: None,
            lost_zero: None,
            states,
            state_of,
            joint_motions: Vec::new(),
            tips,
            instrument,
        };
        out.joint_motions = out.motions_of_images();
        out
    }

    /// Returns the number of scalar equations.
    pub fn equations(&self) -> usize {
        self.set.rows.iter().map(|r| r.reading.equations()).sum()
    }

    fn payload_varies(&self) -> bool {
        let mut payloads = self.states.iter().map(|s| s.payload_kg);
        let first = payloads.next().flatten();
        first.is_some() && payloads.any(|p| p != first)
    }

    /// Returns the stated variance σ² of a component of a row.
    pub fn stated_variance(&self, row: usize, component: usize) -> f64 {
        let row = &self.set.rows[row];
        let sigma = match self.set.sigma(row) {
            Some(sigma) => sigma,
            None if component < 3 => row.declared_noise.position.unwrap_or(TRACKER_NOISE.0),
            None => row.declared_noise.orientation.unwrap_or(TRACKER_NOISE.1),
        };
        sigma * sigma
    }

    /// Returns whether a parameter is the zero that is not believed to be that of the class.
    pub fn is_lost(&self, column: &Column) -> bool {
        column.group == Group::Zero && self.lost_zero == Some(column.index)
    }

    /// Returns the root mean square of the stated noise of a kind; `None` if no row has it.
    pub fn stated_noise(&self, kind: Noise) -> Option<f64> {
        let rows = self.set.rows.iter().enumerate();
        let of_row = |(row, touch): (usize, &TouchRow)| {
            let own = 0..touch.reading.equations();
            let own = own.filter(move |i| Noise::of(&touch.reading, *i) == kind);
            own.map(move |i| self.stated_variance(row, i))
                .collect::<Vec<_>>()
        };
        let all: Vec<f64> = rows.flat_map(of_row).collect();
        let count = all.len() as f64;
        (!all.is_empty()).then(|| (all.iter().sum::<f64>() / count).sqrt())
    }

    /// Creates the nominal arm; `orders` is the number of orders of own-joint errors.
    pub fn arm(&self, orders: usize) -> TouchArm {
        self.arm_with(orders, false)
    }

    /// Creates the nominal arm, with its size as a parameter of its own.
    pub fn arm_of_any_size(&self) -> TouchArm {
        self.arm_with(0, true)
    }

    fn arm_with(&self, orders: usize, size: bool) -> TouchArm {
        let terms = Terms {
            gravity: true,
            payload: self.payload_varies(),
            orders,
            size,
        };
        TouchArm::new(
            &self.nominal,
            &self.tips,
            self.coupling.clone(),
            self.gravity,
            terms,
        )
    }
}

/// Estimates instrument_from_base and the tips that the tracker saw by a fit of its rows to the nominal model.
fn from_tracker(nominal: &Poe<f64>, seen: &[InstrumentSample], tips: &mut [TipStart]) -> Pose<f64> {
    let mut tools: Vec<usize> = seen.iter().map(|s| s.tool).collect();
    tools.sort_unstable();
    tools.dedup();
    let mut samples = seen.to_vec();
    for sample in &mut samples {
        sample.tool = tools.iter().position(|t| *t == sample.tool).unwrap_or(0);
    }
    let found = fit_base_and_tools(nominal, &samples);
    for (tool, target) in tools.iter().zip(&found.flange_from_targets) {
        let whole = seen
            .iter()
            .any(|s| s.tool == *tool && s.observation.has_orientation());
        let tip = &mut tips[*tool];
        tip.pose.translation = target.translation;
        if whole {
            (tip.pose, tip.turns) = (*target, true);
        }
    }
    found.instrument_from_base
}

/// Result of leaving out one state of the arm.
#[derive(Clone, Debug)]
pub struct LeftOut {
    /// Rows of that state.
    pub rows: Vec<usize>,
    /// Errors of each row's components as predicted from the others, in units of the reading.
    pub errors: Vec<Vec<f64>>,
    /// For each row, √(χ²/components) of its error under the predicted covariance.
    pub sigmas: Vec<f64>,
    /// Sum of 1 − h (h: leverage) over the components, for each kind of noise.
    pub(super) freedom: [f64; Noise::ALL.len()],
    /// Residuals of each row's components in the fit, without the error of the joints that the rows share.
    pub(super) within: Vec<Vec<f64>>,
    /// Sum of the squares of the shared errors of the joints, rad², and how many of them the rows determine.
    pub(super) shared: (f64, f64),
}
