//! The search for the hyperparameters of greatest marginal likelihood, and the decision whether the evidence supports an
//! own-joint curve.
//!
//! A first search uses few poses; each of its steps costs an eighth of one with all poses. It is repeated from the
//! optimum of the parameters alone if it found less evidence than they have. The search with all poses starts where the
//! first one ended.

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use crate::identification::parametric::state::ParametricModel;
use crate::learning::elastic::hyperparameter_objective::HyperparameterObjective;
use crate::learning::elastic::hyperparameters::{DEFLECTION_UNIT, HyperLayout};
use crate::learning::elastic::inputs::Inputs;
use crate::learning::elastic::likelihood::MarginalLikelihood;
use crate::learning::elastic::options::{ElasticOptions, mean_payload};
use crate::measurement::noise::NoiseScales;
use crate::measurement::sample::BaseSample;
use crate::numeric::lbfgs::{
    Minimum, Objective, SearchEnd, StopCriteria, minimize, minimize_in_units,
};
use crate::progress::{Cancelled, FitContext};
use poegp_protocol::limits::MAX_CURVE_ORDER;

/// Stop criteria of a search that starts at another optimum or is continued elsewhere: a third of a nat is far below the
/// differences between samples of a set. (Where a nat was enough, five folds of a FARO set had 0.0410 mm instead of
/// 0.0400.)
const STOP: StopCriteria = StopCriteria::after(60, 1e-10).falling_by(0.3);
/// Stop criteria where there are no more poses, or where the likelihood may be flat for a while.
const PATIENT_STOP: StopCriteria = StopCriteria::after(40, 1e-10);
/// Stop criteria of a search without processes, which only gives a start for the full search and the evidence to beat.
const ROUGH_STOP: StopCriteria = StopCriteria::after(20, 1e-5);
/// Least noise variance where the instrument's noise is not stated, as a share of the residual variance of parameters and
/// own-joint curve: processes can explain any noise. (Five folds of a FARO set: 0.0567 mm without the bound, 0.0547 with
/// it.)
const LEAST_NOISE: f64 = 0.25;
/// Amplitudes and lengthscales in rad; the search for a curve starts at the most likely pair. From a single smooth
/// curve, it did not find the rough curves of a UR10. Where no pair is more likely than no curve, there is no search.
const CURVE_STARTS: [(f64, f64); 9] = [
    (4e-4, 0.06),
    (4e-4, 0.15),
    (4e-4, 0.5),
    (1.5e-4, 0.06),
    (1.5e-4, 0.15),
    (1.5e-4, 0.5),
    (5e-5, 0.06),
    (5e-5, 0.15),
    (5e-5, 0.5),
];
/// Least rise of the log evidence for a curve. Curves with less were up to 6 % worse on held-out poses, those with more
/// never.
const CURVE_RISE: f64 = 20.0;
/// Rise of the log evidence below which a curve that hardly gains any more is given up before its search ends.
const HOPEFUL_RISE: f64 = 10.0;
/// Least rise by a curve without processes that justifies a full search.
const WORTH_A_SEARCH: f64 = 10.0;
/// Largest number of poses of the first search, whose evidence decides on the curve.
const FEW_POSES: usize = 100;

/// The model that the evidence prefers.
pub(super) struct Learned {
    /// Parametric model; with a curve, without the ripple that the curve replaces.
    pub state: ParametricModel,
    /// Layout of the hyperparameters.
    pub layout: HyperLayout,
    /// Values of the hyperparameters.
    pub hyperparameters: Vec<f64>,
    /// Report of the search.
    pub report: SearchReport,
}

/// Report of the search for hyperparameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SearchReport {
    /// Reason why the last search ended.
    pub end: SearchEnd,
    /// Number of iterations of all searches that led to the result.
    pub iterations: u64,
    /// Number of poses of the last search.
    pub poses: usize,
    /// Rise of the log evidence by processes and curve over the parameters alone, for the poses of the first search, in
    /// nats; never negative. Zero without processes.
    pub rise: f64,
}

