//! Calibration as in the paper: base-tool, step 1 (POE), step 2 (Gaussian process).
//!
//! All measurements are moved into the base frame of the base-tool fit first, and every later step works there: the
//! device then has small numbers (f32 resolves 0.24 µm at 3 m), and "base" and "flange" keep a meaning for the
//! controller. A [`Calibration`] is the model in `f64`; [`crate::blob::write`] turns it into a blob.

pub mod config;
pub mod frame_changes;
pub mod identified;

use poegp_protocol::limits::{MAX_INPUTS, OUTPUTS};
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::{Pose, Twist};
use serde::{Deserialize, Serialize};

use crate::identification::base_tool::{UNWEIGHTED, with_ends};
use crate::identification::base_tools::{Ends, ends, tool_count};
use crate::identification::frame_fit::{FrameFit, ResidualKind, fit_frames, residual_components};
use crate::learning::elastic;
use crate::learning::elastic::device_variance::device_sigma;
use crate::learning::elastic::options::ElasticOptions;
use crate::learning::elastic::outliers::Outlier;
use crate::learning::elastic::predictive_variance::Uncertainty;
use crate::learning::elastic::reduced_model::ElasticModel;
use crate::learning::elastic::variance_inflation::Recipe;
use crate::learning::task_space as gp;
use crate::learning::task_space::fit::{MAX_SIGNAL_VARIANCE, fit};
use crate::learning::task_space::{Hyperparameters, NotPositiveDefinite, TaskSpaceGp};
use crate::measurement::noise::Scales;
use crate::measurement::sample::{BaseSample, InstrumentSample, Sample, in_base_frame};
use crate::model::config::{Config, Weighting};

/// The calibration methods that the paper compares, simplest first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Base and tool frames only.
    BaseTool,
    /// All frames of the chain (step 1).
    Poe,
    /// The chain and a Gaussian process of the joints.
    PoeGp,
    /// The chain and a Gaussian process of joints and payload: the paper's method.
    PoeGpLoad,
    /// The chain, gravity terms, gear ripple and joint-space processes, solved together.
    Elastic,
}

impl Method {
    /// The four that the paper compares.
    pub const PAPER: [Self; 4] = [Self::BaseTool, Self::Poe, Self::PoeGp, Self::PoeGpLoad];
    /// All of them, simplest first.
    pub const ALL: [Self; 5] = [
        Self::BaseTool,
        Self::Poe,
        Self::PoeGp,
        Self::PoeGpLoad,
        Self::Elastic,
    ];

    /// The name on the command line and in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::BaseTool => "base-tool",
            Self::Poe => "poe",
            Self::PoeGp => "poe-gp",
            Self::PoeGpLoad => "poe-gp-load",
            Self::Elastic => "elastic",
        }
    }

    /// Whether it fits the paper's Gaussian process on the residual twist.
    pub fn has_gp(self) -> bool {
        matches!(self, Self::PoeGp | Self::PoeGpLoad)
    }
}

/// What limits the signal variance θ₀ of the task-space process, in units of the outputs' mean square.
///
/// A large θ₀ with a long lengthscale makes large weights that almost cancel, which single precision cannot hold; along
/// that ridge the likelihood is nearly flat. [`crate::blob::write::calibrate_to_blob`] lowers the limit when it must.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SignalVarianceLimit {
    pub(crate) value: f64,
    /// The hyperparameters of the same data under a higher limit, which save most of the search.
    pub(crate) under_higher: Option<[Hyperparameters; OUTPUTS]>,
}

impl SignalVarianceLimit {
    /// That of the search alone.
    pub(crate) const HIGHEST: Self = Self {
        value: MAX_SIGNAL_VARIANCE,
        under_higher: None,
    };
}

/// A calibrated arm in f64.
#[derive(Debug)]
pub struct Calibration {
    /// How it was made.
    pub config: Config,
    /// The upper limit on the signal variance of the task-space process, in units of the outputs' mean square.
    pub max_signal_variance: f64,
    /// Base and tools on the nominal arm: the gauge.
    pub ends: Ends,
    /// `first_target_from_target` of each tool as calibrated.
    pub tools: Vec<Pose<f64>>,
    /// The nominal chain from base to target.
    pub nominal: Poe<f64>,
    /// The calibrated chain from base to target.
    pub calibrated: Poe<f64>,
    /// What step 1 did.
    pub step1: Option<FrameFit>,
    /// Step 2.
    pub gp: Option<TaskSpaceGp>,
    /// The elastic correction.
    pub elastic: Option<ElasticModel>,
    /// Measurements that do not belong, by their index; whether they were left out is in the options.
    pub outliers: Vec<Outlier>,
    /// What the elastic model does not know.
    pub uncertainty: Option<Uncertainty>,
    /// RMS of one position and one rotation component of the training residual, m and rad.
    pub residual_rms: (f64, f64),
    /// The bound on the correction: metres and radians.
    pub bound: (f64, f64),
    mean: Option<(
        poegp_runtime::gp::quadratic_posterior::MeanHeader<f64>,
        Vec<f64>,
    )>,
}

