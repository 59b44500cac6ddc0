//! Stated lengths that the touches contradict.
//!
//! If all lengths are off alike, an arm of another size fits the touches; if the zero of a wire, the radius of a ball or a tip is off by
//! many standard deviations, so does an arm with much noise. Fits that believe less find them:
//!
//! - an arm of any size. Its size by the stated lengths, against the nominal model and the class, is in doubt from [`SIZE`]
//!   standard deviations;
//! - zeros, radii or tips that may be anything. One is in doubt from [`OWN`] standard deviations, if the noise falls with it;
//! - scales of wires and boards, and known distances, that may be anything. One is in doubt from [`OWN`] standard deviations,
//!   if the rows are clearly more probable with it.
//!
//! Of several, the one with which the rows are most probable is named. A scale and a distance that explain the rows equally
//! well are named together.

use crate::identification::touch::arm::Group;
use crate::identification::touch::fit::{ANY_SIZE, Noise, TouchFit, TouchProblem};
use crate::measurement::touch::{Feature, FeatureKind, KnownDistance, Reading, TouchRow, TouchSet};
use crate::numeric::matrix::Mat;

/// Standard deviations from which the size by all stated lengths together is in doubt.
pub const SIZE: f64 = 3.0;
/// Standard deviations from which one zero, radius or tip is in doubt.
pub const OWN: f64 = 5.0;
/// Largest standard deviation of the size, in those of the class, with which it is determined: an arm of any size becomes
/// smaller where nothing holds it, because its errors do, too. Beyond it, the size is in doubt from [`OWN`] standard deviations.
const DETERMINED: f64 = 3.0;
/// Share of the noise, as a variance, that must be left when a zero, a radius or a tip is not believed.
const EXPLAINED: f64 = 0.75;
/// Standard deviation of a length that is not believed, m.
const ANYTHING: f64 = 0.1;
/// Standard deviation of a scale that is not believed, relative to the reading.
const ANY_SCALE: f64 = 0.05;
/// Difference of −2 log of the evidence from which on one explanation is clearly more probable than another.
const CLEAR: f64 = 8.0;

/// A length that a file states.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StatedLength {
    /// All of them alike.
    All,
    /// Zero of the anchor with this index.
    Zero(usize),
    /// Radius of the sphere with this index.
    Radius(usize),
    /// Position of the tip with this index, along an axis of the flange.
    Tip(usize, usize),
    /// Scale of the anchor or the board with this index.
    Scale(usize),
    /// Known distance with this index.
    Distance(usize),
}

impl StatedLength {
    /// Returns the standard deviation of the length when it is not believed.
    fn wide(self) -> f64 {
        match self {
            Self::All => ANY_SIZE,
            Self::Scale(_) => ANY_SCALE,
            _ => ANYTHING,
        }
    }

    /// Returns whether the length is one of two that contradict each other: the scale of a wire or a board, or a known distance.
    pub fn compares(self) -> bool {
        matches!(self, Self::Scale(_) | Self::Distance(_))
    }
}

/// A stated length that the touches contradict.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Doubt {
    /// The length in doubt.
    pub length: StatedLength,
    /// By the touches, minus what is stated, in m; for [`StatedLength::All`] how much larger than nominal the arm is with
    /// them, relative to its size; for [`StatedLength::Scale`] how much too small a reading or a board is, relative to it.
    pub off: f64,
    /// Standard deviation of `off`, by what is stated and by the touches.
    pub sigma: f64,
}

impl Doubt {
    /// Creates a doubt from an estimate with a prior of standard deviation `wide`, which it removes.
    fn new(length: StatedLength, (mean, variance): (f64, f64), stated: f64) -> Self {
        let wide = length.wide();
        let rest = (1.0 - variance / (wide * wide)).max(1e-6);
        Self {
            length,
            off: mean / rest,
            sigma: libm::sqrt(stated * stated + variance / rest),
        }
    }

    /// Returns `off` in standard deviations, without its sign.
    pub fn sigmas(&self) -> f64 {
        (self.off / self.sigma).abs()
    }
}

