//! Base-tool calibration: determines where the instrument stands and where the target sits, for the arm as its maker drew
//! it.
//!
//! The model is T′ = instrument_from_base · f_nominal(q) · flange_from_target with both ends unknown. A closed form for
//! the rotations (linear in both, smallest eigenvector) and then the translations gives a start. That start is
//! meaningless when all poses have nearly the same orientation, so 24 turned tools are tried as well. The best starts are
//! refined by least squares, unweighted in metres and radians, with the rotation taken at the tool point. The result is
//! the gauge of every model: "base" and "flange" in a blob refer to it.

use nalgebra::{Matrix3, Vector3};
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;

use crate::identification::frame_fit::{HeldTool, ResidualFrame, cost, fit_frames_holding};
use crate::measurement::sample::InstrumentSample;
use crate::numeric::matrix::Mat;
use crate::numeric::rotation::nearest_rotation;

/// Number of starts that are refined.
const REFINED: usize = 3;

/// A measured `instrument_from_target` and the nominal `base_from_flange` at its joints.
type Pair = (Pose<f64>, Pose<f64>);

/// Calibrates base and tool of the nominal chain (base to flange) to samples of one tool. A start needs whole poses. Returns
/// `instrument_from_base` and `flange_from_target`.
pub fn base_tool(nominal: &Poe<f64>, samples: &[InstrumentSample]) -> (Pose<f64>, Pose<f64>) {
    let pair = |s: &InstrumentSample| {
        let flange = nominal.forward(&s.serial_joints);
        s.observation.pose().map(|measured| (measured, flange))
    };
    let pairs: Vec<Pair> = samples.iter().filter_map(pair).collect();
    let mut starts: Vec<(f64, Poe<f64>)> = candidate_rotations(&pairs)
        .into_iter()
        .map(|(base, tool)| {
            let (base_translation, tool_translation) = translations(&pairs, &base);
            let chain = with_base_and_tool(
                nominal,
                &Pose {
                    rotation: base,
                    translation: base_translation,
                },
                &Pose {
                    rotation: tool,
                    translation: tool_translation,
                },
            );
            (
                cost(&chain, samples, ResidualFrame::TOOL_POINT_UNIT_WEIGHTS),
                chain,
            )
        })
        .collect();
    starts.sort_by(|a, b| a.0.total_cmp(&b.0));
    let last = nominal.kinds().len();
    let held = HeldTool::new(nominal, samples);
    let refine = |(_, mut chain): (f64, Poe<f64>)| {
        let fit = fit_frames_holding(
            &mut chain,
            samples,
            &[0, last],
            ResidualFrame::TOOL_POINT_UNIT_WEIGHTS,
            &held,
        );
        (fit, chain)
    };
    let (_, chain) = starts
        .into_iter()
        .take(REFINED)
        .map(refine)
        .reduce(|a, b| if b.0.rms < a.0.rms { b } else { a })
        .expect("the closed form is always a candidate");
    let (before, fitted) = (nominal.frames(), chain.frames());
    (
        fitted[0] * before[0].inverse(),
        before[last].inverse() * fitted[last],
    )
}

/// Returns the chain from the instrument to the target.
pub fn with_base_and_tool(
    nominal: &Poe<f64>,
    instrument_from_base: &Pose<f64>,
    flange_from_target: &Pose<f64>,
) -> Poe<f64> {
    let mut chain = *nominal;
    let last = nominal.kinds().len();
    let frames = chain.frames_mut();
    frames[0] = *instrument_from_base * frames[0];
    frames[last] = frames[last] * *flange_from_target;
    chain
}

/// Returns pairs (base, tool) of rotations to start from.
fn candidate_rotations(pairs: &[Pair]) -> Vec<(Matrix3<f64>, Matrix3<f64>)> {
    let mut out = vec![closed_form(pairs)];
    for tool in cube_rotations() {
        // The base rotation that fits this tool best: the mean of M (A T)ᵀ, projected onto the rotations.
        let sum = pairs
            .iter()
            .fold(Matrix3::zeros(), |sum, (measured, flange)| {
                sum + measured.rotation * (flange.rotation * tool).transpose()
            });
        out.push((nearest_rotation(&sum), tool));
    }
    out
}

/// Returns rotations with Xᵀ M = A Y for all poses (measured M, flange A), from the smallest eigenvector of an 18×18
/// matrix.
fn closed_form(pairs: &[Pair]) -> (Matrix3<f64>, Matrix3<f64>) {
    let mut normal = Mat::<f64>::zeros(18, 18);
    for (measured, flange) in pairs {
        let (m, a) = (&measured.rotation, &flange.rotation);
        for i in 0..3 {
            for j in 0..3 {
                let mut row = [0.0; 18];
                for k in 0..3 {
                    row[3 * i + k] = m[(k, j)];
                    row[9 + 3 * k + j] -= a[(i, k)];
                }
                for (p, x) in row.iter().enumerate() {
                    for (q, y) in row.iter().enumerate() {
                        normal[(p, q)] += x * y;
                    }
                }
            }
        }
    }
    let eigen = normal.symmetric_eigen();
    let least = eigen.eigenvalues.imin();
    let smallest = |i: usize| eigen.eigenvectors[(i, least)];
    let x = Matrix3::from_fn(|i, j| smallest(3 * i + j));
    let y = Matrix3::from_fn(|i, j| smallest(9 + 3 * i + j));
    let sign = if x.determinant() < 0.0 { -1.0 } else { 1.0 };
    (
        nearest_rotation(&(x.transpose() * sign)),
        nearest_rotation(&(y * sign)),
    )
}