/// Negative logarithm of the marginal likelihood times the prior of the lengthscales, by which those of one input are
/// similar for all joints. With few poses, the likelihood alone gives a joint any lengthscale that chance prefers.
struct Posterior<'a> {
    likelihood: HyperparameterObjective<'a>,
    layout: HyperLayout,
    processes: bool,
}

impl Objective for Posterior<'_> {
    fn value_and_gradient(&self, h: &[f64]) -> (f64, Vec<f64>) {
        let (mut value, mut gradient) = self.likelihood.value_and_gradient(h);
        if !self.processes {
            return (value, gradient);
        }
        value += self.layout.add_scale_prior(h, &mut gradient);
        (value, gradient)
    }
}

/// A search for hyperparameters in a subset of the poses.
pub(super) struct HyperparameterSearch<'a> {
    part: Vec<BaseSample>,
    payload_unit: f64,
    scales: NoiseScales,
    options: &'a ElasticOptions,
    context: &'a FitContext<'a>,
}

impl<'a> HyperparameterSearch<'a> {
    /// Creates a search in at most as many of `samples` as `options` allow.
    pub fn new(
        samples: &[BaseSample],
        scales: NoiseScales,
        options: &'a ElasticOptions,
        context: &'a FitContext<'a>,
    ) -> Self {
        let mut order: Vec<usize> = (0..samples.len()).collect();
        order.shuffle(&mut ChaCha8Rng::seed_from_u64(1));
        order.truncate(options.hyperparameter_poses);
        Self {
            part: order.iter().map(|i| samples[*i].clone()).collect(),
            payload_unit: mean_payload(samples),
            scales,
            options,
            context,
        }
    }

    /// Returns the model of greatest evidence, with or without a curve, for a state with gear ripple.
    pub fn learn(
        &self,
        with_ripple: &ParametricModel,
        layout: HyperLayout,
    ) -> Result<Learned, Cancelled> {
        let (start, free) = layout.start_and_bounds(self.payload_unit);
        let mut bounds = free.clone();
        self.bound_noise(&mut bounds, [1.0; 2]);
        let all = self.part.len();
        if !self.options.processes {
            let found = self.minimum(
                with_ripple,
                all,
                (layout, false),
                &start,
                &bounds,
                &PATIENT_STOP,
            )?;
            return Ok(self.learned(with_ripple.clone(), layout, &[&found], 0.0));
        }
        let plain = self.plain(with_ripple, layout, &start, &bounds)?;
        let parameters = plain.parameters.value;
        let (state, layout, few, bounds) = match self.with_curve(with_ripple, layout, &plain)? {
            Some(curved) => curved,
            None => (with_ripple.clone(), layout, plain.few, bounds),
        };
        let rise = parameters - few.value;
        if all <= FEW_POSES {
            return Ok(self.learned(state, layout, &[&few], rise));
        }
        let found = self.go_on(&state, all, (layout, true), &few, &bounds, &STOP)?;
        Ok(self.learned(state, layout, &[&few, &found], rise))
    }

    /// Returns the model without a curve in few poses. From large amplitudes, the search found up to 17 nats more, but
    /// models up to a third worse on held-out poses of an iiwa: processes that grow without need replace parameters.
    fn plain(
        &self,
        state: &ParametricModel,
        layout: HyperLayout,
        start: &[f64],
        bounds: &[(f64, f64)],
    ) -> Result<Plain, Cancelled> {
        let alone = |from: &[f64]| {
            self.minimum(state, FEW_POSES, (layout, false), from, bounds, &ROUGH_STOP)
        };
        let few = |from: &[f64], stop: &StopCriteria| {
            self.minimum(state, FEW_POSES, (layout, true), from, bounds, stop)
        };
        let parameters = alone(start)?;
        let goes_on = self.part.len() > FEW_POSES;
        let mut found = few(start, if goes_on { &STOP } else { &PATIENT_STOP })?;
        if goes_on && found.value > parameters.value - WORTH_A_SEARCH {
            // Hardly better than the parameters: near them the likelihood is flat and falls farther on.
            let iterations = found.iterations;
            found = few(&found.x, &PATIENT_STOP)?;
            found.iterations += iterations;
        }
        if found.value > parameters.value {
            let again = few(
                &layout.without_processes(&parameters.x, bounds),
                &PATIENT_STOP,
            )?;
            if again.value < found.value {
                found = again;
            }
        }
        Ok(Plain {
            parameters,
            few: found,
        })
    }