/// Computes the size of the arm by the stated lengths, with the fit of an arm of any size; `None` if the lengths do not
/// determine it.
pub fn size(problem: &TouchProblem, nominal_arm: &TouchFit) -> Option<(Doubt, TouchFit)> {
    let mut fit = nominal_arm.clone();
    fit.arm = problem.arm_of_any_size();
    let mut theta = nominal_arm.arm.theta.clone();
    theta.push(0.0);
    fit.arm.update(&theta);
    fit.moves = true;
    fit.settle_robustly(problem);
    let at = fit
        .arm
        .columns
        .iter()
        .position(|c| c.group == Group::Size)?;
    let wide = believed(&fit, problem)?;
    let variance = wide.solved(problem)?.covariance()[(at, at)] * ANY_SIZE.powi(2);
    let found = (fit.arm.theta[at], variance);
    let doubt = Doubt::new(StatedLength::All, found, 0.0);
    let is_determined = doubt.sigma < DETERMINED * size_of_class(&wide, problem);
    (is_determined || doubt.sigmas() > OWN).then_some((doubt, fit))
}

/// Returns the standard deviation of the size by the priors of a fit: that of the weighted mean of independent links.
fn size_of_class(fit: &TouchFit, problem: &TouchProblem) -> f64 {
    let frames = problem.nominal.frames();
    let mut axes = vec![0; frames.len()];
    let mut weight = 0.0;
    for (column, sd) in fit.arm.columns.iter().zip(fit.priors(problem)) {
        if column.group == Group::Length {
            let frame = &frames[column.index];
            let lever = frame.rotation.transpose() * frame.translation;
            let axis = &mut axes[column.index];
            weight += (lever[*axis] / sd).powi(2);
            *axis += 1;
        }
    }
    1.0 / f64::sqrt(weight)
}

/// Returns a fit with the priors that are stated for an arm beyond its class.
fn believed(fit: &TouchFit, problem: &TouchProblem) -> Option<TouchFit> {
    let covariance = fit.solved(problem)?.covariance();
    let beyond = fit.beyond_class(problem, &covariance);
    Some(fit.widened(problem, beyond, 1.0))
}

/// Takes the priors of one kind away, and returns what was stated with its standard deviation in m.
type Loosen = fn(&mut TouchSet) -> Vec<(StatedLength, f64)>;

/// Computes what the touches say of every zero, radius and tip if those of its kind are not believed, with the fit.
pub fn own(problem: &TouchProblem) -> Vec<(Vec<Doubt>, TouchFit, f64)> {
    let kinds: [Loosen; 5] = [zeros, radii, tips, scales, distances];
    let of = |loosened: Loosen| {
        let mut set = problem.set.clone();
        let lengths = loosened(&mut set);
        let loose = TouchProblem {
            set: &set,
            ..problem.clone()
        };
        (!lengths.is_empty()).then(|| doubts(&loose, &lengths))?
    };
    kinds.into_iter().filter_map(of).collect()
}

fn zeros(set: &mut TouchSet) -> Vec<(StatedLength, f64)> {
    let features = set.features.iter_mut().enumerate();
    let of = |(index, feature): (usize, &mut Feature)| match &mut feature.kind {
        FeatureKind::Anchor { zero_sigma, .. } => {
            Some((StatedLength::Zero(index), loosened(zero_sigma, ANYTHING)?))
        }
        _ => None,
    };
    features.filter_map(of).collect()
}

fn radii(set: &mut TouchSet) -> Vec<(StatedLength, f64)> {
    let features = set.features.iter_mut().enumerate();
    let of = |(index, feature): (usize, &mut Feature)| match &mut feature.kind {
        FeatureKind::Sphere {
            radius: Some(_),
            radius_sigma,
            ..
        } => Some((
            StatedLength::Radius(index),
            loosened(radius_sigma, ANYTHING)?,
        )),
        _ => None,
    };
    features.filter_map(of).collect()
}

