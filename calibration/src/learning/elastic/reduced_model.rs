//! The fitted elastic model in the form that the runtime evaluates.

use heapless::Vec as FixedVec;
use nalgebra::Vector3;
use poegp_protocol::JointKind;
use poegp_protocol::limits::MAX_JOINTS;
use poegp_runtime::elastic::configuration::Configuration;
use poegp_runtime::elastic::curve::coefficient_count;
use poegp_runtime::elastic::deflection::Deflection;
use poegp_runtime::elastic::gravity::{Gravity, GravityTerms};
use poegp_runtime::elastic::ripple::RippleTerm;
use poegp_runtime::gp::inducing_sets::InducingSet;
use poegp_runtime::gp::joint_processes::JointProcesses;
use poegp_runtime::kinematics::coupling::{Coupling, coupled};
use poegp_runtime::kinematics::minimal_chain::{MinimalChain, MinimalForm};
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::{Pose, Twist};
use poegp_runtime::trace::Unobserved;

use crate::identification::parametric::gear_line::AmbiguousLine;
use crate::identification::parametric::state::ParametricModel;
use crate::learning::elastic::device_variance::DeviceVariance;
use crate::learning::elastic::hyperparameter_search::SearchReport;
use crate::learning::elastic::hyperparameters::DEFLECTION_UNIT;
use crate::learning::elastic::inducing_sets::{InducingSets, select_greedy};
use crate::learning::elastic::options::ElasticOptions;
use crate::learning::elastic::own_joint_curve::orders;
use crate::learning::elastic::solution::ElasticFit;
use crate::measurement::sample::BaseSample;
use crate::numeric::lbfgs::SearchEnd;
use crate::numeric::statistics::distinct;

/// A reduced elastic model in f64.
#[derive(Clone, Debug)]
pub struct ElasticModel {
    /// Deflection by gravity, ripple and processes.
    pub deflection: Deflection<f64>,
    /// Coefficients from which the gravity in `deflection` was made.
    pub gravity: GravityTerms<f64>,
    /// Rows of inducing points sorted by payload, followed by the own-joint curves: in the order of a blob.
    rows: Vec<f64>,
    /// The content of `rows` in the order that the runtime reads.
    arranged_rows: Vec<f64>,
    /// Number of joints of the arm.
    pub joints: usize,
    /// Joint coupling C.
    pub coupling: Option<Coupling<f64>>,
    /// Report of the fit.
    pub report: ElasticReport,
    /// Data from which the device computes its standard deviation of the position, if there are any.
    pub sigma: Option<DeviceVariance>,
}

/// Report of a fit.
#[derive(Clone, Debug)]
pub struct ElasticReport {
    /// Fitted noise of one position component in metres, in the quietest row.
    pub position_noise: f64,
    /// Fitted noise of one rotation component in radians, in the quietest row.
    pub orientation_noise: f64,
    /// Gear ripple: joint (from 1), cycles per turn, amplitude in rad.
    pub ripple: Vec<(usize, f64, f64)>,
    /// Gear ripple that was not used because its frequency is ambiguous.
    pub ambiguous: Vec<AmbiguousLine>,
    /// Number of inducing points of all joints.
    pub inducing_points: usize,
    /// RMS displacement of the target over the measurements, in m, caused by the smaller weights that single precision
    /// needs; `None` where single precision holds the weights as they are.
    pub single_precision_cost: Option<f64>,
    /// The own-joint curve, if there is one.
    pub curve: Option<CurveReport>,
    /// Report of the search for hyperparameters.
    pub search: SearchReport,
}

impl ElasticReport {
    /// Adds to the noise these variances of position and rotation, m² and rad²: those by which single rows exceed the means
    /// that were fitted.
    pub fn add_to_noise(&mut self, [position, orientation]: [f64; 2]) {
        self.position_noise = libm::hypot(self.position_noise, libm::sqrt(position));
        self.orientation_noise = libm::hypot(self.orientation_noise, libm::sqrt(orientation));
    }
}

/// Report of the own-joint curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CurveReport {
    /// Prior standard deviation of the curve at one angle, in rad.
    pub amplitude: f64,
    /// Lengthscale, in rad.
    pub length_scale: f64,
    /// Highest order of the curve, in cycles per turn.
    pub orders: usize,
}

