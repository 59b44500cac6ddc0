//! The search for hyperparameters of the greatest marginal likelihood, and whether the evidence asks for an own-joint curve.
//!
//! A search in all poses begins where one in few of them ended, which costs an eighth for each step, and that one begins again
//! from the parameters alone where it found less evidence than they have.

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

/// When a search ends that began or goes on elsewhere: a third of a nat is far below what samples of a set differ by. (Where a
/// nat was enough, five folds of a FARO set had 0.0410 mm instead of 0.0400.)
const STOP: StopCriteria = StopCriteria::after(60, 1e-10).falling_by(0.3);
/// When it ends where there are no more poses, or where the likelihood may be flat for a while.
const PATIENT_STOP: StopCriteria = StopCriteria::after(40, 1e-10);
/// When a search without processes ends; it only finds a start for the search with everything, and the evidence to beat.
const ROUGH_STOP: StopCriteria = StopCriteria::after(20, 1e-5);
/// Processes can explain any noise. Where the instrument's noise is not stated, its variance is therefore at least this part
/// of the residual of parameters and own-joint curve. (Five folds of a FARO set: 0.0567 mm without the bound, 0.0547
/// with it.)
const LEAST_NOISE: f64 = 0.25;
/// Amplitudes and length scales in rad; the search for a curve begins at the most likely pair. From one smooth curve it did
/// not find the rough curves of a UR10. Where no pair is more likely than no curve, there is no search.
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
/// Least rise of the log evidence for a curve. Curves with less were up to 6 % worse on held-out poses, none with more was.
const CURVE_RISE: f64 = 20.0;
/// With less than this a curve that hardly gains any more is given up before its search ends.
const HOPEFUL_RISE: f64 = 10.0;
/// Least rise by a curve without processes for a search with everything.
const WORTH_A_SEARCH: f64 = 10.0;
/// Most poses of the first search, whose evidence decides on the curve.
const FEW_POSES: usize = 100;

/// What the evidence prefers.
pub(super) struct Learned {
    /// The parametric model; of a curve, without the ripple that it replaces.
    pub state: ParametricModel,
    /// Which hyperparameters there are.
    pub layout: HyperLayout,
    /// Their values.
    pub hyperparameters: Vec<f64>,
    /// How they were found.
    pub report: SearchReport,
}

/// How the hyperparameters were found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SearchReport {
    /// How the last search ended.
    pub end: SearchEnd,
    /// Iterations of all searches that led there.
    pub iterations: u64,
    /// Poses of the last search.
    pub poses: usize,
    /// By how much processes and curve raise the log evidence of the first search's poses above that of the parameters alone,
    /// nats; never negative. 0 without processes.
    pub rise: f64,
}

/// Minus the logarithm of the marginal likelihood times the prior of the length scales: those of one input are alike for all
/// joints. From few poses the likelihood alone gives a joint any length scale that chance prefers.
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

/// The search in a part of the poses.
pub(super) struct HyperparameterSearch<'a> {
    part: Vec<BaseSample>,
    payload_unit: f64,
    scales: NoiseScales,
    options: &'a ElasticOptions,
    context: &'a FitContext<'a>,
}

impl<'a> HyperparameterSearch<'a> {
    /// In at most as many of `samples` as `options` say.
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

    /// The model of the greatest evidence for a state with gear ripple, with a curve or without.
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

    /// The model without a curve in few poses. From large amplitudes the search found up to 17 nats more, and models up to a
    /// third worse on held-out poses of an iiwa: processes that grow without need take the place of parameters.
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
            // Hardly better than the parameters: beside them the likelihood is flat, and falls farther on.
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

    /// The result of searches, each of which began where the one before ended.
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

    /// The noise is at least what is stated of the instrument or a part of `left`, both relative to the scales.
    fn bound_noise(&self, bounds: &mut [(f64, f64)], left: [f64; 2]) {
        let scales = &self.scales;
        let stated = [scales.quietest.position, scales.quietest.orientation];
        let units = [scales.position, scales.orientation];
        for (i, bound) in bounds.iter_mut().take(2).enumerate() {
            let sheet = stated[i].map(|sigma| (sigma / units[i]).powi(2));
            bound.0 = libm::log(sheet.unwrap_or(LEAST_NOISE * left[i]).clamp(1e-4, 1.0));
        }
    }

    /// Calls `use_it` with the likelihood of the first `poses` of the part.
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

    /// A search in the first `poses` of the part.
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

    /// A search in the first `poses` of the part from where another one ended.
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

    /// The model with an own-joint curve in place of the ripple of its orders, at its optimum of few poses; `None` unless the
    /// log evidence rises by more than [`CURVE_RISE`].
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

    /// Whether the noise of an optimum is held by no bound.
    fn is_free(&self, h: &[f64], layout: HyperLayout) -> bool {
        let mut bounds = layout.start_and_bounds(self.payload_unit).1;
        self.bound_noise(&mut bounds, [1.0; 2]);
        h.iter().zip(&bounds).take(2).all(|(h, bound)| *h > bound.0)
    }

    /// Hyperparameters of parameters and curve without processes, from the best of several starts; `None` when the curve is
    /// not worth more. `without` is the optimum without it, if that is known.
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
    /// The optimum of the parameters alone.
    parameters: Minimum,
    /// The optimum with processes.
    few: Minimum,
}

/// A model with a curve: without the ripple that it replaces, its optimum of few poses and the bounds of the search.
type WithCurve = (ParametricModel, HyperLayout, Minimum, Vec<(f64, f64)>);