    /// Assembles the result of searches, each of which started where the one before ended.
    fn learned(
        &self,
        state: ParametricModel,
        layout: HyperLayout,
        searches: &[&Minimum],
        rise: f64,
    ) -> Learned {
        let last = searches[searches.len() - 1];
        Learned {
            state,
            layout,
            hyperparameters: last.x.clone(),
            report: SearchReport {
                end: last.end,
                iterations: searches.iter().map(|found| found.iterations).sum(),
                poses: self.part.len(),
                rise,
            },
        }
    }

    /// Sets the lower bounds of the noise: what is stated of the instrument, or else a share of `left`, both relative to
    /// the scales.
    fn bound_noise(&self, bounds: &mut [(f64, f64)], left: [f64; 2]) {
        let scales = &self.scales;
        let stated = [scales.quietest.position, scales.quietest.orientation];
        let units = [scales.position, scales.orientation];
        for (i, bound) in bounds.iter_mut().take(2).enumerate() {
            let sheet = stated[i].map(|sigma| (sigma / units[i]).powi(2));
            bound.0 = libm::log(sheet.unwrap_or(LEAST_NOISE * left[i]).clamp(1e-4, 1.0));
        }
    }

    /// Calls `use_it` with the objective for the first `poses` of the subset.
    fn with_likelihood<T>(
        &self,
        state: &ParametricModel,
        poses: usize,
        (layout, processes): (HyperLayout, bool),
        use_it: impl FnOnce(&Posterior<'_>) -> T,
    ) -> T {
        let part = &self.part[..poses.min(self.part.len())];
        let linear = state.linearise(part, self.scales);
        let inputs = Inputs::new(state, part);
        let similarities = inputs.similarities();
        let groups = state.layout.groups();
        let evidence = MarginalLikelihood {
            linear: &linear,
            groups: &groups,
            similarities: &similarities,
            waves: &inputs.waves(layout),
            inputs: &inputs,
            layout,
            processes,
            threads: self.context.threads(),
        };
        use_it(&Posterior {
            likelihood: HyperparameterObjective::new(&evidence),
            layout,
            processes,
        })
    }

    /// Searches in the first `poses` of the subset.
    fn minimum(
        &self,
        state: &ParametricModel,
        poses: usize,
        model: (HyperLayout, bool),
        start: &[f64],
        bounds: &[(f64, f64)],
        stop: &StopCriteria,
    ) -> Result<Minimum, Cancelled> {
        self.with_likelihood(state, poses, model, |objective| {
            minimize(objective, start, bounds, stop, self.context)
        })
    }

    /// Searches in the first `poses` of the subset from where another search ended.
    fn go_on(
        &self,
        state: &ParametricModel,
        poses: usize,
        model: (HyperLayout, bool),
        from: &Minimum,
        bounds: &[(f64, f64)],
        stop: &StopCriteria,
    ) -> Result<Minimum, Cancelled> {
        self.with_likelihood(state, poses, model, |objective| {
            minimize_in_units(objective, &from.x, &from.units, bounds, stop, self.context)
        })
    }

    /// Returns the model with an own-joint curve in place of the ripple of its orders, at its optimum of few poses;
    /// `None` unless the log evidence rises by more than [`CURVE_RISE`].
    fn with_curve(
        &self,
        with_ripple: &ParametricModel,
        layout: HyperLayout,
        plain: &Plain,
    ) -> Result<Option<WithCurve>, Cancelled> {
        if !self.options.curve {
            return Ok(None);
        }
        let mut state = with_ripple.clone();
        state.retain_ripple(|line| line.cycles > MAX_CURVE_ORDER as f64);
        let curved = HyperLayout {
            curve: true,
            ..layout
        };
        let is_same = state.ripple.len() == with_ripple.ripple.len();
        let without =
            Some(&plain.parameters).filter(|found| is_same && self.is_free(&found.x, layout));
        let Some(alone) = self.curve_alone(&state, layout, curved, without)? else {
            return Ok(None);
        };
        let (mut start, mut bounds) = curved.start_and_bounds(self.payload_unit);
        start[..plain.few.x.len()].copy_from_slice(&plain.few.x);
        for i in [0, 1, curved.curve_amplitude(), curved.curve_scale()] {
            start[i] = alone[i];
        }
        self.bound_noise(&mut bounds, [libm::exp(alone[0]), libm::exp(alone[1])]);
        let hopeful = plain.few.value - HOPEFUL_RISE;
        let stop = PATIENT_STOP.falling_by(1.0).unless_below(hopeful);
        let few = self.minimum(&state, FEW_POSES, (curved, true), &start, &bounds, &stop)?;
        if plain.few.value - few.value <= CURVE_RISE {
            return Ok(None);
        }
        Ok(Some((state, curved, few, bounds)))
    }

    /// Returns whether no bound holds the noise of an optimum.
    fn is_free(&self, h: &[f64], layout: HyperLayout) -> bool {
        let mut bounds = layout.start_and_bounds(self.payload_unit).1;
        self.bound_noise(&mut bounds, [1.0; 2]);
        h.iter().zip(&bounds).take(2).all(|(h, bound)| *h > bound.0)
    }

    /// Returns the hyperparameters of parameters and curve without processes, from the best of several starts; `None`
    /// when the curve is not worth a full search. `without` is the optimum without the curve, if that is known.
    fn curve_alone(
        &self,
        state: &ParametricModel,
        layout: HyperLayout,
        curved: HyperLayout,
        without: Option<&Minimum>,
    ) -> Result<Option<Vec<f64>>, Cancelled> {
        let without = match without {
            Some(found) => found.clone(),
            None => {
                let (start, bounds) = layout.start_and_bounds(self.payload_unit);
                let model = (layout, false);
                self.minimum(state, FEW_POSES, model, &start, &bounds, &ROUGH_STOP)?
            }
        };
        let (mut start, bounds) = curved.start_and_bounds(self.payload_unit);
        start[..without.x.len()].copy_from_slice(&without.x);
        self.with_likelihood(state, FEW_POSES, (curved, false), |objective| {
            let mut best: Option<(f64, Vec<f64>)> = None;
            for (amplitude, scale) in CURVE_STARTS {
                start[curved.curve_amplitude()] = 2.0 * libm::log(amplitude / DEFLECTION_UNIT);
                start[curved.curve_scale()] = libm::log(scale);
                let (value, _) = objective.value_and_gradient(&start);
                if value < best.as_ref().map_or(without.value, |b| b.0) {
                    best = Some((value, start.clone()));
                }
            }
            let Some((_, start)) = best else {
                return Ok(None);
            };
            let found = minimize(objective, &start, &bounds, &ROUGH_STOP, self.context)?;
            Ok((without.value - found.value > WORTH_A_SEARCH).then_some(found.x))
        })
    }
}

/// The model without a curve in few poses.
struct Plain {
    /// Optimum of the parameters alone.
    parameters: Minimum,
    /// Optimum with processes.
    few: Minimum,
}

/// A model with a curve: its state without the ripple that the curve replaces, its layout, its optimum of few poses and
/// the bounds of the search.
type WithCurve = (ParametricModel, HyperLayout, Minimum, Vec<(f64, f64)>);
