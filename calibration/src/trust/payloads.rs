//! Examines the payloads that the rows state: whether the arm sags under them as stated.

use poegp_protocol::cause::Cause;
use poegp_protocol::limits::MAX_JOINTS;
use poegp_runtime::elastic::gravity::GravityRegressors;

use crate::identification::parametric::state::{PriorGroup, ROWS};
use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;
use crate::trust::added_terms::AddedTerms;
use crate::trust::finding::{Finding, Tier};
use crate::trust::geometry::Geometry;
use crate::trust::wording::{length, three_digits};

/// Ratio of the scatter along the direction of sag to that across it above which the payloads are doubted.
const SAG: f64 = 13.0;
/// Drop of χ² per row by gravity terms for each payload above which the payloads are doubted; tested if the scatter ratio
/// along sag exceeds the second number.
const BY_PAYLOAD: (f64, f64) = (3.3, 6.0);
/// Ratio of the scatter along the motion of a joint to that along sag above which the joint is named.
const PLAY: f64 = 0.95;
/// Rise under load above which the payloads are doubted, in its standard deviations.
const RISE: f64 = 4.0;
/// Rise from the lightest to the heaviest payload above which the file is refused, in standard deviations of one component
/// of the position.
const REFUSED_RISE: f64 = 3.0;
/// Payloads that differ by less are the same, in kg.
const SAME: f64 = 0.05;
/// Largest number of different payloads that have terms of their own.
const MOST: usize = 12;

/// The payloads of a geometry's samples.
struct Payloads<'a> {
    geometry: &'a Geometry,
    /// For each sample, the effect of a mass of 1 kg at the target on each joint, in N m or N.
    torques: Vec<[f64; MAX_JOINTS]>,
    /// The different payloads, in kg.
    different: Vec<f64>,
}

/// Returns a warning or a refusal if the payloads do not explain how the arm sags.
pub fn examine(geometry: &Geometry) -> Option<Finding> {
    let payloads = Payloads::of(geometry);
    payloads.rise().or_else(|| payloads.scatter())
}

/// Adds terms to a geometry by which each payload may bend the arm in its own way: no straight line describes how gears and
/// bearings give way.
pub fn with_terms_of_each_payload(geometry: Geometry) -> Geometry {
    let payloads = Payloads::of(&geometry);
    if !payloads.are_few() {
        return geometry;
    }
    let terms = payloads.terms(|m| m);
    let (mut schur, right) = terms.adapted(&geometry);
    let precision = PriorGroup::Payload.prior_sd().powi(-2);
    for i in 0..schur.nrows() {
        schur[(i, i)] += precision;
    }
    let Ok(factor) = Factor::new(schur, 1) else {
        return geometry;
    };
    let (inverse, step) = (factor.inverse(), factor.solve(&right));
    let follows = &geometry.covariance * terms.with_all.transpose();
    let (before, added) = follows.shape();
    let count = before + added;
    let mut covariance = Mat::zeros(count, count);
    let crossed = &follows * &inverse;
    covariance
        .view_mut((0, 0), (before, before))
        .copy_from(&(&geometry.covariance + &crossed * follows.transpose()));
    covariance
        .view_mut((0, before), (before, added))
        .copy_from(&-&crossed);
    covariance
        .view_mut((before, 0), (added, before))
        .copy_from(&-crossed.transpose());
    covariance
        .view_mut((before, before), (added, added))
        .copy_from(&inverse);
    let mut next_step = Mat::zeros(count, 1);
    next_step
        .rows_mut(0, before)
        .copy_from(&(&geometry.next_step - &follows * &step));
    next_step.rows_mut(before, added).copy_from(&step);
    let determined: f64 = (0..added).map(|i| 1.0 - inverse[(i, i)] * precision).sum();
    let mut a = geometry.linear.a.clone().resize_horizontally(count, 0.0);
    for row in 0..a.nrows() {
        for term in 0..added {
            a[(row, before + term)] = payloads.effect(row, term, |m| m);
        }
    }
    let mut out = geometry;
    out.linear.a = a;
    out.covariance = covariance;
    out.next_step = next_step;
    out.determined += determined;
    out.sd.resize(count, PriorGroup::Payload.prior_sd());
    out
}