/// Why a calibration failed.
#[derive(Debug, thiserror::Error)]
pub enum CalibrationError {
    /// Not enough poses for the parameters that are to be found.
    #[error(
        "{found} poses: `{method}` needs at least {needed} (six equations each, {parameters} unknowns)"
    )]
    TooFewPoses {
        /// Poses there.
        found: usize,
        /// Poses needed.
        needed: usize,
        /// Identifiable parameters.
        parameters: usize,
        /// The method asked for.
        method: &'static str,
    },
    /// The paper's process for data with several tools or positions alone.
    #[error(
        "`{method}` compares whole poses of one tool; use base-tool, poe or elastic for several sessions or targets, or positions alone"
    )]
    OneToolOnly {
        /// The method asked for.
        method: &'static str,
    },
    /// `poe-gp-load` for data without payloads.
    #[error("`poe-gp-load` needs a payload_kg column; without one use `poe-gp`")]
    NoPayload,
    /// The equations of the elastic model could not be solved.
    #[error(
        "the equations of the elastic model cannot be solved: are these measurements of this robot?"
    )]
    Unsolvable,
    /// The Gram matrix could not be factored.
    #[error(transparent)]
    NotPositiveDefinite(#[from] NotPositiveDefinite),
}

/// Fewest poses for a method on an arm of `joints` joints: equations for every identifiable parameter (4 for each
/// revolute joint and 6 for the tool, at most), and for the Gaussian process one pose more than hyperparameters.
pub fn fewest_poses(method: Method, joints: usize) -> (usize, usize) {
    let parameters = match method {
        Method::BaseTool => 12,
        _ => 4 * joints + 6,
    };
    let poses = parameters.div_ceil(6) + 1;
    (
        if method.has_gp() {
            poses.max(6) + 4
        } else {
            poses
        },
        parameters,
    )
}

/// Calibrates the nominal chain (base to flange) with samples whose poses are `instrument_from_target`. `coupling` is C of
/// q_serial = C q; the samples have been through it already.
///
/// # Errors
/// [`CalibrationError`].
pub fn calibrate(
    nominal: &Poe<f64>,
    coupling: Option<&Vec<Vec<f64>>>,
    samples: &[InstrumentSample],
    config: &Config,
) -> Result<Calibration, CalibrationError> {
    calibrate_within(
        nominal,
        coupling,
        samples,
        config,
        &SignalVarianceLimit::HIGHEST,
    )
}