fn tips(set: &mut TouchSet) -> Vec<(StatedLength, f64)> {
    let sees =
        |reading: &Reading| !matches!(reading, Reading::Level { .. } | Reading::Board { .. });
    let rows = &set.rows;
    let is_seen = |tip: usize| rows.iter().any(|row| row.tip == tip && sees(&row.reading));
    let mut out = Vec::new();
    for (tip, stated) in set.tips.iter_mut().enumerate() {
        let sigma = is_seen(tip)
            .then(|| loosened(&mut stated.sigma, ANYTHING))
            .flatten();
        out.extend(
            sigma
                .iter()
                .flat_map(|sigma| (0..3).map(move |axis| (StatedLength::Tip(tip, axis), *sigma))),
        );
    }
    out
}

fn scales(set: &mut TouchSet) -> Vec<(StatedLength, f64)> {
    // By itself, the scale of a wire or of a board is the size of the arm.
    if !has_other_length(set) {
        return Vec::new();
    }
    let features = set.features.iter_mut().enumerate();
    let of = |(index, feature): (usize, &mut Feature)| match &mut feature.kind {
        FeatureKind::Anchor { scale_sigma, .. } => Some((
            StatedLength::Scale(index),
            loosened(scale_sigma, ANY_SCALE)?,
        )),
        FeatureKind::Board(board) => Some((
            StatedLength::Scale(index),
            loosened(&mut board.scale_sigma, ANY_SCALE)?,
        )),
        _ => None,
    };
    features.filter_map(of).collect()
}

fn distances(set: &mut TouchSet) -> Vec<(StatedLength, f64)> {
    let known = set.distances.iter_mut().enumerate();
    let of = |(index, known): (usize, &mut KnownDistance)| {
        Some((
            StatedLength::Distance(index),
            loosened(&mut known.sigma, ANYTHING)?,
        ))
    };
    known.filter_map(of).collect()
}

/// Returns whether a wire is not the only length that a set states.
fn has_other_length(set: &TouchSet) -> bool {
    let states = |feature: &Feature| match &feature.kind {
        FeatureKind::Anchor { .. } | FeatureKind::Board(_) => true,
        FeatureKind::Sphere { radius, .. } => radius.is_some(),
        _ => false,
    };
    let is_tracked = |row: &TouchRow| matches!(row.reading, Reading::Tracker(_));
    let of_features = set.features.iter().filter(|f| states(f)).count();
    let tracked = usize::from(set.rows.iter().any(is_tracked));
    set.distances.len() + of_features + tracked > 1
}

/// Replaces a standard deviation by a wide one, and returns it; `None` if it is as wide already.
fn loosened(sigma: &mut f64, wide: f64) -> Option<f64> {
    (*sigma < wide).then(|| std::mem::replace(sigma, wide))
}

/// Fits a set in which `lengths`, with their stated standard deviations, are not believed.
fn doubts(
    loose: &TouchProblem,
    lengths: &[(StatedLength, f64)],
) -> Option<(Vec<Doubt>, TouchFit, f64)> {
    let fit = TouchFit::new(loose, &TouchFit::on_nominal(loose, 0));
    let solved = believed(&fit, loose)?.solved(loose)?;
    let covariance = solved.covariance();
    let of = |(length, stated): &(StatedLength, f64)| {
        let (mean, variance) = match *length {
            StatedLength::All => return None,
            StatedLength::Distance(index) => {
                let known = &loose.set.distances[index];
                let (missed, _) = fit.distance(known.between, known.distance)?;
                let measured = fit.distance_by_touches(loose, known.between)?;
                (missed, measured.sigma.powi(2))
            }
            StatedLength::Zero(feature)
            | StatedLength::Radius(feature)
            | StatedLength::Scale(feature) => {
                // Zero and radius follow the three coordinates of the feature, the scale follows the zero, or the pose of a
                // board.
                let is_scale = matches!(length, StatedLength::Scale(_));
                let after = match loose.set.features[feature].kind {
                    FeatureKind::Board(_) => 6,
                    _ => 3 + usize::from(is_scale),
                };
                let at = fit.scene.first[feature] + after;
                let groups = &fit.scene.groups;
                let group = groups.iter().position(|group| group.contains(&at))?;
                let mut own = Mat::zeros(1, groups[group].len());
                own[(0, at - groups[group].start)] = length.wide();
                let arm = Mat::zeros(1, fit.arm.columns.len());
                let variance = solved.predictive(&arm, &[(group, own)])[(0, 0)];
                (fit.scene.deviation[at], variance)
            }
            StatedLength::Tip(tip, axis) => {
                let columns = fit.arm.columns.iter().enumerate();
                let mut own = columns.filter(|(_, c)| c.group == Group::Tip && c.index == tip);
                let (at, _) = own.nth(axis)?;
                (fit.arm.theta[at], covariance[(at, at)] * ANYTHING.powi(2))
            }
        };
        Some(Doubt::new(*length, (mean, variance), *stated))
    };
    let found = lengths.iter().filter_map(of).collect();
    let evidence = fit.evidence(loose)?;
    Some((found, fit, evidence))
}

