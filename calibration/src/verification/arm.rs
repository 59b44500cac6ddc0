//! The arm of a blob as the check sees it: its Jacobians, and the covariance of its expected errors.
//!
//! A blob does not say how wrong it is. But it has the kernels, the poses and payloads of the inducing points, and the
//! number of training poses. That is enough to compute what a calibration of this kind from such poses leaves unknown. The
//! errors at neighbouring poses are correlated, and a check must not take those that look like a moved base, tool or joint
//! for one. So the covariance of the errors at the poses of the check is that of the elastic model's own posterior,
//!
//! ```text
//! P − C S⁻¹ Cᵀ,   S = A Λ Aᵀ + Σ_c k_c ∘ J_c J_cᵀ + noise/repeats
//! ```
//!
//! with the parameters and processes of the elastic model (`elastic::state`). It is taken at the poses of the inducing
//! points, each of which stands for `repeats` training poses: a part of one where the inducing points of all joints are more
//! than the training poses, which the inducing points of each joint cover. A model without such processes does not know the shape of its
//! own error: it gets a smooth deflection of every joint, whose size the check itself estimates.

use nalgebra::Vector3;
use poegp_protocol::JointKind;
use poegp_protocol::blob::{Blob, Correction};
use poegp_runtime::gp::joint_kernel::JointKernel;
use poegp_runtime::math::se3::Pose;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::blob::predict::BlobModel;
use crate::identification::parametric::gear_line::GearLine;
use crate::identification::parametric::state::{
    Layout, Linearised, ParametricModel, PriorGroup, ROWS,
};
use crate::learning::elastic::inputs::Inputs;
use crate::learning::elastic::inputs::kernel;
use crate::measurement::noise::NoiseScales;
use crate::measurement::observation::Observation;
use crate::measurement::sample::{Base, BaseSample, InstrumentSample, Sample};
use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;
use crate::numeric::product::{Transposed, product};
use crate::robot::coupled;
use crate::verification::unknown_frames::{TrainingSet, UnknownFrames};

/// Most poses that stand for the training poses.
const MAX_POSES: usize = 100;
/// Variance of the smooth deflection of a model without joint processes, rad² or m², before its size is fitted.
const SMOOTH_VARIANCE: f64 = 1e-8;
/// Share of a smooth deflection that rounding needs.
const ROUNDING: f64 = 1e-9;
/// Variance of the scatter of a joint, rad² or m², before its size is fitted.
const SCATTER_VARIANCE: f64 = 1e-9;
/// Expected variance of a joint's scatter or smooth deflection, rad² or m²: 20 µrad or 20 µm. The fit begins above it,
/// because a size that is too small grows slowly.
const EXPECTED_VARIANCE: f64 = 4e-10;
/// Number of poses in all sets of training poses that are drawn for a model without processes, and the fewest and the most
/// sets: the fewer poses, the more sets differ.
const DRAWN: usize = 2000;
const SETS: (usize, usize) = (16, 128);
/// Kernel weight of each joint in the smooth deflection; its lengthscale is about a radian.
const SMOOTH_WEIGHT: f64 = 1.0;

/// The arm of a blob, with the poses that stand for its training.
pub struct BlobArm {
    /// Linearised model of the arm: frames, tools and further parameters.
    pub state: ParametricModel,
    kernels: Vec<JointKernel<f64>>,
    /// Whether the kernels are the blob's; if not, their size has to be estimated.
    pub has_error_covariance: bool,
    training: Vec<BaseSample>,
    /// Further sets like `training`, drawn from the trained ranges.
    sets: Vec<Vec<BaseSample>>,
    repeats: f64,
    /// Whether the frames were fitted with priors about the nominal model.
    has_priors: bool,
    /// Standard deviation of the training positions about a model that does not know its own error, m: its frames were
    /// fitted as if all that it leaves unexplained were noise.
    unexplained: Option<f64>,
}

