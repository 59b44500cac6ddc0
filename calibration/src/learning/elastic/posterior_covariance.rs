//! The posterior covariance of the elastic model: the uncertainty of its predictions, before any inflation.
//!
//! For a new pose y* = A* x + Σ_c J*_c δ_c(q*, m*): cov(y*) = P** − C S⁻¹ Cᵀ, with P** the prior covariance of y* and C
//! its covariance with the measurements, both from parameters and processes. The reduction to fewer inducing points adds
//! less than a hundredth, which is neglected.
//!
//! Everything is linearised around the same parameters as S. Base and tool have priors of 60 mm: if C were linearised
//! around parameters that differ by a ten-thousandth, P** − C S⁻¹ Cᵀ would be noise as large as the result.
//!
//! Without processes, the same covariance is A* Σ A*ᵀ with that of the parameters, Σ, which is small for any number of rows.

use std::sync::OnceLock;

use poegp_protocol::JointKind;
use poegp_protocol::limits::{MAX_GROUPS, MAX_JOINTS};
use poegp_runtime::gp::joint_kernel::{JointKernel, similarity};
use poegp_runtime::kinematics::poe::JointTrig;
use poegp_runtime::math::se3::Pose;

use crate::identification::parametric::fit::covariance;
use crate::identification::parametric::state::{Linearised, ROWS, prior_variance};
use crate::identification::prediction_covariance::{PredictionCovariance, rows_of};
use crate::learning::elastic::hyperparameters::DEFLECTION_UNIT;
use crate::learning::elastic::likelihood::Posterior;
use crate::learning::elastic::own_joint_curve::CurvePrior;
use crate::learning::elastic::solution::ElasticFit;
use crate::measurement::noise::InstrumentNoise;
use crate::measurement::observation::Observation;
use crate::measurement::sample::{BaseSample, Sample};
use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;
use crate::numeric::product::{Transposed, product};
use crate::numeric::statistics::{Standardised, calibration_factor, distinct};

/// Share of the largest payload up to which two payloads count as equal.
const SAME_PAYLOAD: f64 = 0.01;

/// A fit, with everything that the covariance of its predictions needs.
pub struct PosteriorCovariance {
    fit: ElasticFit,
    linear: Linearised,
    kernels: Vec<JointKernel<f64>>,
    /// Prior of the own-joint curve, with its amplitude in rad².
    curve: Option<CurvePrior>,
    /// Noise assumed for a measurement that states none.
    typical: InstrumentNoise,
    samples: Vec<BaseSample>,
    /// The samples with the noise of one row, where they are means of several.
    single_rows: Vec<BaseSample>,
    /// Covariance of the parameters of a fit without processes.
    parameters: Option<Mat<f64>>,
    /// Further factors for standard deviations at a payload that was not trained.
    other_payload: OnceLock<[f64; 2]>,
}

impl PosteriorCovariance {
    /// Creates the posterior covariance of a fit to `samples`; `None` when the equations cannot be solved.
    pub fn new(fit: ElasticFit, samples: &[BaseSample]) -> Option<Self> {
        let linear = fit.origin.linearise(samples, fit.scales);
        let groups = fit.origin.layout.groups();
        let parameters = match fit.solved {
            Some(_) => None,
            None => Some(covariance(&linear.a, &groups, &fit.hyperparameters)?),
        };
        let kernels = fit.layout.kernels(&fit.hyperparameters);
        let mut curve = fit.layout.curve_prior(&fit.hyperparameters);
        if let Some(prior) = &mut curve {
            prior.amplitude *= DEFLECTION_UNIT * DEFLECTION_UNIT;
        }
        Some(Self {
            fit,
            linear,
            kernels,
            curve,
            typical: InstrumentNoise::rms_over(samples),
            samples: samples.to_vec(),
            single_rows: samples.to_vec(),
            parameters,
            other_payload: OnceLock::new(),
        })
    }

    /// States the noise of one row of every sample, for samples that are means of several rows.
    #[must_use]
    pub fn with_noise_of_rows(mut self, of_rows: &[InstrumentNoise]) -> Self {
        for (sample, noise) in self.single_rows.iter_mut().zip(of_rows) {
            sample.declared_noise = *noise;
        }
        self.typical = InstrumentNoise::rms_over(&self.single_rows);
        self
    }

    /// Returns the samples with the noise of one row, where they are means of several.
    pub fn single_rows(&self) -> &[BaseSample] {
        &self.single_rows
    }

