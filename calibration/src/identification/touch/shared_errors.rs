//! Errors of the joints that all readings of one image share.
//!
//! While the camera looks, the arm stands in one pose, and what its gears miss there, every corner of the image sees. A
//! hundred corners that count as a hundred readings of the arm would state an error that is many times too small. Each joint
//! of such a state therefore has an error of its own, drawn from one normal distribution of the standard deviation σ. The
//! rows' covariance becomes W⁻¹ + σ² P Z Zᵀ Pᵀ, with W⁻¹ their own, P their derivatives by motions of the tip, and Z the
//! motions of the tip by the joints. The errors are eliminated in each visit, and the evidence chooses σ.

use crate::identification::touch::equations::VisitSums;
use crate::identification::touch::noise::USUAL_ROWS;
use crate::identification::touch::problem::{LeftOut, TouchProblem};
use crate::measurement::touch::Reading;
use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;
use crate::numeric::product::{Transposed, product};

/// Usual σ, rad or m.
pub(super) const USUAL_JOINT: f64 = 1e-4;
/// Step of a joint for its motion of the flange, rad or m.
const JOINT_STEP: f64 = 1e-5;

/// The errors that the rows of a visit share.
pub struct SharedErrors {
    /// Zᵀ M, with M the tip block.
    gain: Mat<f64>,
    /// Zᵀ b, with b the gradient by the tip.
    right: Mat<f64>,
    /// Factor of I/σ² + Zᵀ M Z.
    factor: Factor,
}

impl SharedErrors {
    /// Creates the shared errors of a visit, with Z (6 × n) in `motions` and σ in `sigma`; `None` if they cannot be factored.
    pub fn new(visit: &VisitSums, motions: &Mat<f64>, sigma: f64) -> Option<Self> {
        let gain = product(Transposed(motions), &visit.tip);
        let mut own = product(&gain, motions);
        for i in 0..own.nrows() {
            own[(i, i)] += sigma.powi(-2);
        }
        Some(Self {
            right: product(Transposed(motions), &visit.tip_right),
            factor: Factor::new(own, 1).ok()?,
            gain,
        })
    }

    /// Returns by how much the most probable errors lower χ² of the visit.
    pub fn explained(&self) -> f64 {
        let solved = self.factor.solve(&self.right);
        let pairs = solved.as_slice().iter().zip(self.right.as_slice());
        pairs.map(|(a, b)| a * b).sum()
    }

    /// Returns by how much the errors raise the logarithm of the determinant of the rows' covariance:
    /// log det (I + σ² Zᵀ M Z).
    pub fn log_determinant(&self, sigma: f64) -> f64 {
        let joints = self.right.nrows() as f64;
        2.0 * (joints * libm::log(sigma) + self.factor.half_log_determinant())
    }

    /// Eliminates the errors from the sums of the visit.
    pub fn eliminate(&self, visit: &mut VisitSums, motions: &Mat<f64>) {
        let by_group = product(&visit.cross, motions);
        let tip = self.factor.solve(&self.gain);
        let right = self.factor.solve(&self.right);
        let group = self.factor.solve(&by_group.transpose());
        visit.tip -= product(Transposed(&self.gain), &tip);
        visit.tip_right -= product(Transposed(&self.gain), &right);
        visit.cross -= product(&by_group, &tip);
        visit.own -= product(&by_group, &group);
        visit.own_right -= product(&by_group, &right);
    }
}

/// Returns σ by the evidence: MacKay's fixed point with a hyperprior.
pub(super) fn scatter(left_out: &[LeftOut]) -> f64 {
    let usual = (USUAL_ROWS * USUAL_JOINT.powi(2), USUAL_ROWS);
    let add = |(sum, count): (f64, f64), l: &LeftOut| (sum + l.shared.0, count + l.shared.1);
    let (sum, count) = left_out.iter().fold(usual, add);
    (sum / count).sqrt()
}

