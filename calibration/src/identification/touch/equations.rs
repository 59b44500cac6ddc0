//! The normal equations of arm and surroundings, with the surroundings eliminated group by group.
//!
//! All unknowns are in units of their prior standard deviations, so that the prior is the identity:
//!
//! ```text
//! | S   B_gᵀ |        S = I + Σ P_aᵀ W P_a          arm
//! | B_g  D_g |        D_g = I + Σ F_gᵀ W F_g        surroundings, one block for each group: no row sees two groups
//! ```
//!
//! With K_g = D_g⁻¹ B_g, the reduced equations of the arm are S − Σ B_gᵀ K_g (Schur complement). The covariance of a
//! prediction includes both arm and surroundings.

use crate::identification::touch::jet::RowJet;
use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;
use crate::numeric::product::{Transposed, product};

/// Normal equations: sums over all rows.
#[derive(Clone, Debug)]
pub struct Equations {
    /// Arm block S without the identity.
    pub arm: Mat<f64>,
    /// Right-hand side of the arm: the negative gradient.
    pub arm_right: Mat<f64>,
    /// For each group, D_g without the identity, B_g and the right-hand side.
    pub groups: Vec<GroupSums>,
}

/// Sums of one group of unknowns of the surroundings.
#[derive(Clone, Debug)]
pub struct GroupSums {
    /// Block F_gᵀ W F_g of the group.
    pub own: Mat<f64>,
    /// Cross block F_gᵀ W P_a between group and arm.
    pub cross: Mat<f64>,
    /// Right-hand side of the group: the negative gradient.
    pub right: Mat<f64>,
}

/// Sums over the rows of one state of the arm and one group, expressed in motions of the tip.
pub struct VisitSums {
    /// Tip block Pᵀ W P.
    pub tip: Mat<f64>,
    /// Gradient Pᵀ W e by the tip.
    pub tip_right: Mat<f64>,
    /// Cross block F_gᵀ W P between group and tip.
    pub cross: Mat<f64>,
    /// Block F_gᵀ W F_g of the group.
    pub own: Mat<f64>,
    /// Gradient F_gᵀ W e by the unknowns of the group.
    pub own_right: Mat<f64>,
}

impl VisitSums {
    /// Creates sums that are all zero, for a group of `unknowns` unknowns.
    pub fn new(unknowns: usize) -> Self {
        Self {
            tip: Mat::zeros(6, 6),
            tip_right: Mat::zeros(6, 1),
            cross: Mat::zeros(unknowns, 6),
            own: Mat::zeros(unknowns, unknowns),
            own_right: Mat::zeros(unknowns, 1),
        }
    }

    /// Adds a row. The unknowns of its group begin at index `first` and have the standard deviations `prior`; `weights`
    /// are the reciprocal variances of the row's components.
    pub fn add(&mut self, jet: &RowJet, weights: &[f64], first: usize, prior: &[f64]) {
        for i in 0..jet.count {
            let (w, e, tip) = (weights[i], jet.residual[i], &jet.tip[i]);
            if w == 0.0 {
                continue;
            }
            for a in 0..6 {
                if tip[a] == 0.0 {
                    continue;
                }
                self.tip_right[(a, 0)] += w * tip[a] * e;
                for b in 0..6 {
                    self.tip[(a, b)] += w * tip[a] * tip[b];
                }
            }
            for (index, column) in &jet.own {
                let (at, scaled) = (index - first, w * column[i] * prior[*index]);
                if scaled == 0.0 {
                    continue;
                }
                self.own_right[(at, 0)] += scaled * e;
                for (b, by_tip) in tip.iter().enumerate() {
                    self.cross[(at, b)] += scaled * by_tip;
                }
                for (other, column) in &jet.own {
                    self.own[(at, other - first)] += scaled * column[i] * prior[*other];
                }
            }
        }
    }
}

impl Equations {
    /// Creates equations without rows: the gradient of the prior alone. `arm` and `groups` are the unknowns in units of
    /// their priors.
    pub fn new(arm: &[f64], groups: &[Vec<f64>]) -> Self {
        let p = arm.len();
        let negative = |x: &[f64]| Mat::from_fn(x.len(), 1, |i, _| -x[i]);
        let of = |x: &Vec<f64>| GroupSums {
            own: Mat::zeros(x.len(), x.len()),
            cross: Mat::zeros(x.len(), p),
            right: negative(x),
        };
        Self {
            arm: Mat::zeros(p, p),
            arm_right: negative(arm),
            groups: groups.iter().map(of).collect(),
        }
    }