impl BlobArm {
    /// Creates the arm of `loaded` with these tools, each given as `first_target_from_target`.
    pub fn new(loaded: &BlobModel, tools: &[Pose<f64>]) -> Self {
        let blob = loaded.blob();
        let n = blob.robot.joints.len();
        let chain = loaded.chain();
        let coupling = loaded.coupling();
        let last = chain.frames()[n];
        let tools = tools.iter().map(|tool| last * *tool).collect::<Vec<_>>();
        let elastic = match &blob.correction {
            Correction::Elastic(elastic) => Some(elastic),
            _ => None,
        };
        let ripple = elastic.map_or(Vec::new(), |e| {
            let term = |t: &poegp_protocol::blob::Ripple| {
                GearLine::found(t.joint.into(), f64::from(t.cycles))
            };
            e.ripple.iter().map(term).collect()
        });
        let count = tools.len();
        let layout = Layout {
            joints: n,
            tools: count,
            gravity: elastic.is_some_and(|e| !e.links.is_empty()),
            payload: elastic.is_some_and(|e| !e.links.is_empty() && !e.payload.is_empty()),
            ripple,
        };
        let gravity = elastic.map_or([0.0; 3], |e| e.gravity.map(f64::from));
        let kernels: Vec<JointKernel<f64>> =
            elastic.map_or(Vec::new(), |e| e.kernels.iter().map(joint_kernel).collect());
        let trained = loaded.host().provenance.training_poses as usize;
        let of_tools = |poses: Vec<BaseSample>| -> Vec<BaseSample> {
            let with = |(i, s): (usize, BaseSample)| Sample {
                tool: i % count,
                ..s
            };
            poses.into_iter().enumerate().map(with).collect()
        };
        let draw =
            |seed: u64, most: usize| of_tools(training_poses(blob, coupling.as_ref(), seed, most));
        let training = draw(1, MAX_POSES);
        let fewest = trained.clamp(1, MAX_POSES);
        let sets = match kernels.is_empty() {
            true => (0..(DRAWN / fewest).clamp(SETS.0, SETS.1) as u64)
                .map(|seed| draw(2 + seed, fewest))
                .collect(),
            false => Vec::new(),
        };
        Self {
            repeats: (trained.max(1)) as f64 / training.len() as f64,
            sets,
            has_priors: elastic.is_some(),
            has_error_covariance: !kernels.is_empty(),
            unexplained: (blob.variance.as_ref().filter(|_| kernels.is_empty()))
                .map(|v| f64::from(v.floor_m2).sqrt()),
            kernels: if kernels.is_empty() {
                let weights = vec![SMOOTH_WEIGHT; n];
                vec![JointKernel::from_natural(&weights, 0.0, SMOOTH_VARIANCE, 0.0); n]
            } else {
                kernels
            },
            state: ParametricModel::new(&chain, tools, coupling, layout, gravity.into()),
            training,
        }
    }

    /// Computes the Jacobians at `samples`, with rows in units of their scales.
    pub fn linearise(&self, samples: &[InstrumentSample], scales: NoiseScales) -> Linearised {
        self.state.linearise(samples, scales)
    }

    /// Computes the covariance of the errors of the blob's predictions at `samples`, in units of the scales of the rows. For
    /// a blob that does not know its own error, it is that of the frames alone. `scatter` are the sizes of the joints' scatter,
    /// which the training poses had as well; none may be given. `None` if the covariance cannot be computed.
    pub fn error_covariance(
        &self,
        samples: &[InstrumentSample],
        at: &Linearised,
        scales: NoiseScales,
        scatter: &[f64],
    ) -> Option<Mat<f64>> {
        let observation = seen_as(samples);
        let with = |s: &BaseSample| Sample {
            observation,
            ..s.clone()
        };
        let training: Vec<BaseSample> = self.training.iter().map(with).collect();
        let seen = self.state.linearise(&training, scales);
        let (here, there) = (
            Inputs::new(&self.state, samples),
            Inputs::new(&self.state, &training),
        );
        let mut s = self.prior((&seen, &there), (&seen, &there));
        let noise = (self.unexplained).map_or(1.0, |u| (u / scales.position).powi(2).max(1.0));
        for i in 0..s.nrows() {
            s[(i, i)] += noise / self.repeats;
            let pose = ROWS * (i / ROWS);
            for j in pose..pose + ROWS {
                let of = |(c, size): (usize, &f64)| {
                    size * SCATTER_VARIANCE * seen.jacobian[(i, c)] * seen.jacobian[(j, c)]
                };
                s[(i, j)] += scatter.iter().enumerate().map(of).sum::<f64>() / self.repeats;
            }
        }
        let c = self.prior((at, &here), (&seen, &there));
        let p = self.prior((at, &here), (at, &here));
        let factor = Factor::new(s, 1).ok()?;
        let known = product(&c, &factor.solve(&c.transpose()));
        Some(Mat::from_fn(p.nrows(), p.ncols(), |i, j| {
            p[(i, j)] - 0.5 * (known[(i, j)] + known[(j, i)])
        }))
    }

