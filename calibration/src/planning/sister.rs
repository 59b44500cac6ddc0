//! A prior from the model of a sister robot: another arm of the same type that is already calibrated.
//!
//! | from the blob | what a plan takes of it |
//! |---|---|
//! | calibrated frames | the chain that Jacobians are taken of, and how far frames are from the nominal model |
//! | gravity terms | how large the terms of links and payload are |
//! | gear ripple, own-joint curves | which waves of a joint's angle there are, and how large |
//! | kernels | how large the smooth deflection of each joint is, by each joint |
//!
//! The values themselves belong to the other arm: a plan takes their sizes as standard deviations about zero. A blob does
//! not show how much two arms differ. A model without an elastic correction says nothing of deflections, so their usual
//! sizes are taken.

use nalgebra::Vector3;
use poegp_protocol::blob::{Correction, Elastic};
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::{Pose, Twist};

use crate::blob::predict::{BlobModel, rigid_poses};
use crate::planning::optimal_design::{Prior, Wave};
use crate::robot::Robot;

/// Largest difference between frames of the same nominal model, m and rad; it is due to rounding only.
const SAME_NOMINAL: f64 = 1e-3;
/// Most waves that are taken, beginning with the largest.
const MOST_WAVES: usize = 48;
/// Amplitude below which a wave is noise of the fit, rad.
const SMALLEST_WAVE: f64 = 1e-6;
/// Smallest standard deviation of a frame, m and rad: no two arms are more alike than this.
const LEAST_FRAMES: f64 = 0.05e-3;

/// Error: a model is not that of a sister robot.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NotASister {
    /// The model has another number of joints.
    #[error("a model of \"{robot}\" with {found} joints")]
    Joints {
        /// Robot of the model.
        robot: String,
        /// Number of joints of the model.
        found: usize,
    },
    /// A joint is revolute in one robot and prismatic in the other.
    #[error("a model of \"{robot}\", whose joint {joint} is of another kind")]
    Kind {
        /// Robot of the model.
        robot: String,
        /// Number of the joint, from 1.
        joint: usize,
    },
    /// The joints of the controller are coupled in another way.
    #[error("a model of \"{robot}\", with another joint coupling")]
    Coupling {
        /// Robot of the model.
        robot: String,
    },
    /// The nominal model differs.
    #[error(
        "a model of \"{robot}\", whose nominal model differs at joint {joint} by {millimetres:.1} mm or {milliradians:.1} mrad"
    )]
    Nominal {
        /// Robot of the model.
        robot: String,
        /// Number of the first joint that differs, from 1.
        joint: usize,
        /// Distance between the joint's frames, mm.
        millimetres: f64,
        /// Angle between the joint's frames, mrad.
        milliradians: f64,
    },
}

/// What the model of a calibrated arm says of the arms of its type.
#[derive(Clone, Debug)]
pub struct Sister {
    /// Calibrated chain from base to flange.
    pub chain: Poe<f64>,
    /// Sizes of the model's terms, as standard deviations.
    pub prior: Prior,
    /// Whether the model has sizes of deflections, too; if not, `prior` has the usual ones.
    pub is_elastic: bool,
}

impl Sister {
    /// Creates a sister from a model of the same type as `robot`.
    ///
    /// # Errors
    /// [`NotASister`] if joints, their kinds, their coupling or the nominal model differ.
    pub fn new(model: &BlobModel, robot: &Robot) -> Result<Self, NotASister> {
        let blob = model.blob();
        let name = || blob.robot.name.to_owned();
        let n = robot.joints.len();
        if blob.robot.joints.len() != n {
            return Err(NotASister::Joints {
                robot: name(),
                found: blob.robot.joints.len(),
            });
        }
        let mut kinds = blob.robot.joints.iter().zip(&robot.joints);
        if let Some(joint) = kinds.position(|(a, b)| a.kind != b.kind) {
            return Err(NotASister::Kind {
                robot: name(),
                joint: joint + 1,
            });
        }
        let coupling = robot.coupling.iter().flatten().flatten();
        if !coupling
            .map(|c| *c as f32)
            .eq(blob.robot.coupling.iter().copied())
        {
            return Err(NotASister::Coupling { robot: name() });
        }
        let nominal = aligned(robot, &rigid_poses(&blob.geometry.nominal));
        for (joint, (_, twist)) in (1..).zip(&nominal[..n]) {
            let (linear, angular) = (twist.linear.norm(), twist.angular.norm());
            if linear.max(angular) > SAME_NOMINAL {
                return Err(NotASister::Nominal {
                    robot: name(),
                    joint,
                    millimetres: 1e3 * linear,
                    milliradians: 1e3 * angular,
                });
            }
        }
        let calibrated = aligned(robot, &rigid_poses(&blob.geometry.calibrated));
        let mut frames: Vec<Pose<f64>> = calibrated.iter().map(|(frame, _)| *frame).collect();
        let target: Pose<f64> = Pose::from_rows(&model.host().gauge.flange_from_target);
        if let Some(last) = frames.last_mut() {
            *last = *last * target.inverse();
        }
        let mut prior = Prior::usual(n);
        // The first frame is the base's and the last the target's: both are where somebody mounted them.
        prior.frames =
            sizes(calibrated[..n].iter().skip(1).map(|(_, twist)| twist)).unwrap_or(prior.frames);
        let is_elastic = match &blob.correction {
            Correction::Elastic(elastic) => {
                deflections(&mut prior, elastic, n);
                true
            }
            _ => false,
        };
        Ok(Self {
            chain: Poe::new(&robot.kinds(), &frames).expect("as many frames as the robot has"),
            prior,
            is_elastic,
        })
    }
}