/// [`calibrate`] with a limit on the signal variance.
pub(crate) fn calibrate_within(
    nominal: &Poe<f64>,
    coupling: Option<&Vec<Vec<f64>>>,
    samples: &[InstrumentSample],
    config: &Config,
    limit: &SignalVarianceLimit,
) -> Result<Calibration, CalibrationError> {
    let method = config.method;
    let (needed, parameters) = fewest_poses(method, nominal.kinds().len());
    if samples.len() < needed {
        return Err(CalibrationError::TooFewPoses {
            found: samples.len(),
            needed,
            parameters,
            method: method.name(),
        });
    }
    let plain_needed = method.has_gp();
    if plain_needed
        && (tool_count(samples) > 1 || samples.iter().any(|s| !s.observation.has_orientation()))
    {
        return Err(CalibrationError::OneToolOnly {
            method: method.name(),
        });
    }
    if method == Method::PoeGpLoad && samples.iter().any(|s| s.payload_kg.is_none()) {
        return Err(CalibrationError::NoPayload);
    }
    let ends = ends(nominal, samples);
    let in_base: Vec<BaseSample> = in_base_frame(samples, &ends.instrument_from_base)
        .into_iter()
        .map(|s| s.with_noise(config.instrument_noise()))
        .collect();
    let flange = *nominal.frames().last().unwrap_or(&Pose::identity());
    let chain_ends: Vec<Pose<f64>> = ends
        .flange_from_targets
        .iter()
        .map(|t| flange * *t)
        .collect();
    let plain = chain_ends.len() == 1 && samples.iter().all(|s| s.observation.has_orientation());
    let nominal = with_ends(nominal, &Pose::identity(), &ends.flange_from_targets[0]);
    let mut out = Calibration {
        config: *config,
        max_signal_variance: limit.value,
        tools: relative(&chain_ends),
        ends,
        nominal,
        calibrated: nominal,
        step1: None,
        gp: None,
        elastic: None,
        outliers: Vec::new(),
        uncertainty: None,
        residual_rms: (0.0, 0.0),
        bound: (0.0, 0.0),
        mean: None,
    };
    let elastic = match method {
        Method::Elastic => Some(config.elastic()),
        // The paper's step 1 compares whole poses of one tool; other data get the same parameters by weighted least squares.
        Method::Poe if !plain => Some(ElasticOptions {
            gravity_terms: false,
            processes: false,
            ripple: false,
            ..config.elastic()
        }),
        _ => None,
    };
    if let Some(options) = &elastic {
        let mut robust =
            elastic::fit::fit_robust(&nominal, &chain_ends, coupling, &in_base, options)
                .ok_or(CalibrationError::Unsolvable)?;
        let kept: Vec<BaseSample> = robust.kept.iter().map(|i| in_base[*i].clone()).collect();
        let units = elastic::fit::solve_units(kept.len());
        let model = crate::progress::phase(units, || {
            ElasticModel::new(&mut robust.fit, &kept, coupling, options)
        });
        let mut model = model.ok_or(CalibrationError::Unsolvable)?;
        if options.device_sigma && options.tied && options.processes {
            model.sigma = device_sigma(&robust, &kept, model.coupling.as_ref());
        }
        out.outliers = robust.outliers;
        out.elastic = Some(model).filter(|_| method == Method::Elastic);
        out.calibrated = robust.fit.state.chain(0);
        out.tools = relative(&robust.fit.state.tools);
        out.uncertainty = Uncertainty::new(robust.fit, &kept, robust.inflation).map(|u| {
            u.with_recipe(Recipe {
                chain: nominal,
                tools: chain_ends.clone(),
                coupling: coupling.cloned(),
                options: *options,
            })
        });
    } else if method != Method::BaseTool {
        out.step1 = Some(step1(&mut out.calibrated, &in_base, config.weighting));
    }
    if method.has_gp() {
        let gp = step2(&out.calibrated, &in_base, config, limit)?;
        out.mean = Some(gp.mean());
        out.gp = Some(gp);
    }
    out.bound = out.bound_from(&in_base);
    out.residual_rms = out.training_rms(&in_base);
    Ok(out)
}

/// Every tool seen from the first.
fn relative(tools: &[Pose<f64>]) -> Vec<Pose<f64>> {
    tools.iter().map(|t| tools[0].inverse() * *t).collect()
}

/// Step 1: all frames, by the paper's unweighted least squares or weighted by the noise.
fn step1(poe: &mut Poe<f64>, samples: &[BaseSample], weighting: Weighting) -> FrameFit {
    let free: Vec<usize> = (0..poe.frames().len()).collect();
    if weighting == Weighting::None {
        return fit_frames(poe, samples, &free, ResidualKind::Space);
    }
    // Noise and model error of position and rotation are estimated from the residuals: a few rounds settle.
    let mut kind = UNWEIGHTED;
    let mut fit = fit_frames(poe, samples, &free, kind);
    for _ in 0..NOISE_ROUNDS {
        kind = estimated_noise(poe, samples);
        fit = fit_frames(poe, samples, &free, kind);
    }
    fit
}

/// Rounds of noise estimation in a weighted step 1.
const NOISE_ROUNDS: usize = 4;

/// The noise of position and rotation that the residuals ask for, at the tool point; rows of their own noise have theirs.
fn estimated_noise(poe: &Poe<f64>, samples: &[BaseSample]) -> ResidualKind {
    let residual = |s: &BaseSample| {
        residual_components(UNWEIGHTED, &s.observation, &poe.forward(&s.serial_joints))
    };
    let residuals: Vec<[f64; 6]> = samples.iter().map(residual).collect();
    ResidualKind::ToolCentred(Scales::estimated(&residuals, samples).at_least(1e-9))
}

/// Step 2: the process on the residual twist in the base frame (eq. 8–12).
fn step2(
    poe: &Poe<f64>,
    samples: &[BaseSample],
    config: &Config,
    limit: &SignalVarianceLimit,
) -> Result<TaskSpaceGp, CalibrationError> {
    let residuals: Vec<[f64; OUTPUTS]> = samples
        .iter()
        .map(|s| {
            let predicted = poe.forward(&s.serial_joints);
            residual_components(ResidualKind::Space, &s.observation, &predicted)
        })
        .collect();
    let inputs = samples
        .iter()
        .map(|s| config.inputs(&s.joints, s.payload_kg))
        .collect();
    Ok(fit(
        inputs,
        &residuals,
        config.hyperparameters,
        limit.value,
        limit.under_higher.as_ref(),
    )?)
}

