//! Gear ripple: a periodogram of the residual through each joint's Jacobian column.
//!
//! Strain-wave gears and their like make errors of tens to hundreds of cycles per turn of the joint that no smooth
//! process can learn. For every frequency the residual is regressed on J_c sin kq and J_c cos kq; a term is accepted
//! when χ² drops by more than [`SIGNIFICANT`], which chance does less than once in several hundred searches.

use faer::Mat;

use crate::identification::parametric::state::ROWS;
use crate::measurement::sample::BaseSample;

/// Drop of χ² that a term must make: two degrees of freedom, some 10⁴ independent frequencies a search, p ≈ 10⁻³.
pub const SIGNIFICANT: f64 = 32.0;
/// Cycles per turn that are searched.
pub const RANGE: (f64, f64) = (8.0, 420.0);

/// A frequency of one joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Peak {
    /// The joint, from 0.
    pub joint: usize,
    /// Cycles per turn.
    pub cycles: f64,
    /// Drop of χ².
    pub drop: f64,
}

/// One joint's residual, contracted: everything a frequency needs.
struct Contracted {
    joint: usize,
    q: Vec<f64>,
    /// J_cᵀ e.
    projection: Vec<f64>,
    /// J_cᵀ J_c.
    weight: Vec<f64>,
}

impl Contracted {
    /// Drop of χ² by a term of `cycles`.
    fn drop(&self, cycles: f64) -> f64 {
        let (mut ss, mut sc, mut cc, mut bs, mut bc) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for ((q, b), w) in self.q.iter().zip(&self.projection).zip(&self.weight) {
            let (s, c) = (cycles * q).sin_cos();
            ss += w * s * s;
            sc += w * s * c;
            cc += w * c * c;
            bs += b * s;
            bc += b * c;
        }
        let determinant = ss * cc - sc * sc;
        // A joint that hardly moves cannot separate sine from cosine.
        if determinant < 1e-3 * ss * cc || ss * cc <= 0.0 {
            return 0.0;
        }
        (cc * bs * bs - 2.0 * sc * bs * bc + ss * bc * bc) / determinant
    }
}

/// The most significant frequency of each joint, for residuals (in units of their noise) and Jacobian of all poses.
pub fn peaks(samples: &[BaseSample], residuals: &[[f64; ROWS]], jacobian: &Mat<f64>) -> Vec<Peak> {
    let joints = jacobian.ncols();
    (0..joints)
        .filter_map(|joint| {
            let q: Vec<f64> = samples.iter().map(|s| s.joints[joint]).collect();
            let (lowest, highest) = q
                .iter()
                .fold((f64::MAX, f64::MIN), |(a, b), x| (a.min(*x), b.max(*x)));
            let span = highest - lowest;
            if span < 1e-2 {
                return None;
            }
            let row = |k: usize, b: usize| jacobian[(ROWS * k + b, joint)];
            let contract = |f: &dyn Fn(usize, usize) -> f64| -> Vec<f64> {
                (0..samples.len())
                    .map(|k| (0..ROWS).map(|b| f(k, b)).sum())
                    .collect()
            };
            let data = Contracted {
                joint,
                projection: contract(&|k, b| row(k, b) * residuals[k][b]),
                weight: contract(&|k, b| row(k, b) * row(k, b)),
                q,
            };
            // A quarter of the resolution that the span allows, and not less than one cycle within the span.
            let step = (0.25 * std::f64::consts::TAU / span).min(0.5);
            let first = RANGE.0.max(std::f64::consts::TAU / span);
            let mut best = Peak {
                joint: data.joint,
                cycles: first,
                drop: 0.0,
            };
            let mut cycles = first;
            while cycles <= RANGE.1 {
                let drop = data.drop(cycles);
                if drop > best.drop {
                    best = Peak {
                        joint,
                        cycles,
                        drop,
                    };
                }
                cycles += step;
            }
            Some(refine(&data, best, step))
        })
        .collect()
}

/// The top of a peak within one step, by repeated trisection.
fn refine(data: &Contracted, coarse: Peak, step: f64) -> Peak {
    let (mut lower, mut upper) = (coarse.cycles - step, coarse.cycles + step);
    for _ in 0..24 {
        let (a, b) = (lower + (upper - lower) / 3.0, upper - (upper - lower) / 3.0);
        if data.drop(a) < data.drop(b) {
            lower = a;
        } else {
            upper = b;
        }
    }
    let cycles = 0.5 * (lower + upper);
    let drop = data.drop(cycles);
    if drop > coarse.drop {
        Peak {
            cycles,
            drop,
            ..coarse
        }
    } else {
        coarse
    }
}
