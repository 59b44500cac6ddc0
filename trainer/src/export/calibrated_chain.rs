//! The calibrated chain of a blob in `f64`, with what is known about it.

use poegp_protocol::JointKind;
use poegp_protocol::blob::{Correction, Elastic, FrameSource};
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;

use poegp_calibration::blob::nearest_chain::NearestChain;
use poegp_calibration::blob::predict::{BlobModel, rigid_poses};
use poegp_calibration::blob::predicted_poses::PredictedPoses;
use poegp_calibration::blob::region::Region;
use poegp_calibration::numeric::statistics::ErrorSummary;
use poegp_calibration::robot::{BUILT_IN, Joint, LoadOptions, Robot};

/// Largest distance between two descriptions of one nominal arm, in metres. Exports do not depend on it: the nominal arm
/// only determines where links are drawn.
const SAME_ARM_M: f64 = 1e-3;
/// Largest rotation between two descriptions of one nominal arm, in radians.
const SAME_ARM_RAD: f64 = 1e-3;

/// What a file of links and joints leaves out where joints are coupled, as part of a sentence.
pub const COUPLING: &str =
    "the coupling of the joints: joint values are those of the chain, q_serial = C q";

/// Why the frames of a loaded blob always form a chain, as a message of `expect`.
const HAS_JOINTS: &str = "a blob that loads has 1 to 8 joints and a frame more";

/// Distances of the chain and of the nominal model from the predictions of the whole model, at poses to which nothing was
/// fitted.
#[derive(Clone, Debug)]
pub struct Distance {
    /// Region that contains the poses.
    pub region: Region,
    /// Distance of the chain from the predictions.
    pub chain: ErrorSummary,
    /// Distance of the nominal model, with the model's base and tool, from the predictions.
    pub nominal: ErrorSummary,
}

/// The calibrated chain of a blob, without its correction.
///
/// A blob without correction is its chain. For any other blob, the frames are fitted again to the poses of the whole model.
///
/// The frames of a blob are `f32`, so their rotations are orthonormal to about seven digits only. This chain has the nearest
/// rotations in `f64`, and every export gives the poses of these frames. A device that evaluates a blob without correction
/// in `f32` differs from them by tenths of a micrometre.
#[derive(Clone, Debug)]
pub struct CalibratedChain {
    /// Name of the robot.
    pub name: String,
    /// Lines on the origin of the calibration, for comments.
    pub provenance: Vec<String>,
    /// Joints, base first; their names are made up where the robot is not a built-in one.
    pub joints: Vec<Joint>,
    /// Calibrated frames `parent_from_joint`, n + 1, in metres; the last leads to the target of the first tool.
    pub frames: Vec<Pose<f64>>,
    /// Nominal frames `parent_from_joint`, in the order of `frames`.
    pub nominal: Vec<Pose<f64>>,
    /// `flange_from_target`, which defines the flange of the calibrated arm.
    pub flange_from_target: Pose<f64>,
    /// `instrument_from_base`.
    pub instrument_from_base: Pose<f64>,
    /// C of q_serial = C q, by rows; `None` is the identity.
    pub coupling: Option<Vec<Vec<f64>>>,
    /// Fit of the frames to the poses of the model; `None` for a blob without correction.
    pub fit: Option<NearestChain>,
    /// Distances of chain and nominal model from the model.
    pub distance: Distance,
    /// Parts of the model that no chain can hold, each as part of a sentence. The coupling is not among them, because tables
    /// state it.
    pub not_carried: Vec<String>,
    /// Names of the tools after the first.
    pub other_tools: Vec<String>,
    /// Source of the target's frame on the flange.
    pub tool: FrameSource,
}

impl CalibratedChain {
    /// Returns the chain of a blob for its whole trained region.
    pub fn of(loaded: &BlobModel) -> Self {
        let region = Region::trained(loaded.blob());
        Self::nearest(loaded, &PredictedPoses::new(loaded, region))
    }