impl Config {
    /// x = [q, m] as far as the method uses it.
    pub fn inputs(&self, joints: &[f64], payload_kg: Option<f64>) -> Vec<f64> {
        gp::input(
            joints,
            payload_kg.filter(|_| self.method == Method::PoeGpLoad),
        )
    }
}

impl Calibration {
    /// `base_from_target` as the f64 model has it and its correction, a twist of the base frame, without bounding.
    pub fn compensate<F>(&self, sample: &Sample<F>) -> (Pose<f64>, Twist<f64>) {
        if let Some(elastic) = &self.elastic {
            return elastic.compensate(&self.calibrated, &sample.joints, sample.payload_kg);
        }
        let chain = self.calibrated.forward(&sample.serial_joints);
        let Some((header, rows)) = &self.mean else {
            return (chain, Twist::zero());
        };
        let x: [f64; MAX_INPUTS] =
            gp::padded(&self.config.inputs(&sample.joints, sample.payload_kg));
        let twist = Twist::from_array(&header.mean(rows, &x));
        (chain.corrected(&twist), twist)
    }

    /// `base_from_target` of the sample's tool as the f64 model has it, without bounding.
    pub fn predict<F>(&self, sample: &Sample<F>) -> Pose<f64> {
        let first = self.compensate(sample).0;
        match self.tools.get(sample.tool) {
            Some(tool) if sample.tool > 0 => first * *tool,
            _ => first,
        }
    }

    /// Predictive standard deviation of a new measurement: position along the axes of the base frame in metres, rotation
    /// about them in radians. Of the elastic model from parameters, processes and noise; of the paper's process by eq. 7,
    /// carried to the tool, and its noise; of the chain alone the RMS of its training residual. `None` only when a model
    /// that should know does not.
    pub fn standard_deviation<F: Clone>(&self, sample: &Sample<F>) -> Option<[f64; OUTPUTS]> {
        if let Some(uncertainty) = &self.uncertainty {
            let sample = sample.clone().with_noise(self.config.instrument_noise());
            return Some(uncertainty.standard_deviation(&sample));
        }
        let Some(gp) = &self.gp else {
            let (p, r) = self.residual_rms;
            return Some([p, p, p, r, r, r]);
        };
        let x = self.config.inputs(&sample.joints, sample.payload_kg);
        let latent = gp.variance(&x);
        let variance =
            |c: usize| latent[c] + gp.output(c).noise_variance * gp.output_scale[c].powi(2);
        let p = self.calibrated.forward(&sample.serial_joints).translation;
        // v + ω × p, component by component; the outputs are independent.
        Some(std::array::from_fn(|i| {
            let (j, k) = ((i + 1) % 3, (i + 2) % 3);
            let lever = if i < 3 {
                p[k].powi(2) * variance(3 + j) + p[j].powi(2) * variance(3 + k)
            } else {
                0.0
            };
            (variance(i) + lever).sqrt()
        }))
    }

    fn training_rms(&self, samples: &[BaseSample]) -> (f64, f64) {
        let of = |s: &BaseSample| residual_components(UNWEIGHTED, &s.observation, &self.predict(s));
        let (mut position, mut orientation, mut whole) = (0.0, 0.0, 0);
        for sample in samples {
            let r = of(sample);
            position += r[..3].iter().map(|x| x * x).sum::<f64>();
            if sample.observation.has_orientation() {
                orientation += r[3..].iter().map(|x| x * x).sum::<f64>();
                whole += 1;
            }
        }
        let rms = |sum: f64, n: usize| (sum / (3 * n).max(1) as f64).sqrt();
        (rms(position, samples.len()), rms(orientation, whole))
    }

    /// The posterior mean as it is exported.
    pub fn mean(
        &self,
    ) -> Option<&(
        poegp_runtime::gp::quadratic_posterior::MeanHeader<f64>,
        Vec<f64>,
    )> {
        self.mean.as_ref()
    }

    fn bound_from(&self, samples: &[BaseSample]) -> (f64, f64) {
        let (mut displacement, mut angle) = (0.0_f64, 0.0_f64);
        for sample in samples {
            let (_, twist) = self.compensate(sample);
            let point = self.calibrated.forward(&sample.serial_joints).translation;
            displacement = displacement.max(twist.at_point(&point).linear.norm());
            angle = angle.max(twist.angular.norm());
        }
        (
            self.config
                .max_correction_mm
                .map_or(2.0 * displacement, |x| 1e-3 * x),
            self.config
                .max_correction_mrad
                .map_or(2.0 * angle, |x| 1e-3 * x),
        )
    }
}