impl<'a> Payloads<'a> {
    fn of(geometry: &'a Geometry) -> Self {
        let all = geometry.samples.iter().filter_map(|s| s.payload_kg);
        let mut different: Vec<f64> = all.collect();
        different.sort_by(f64::total_cmp);
        different.dedup_by(|a, b| (*a - *b).abs() < SAME);
        let torques = |row: usize| {
            let (state, sample) = (&geometry.state, &geometry.samples[row]);
            let chain = state.chain(sample.tool);
            let motions = chain.motions(&sample.serial_joints);
            let (frames, target) = chain.joint_frames_with(&motions);
            let at =
                GravityRegressors::new(state.kinds(), &frames, &target, &state.gravity.gravity);
            let mut out = [0.0; MAX_JOINTS];
            for (c, torque) in out.iter_mut().enumerate().take(state.layout.joints) {
                *torque = at.payload(c).0;
            }
            out
        };
        Self {
            torques: (0..geometry.samples.len()).map(torques).collect(),
            geometry,
            different,
        }
    }

    /// Returns whether each payload can have terms of its own.
    fn are_few(&self) -> bool {
        self.geometry.is_whole() && (2..=MOST).contains(&self.different.len())
    }

    /// Returns the effect on a residual component of a term of [`terms`](Self::terms).
    fn effect(&self, row: usize, term: usize, scale: fn(f64) -> f64) -> f64 {
        let joints = self.geometry.state.layout.joints;
        let (sample, joint) = (row / ROWS, term % joints);
        let carried = self.geometry.samples[sample].payload_kg.unwrap_or(0.0);
        let payload = self.different[term / joints];
        if (payload - carried).abs() < SAME {
            let effect = self.geometry.linear.jacobian[(row, joint)];
            scale(payload) * self.torques[sample][joint] * effect
        } else {
            0.0
        }
    }

    /// Returns terms for each payload and joint: a deflection in proportion to the torque, times `scale` of the payload.
    fn terms(&self, scale: fn(f64) -> f64) -> AddedTerms {
        let g = self.geometry;
        let count = g.state.layout.joints * self.different.len();
        AddedTerms::over(g, count, 0..g.samples.len(), |_, row, term| {
            self.effect(row, term, scale)
        })
    }

    /// Examines whether the fitted payload terms lift the target. The priors allow both signs, and with exchanged labels
    /// nothing is left in the residuals.
    fn rise(&self) -> Option<Finding> {
        let g = self.geometry;
        let Lift {
            lift,
            variance,
            carried,
        } = Lift::of(g)?;
        let noise = g.noise_factor() * g.leniency();
        let rise = lift / (variance.sqrt() * noise).max(f64::MIN_POSITIVE);
        let span = self.different.last()? - self.different.first()?;
        let of_span = span * lift / carried;
        (rise > RISE).then(|| {
            let text = format!(
                "the arm rises under load, by {} with {} kg: are the payloads exchanged, or does --gravity point up?",
                length(of_span * g.scales.position),
                three_digits(span)
            );
            let tier = Tier::refused_if(of_span > REFUSED_RISE * noise);
            Finding::new(Cause::Payload, tier, text, rise, RISE)
        })
    }

    /// Returns the joint, from 0, along whose motion the residuals scatter most, if that is nearly as much as `along` the
    /// direction of sag.
    fn joint_with_play(&self, along: f64) -> Option<usize> {
        let g = self.geometry;
        let of = |joint: usize| -> f64 {
            let rows = g.residuals.iter().zip(&g.weights).enumerate();
            rows.map(|(k, (residual, weight))| {
                let moves = |b: usize| g.linear.jacobian[(ROWS * k + b, joint)];
                let square: f64 = (0..ROWS).map(|b| moves(b).powi(2)).sum();
                let part: f64 = (0..ROWS).map(|b| moves(b) * residual[b]).sum();
                weight * part * part / square.max(f64::MIN_POSITIVE)
            })
            .sum()
        };
        let all = (0..g.state.layout.joints).map(|joint| (joint, of(joint)));
        let (joint, most) = all.max_by(|a, b| a.1.total_cmp(&b.1))?;
        (most > PLAY * along).then_some(joint)
    }