impl ElasticModel {
    /// Reduces a fit to the samples `dense` to the inducing points that `options` allows. Parameters and weights are
    /// solved again from `samples`, which may be more; afterwards `fit.state` holds the calibrated chain. Returns `None`
    /// when the equations cannot be solved or a capacity is exceeded.
    pub fn new(
        fit: &mut ElasticFit,
        dense: &[BaseSample],
        samples: &[BaseSample],
        coupling: Option<&Vec<Vec<f64>>>,
        options: &ElasticOptions,
    ) -> Option<Self> {
        let (mut processes, mut rows) = (JointProcesses::none(), Vec::new());
        let mut single_precision_cost = None;
        if options.processes {
            let sets = select_greedy(fit, dense, samples, options.inducing)?;
            single_precision_cost = sets.single_precision_cost;
            (processes, rows) = of_sets(&sets)?;
        }
        let n = fit.layout.joints;
        let mut ripple = FixedVec::new();
        for term in &fit.state.ripple {
            ripple.push(*term).ok()?;
        }
        let amplitude = |t: &RippleTerm<f64>| (t.joint + 1, t.cycles, libm::hypot(t.sin, t.cos));
        let noise = |i: usize| libm::exp(0.5 * fit.hyperparameters[i]);
        let report = ElasticReport {
            position_noise: fit.scales.position * if options.processes { noise(0) } else { 1.0 },
            orientation_noise: fit.scales.orientation
                * if options.processes { noise(1) } else { 1.0 },
            ripple: fit.state.ripple.iter().map(amplitude).collect(),
            ambiguous: fit.ambiguous.clone(),
            inducing_points: processes.points(),
            single_precision_cost,
            search: fit.search,
            curve: fit.layout.curve_prior(&fit.hyperparameters).map(|prior| {
                let length_scale = libm::exp(fit.hyperparameters[fit.layout.curve_scale()]);
                CurveReport {
                    amplitude: DEFLECTION_UNIT * (prior.amplitude * prior.spectrum.total()).sqrt(),
                    length_scale,
                    orders: orders(length_scale),
                }
            }),
        };
        processes.choose_loops(fit.state.kinds(), &[]);
        rows.extend(&fit.state.curves);
        let mut arranged_rows = rows.clone();
        processes.arrange(&mut arranged_rows);
        let gravity = without_upright_axis(&fit.state, samples);
        let deflection = Deflection {
            gravity: arranged(&gravity, &fit.state.chain(0)),
            ripple,
            curve_orders: fit.state.curves.len() / (2 * n),
            processes,
            variance: None,
        };
        Some(Self {
            deflection,
            gravity,
            rows,
            arranged_rows,
            joints: n,
            coupling: coupling.map(|rows| matrix(rows)),
            report,
            sigma: None,
        })
    }

    /// Creates a parametric model without ripple, curves or processes. `samples` are those of its fit, and `noise` is the
    /// error of a position component beyond its parameters, in m. Returns `None` when a blob cannot hold the model.
    pub fn parametric(
        state: &ParametricModel,
        samples: &[BaseSample],
        coupling: Option<&Vec<Vec<f64>>>,
        noise: f64,
    ) -> Option<Self> {
        let mut ripple = FixedVec::new();
        for term in &state.ripple {
            ripple.push(*term).ok()?;
        }
        let gravity = without_upright_axis(state, samples);
        let deflection = Deflection {
            gravity: arranged(&gravity, &state.chain(0)),
            ripple,
            curve_orders: 0,
            processes: JointProcesses::none(),
            variance: None,
        };
        let amplitude = |t: &RippleTerm<f64>| (t.joint + 1, t.cycles, libm::hypot(t.sin, t.cos));
        Some(Self {
            deflection,
            gravity,
            rows: Vec::new(),
            arranged_rows: Vec::new(),
            joints: state.kinds().len(),
            coupling: coupling.map(|rows| matrix(rows)),
            report: ElasticReport {
                position_noise: noise,
                orientation_noise: 0.0,
                ripple: state.ripple.iter().map(amplitude).collect(),
                ambiguous: Vec::new(),
                inducing_points: 0,
                single_precision_cost: None,
                curve: None,
                search: SearchReport {
                    end: SearchEnd::Converged,
                    iterations: 0,
                    poses: samples.len(),
                    rise: 0.0,
                },
            },
            sigma: None,
        })
    }

    /// Rotates gravity into the axes of a new base; `new_from_old` is the old base seen from it, and `chain` the
    /// calibrated chain from it.
    pub(crate) fn turn_base(&mut self, new_from_old: &Pose<f64>, chain: &Poe<f64>) {
        self.gravity.gravity = new_from_old.rotation * self.gravity.gravity;
        self.deflection.gravity = arranged(&self.gravity, chain);
    }

