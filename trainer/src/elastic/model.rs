//! The fitted elastic model in the form that the runtime evaluates.

use faer::Mat;
use heapless::Vec as FixedVec;
use poegp_protocol::limits::MAX_JOINTS;
use poegp_runtime::deflection::{
    Configuration, CouplingMatrix, Deflection, JointKernel, JointProcesses, PayloadGroup,
    RippleTerm, coupled, row_words,
};
use poegp_runtime::observer::Unobserved;
use poegp_runtime::poe::Poe;
use poegp_runtime::se3::{Pose, Twist};

use super::device_sigma::DeviceSigma;
use super::fit::{ElasticFit, ElasticOptions};
use super::support::{Support, gathered, reduce};
use crate::calibration::frames::Sample;

/// An elastic model in f64.
#[derive(Clone, Debug)]
pub struct ElasticModel {
    /// Gravity, ripple and processes.
    pub deflection: Deflection<f64>,
    /// Support rows, by payload.
    pub rows: Vec<f64>,
    /// C.
    pub coupling: Option<CouplingMatrix<f64>>,
    /// Facts of the fit.
    pub report: ElasticReport,
    /// What the device gets to say how well it knows the position.
    pub sigma: Option<DeviceSigma>,
}

/// Facts of a fit.
#[derive(Clone, Debug)]
pub struct ElasticReport {
    /// Fitted noise of one position component in metres, in the quietest row.
    pub position_noise: f64,
    /// Fitted noise of one rotation component in radians, in the quietest row.
    pub orientation_noise: f64,
    /// Gear ripple: joint from 1, cycles per turn, amplitude in rad.
    pub ripple: Vec<(usize, f64, f64)>,
    /// Support points.
    pub support: usize,
}

impl ElasticModel {
    /// From a fit; reduced to `options.support` points. The calibrated chain is that of `fit.state` afterwards.
    pub fn new(
        fit: &mut ElasticFit,
        samples: &[Sample],
        coupling: Option<&Vec<Vec<f64>>>,
        options: &ElasticOptions,
    ) -> Option<Self> {
        let distinct = gathered(&fit.inputs.payloads) != fit.inputs.payloads;
        let count = options.support.unwrap_or(samples.len()).min(samples.len());
        let support = if !options.processes {
            Support {
                features: Vec::new(),
                payloads: Vec::new(),
                weights: Vec::new(),
            }
        } else if count < samples.len() || distinct {
            reduce(fit, samples, count)?
        } else {
            all(fit)?
        };
        let n = fit.layout.joints;
        let mut kernels = [JointKernel::zero(); MAX_JOINTS];
        if options.processes {
            for (slot, kernel) in kernels
                .iter_mut()
                .zip(fit.layout.kernels(&fit.hyperparameters))
            {
                *slot = kernel;
            }
        }
        let (rows, groups) = rows(&support, n);
        let mut ripple = FixedVec::new();
        for term in &fit.state.ripple {
            ripple.push(*term).ok()?;
        }
        let amplitude = |t: &RippleTerm<f64>| (t.joint + 1, t.cycles, t.sin.hypot(t.cos));
        let noise = |i: usize| (0.5 * fit.hyperparameters[i]).exp();
        let report = ElasticReport {
            position_noise: fit.scales.position * if options.processes { noise(0) } else { 1.0 },
            orientation_noise: fit.scales.orientation
                * if options.processes { noise(1) } else { 1.0 },
            ripple: fit.state.ripple.iter().map(amplitude).collect(),
            support: support.payloads.len(),
        };
        let processes = JointProcesses {
            kernels,
            tied: fit.layout.tied,
            groups,
            sets: FixedVec::new(),
        };
        let deflection = Deflection {
            gravity: fit.state.gravity,
            ripple,
            processes,
            variance: None,
        };
        Some(Self {
            deflection,
            rows,
            coupling: coupling.map(matrix),
            report,
            sigma: None,
        })
    }