    /// Returns what a model without processes does not know of its frames, seen by observations as at `samples`; `None` for a
    /// model that knows its error.
    pub fn unknown_frames(
        &self,
        samples: &[InstrumentSample],
        scales: NoiseScales,
    ) -> Option<UnknownFrames> {
        let fewest = self.sets.first()?.len();
        let groups = self.state.layout.groups();
        let prior = |g: &PriorGroup| match self.has_priors {
            true => g.prior_sd(),
            // Least squares without priors.
            false => PriorGroup::BaseAndTools.prior_sd(),
        };
        let sd: Vec<f64> = groups.iter().map(prior).collect();
        let observation = seen_as(samples);
        let sets = self.sets.iter().map(|set| {
            let with = |s: &BaseSample| Sample {
                observation,
                ..s.clone()
            };
            let set: Vec<BaseSample> = set.iter().map(with).collect();
            let at = self.state.linearise(&set, scales);
            let here = Inputs::new(&self.state, &set);
            let grams: Vec<Mat<f64>> = (0..self.kernels.len())
                .map(|c| self.gram(c, &here, &here))
                .collect();
            TrainingSet::new((&at.a, &at.jacobian), &sd, &grams, observation.equations())
        });
        Some(UnknownFrames {
            sets: sets.collect(),
            repeats: self.repeats * self.training.len() as f64 / fewest as f64,
            sd: sd.clone(),
        })
    }

    /// Returns the expected size of each joint's scatter, or of its smooth deflection for a blob that does not know its own
    /// error.
    pub fn expected_size(&self) -> f64 {
        match self.has_error_covariance {
            true => EXPECTED_VARIANCE / SCATTER_VARIANCE,
            false => EXPECTED_VARIANCE / SMOOTH_VARIANCE,
        }
    }

    /// Returns a root of the covariance of each joint's smooth deflection, of unit size. `None` if it has none.
    pub fn smooth_of_joints<F>(
        &self,
        samples: &[Sample<F>],
        at: &Linearised,
    ) -> Option<Vec<Mat<f64>>> {
        let here = Inputs::new(&self.state, samples);
        let of = |joint: usize| {
            let mut gram = self.gram(joint, &here, &here);
            for i in 0..gram.nrows() {
                gram[(i, i)] *= 1.0 + ROUNDING;
            }
            let root = Factor::new(gram, 1).ok()?.lower();
            Some(moved_by(at, joint, &root))
        };
        (0..self.kernels.len()).map(of).collect()
    }

    /// Returns a root of the covariance of each joint's scatter, of unit size: what it repeats badly, and what changes within
    /// a few degrees (gear errors beyond those that the model has).
    pub fn scatter_of_joints(&self, at: &Linearised) -> Vec<Mat<f64>> {
        let poses = at.a.nrows() / ROWS;
        let unit = Mat::identity(poses, poses) * libm::sqrt(SCATTER_VARIANCE);
        (0..self.state.layout.joints)
            .map(|joint| moved_by(at, joint, &unit))
            .collect()
    }

    /// Computes the covariance of the smooth deflection, of unit size, for a blob that does not know its own error.
    pub fn smooth_covariance(&self, samples: &[InstrumentSample], at: &Linearised) -> Mat<f64> {
        let here = Inputs::new(&self.state, samples);
        self.processes((at, &here), (at, &here))
    }

    /// Computes the prior covariance of the modelled errors between two sets of poses.
    fn prior(&self, a: (&Linearised, &Inputs), b: (&Linearised, &Inputs)) -> Mat<f64> {
        let groups = self.state.layout.groups();
        let sd = |i: usize| groups[i].prior_sd();
        let scaled = Mat::from_fn(a.0.a.nrows(), groups.len(), |row, i| {
            a.0.a[(row, i)] * sd(i).powi(2)
        });
        let parameters = product(&scaled, Transposed(&b.0.a));
        if self.has_error_covariance {
            parameters + self.processes(a, b)
        } else {
            parameters
        }
    }

    fn processes(&self, a: (&Linearised, &Inputs), b: (&Linearised, &Inputs)) -> Mat<f64> {
        let mut out = Mat::zeros(a.0.a.nrows(), b.0.a.nrows());
        for c in 0..self.kernels.len() {
            let gram = self.gram(c, a.1, b.1);
            for i in 0..gram.nrows() {
                for j in 0..gram.ncols() {
                    for row in 0..ROWS {
                        let left = gram[(i, j)] * a.0.jacobian[(ROWS * i + row, c)];
                        for column in 0..ROWS {
                            out[(ROWS * i + row, ROWS * j + column)] +=
                                left * b.0.jacobian[(ROWS * j + column, c)];
                        }
                    }
                }
            }
        }
        out
    }

