//! What an image shows of the arm, apart from what its corners show of each other.
//!
//! All corners of an image share the errors of the joints. With U, the derivatives of its c equations by the n joints, and the
//! eigenvectors v of UᵀU with the eigenvalues λ, the sums (U v)ᵀ e / λ are readings of independent errors of the joints. What
//! is left of the equations, e − U v (U v)ᵀ e / λ, is free of them. Both together weigh as much as the equations did.

use crate::identification::touch::added_equation::{Equation, SHARED};
use crate::identification::touch::fit::{TouchFit, TouchProblem};
use crate::numeric::matrix::Mat;

/// Least eigenvalue of a direction in which errors of the joints show, as a share of the largest.
const LEAST: f64 = 1e-3;

/// Replaces the equations of every image. `by_joints` has for each equation of a corner its derivatives by the joints.
/// Returns the number of images.
pub fn separate(
    problem: &TouchProblem,
    fit: &TouchFit,
    equations: &mut Vec<Equation>,
    by_joints: &[Option<Vec<f64>>],
) -> usize {
    let mut of_state = vec![Vec::new(); problem.states.len()];
    for (i, equation) in equations.iter().enumerate() {
        // A corner that does not belong would move the whole image.
        if by_joints[i].is_some() && fit.weights[equation.row] > 0.0 {
            of_state[problem.state_of[equation.row]].push(i);
        }
    }
    let images = of_state.iter().filter(|own| !own.is_empty());
    let mut added = Vec::new();
    let mut count = 0;
    for own in images {
        let weight = problem.set.rows.len() + count;
        added.extend(separated(problem, (own, weight), equations, by_joints));
        count += 1;
    }
    equations.extend(added);
    count
}

/// Takes the errors of the joints out of the equations `own` of an image, and returns the equations that show them.
fn separated(
    problem: &TouchProblem,
    (own, weight): (&[usize], usize),
    equations: &mut [Equation],
    by_joints: &[Option<Vec<f64>>],
) -> Vec<Equation> {
    let joints = problem.nominal.kinds().len();
    let derivative = |i: usize, j: usize| by_joints[own[i]].as_ref().map_or(0.0, |u| u[j]);
    let u = Mat::from_fn(own.len(), joints, derivative);
    let eigen = (u.transpose() * &u).symmetric_eigen();
    let largest = eigen.eigenvalues.max();
    let stated = own.iter().map(|i| equations[*i].stated).sum::<f64>() / own.len() as f64;
    let row = own.iter().map(|i| equations[*i].row).min();
    let mut out = Vec::new();
    for (k, value) in eigen.eigenvalues.iter().enumerate() {
        if *value <= LEAST * largest {
            continue;
        }
        let moved = &u * eigen.eigenvectors.column(k);
        let first = &equations[own[0]];
        let mut sum = Equation {
            row: row.unwrap_or(first.row),
            weight,
            scale: SHARED,
            stated: stated / value,
            corners: value.recip(),
            residual: 0.0,
            unknowns: vec![0.0; first.unknowns.len()],
            terms: vec![0.0; first.terms.len()],
            taken: 0.0,
        };
        for (i, by) in own.iter().zip(moved.iter()) {
            sum.add(&equations[*i], by / value);
        }
        for (i, by) in own.iter().zip(moved.iter()) {
            equations[*i].add(&sum, -by);
            equations[*i].taken += by * by / value;
        }
        out.push(sum);
    }
    out
}