    /// Returns the variance of position and rotation, m² and rad², by which the noise of the quietest row exceeds that of the
    /// quietest sample.
    pub fn excess_of_rows(&self) -> [f64; 2] {
        let all = self
            .single_rows
            .iter()
            .map(|row| self.fit.scales.excess(row));
        all.fold([f64::INFINITY; 2], |least, own| {
            [least[0].min(own[0]), least[1].min(own[1])]
        })
    }

    /// Returns the fit.
    pub fn fit(&self) -> &ElasticFit {
        &self.fit
    }

    /// Returns the samples of the fit.
    pub fn samples(&self) -> &[BaseSample] {
        &self.samples
    }

    /// Returns the further factors for the standard deviations of position and rotation at `payload_kg`, relative to a
    /// trained payload; `left_out` are the factors found by leaving single poses out.
    pub fn payload_factor(&self, payload_kg: Option<f64>, left_out: [f64; 2]) -> [f64; 2] {
        let payload = payload_kg.unwrap_or(0.0);
        let trained = &self.fit.inputs.payloads;
        let widest = trained.iter().fold(0.0_f64, |w, m| w.max(*m));
        let same = |m: &f64| (m - payload).abs() <= SAME_PAYLOAD * widest;
        if trained.iter().any(same) {
            return [1.0; 2];
        }
        *self.other_payload.get_or_init(|| {
            let solved = self.fit.solved.as_ref();
            let found = solved.and_then(|s| payloads_left_out(s, &self.samples));
            let share = |i: usize| found.map_or(1.0, |f| (f[i] / left_out[i]).max(1.0));
            [share(0), share(1)]
        })
    }

    /// Returns the standard deviation of a new measurement about its prediction, times `factor` for position and for
    /// rotation: position along the axes of the base frame in metres, rotation about them in radians. A measurement that
    /// states no noise gets that of a typical training row.
    pub fn standard_deviation<F: Clone>(
        &self,
        sample: &Sample<F>,
        factor: [f64; 2],
    ) -> [f64; ROWS] {
        let whole = Sample {
            observation: Observation::Pose(Pose::identity()),
            ..sample.clone()
        };
        let found = self.of_predictions(&[whole]);
        std::array::from_fn(|a| {
            let variance = found.covariance[(a, a)].max(0.0) + found.noise[a];
            factor[usize::from(a >= 3)] * variance.sqrt()
        })
    }

    /// Returns the covariance of the predictions of `samples`, including rotations where they have orientations.
    pub fn of_predictions<F: Clone>(&self, samples: &[Sample<F>]) -> PredictionCovariance {
        let fit = &self.fit;
        let noisy = |sample: &Sample<F>| {
            sample
                .clone()
                .with_noise(sample.declared_noise.or(self.typical))
        };
        let samples: Vec<Sample<F>> = samples.iter().map(noisy).collect();
        let (rows, first) = rows_of(samples.iter().map(|s| s.observation.equations()));
        let new = fit.origin.linearise(&samples, fit.scales);
        let covariance = match &self.parameters {
            Some(parameters) => {
                let own = Mat::from_fn(rows.len(), new.a.ncols(), |i, j| new.a[(rows[i], j)]);
                product(&product(&own, parameters), Transposed(&own))
            }
            None => self.with_processes(&samples, &new, (&rows, &first)),
        };
        let scale = |row: usize| {
            let scales = fit.scales.of(&samples[row / ROWS]);
            match row % ROWS {
                0..3 => scales.position,
                _ => scales.orientation,
            }
        };
        let scales: Vec<f64> = rows.iter().map(|row| scale(*row)).collect();
        // The parameters alone are fitted with scales that are the noise already.
        let h = |row: usize| match self.parameters {
            Some(_) => 0.0,
            None => fit.hyperparameters[usize::from(row % ROWS >= 3)],
        };
        let noise = |(row, scale): (&usize, &f64)| {
            let h = h(*row);
            scale * scale * libm::exp(h) * new.relative_noise(*row, h).powi(2)
        };
        PredictionCovariance {
            covariance: Mat::from_fn(rows.len(), rows.len(), |i, j| {
                scales[i] * covariance[(i, j)] * scales[j]
            }),
            noise: rows.iter().zip(&scales).map(noise).collect(),
            first,
        }
    }