    /// Takes sets in place of the rows.
    pub fn set_sets(&mut self, sets: &super::sets::Sets) {
        let p = &mut self.deflection.processes;
        for (slot, k) in p.kernels.iter_mut().zip(&sets.kernels) {
            *slot = *k;
        }
        let mut payloads: Vec<f64> = sets.points.iter().flatten().map(|x| x.1).collect();
        payloads.sort_by(f64::total_cmp);
        payloads.dedup();
        p.groups.clear();
        for m in &payloads {
            let points = sets.points.iter().flatten().filter(|x| x.1 == *m).count();
            let _ = p.groups.push(PayloadGroup { payload_kg: *m, points });
        }
        p.sets.clear();
        self.rows.clear();
        for (k, points) in sets.kernels.iter().zip(&sets.points) {
            let counts: Vec<u16> = payloads
                .iter()
                .map(|m| points.iter().filter(|x| x.1 == *m).count() as u16)
                .collect();
            let set = poegp_runtime::deflection::SupportSet::new(k, &counts);
            let mut sorted: Vec<_> = points.iter().collect();
            sorted.sort_by(|a, b| a.1.total_cmp(&b.1));
            for (f, _, w) in sorted {
                for j in set.joints() {
                    self.rows.extend(f[usize::from(*j)]);
                }
                self.rows.push(*w);
            }
            let _ = p.sets.push(set);
        }
    }

    /// The compensated pose and its correction as a twist, without bounding. `base_from_target`.
    pub fn compensate(
        &self,
        poe: &Poe<f64>,
        joints: &[f64],
        payload_kg: Option<f64>,
    ) -> (Pose<f64>, Twist<f64>) {
        let mut padded = [0.0; MAX_JOINTS];
        padded[..joints.len()].copy_from_slice(joints);
        let serial = coupled(self.coupling.as_ref(), &padded);
        let at = Configuration {
            poe,
            coupling: self.coupling.as_ref(),
            joints: &padded,
            motions: &poe.motions(&serial),
            payload_kg: payload_kg.unwrap_or(0.0),
        };
        let result = self
            .deflection
            .compensate(&at, &self.rows, None, &mut Unobserved);
        (result.pose, result.twist)
    }
}

fn matrix(rows: &Vec<Vec<f64>>) -> CouplingMatrix<f64> {
    let mut out = [[0.0; MAX_JOINTS]; MAX_JOINTS];
    for (slots, row) in out.iter_mut().zip(rows) {
        slots[..row.len()].copy_from_slice(row);
    }
    out
}

/// All poses as support, with the weights of the generalised least squares.
fn all(fit: &ElasticFit) -> Option<Support> {
    let weights: &Mat<f64> = &fit.solved.as_ref()?.weights;
    Some(Support {
        features: fit.inputs.features.clone(),
        payloads: fit.inputs.payloads.clone(),
        weights: (0..weights.nrows())
            .map(|j| (0..weights.ncols()).map(|c| weights[(j, c)]).collect())
            .collect(),
    })
}

/// Rows sorted by payload, and the groups.
fn rows<const N: usize>(
    support: &Support,
    joints: usize,
) -> (Vec<f64>, FixedVec<PayloadGroup<f64>, N>) {
    let mut order: Vec<usize> = (0..support.payloads.len()).collect();
    order.sort_by(|a, b| support.payloads[*a].total_cmp(&support.payloads[*b]));
    let mut groups: FixedVec<PayloadGroup<f64>, N> = FixedVec::new();
    let mut rows = Vec::with_capacity(order.len() * row_words(joints));
    for j in order {
        let payload_kg = support.payloads[j];
        match groups.last_mut() {
            Some(group) if group.payload_kg == payload_kg => group.points += 1,
            _ => {
                // There are no more groups than the limit: payloads were gathered.
                let _ = groups.push(PayloadGroup {
                    payload_kg,
                    points: 1,
                });
            }
        }
        rows.extend(support.features[j][..joints].iter().flatten());
        rows.extend(&support.weights[j]);
    }
    (rows, groups)
}