/// Returns the same chain with frames as near as possible to the robot's, each with its deviation as a twist in the joint's
/// frame.
///
/// A turn about a joint's axis and a shift along it commute with the joint. A blob moves them to the frame before
/// (`runtime/src/kinematics/minimal_chain.rs`), and for parallel axes the turn is any angle. This function moves them on to
/// the frame behind, as far as the robot's frame does not have them.
fn aligned(robot: &Robot, frames: &[Pose<f64>]) -> Vec<(Pose<f64>, Twist<f64>)> {
    let mut handed = Pose::identity();
    let last = frames.len() - 1;
    let mut out = Vec::with_capacity(frames.len());
    for (i, (frame, nominal)) in frames.iter().zip(&robot.parent_from_joint).enumerate() {
        let mut frame = handed * *frame;
        handed = Pose::identity();
        // The angle of the moved turn is not small, so further steps correct the first.
        for _ in 0..if i < last { 3 } else { 0 } {
            let deviation = nominal.inverse() * frame;
            let angle = libm::atan2(
                deviation.rotation[(1, 0)] - deviation.rotation[(0, 1)],
                deviation.rotation[(0, 0)] + deviation.rotation[(1, 1)],
            );
            let along = Pose::exp(&Twist {
                linear: Vector3::new(0.0, 0.0, deviation.translation[2]),
                angular: Vector3::new(0.0, 0.0, angle),
            });
            frame = frame * along.inverse();
            handed = along * handed;
        }
        out.push((frame, (nominal.inverse() * frame).log()));
    }
    out
}

/// Returns the root mean squares of the components that remain, m and rad: two of translation and two of rotation for each
/// frame.
fn sizes<'a>(twists: impl Iterator<Item = &'a Twist<f64>>) -> Option<(f64, f64)> {
    let (mut linear, mut angular, mut count) = (0.0, 0.0, 0);
    for twist in twists {
        linear += twist.linear.norm_squared();
        angular += twist.angular.norm_squared();
        count += 2;
    }
    let rms = |sum: f64| (sum / f64::from(count)).sqrt().max(LEAST_FRAMES);
    (count > 0).then(|| (rms(linear), rms(angular)))
}

/// Sets the sizes of the terms of an elastic correction.
fn deflections(prior: &mut Prior, elastic: &Elastic<'_>, n: usize) {
    let rms = |values: &mut dyn Iterator<Item = f32>| {
        let squares: Vec<f64> = values.map(|x| f64::from(x).powi(2)).collect();
        let mean = squares.iter().sum::<f64>() / squares.len().max(1) as f64;
        (mean > 0.0).then(|| mean.sqrt())
    };
    if let Some(links) = rms(&mut elastic.links.iter().flatten().copied()) {
        prior.links = links;
    }
    if let Some(payload) = rms(&mut elastic.payload.iter().flatten().copied()) {
        prior.payload = payload;
    }
    for (kernel, row) in elastic.kernels.iter().zip(&mut prior.smooth) {
        let sum: f64 = kernel.rates.iter().map(|rate| f64::from(*rate)).sum();
        // The variance of the process is divided among the joints by how much it depends on each.
        for (sd, rate) in row.iter_mut().zip(&kernel.rates) {
            let share = f64::from(kernel.amplitude) * f64::from(*rate) / sum.max(1e-30);
            // The size is never below the usual one, which also keeps poses apart: plans for regular arms without it were 3
            // % worse.
            *sd = share.sqrt().max(*sd);
        }
    }
    let wave = |joint: usize, cycles: f64, sin: f32, cos: f32| Wave {
        joint,
        cycles,
        sd: libm::hypot(f64::from(sin), f64::from(cos)) / std::f64::consts::SQRT_2,
    };
    let ripple = elastic
        .ripple
        .iter()
        .map(|r| wave(usize::from(r.joint), f64::from(r.cycles), r.sin, r.cos));
    let amplitudes: Vec<f32> = elastic
        .curves
        .chunks_exact(4)
        .map(|bytes| f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
        .collect();
    let orders = amplitudes.len() / (2 * n);
    let curves = amplitudes.chunks_exact(2).enumerate().map(|(i, pair)| {
        let order = (i % orders.max(1) + 1) as f64;
        wave(i / orders.max(1), order, pair[0], pair[1])
    });
    prior.waves = ripple
        .chain(curves)
        .filter(|wave| wave.sd > SMALLEST_WAVE)
        .collect();
    prior.waves.sort_by(|a, b| b.sd.total_cmp(&a.sd));
    prior.waves.truncate(MOST_WAVES);
}