    /// Adds the rows of a visit; `jacobian` is the tip's Jacobian by the arm's unknowns, in units of their priors.
    pub fn add(&mut self, group: usize, visit: &VisitSums, jacobian: &Mat<f64>) {
        let moved = product(&visit.tip, jacobian);
        self.arm += product(Transposed(jacobian), &moved);
        self.arm_right -= product(Transposed(jacobian), &visit.tip_right);
        let sums = &mut self.groups[group];
        sums.cross += product(&visit.cross, jacobian);
        sums.own += &visit.own;
        sums.right -= &visit.own_right;
    }

    /// Factors the equations with their diagonal times 1 + `damping`. Returns `None` when that fails.
    pub fn factor(&self, damping: f64) -> Option<Solved> {
        let p = self.arm.nrows();
        let with_prior = |matrix: &Mat<f64>| {
            let mut out = matrix.clone();
            for i in 0..out.nrows() {
                // Damp the whole diagonal, as Marquardt does: unknowns of the surroundings have wide priors.
                out[(i, i)] = (1.0 + out[(i, i)]) * (1.0 + damping);
            }
            out
        };
        let mut arm = with_prior(&self.arm);
        let mut right = self.arm_right.clone();
        let mut groups = Vec::with_capacity(self.groups.len());
        for sums in &self.groups {
            let factor = Factor::new(with_prior(&sums.own), 1).ok()?;
            let gain = factor.solve(&sums.cross);
            let own = factor.solve(&sums.right);
            arm -= product(Transposed(&sums.cross), &gain);
            right -= product(Transposed(&gain), &sums.right);
            groups.push(SolvedGroup { factor, gain, own });
        }
        let factor = match p {
            0 => None,
            _ => Some(Factor::new(arm, 1).ok()?),
        };
        Some(Solved {
            factor,
            right,
            groups,
        })
    }
}

/// Factored normal equations.
#[derive(Clone, Debug)]
pub struct Solved {
    factor: Option<Factor>,
    right: Mat<f64>,
    groups: Vec<SolvedGroup>,
}

#[derive(Clone, Debug)]
struct SolvedGroup {
    /// Cholesky factor of D_g.
    factor: Factor,
    /// Gain K_g = D_g⁻¹ B_g.
    gain: Mat<f64>,
    /// D_g⁻¹ times the group's right-hand side.
    own: Mat<f64>,
}

impl Solved {
    /// Returns the steps of the arm and of every group, in units of the priors.
    pub fn step(&self) -> (Vec<f64>, Vec<Vec<f64>>) {
        let arm = match &self.factor {
            Some(factor) => factor.solve(&self.right),
            None => Mat::zeros(0, 1),
        };
        let of = |group: &SolvedGroup| {
            let step = &group.own - product(&group.gain, &arm);
            step.as_slice().to_vec()
        };
        (
            arm.as_slice().to_vec(),
            self.groups.iter().map(of).collect(),
        )
    }

    /// Returns the logarithm of the determinant of the equations.
    pub fn log_determinant(&self) -> f64 {
        let groups = self.groups.iter().map(|group| &group.factor);
        let of = |factor: &Factor| 2.0 * factor.half_log_determinant();
        groups.chain(&self.factor).map(of).sum()
    }

    /// Returns the covariance of the arm's unknowns in units of their priors.
    pub fn covariance(&self) -> Mat<f64> {
        self.factor
            .as_ref()
            .map_or(Mat::zeros(0, 0), Factor::inverse)
    }

    /// Computes the covariance of predictions. `arm` (c × p) is their Jacobian by the arm's unknowns; `own` is, for each
    /// group that they involve, their Jacobian by the group's unknowns. All are in units of the priors.
    pub fn predictive(&self, arm: &Mat<f64>, own: &[(usize, Mat<f64>)]) -> Mat<f64> {
        let mut rows = arm.clone();
        let mut out = Mat::zeros(arm.nrows(), arm.nrows());
        for (group, columns) in own {
            let group = &self.groups[*group];
            rows -= product(columns, &group.gain);
            let half = group.factor.half_solve(&columns.transpose());
            out += product(Transposed(&half), &half);
        }
        if let Some(factor) = &self.factor {
            let half = factor.half_solve(&rows.transpose());
            out += product(Transposed(&half), &half);
        }
        out
    }
}