    /// Returns the chain that is nearest to the predictions of a blob over a region.
    pub fn nearest(loaded: &BlobModel, predicted: &PredictedPoses) -> Self {
        let blob = loaded.blob();
        let unnamed = blob
            .robot
            .joints
            .iter()
            .enumerate()
            .map(|(i, joint)| Joint {
                name: format!("joint_{}", i + 1),
                kind: joint.kind,
                limits: joint
                    .limits
                    .map(|(lower, upper)| (decimal(lower), decimal(upper))),
                gear_lines: Vec::new(),
                link_radius: None,
            });
        let frames = rigid_poses(&blob.geometry.calibrated);
        let nominal = rigid_poses(&blob.geometry.nominal);
        let kinds = loaded.kinds();
        let poe = |frames: &[Pose<f64>]| Poe::new(&kinds, frames).expect(HAS_JOINTS);
        let not_carried = not_carried(&blob.correction);
        let fit = (!not_carried.is_empty()).then(|| NearestChain::new(predicted, &poe(&frames)));
        let own = match &fit {
            Some(fit) => fit.after.clone(),
            None => predicted.distances(&poe(&frames)),
        };
        let distance = Distance {
            region: predicted.region.clone(),
            chain: own,
            nominal: predicted.distances(&poe(&nominal)),
        };
        let serial = match blob.robot.serial_number {
            "" => String::new(),
            number => format!(", serial number {number}"),
        };
        let host = loaded.host();
        let p = &host.provenance;
        let tools = loaded.tools().iter().skip(1);
        let mut chain = Self {
            name: blob.robot.name.to_owned(),
            provenance: vec![
                format!(
                    "{}{serial}: calibrated chain of model `{}`",
                    blob.robot.name, p.method
                ),
                format!(
                    "calibrated {} by trainer {} on {} poses, data SHA-256 {}",
                    p.date,
                    p.trainer_version,
                    p.training_poses,
                    p.data_sha256
                        .iter()
                        .map(|b| format!("{b:02x}"))
                        .collect::<String>()
                ),
            ],
            joints: unnamed.collect(),
            frames: match &fit {
                Some(fit) => fit.chain.frames().to_vec(),
                None => frames,
            },
            nominal,
            flange_from_target: Pose::from_rows(&host.gauge.flange_from_target),
            instrument_from_base: loaded.instrument_from_base(),
            coupling: loaded.coupling(),
            fit,
            distance,
            not_carried,
            other_tools: tools.map(|(name, _)| name.to_string()).collect(),
            tool: host.gauge.tool,
        };
        if let Some(robot) = chain.built_in() {
            chain.joints = robot.joints;
        }
        chain
    }

    /// Returns the calibrated chain from base to target, as the runtime evaluates it.
    pub fn poe(&self) -> Poe<f64> {
        chain_of(&self.joints, &self.frames)
    }

    /// Returns the nominal chain from base to target.
    pub fn nominal_arm(&self) -> Poe<f64> {
        chain_of(&self.joints, &self.nominal)
    }

    /// Returns what a file of links and joints leaves out of the model, each as part of a sentence.
    pub fn not_in_links(&self) -> Vec<String> {
        let mut out = self.not_carried.clone();
        out.extend(self.coupling.is_some().then(|| COUPLING.to_owned()));
        out
    }

    /// Returns what a new file of links and joints leaves out of the model: also limits, which a nominal URDF keeps.
    pub fn not_in_new_links(&self) -> Vec<String> {
        let mut out = self.not_in_links();
        out.extend(self.limits_left_out());
        out
    }

    /// Says which limits no file of links and joints can hold, as part of a sentence.
    pub fn limits_left_out(&self) -> Option<String> {
        let indexed = self.joints.iter().enumerate();
        let names: Vec<&str> = indexed
            .filter(|(i, joint)| joint.limits.is_some() && self.limits(*i).is_none())
            .map(|(_, joint)| joint.name.as_str())
            .collect();
        let names = names.join(", ");
        (!names.is_empty()).then(|| {
            format!("the limits of joints that several joints of the controller move ({names})")
        })
    }

    /// Returns the limits of joint `i` of the chain, in rad or m: those of the joint of the controller that moves it, times
    /// its element of the coupling. Returns `None` for a joint that several joints of the controller move.
    pub fn limits(&self, i: usize) -> Option<(f64, f64)> {
        let Some(rows) = &self.coupling else {
            return self.joints[i].limits;
        };
        let mut moved_by = rows[i].iter().enumerate().filter(|(_, c)| **c != 0.0);
        let (j, c) = moved_by.next()?;
        if moved_by.next().is_some() {
            return None;
        }
        let (lower, upper) = self.joints[j].limits?;
        let (a, b) = (c * lower, c * upper);
        Some((a.min(b), a.max(b)))
    }