    /// Returns the covariance of some `rows` of new samples by parameters and processes, in units of their scales; `first` are
    /// those that begin a pose.
    fn with_processes<F>(
        &self,
        samples: &[Sample<F>],
        new: &Linearised,
        (rows, first): (&[usize], &[usize]),
    ) -> Mat<f64> {
        let fit = &self.fit;
        let points: Vec<Point> = samples
            .iter()
            .map(|s| (fit.origin.features(s), s.payload_kg.unwrap_or(0.0)))
            .collect();
        let groups = fit.origin.layout.groups();
        let lambda: Vec<f64> = groups
            .iter()
            .map(|g| prior_variance(*g, &fit.hyperparameters))
            .collect();
        let own = Mat::from_fn(rows.len(), lambda.len(), |i, j| new.a[(rows[i], j)]);
        let scaled = Mat::from_fn(rows.len(), lambda.len(), |i, j| own[(i, j)] * lambda[j]);
        let mut covariance = product(&scaled, Transposed(&own));
        let mut cross = product(&self.linear.a, Transposed(&scaled));
        let trained: Vec<Point> = fit
            .inputs
            .features
            .iter()
            .copied()
            .zip(fit.inputs.payloads.iter().copied())
            .collect();
        for (pose, point) in points.iter().enumerate() {
            let columns = first[pose]..first[pose + 1];
            let add =
                |to: &mut Mat<f64>, jacobian: &Mat<f64>, row: usize, own: usize, k: &[f64]| {
                    for column in columns.clone() {
                        let moved = k
                            .iter()
                            .enumerate()
                            .map(|(c, k)| k * jacobian[(own, c)] * new.jacobian[(rows[column], c)]);
                        to[(row, column)] += moved.sum::<f64>();
                    }
                };
            for (k, other) in trained.iter().enumerate() {
                let between = self.between(point, other);
                for row in ROWS * k..ROWS * (k + 1) {
                    add(&mut cross, &self.linear.jacobian, row, row, &between);
                }
            }
            for (k, other) in points.iter().enumerate() {
                let between = self.between(point, other);
                for (row, own) in rows.iter().enumerate().take(first[k + 1]).skip(first[k]) {
                    add(&mut covariance, &new.jacobian, row, *own, &between);
                }
            }
        }
        if let Some(solved) = &fit.solved {
            let half = solved.factor.half_solve(&cross);
            covariance -= product(Transposed(&half), &half);
        }
        covariance
    }

    /// Returns the covariance of each joint's deflections at two points, in rad² or m².
    fn between(&self, (a, m): &Point, (b, other): &Point) -> Vec<f64> {
        let kinds = &self.fit.inputs.kinds;
        let mut s = [0.0; MAX_JOINTS];
        for (d, kind) in kinds.iter().enumerate() {
            s[d] = similarity(*kind, &a[d], &b[d]);
        }
        let of = |(c, kernel): (usize, &JointKernel<f64>)| {
            let curve = self.curve.as_ref();
            let curve = curve.filter(|_| kinds[c] == JointKind::Revolute);
            kernel.payload_factor(*m, *other) * kernel.joint_factor(&s)
                + curve.map_or(0.0, |prior| prior.between(a[c], b[c]))
        };
        self.kernels.iter().enumerate().map(of).collect()
    }
}

/// Joints in the form that a kernel compares, and a payload in kg.
type Point = (JointTrig<f64>, f64);

/// Leaves the poses of each payload out of `solved` together and returns the factors that their errors ask for. Returns
/// `None` when there is only one payload, or when there are so many that a pose left out alone has no neighbours of its
/// own payload.
fn payloads_left_out(solved: &Posterior, samples: &[BaseSample]) -> Option<[f64; 2]> {
    let payloads = distinct(samples.iter().filter_map(|s| s.payload_kg));
    if !(2..=MAX_GROUPS).contains(&payloads.len()) {
        return None;
    }
    let inverse = solved.factor.lower_inverse();
    let mut all: Standardised = [Vec::new(), Vec::new()];
    for payload in payloads {
        let rows: Vec<usize> = (0..samples.len())
            .filter(|k| samples[*k].payload_kg == Some(payload))
            .flat_map(|k| {
                let rows = samples[k].observation.equations();
                ROWS * k..ROWS * k + rows
            })
            .collect();
        // The errors of the rows left out are the block's inverse times α, and that inverse is the covariance of the
        // errors.
        let block = Mat::from_fn(rows.len(), rows.len(), |i, j| {
            inverse[(rows[i.max(j)], rows[i.min(j)])]
        });
        let alpha = Mat::from_fn(rows.len(), 1, |i, _| solved.alpha[(rows[i], 0)]);
        let factor = Factor::new(block, 1).ok()?;
        let (error, covariance) = (factor.solve(&alpha), factor.inverse());
        for (i, row) in rows.iter().enumerate() {
            let z = error[(i, 0)] / covariance[(i, i)].sqrt();
            all[usize::from(row % ROWS >= 3)].push(z.abs());
        }
    }
    Some(calibration_factor(&mut all))
}