/// Computes the translations of base and tool by linear least squares, given the rotation of the base.
fn translations(pairs: &[Pair], base: &Matrix3<f64>) -> (Vector3<f64>, Vector3<f64>) {
    let mut a = Mat::<f64>::zeros(3 * pairs.len(), 6);
    let mut b = Mat::<f64>::zeros(3 * pairs.len(), 1);
    for (k, (measured, flange)) in pairs.iter().enumerate() {
        let turned = base * flange.rotation;
        let rest = measured.translation - base * flange.translation;
        for i in 0..3 {
            a[(3 * k + i, i)] = 1.0;
            for j in 0..3 {
                a[(3 * k + i, 3 + j)] = turned[(i, j)];
            }
            b[(3 * k + i, 0)] = rest[i];
        }
    }
    // Column pivoting alone would let a tool that cannot be distinguished from the base run away; a small ridge term
    // prevents that.
    let mut ridge = Mat::<f64>::zeros(a.nrows() + 6, 6);
    ridge.rows_mut(0, a.nrows()).copy_from(&a);
    for i in 0..6 {
        ridge[(a.nrows() + i, i)] = 1e-6;
    }
    let mut rest = Mat::<f64>::zeros(a.nrows() + 6, 1);
    rest.rows_mut(0, a.nrows()).copy_from(&b);
    let (q, r) = ridge.qr().unpack();
    let x = r.solve_upper_triangular(&q.tr_mul(&rest));
    let x = x.unwrap_or(Mat::zeros(6, 1));
    (
        Vector3::new(x[(0, 0)], x[(1, 0)], x[(2, 0)]),
        Vector3::new(x[(3, 0)], x[(4, 0)], x[(5, 0)]),
    )
}

/// Returns the 24 rotations that map a cube to itself.
pub(crate) fn cube_rotations() -> Vec<Matrix3<f64>> {
    let mut out = Vec::with_capacity(24);
    let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
    for first in 0..3 {
        for second in (0..3).filter(|second| *second != first) {
            for (a, b) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
                let (x, y) = (axes[first] * a, axes[second] * b);
                out.push(Matrix3::from_columns(&[x, y, x.cross(&y)]));
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use poegp_protocol::JointKind;
    use poegp_runtime::math::se3::Twist;

    use super::*;
    use crate::measurement::observation::Observation;
    use crate::measurement::sample::{Instrument, Sample};

    /// Where all axes are parallel, a longer tool is a lower base. Errors of the arm must not decide between them.
    #[test]
    fn parallel_axes_leave_the_tool_at_the_flange() {
        let link = |x: f64, tilt: f64| {
            Pose::exp(&Twist::from_array(&[x, 0.0, 0.0, tilt, -0.7 * tilt, 0.0]))
        };
        let kinds = [JointKind::Revolute; 3];
        let arm = |tilt: f64| {
            let frames = [0.0, tilt, -tilt, 0.0].map(|tilt| link(0.3, tilt));
            Poe::new(&kinds, &frames).unwrap()
        };
        let (nominal, real) = (arm(0.0), arm(8e-4));
        let base = Pose::exp(&Twist::from_array(&[0.5, -0.2, 0.9, 0.3, 0.1, -0.4]));
        let tool = Pose::exp(&Twist::from_array(&[0.02, 0.01, 0.0, 0.2, -0.1, 0.5]));
        let truth = with_base_and_tool(&real, &base, &tool);
        let samples = (0..40).map(|k| {
            let joints = vec![0.9 * f64::from(k), -0.7 * f64::from(k), 0.4 * f64::from(k)];
            let seen = Observation::Pose(truth.forward(&joints));
            Sample::new(joints.clone(), joints, seen, Instrument)
        });
        let samples: Vec<InstrumentSample> = samples.collect();
        let (_, found) = base_tool(&nominal, &samples);
        assert!(found.translation.z.abs() < 1e-4, "{}", found.translation);
    }

    #[test]
    fn the_cube_has_24_different_rotations() {
        let all = cube_rotations();
        for (i, a) in all.iter().enumerate() {
            assert!((a.determinant() - 1.0).abs() < 1e-12);
            assert!(all[..i].iter().all(|b| (a - b).norm() > 0.5));
        }
        assert_eq!(all.len(), 24);
    }
}