    /// Returns the covariance of one joint's process between two sets of poses, poses × poses, rad² or m².
    fn gram(&self, joint: usize, a: &Inputs, b: &Inputs) -> Mat<f64> {
        let (k, kinds) = (&self.kernels[joint], self.state.kinds());
        Mat::from_fn(a.payloads.len(), b.payloads.len(), |i, j| {
            let query = |inputs: &Inputs, i: usize| (inputs.features[i], inputs.payloads[i]);
            let ((fa, ma), (fb, mb)) = (query(a, i), query(b, j));
            kernel(k, kinds, (&fa, ma), (&fb, mb))
        })
    }
}

/// Returns what deflections of one joint, one column each, do to the rows; `root` is poses × columns.
fn moved_by(at: &Linearised, joint: usize, root: &Mat<f64>) -> Mat<f64> {
    Mat::from_fn(at.a.nrows(), root.ncols(), |row, j| {
        at.jacobian[(row, joint)] * root[(row / ROWS, j)]
    })
}

/// Returns an observation of the kind of `samples`.
fn seen_as(samples: &[InstrumentSample]) -> Observation {
    if samples.iter().any(|s| s.observation.has_orientation()) {
        Observation::Pose(Pose::identity())
    } else {
        Observation::Position(Vector3::zeros())
    }
}

fn joint_kernel(wire: &poegp_protocol::blob::JointKernel) -> JointKernel<f64> {
    let mut out = JointKernel::zero();
    out.set_rates(wire.rates.iter().map(|rate| f64::from(*rate)));
    out.payload_rate = wire.payload_rate.into();
    out.amplitude = wire.amplitude.into();
    out.payload_amplitude = wire.payload_amplitude.into();
    out
}

/// Returns poses that stand for the training poses. They are at the inducing points; joints that a kernel does not depend on
/// are drawn from the trained ranges. For a blob without inducing points, all joints are drawn.
/// At most `most` poses are returned.
fn training_poses(
    blob: &Blob<'_>,
    coupling: Option<&Vec<Vec<f64>>>,
    seed: u64,
    most: usize,
) -> Vec<BaseSample> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut within = |range: (f32, f32)| {
        let (lower, upper) = (f64::from(range.0), f64::from(range.1));
        lower + (upper - lower) * random.random::<f64>()
    };
    let mut points = inducing_points(blob);
    let every = points.len().div_ceil(most).max(1);
    points = points.into_iter().step_by(every).collect();
    if points.is_empty() {
        points = vec![(Vec::new(), None); most];
    }
    let poses: Vec<(Vec<f64>, f64)> = points
        .into_iter()
        .map(|(known, payload)| {
            let mut joints: Vec<f64> = blob.ranges.joints.iter().map(|r| within(*r)).collect();
            for (joint, value) in known {
                joints[joint] = value;
            }
            let drawn = blob.ranges.payload_kg.map_or(0.0, &mut within);
            (joints, payload.unwrap_or(drawn))
        })
        .collect();
    let sample = |(joints, payload): (Vec<f64>, f64)| {
        let serial_joints = coupled(coupling.map(Vec::as_slice), &joints);
        let observation = Observation::Pose(Pose::identity());
        Sample {
            payload_kg: Some(payload),
            ..Sample::new(joints, serial_joints, observation, Base)
        }
    };
    poses.into_iter().map(sample).collect()
}

/// The joints that an inducing point's kernel depends on, with their values, and the point's payload in kg.
type PartialPose = (Vec<(usize, f64)>, Option<f64>);

fn inducing_points(blob: &Blob<'_>) -> Vec<PartialPose> {
    let Correction::Elastic(elastic) = &blob.correction else {
        return Vec::new();
    };
    let numbers = elastic.rows.as_chunks::<4>().0.iter();
    let mut numbers = numbers.map(|word| f64::from(f32::from_le_bytes(*word)));
    let mut out = Vec::new();
    for (kernel, groups) in elastic.kernels.iter().zip(&elastic.sets) {
        for (payload_kg, points) in elastic.group_payloads_kg.iter().zip(groups) {
            for _ in 0..*points {
                let mut known = Vec::new();
                for (joint, rate) in kernel.rates.iter().enumerate() {
                    if *rate > 0.0 {
                        let [first, second] = [0, 1].map(|_| numbers.next().unwrap_or(0.0));
                        known.push(match blob.robot.joints[joint].kind {
                            JointKind::Revolute => (joint, libm::atan2(first, second)),
                            JointKind::Prismatic => (joint, first),
                        });
                    }
                }
                // Skips the weight.
                numbers.next();
                out.push((known, Some(f64::from(*payload_kg))));
            }
        }
    }
    out
}