    /// Returns the rows of inducing points, and the own-joint curves behind them.
    pub fn rows_and_curves(&self) -> (&[f64], &[f64]) {
        let curves = coefficient_count(self.joints, self.deflection.curve_orders);
        self.rows.split_at(self.rows.len() - curves)
    }

    /// Returns `base_from_target` with the correction, and the correction as a twist of the base frame; not limited.
    pub fn corrected(
        &self,
        poe: &Poe<f64>,
        joints: &[f64],
        payload_kg: Option<f64>,
    ) -> (Pose<f64>, Twist<f64>) {
        let mut padded = [0.0; MAX_JOINTS];
        padded[..joints.len()].copy_from_slice(joints);
        let serial = coupled(self.coupling.as_ref(), &padded);
        let at = Configuration {
            chain: &MinimalChain::new(&MinimalForm::new(poe)),
            coupling: self.coupling.as_ref(),
            joints: &padded,
            motions: &poe.motions(&serial),
            payload_kg: payload_kg.unwrap_or(0.0),
        };
        let result = self
            .deflection
            .compensate(&at, &self.arranged_rows, None, &mut Unobserved);
        (result.pose, result.twist)
    }
}

/// Converts gravity to the form that the runtime evaluates.
fn arranged(terms: &GravityTerms<f64>, chain: &Poe<f64>) -> Gravity<f64> {
    let form = MinimalForm::new(chain);
    let mut turned = *terms;
    turned.turn_into(&form);
    Gravity::new(&turned, &form)
}

/// Largest deflection of the first joint by gravity that is neglected, in rad: 0.3 µm at 3 m.
const UPRIGHT_DEFLECTION: f64 = 1e-7;
/// Assumed largest distance of the payload from the first joint, in m: a metre more than any arm reaches.
const LONGEST_LEVER_M: f64 = 5.0;

/// Returns the gravity coefficients without those of the first joint if its axis is so upright that gravity cannot move
/// it: the device then need not compute them in every cycle.
fn without_upright_axis(state: &ParametricModel, samples: &[BaseSample]) -> GravityTerms<f64> {
    let heaviest = samples
        .iter()
        .filter_map(|s| s.payload_kg)
        .fold(0.0, f64::max);
    let mut terms = state.gravity;
    let axis = state.frames[0].rotation.column(2).into_owned();
    let pull = terms.gravity.cross(&axis).norm();
    let links: f64 = terms.links[0].iter().map(|a| a.norm()).sum();
    let payload = terms.payload_lever[0].abs() * LONGEST_LEVER_M + terms.payload_offset[0].norm();
    let upright = pull * (links + heaviest * payload) < UPRIGHT_DEFLECTION;
    if upright && state.kinds()[0] == JointKind::Revolute {
        terms.links[0] = [Vector3::zeros(); MAX_JOINTS];
        terms.payload_lever[0] = 0.0;
        terms.payload_offset[0] = Vector3::zeros();
    }
    terms
}

fn matrix(rows: &[Vec<f64>]) -> Coupling<f64> {
    Coupling::new(rows.len(), rows.iter().flatten().copied())
}

/// Returns the processes with these inducing points, and their rows.
fn of_sets(sets: &InducingSets) -> Option<(JointProcesses<f64>, Vec<f64>)> {
    let all = sets.points.iter().flatten();
    let payloads = distinct(all.map(|point| point.payload_kg));
    let mut out = JointProcesses::none();
    out.group_payloads_kg.extend_from_slice(&payloads).ok()?;
    let mut rows = Vec::new();
    let slots = out.kernels.iter_mut().zip(&sets.kernels);
    for ((slot, kernel), inducing) in slots.zip(&sets.points) {
        *slot = *kernel;
        let of = |payload: &f64| inducing.iter().filter(|p| p.payload_kg == *payload).count();
        let counts: Vec<u16> = payloads.iter().map(|m| of(m) as u16).collect();
        let set = InducingSet::new(kernel, &counts);
        for point in inducing {
            let looked_at = set.joints().iter();
            rows.extend(looked_at.flat_map(|joint| point.features[usize::from(*joint)]));
            rows.push(point.weight);
        }
        out.sets.push(set).ok()?;
    }
    Some((out, rows))
}