    /// Examines whether the residuals scatter along the direction of sag.
    fn scatter(&self) -> Option<Finding> {
        let g = self.geometry;
        if !g.is_whole() {
            return None;
        }
        let joints = g.state.layout.joints;
        let (mut along, mut across, mut equations) = (0.0, 0.0, 0.0);
        for (k, torque) in self.torques.iter().enumerate() {
            let weight = g.weights[k];
            let sag: [f64; ROWS] = std::array::from_fn(|b| {
                (0..joints)
                    .map(|c| g.linear.jacobian[(ROWS * k + b, c)] * torque[c])
                    .sum()
            });
            let norm = sag.iter().map(|x| x * x).sum::<f64>().sqrt();
            if norm <= 0.0 {
                continue;
            }
            let residual = &g.residuals[k];
            let part = sag.iter().zip(residual).map(|(s, r)| s * r).sum::<f64>() / norm;
            along += weight * part * part;
            across += weight * (residual.iter().map(|r| r * r).sum::<f64>() - part * part);
            equations += (g.samples[k].observation.equations() - 1) as f64;
        }
        let count = g.samples.len() as f64;
        let ratio = (along / count) / (across / equations.max(1.0)).max(1e-12);
        let warning = |text: String, value: f64, threshold: f64| {
            Finding::new(Cause::Payload, Tier::Warning, text, value, threshold)
        };
        if ratio > SAG {
            let has_play = match self.joint_with_play(along) {
                Some(joint) => format!("joint {} has play", joint + 1),
                None => "a joint has play".to_owned(),
            };
            let why = match self.different.is_empty() {
                true => format!(
                    "the file has no payload_kg, so {has_play}, or several payloads were carried"
                ),
                false => "payload_kg is wrong or exchanged in some rows, or several payloads were carried but only one \
                          is stated"
                    .to_owned(),
            };
            let text = format!(
                "the measurements scatter {} times as much along the direction of sag as across it: {why}",
                three_digits(ratio)
            );
            return Some(warning(text, ratio, SAG));
        }
        if ratio <= BY_PAYLOAD.1 || !self.are_few() {
            return None;
        }
        let drops = self.terms(|_| 1.0).optimum(g)?.drops;
        let drop = drops.iter().sum::<f64>() / count;
        let of_payload: Vec<f64> = drops.chunks(joints).map(|c| c.iter().sum()).collect();
        let worst =
            (0..of_payload.len()).max_by(|a, b| of_payload[*a].total_cmp(&of_payload[*b]))?;
        (drop > BY_PAYLOAD.0).then(|| {
            let text = format!(
                "the arm does not sag in proportion to payload_kg, least so at {} kg: is a value in another unit, or are \
                 two exchanged?",
                three_digits(self.different[worst])
            );
            warning(text, drop, BY_PAYLOAD.0)
        })
    }
}

/// Sums over the poses: how far the fitted payload terms lift the target against gravity, in units of the rows' noise, with
/// the variance, and the payloads carried.
pub struct Lift {
    /// Positive where loads lift the target.
    pub lift: f64,
    variance: f64,
    carried: f64,
}

impl Lift {
    /// Returns the sums; `None` without payload terms.
    pub fn of(g: &Geometry) -> Option<Self> {
        let groups = g.state.layout.groups();
        let first = groups.iter().position(|p| *p == PriorGroup::Payload)?;
        let terms = groups.iter().filter(|p| **p == PriorGroup::Payload).count();
        let up = -g.state.gravity.gravity.try_normalize(0.0)?;
        let mut weighted = Mat::zeros(1, groups.len());
        let mut carried = 0.0;
        for (k, sample) in g.samples.iter().enumerate() {
            carried += g.weights[k] * sample.payload_kg.unwrap_or(0.0);
            for term in first..first + terms {
                let lift = (0..3).map(|b| up[b] * g.linear.a[(ROWS * k + b, term)]);
                weighted[(0, term)] += g.weights[k] * lift.sum::<f64>();
            }
        }
        let lift: f64 = (first..first + terms)
            .map(|i| weighted[(0, i)] * (g.state.deviation[i] + g.next_step[(i, 0)]))
            .sum();
        let variance = (&weighted * &g.covariance * weighted.transpose())[(0, 0)];
        Some(Self {
            lift,
            variance,
            carried,
        })
    }
}
