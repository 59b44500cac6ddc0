//! Elementary motions that a person can name, and directions expressed in them.
//!
//! There are more names than identifiable directions: joint 3's offset is also a rotation of the link before it. Motions
//! are therefore taken in the order base, tool, offsets, lengths, tilts, each only if it is no combination of those
//! already taken.

use poegp_protocol::JointKind;

use crate::identification::identifiability::frames::{Frame, ROUNDING, Role};
use crate::identification::identifiability::subspaces::Space;
use crate::numeric::matrix::Mat;
use crate::robot::own_motion;

/// Least share of a new motion that must be independent of the motions taken before, in three passes. The axes of a
/// fitted arm are slightly off parallel, and motions that differ by no more than that would all be correlated; they are
/// taken only where there are no better ones.
const NEW: [f64; 3] = [0.05, 1e-3, 1e-6];
/// Coefficients of a combination below this share of its largest are not named.
const NAMED: f64 = 0.2;
/// Weight of a link's motion when a name is chosen: links are named only where base, tool and offsets do not suffice.
const LINK_WEIGHT: f64 = 0.5;

/// An elementary motion ("atom"): of one frame, along or about one of its axes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ElementaryMotion {
    /// Frame that moves.
    pub role: Role,
    /// Axis of the motion: 0–2 along x, y, z; 3–5 about x, y, z.
    pub axis: usize,
    /// Whether the motion is the offset of the joint before the frame.
    pub offset: bool,
    column: usize,
}

/// Elementary motions as coordinates of the identifiable directions.
pub struct Coordinates {
    /// Elementary motions, as many as there are identifiable directions.
    pub atoms: Vec<ElementaryMotion>,
    /// Matrix from parameters to coefficients of the atoms, `atoms × parameters`; redundant parts are dropped.
    pub from_parameters: Mat<f64>,
}

/// A direction as a combination of atoms with their coefficients, strongest first.
pub type Combination = Vec<(ElementaryMotion, f64)>;

impl Coordinates {
    /// Chooses the coordinates for the frames of a task whose identifiable space is `possible`. Returns `None` when the
    /// motions do not span that space.
    pub fn new(frames: &[Frame], kinds: &[JointKind], possible: &Space) -> Option<Self> {
        let basis = possible.identified();
        let mut orthonormal: Vec<Vec<f64>> = Vec::new();
        let mut atoms = Vec::new();
        let mut left = candidates(frames, kinds);
        for new in NEW {
            left.retain(|atom| {
                let full: Vec<f64> = (0..basis.ncols())
                    .map(|j| basis[(atom.column, j)])
                    .collect();
                let mut rest = full.clone();
                // Orthogonalise twice, so that rounding errors do not grow.
                for _ in 0..2 {
                    for q in &orthonormal {
                        let share: f64 = q.iter().zip(&rest).map(|(a, b)| a * b).sum();
                        rest.iter_mut().zip(q).for_each(|(r, q)| *r -= share * q);
                    }
                }
                let norm = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
                let length = norm(&rest);
                let is_new = length > ROUNDING && length > new * norm(&full);
                if is_new {
                    orthonormal.push(rest.iter().map(|r| r / length).collect());
                    atoms.push(*atom);
                }
                !is_new
            });
        }
        if atoms.len() != basis.ncols() {
            return None;
        }
        let square = Mat::from_fn(atoms.len(), atoms.len(), |i, j| basis[(atoms[j].column, i)]);
        let from_parameters = square.lu().solve(&basis.transpose())?;
        Some(Self {
            atoms,
            from_parameters,
        })
    }

    /// Returns the share of each atom that lies in the orthonormal `directions`, from 0 to 1.
    pub fn shares(&self, directions: &Mat<f64>) -> Vec<f64> {
        let y = &self.from_parameters * directions;
        let norm = |i: usize| {
            (0..y.ncols())
                .map(|j| y[(i, j)].powi(2))
                .sum::<f64>()
                .sqrt()
        };
        (0..y.nrows()).map(|i| norm(i).min(1.0)).collect()
    }

    /// Expresses the space spanned by `directions` as combinations, each with an atom that no other combination has.
    pub fn combinations(&self, directions: &Mat<f64>) -> Vec<Combination> {
        let mut y = &self.from_parameters * directions;
        let (rows, count) = (y.nrows(), y.ncols());
        let weight = |i: usize| match self.atoms[i] {
            ElementaryMotion { offset: true, .. } => 1.0,
            ElementaryMotion {
                role: Role::Link(_),
                ..
            } => LINK_WEIGHT,
            _ => 1.0,
        };
        let mut pivots: Vec<usize> = Vec::new();
        for column in 0..count {
            let mut best = (0.0, 0, column);
            for j in column..count {
                for i in (0..rows).filter(|i| !pivots.contains(i)) {
                    let value = weight(i) * y[(i, j)].abs();
                    if value > best.0 {
                        best = (value, i, j);
                    }
                }
            }
            let (value, row, from) = best;
            if value == 0.0 {
                break;
            }
            for i in 0..rows {
                (y[(i, column)], y[(i, from)]) = (y[(i, from)], y[(i, column)]);
            }
            let pivot = y[(row, column)];
            for i in 0..rows {
                y[(i, column)] /= pivot;
            }
            for j in (0..count).filter(|j| *j != column) {
                let factor = y[(row, j)];
                for i in 0..rows {
                    y[(i, j)] -= factor * y[(i, column)];
                }
            }
            pivots.push(row);
        }
        (0..pivots.len())
            .map(|j| {
                let largest = (0..rows).fold(0.0_f64, |m, i| m.max(y[(i, j)].abs()));
                let mut circuit: Combination = (0..rows)
                    .filter(|i| y[(*i, j)].abs() > NAMED * largest)
                    .map(|i| (self.atoms[i], y[(i, j)]))
                    .collect();
                circuit.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
                circuit
            })
            .collect()
    }
}

/// Returns all atoms in order of preference.
fn candidates(frames: &[Frame], kinds: &[JointKind]) -> Vec<ElementaryMotion> {
    let atom = |index: usize, axis: usize| {
        let role = frames[index].role;
        let own_axis = |joint: usize| own_motion(kinds[joint - 1]);
        ElementaryMotion {
            role,
            axis,
            offset: matches!(role, Role::Link(joint) if own_axis(joint) == axis),
            column: 6 * index + axis,
        }
    };
    let mut out: Vec<ElementaryMotion> = (0..frames.len())
        .flat_map(|index| (0..6).map(move |axis| (index, axis)))
        .map(|(index, axis)| atom(index, axis))
        .collect();
    let rank = |a: &ElementaryMotion| match (a.role, a.offset, a.axis) {
        (Role::Base, ..) => 0,
        (Role::Tool(_), ..) => 1,
        (Role::Link(_), true, _) => 2,
        (Role::Link(_), false, 2) => 3,
        (Role::Link(_), false, 0 | 1) => 4,
        _ => 5,
    };
    out.sort_by_key(rank);
    out
}