impl TouchProblem<'_> {
    /// Computes [`TouchProblem::joint_motions`], on the nominal arm.
    pub(super) fn motions_of_images(&self) -> Vec<Option<Mat<f64>>> {
        let mut images = vec![false; self.states.len()];
        for (row, state) in self.set.rows.iter().zip(&self.state_of) {
            images[*state] |= matches!(row.reading, Reading::Board { .. });
        }
        let arm = self.arm(0);
        let before = arm.poses(&self.states);
        let mut out: Vec<Option<Mat<f64>>> = images
            .iter()
            .map(|is_image| is_image.then(|| Mat::zeros(6, self.nominal.kinds().len())))
            .collect();
        for joint in 0..self.nominal.kinds().len() {
            let mut moved = self.states.clone();
            for state in &mut moved {
                state.serial_joints[joint] += JOINT_STEP;
            }
            for ((pose, start), motions) in arm.poses(&moved).iter().zip(&before).zip(&mut out) {
                let Some(motions) = motions else {
                    continue;
                };
                let turned = pose.rotation * start.rotation.transpose();
                let shift = pose.translation - start.translation;
                // The vector of a small rotation.
                let turn = [
                    0.5 * (turned[(2, 1)] - turned[(1, 2)]),
                    0.5 * (turned[(0, 2)] - turned[(2, 0)]),
                    0.5 * (turned[(1, 0)] - turned[(0, 1)]),
                ];
                for i in 0..3 {
                    motions[(i, joint)] = shift[i] / JOINT_STEP;
                    motions[(3 + i, joint)] = turn[i] / JOINT_STEP;
                }
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use crate::identification::touch::equations::{Equations, VisitSums};
    use crate::identification::touch::jet::RowJet;
    use crate::numeric::matrix::Mat;

    use super::SharedErrors;

    const ARM: usize = 4;
    const OWN: usize = 2;
    const JOINTS: usize = 3;
    const VISITS: usize = 3;
    const ROWS: usize = 5;
    const SIGMA: f64 = 0.7;
    const WEIGHTS: [f64; 2] = [1.3, 0.8];
    const PRIOR: [f64; OWN] = [1.5, 0.4];

    /// Any numbers between −1 and 1, always the same.
    struct Numbers(u32);

    impl Numbers {
        fn next(&mut self) -> f64 {
            self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(self.0 >> 8) / f64::from(1 << 23) - 1.0
        }

        fn matrix(&mut self, rows: usize, columns: usize) -> Mat<f64> {
            Mat::from_fn(rows, columns, |_, _| self.next())
        }
    }

    /// Steps, χ² and the determinant are those of equations in which every shared error is an unknown of its own.
    #[test]
    fn eliminated_errors_are_those_of_explicit_unknowns() {
        let mut numbers = Numbers(1);
        let mut sums = Equations::new(&[0.0; ARM], &[vec![0.0; OWN]]);
        let unknowns = ARM + OWN + VISITS * JOINTS;
        let mut normal = Mat::<f64>::identity(unknowns, unknowns);
        let mut right = Mat::zeros(unknowns, 1);
        let (mut explained, mut determinant) = (0.0, 0.0);
        for visit in 0..VISITS {
            let (motions, jacobian) = (numbers.matrix(6, JOINTS), numbers.matrix(6, ARM));
            let mut rows = VisitSums::new(OWN);
            // χ² of this visit alone, by its shared errors.
            let mut alone = (Mat::<f64>::identity(JOINTS, JOINTS), Mat::zeros(JOINTS, 1));
            for _ in 0..ROWS {
                let mut jet = RowJet::new(WEIGHTS.len());
                let columns = numbers.matrix(WEIGHTS.len(), OWN);
                for (i, weight) in WEIGHTS.iter().enumerate() {
                    jet.residual[i] = numbers.next();
                    jet.tip[i] = std::array::from_fn(|_| numbers.next());
                    let tip = Mat::from_row_slice(1, 6, &jet.tip[i]);
                    let shared = SIGMA * &tip * &motions;
                    let mut whole = Mat::zeros(1, unknowns);
                    whole.columns_mut(0, ARM).copy_from(&(&tip * &jacobian));
                    for k in 0..OWN {
                        whole[(0, ARM + k)] = columns[(i, k)] * PRIOR[k];
                    }
                    let first = ARM + OWN + visit * JOINTS;
                    whole.columns_mut(first, JOINTS).copy_from(&shared);
                    normal += *weight * whole.transpose() * &whole;
                    right -= *weight * jet.residual[i] * whole.transpose();
                    alone.0 += *weight * shared.transpose() * &shared;
                    alone.1 += *weight * jet.residual[i] * shared.transpose();
                }
                for k in 0..OWN {
                    jet.push(7 + k, columns.column(k).as_slice());
                }
                let prior: Vec<f64> = [0.0; 7].into_iter().chain(PRIOR).collect();
                rows.add(&jet, &WEIGHTS, 7, &prior);
            }
            let solved = alone.0.cholesky().unwrap().solve(&alone.1);
            explained += alone.1.dot(&solved);
            let shared = SharedErrors::new(&rows, &motions, SIGMA).unwrap();
            explained -= shared.explained();
            determinant += shared.log_determinant(SIGMA);
            shared.eliminate(&mut rows, &motions);
            sums.add(0, &rows, &jacobian);
        }
        let solved = sums.factor(0.0).unwrap();
        determinant += solved.log_determinant() - libm::log(normal.determinant());
        assert!(determinant.abs() < 1e-10, "{determinant}");
        let step = normal.cholesky().unwrap().solve(&right);
        let (arm, own) = solved.step();
        assert!(explained.abs() < 1e-10, "{explained}");
        for (found, expected) in arm.iter().chain(&own[0]).zip(step.iter()) {
            assert!((found - expected).abs() < 1e-10, "{found} {expected}");
        }
    }
}