    /// Returns the calibrated fixed frames from base to flange.
    pub fn to_flange(&self) -> Vec<Pose<f64>> {
        shortened(&self.frames, &self.flange_from_target)
    }

    /// Returns the nominal fixed frames from base to flange.
    pub fn nominal_to_flange(&self) -> Vec<Pose<f64>> {
        shortened(&self.nominal, &self.flange_from_target)
    }

    /// Compares the nominal arm with another description of an arm: returns the largest distance of the flanges in metres
    /// and in radians, and whether both are the same arm. The joint values are within ±1.5 and move every joint. Returns
    /// `None` where the joints differ in number or kind.
    pub fn distance_to(&self, robot: &Robot) -> Option<(f64, f64, bool)> {
        let same_kinds = robot.joints.len() == self.joints.len()
            && robot
                .joints
                .iter()
                .zip(&self.joints)
                .all(|(a, b)| a.kind == b.kind);
        if !same_kinds {
            return None;
        }
        let (ours, theirs) = (
            chain_of(&self.joints, &self.nominal_to_flange()),
            chain_of(&robot.joints, &robot.parent_from_joint),
        );
        let (mut apart, mut turned) = (0.0_f64, 0.0_f64);
        for k in 0..8 {
            let q: Vec<f64> = (0..self.joints.len())
                .map(|i| 1.5 * (1.7 * f64::from(k) + 2.3 * i as f64 * f64::from(k.min(1))).sin())
                .collect();
            let (a, b) = (ours.forward(&q), theirs.forward(&q));
            apart = apart.max((a.translation - b.translation).norm());
            let between = (a.inverse() * b).log().angular;
            turned = turned.max(between.norm());
        }
        Some((apart, turned, apart <= SAME_ARM_M && turned <= SAME_ARM_RAD))
    }

    /// Returns the built-in robot that this arm is, which has the names of the joints.
    fn built_in(&self) -> Option<Robot> {
        let name = BUILT_IN.iter().find(|name| **name == self.name)?;
        let robot = Robot::load(name, &LoadOptions::default()).ok()?;
        self.distance_to(&robot)
            .is_some_and(|(_, _, same)| same)
            .then_some(robot)
    }
}

/// Returns the parts of a model that no chain can hold.
fn not_carried(correction: &Correction<'_>) -> Vec<String> {
    let out: Vec<&str> = match correction {
        Correction::None => Vec::new(),
        Correction::TaskSpace(_) => vec!["the Gaussian process on the pose of the tool"],
        Correction::Elastic(e) => elastic_terms(e),
    };
    out.into_iter().map(str::to_owned).collect()
}

fn elastic_terms(e: &Elastic<'_>) -> Vec<&'static str> {
    [
        (!e.links.is_empty(), "the deflection under gravity"),
        (!e.payload.is_empty(), "the deflection under the payload"),
        (!e.ripple.is_empty(), "gear ripple"),
        (!e.curves.is_empty(), "the own-joint curves"),
        (!e.rows.is_empty(), "the Gaussian processes of the joints"),
    ]
    .into_iter()
    .filter_map(|(there, name)| there.then_some(name))
    .collect()
}

/// Returns the decimal number that an `f32` was written as, so that limits of ±2.87979 do not become 2.879790067…
fn decimal(x: f32) -> f64 {
    x.to_string().parse().unwrap_or(f64::from(x))
}

fn shortened(frames: &[Pose<f64>], flange_from_target: &Pose<f64>) -> Vec<Pose<f64>> {
    let mut frames = frames.to_vec();
    if let Some(last) = frames.last_mut() {
        *last = *last * flange_from_target.inverse();
    }
    frames
}

/// Returns the runtime's chain for the joints and frames of a blob or a robot.
pub(super) fn chain_of(joints: &[Joint], frames: &[Pose<f64>]) -> Poe<f64> {
    let kinds: Vec<JointKind> = joints.iter().map(|j| j.kind).collect();
    Poe::new(&kinds, frames).expect(HAS_JOINTS)
}

/// Returns `base_from_joint` at joint values zero, and `base_from_end`: n + 1 poses.
pub(super) fn at_zero(frames: &[Pose<f64>]) -> Vec<Pose<f64>> {
    let mut pose = Pose::identity();
    frames
        .iter()
        .map(|frame| {
            pose = pose * *frame;
            pose
        })
        .collect()
}