/// Returns the mean variance of the rows of a length.
fn noise(problem: &TouchProblem, fit: &TouchFit) -> f64 {
    let rows = problem.set.rows.iter().enumerate();
    let lengths = rows.filter(|(_, row)| Noise::of(&row.reading, 0).is_length());
    let all: Vec<f64> = lengths.map(|(k, _)| fit.variance(problem, k, 0)).collect();
    all.iter().sum::<f64>() / all.len().max(1) as f64
}

/// What the rows say against what is stated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Explained {
    /// By how much −2 log of the evidence falls without it.
    pub gain: f64,
    /// Share of the noise, as a variance, that is left without it.
    pub left: f64,
}

/// Returns what the rows say against the known distances, if there are any.
pub fn without_distances(problem: &TouchProblem, fit: &TouchFit) -> Option<Explained> {
    let mut set = problem.set.clone();
    if distances(&mut set).is_empty() {
        return None;
    }
    let loose = TouchProblem {
        set: &set,
        ..problem.clone()
    };
    let without = TouchFit::new(&loose, &TouchFit::on_nominal(&loose, 0));
    let left = noise(&loose, &without) / noise(problem, fit).max(f64::MIN_POSITIVE);
    let gain = fit.evidence(problem)? - without.evidence(&loose)?;
    Some(Explained { gain, left })
}

/// What is stated and in doubt.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Doubted {
    /// The length with which the rows are most probable.
    pub doubt: Doubt,
    /// How much it explains.
    pub explained: Explained,
    /// Another length that explains the rows as well.
    pub or: Option<Doubt>,
}

/// Returns what is stated and in doubt, if anything is.
pub fn doubt(problem: &TouchProblem, nominal_arm: &TouchFit, fit: &TouchFit) -> Option<Doubted> {
    let given = noise(problem, fit);
    let believed = fit.evidence(problem)?;
    let mut found: Vec<(Doubt, f64, f64)> = Vec::new();
    for (doubts, loose, evidence) in own(problem) {
        let most = doubts
            .into_iter()
            .max_by(|a, b| a.sigmas().total_cmp(&b.sigmas()));
        // The joints of every image err less where the board has its true size.
        let scatter = (loose.joint_scatter / fit.joint_scatter).powi(2);
        let left = noise(problem, &loose).min(scatter * given);
        let is_in_doubt = |d: &Doubt| d.sigmas() > OWN;
        let explains = |d: &Doubt| match d.length.compares() {
            true => evidence < believed - CLEAR,
            false => left < EXPLAINED * given,
        };
        found.extend(
            most.filter(|d| is_in_doubt(d) && explains(d))
                .map(|d| (d, evidence, left)),
        );
    }
    if let Some((doubt, fit)) = size(problem, nominal_arm).filter(|(d, _)| d.sigmas() > SIZE) {
        // One scale is a simpler reason than many radii.
        let left = EXPLAINED * noise(problem, &fit);
        found.push((doubt, fit.evidence(problem)?, left));
    }
    found.sort_by(|a, b| a.1.total_cmp(&b.1));
    let (best, evidence, left) = *found.first()?;
    let mut others = found[1..].iter();
    let or = others.find(|other| {
        let is_one = best.length.compares() && other.0.length.compares();
        is_one && other.1 < evidence + CLEAR
    });
    Some(Doubted {
        doubt: best,
        explained: Explained {
            gain: believed - evidence,
            left: left / given.max(f64::MIN_POSITIVE),
        },
        or: or.map(|other| other.0),
    })
}
