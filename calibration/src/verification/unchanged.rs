//! How the residuals of an arm that has not changed may look under a model without processes: draws of a mixture.
//!
//! The covariance of the residuals is estimated, and what an unchanged arm may have instead differs from it by what the drawn
//! sets of training poses leave of the frames and by the sizes of the joints' deflections ([`super::unknown_frames`]). In
//! units of the estimate, each set s has
//!
//! ```text
//! W_s = I + A (C_s − C) Aᵀ + Σ_c (v_cs − v_c) K_c
//! ```
//!
//! The test looks at few directions, Q. With B an orthonormal basis of Q and A beside what is free in any case, and P the
//! projection onto what is left, Bᵀ y is drawn exactly. Outside of B no frame is seen, and yᵀ P y is the sum of many similar
//! χ². It is drawn as the multiple of one χ² that has the same mean and variance (Satterthwaite):
//!
//! ```text
//! g χ²_f,   g f = tr(P W_s),   g² f = tr(P W_s P W_s)
//! ```
//!
//! All traces are quadratic in the sizes, so that one matrix of each joint is projected once, however many sets there are.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{ChiSquared, Distribution, StandardNormal};

use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;
use crate::numeric::product::{Transposed, product};
use crate::numeric::vectors::dot;
use crate::verification::columns::{Columns, DRAWS, Draw, basis, columns, without};
use crate::verification::noise::PRIOR;
use crate::verification::unknown_frames::UnknownFrames;

const SEED: u64 = 20_261_129;
/// Number of sets of sizes that are drawn.
const SETS: usize = 128;

/// The covariances that an arm which has not changed may have, in units of the estimated one.
pub struct Unchanged {
    /// A: effects of the parameters, m × parameters.
    pub frames: Mat<f64>,
    /// Roots B_c of the covariance B_c B_cᵀ of each component, of unit size, m × its numbers; those of the noise are the first.
    pub roots: Vec<Mat<f64>>,
    /// v_c: the estimated size of each component.
    pub sizes: Vec<f64>,
    /// What a model without processes does not know of its frames, and C, the mean covariance of the parameters.
    pub unknown: Option<(UnknownFrames, Mat<f64>)>,
}

/// What one set leaves: a root of the covariance of Bᵀ y, and g with f of yᵀ P y.
struct Drawn {
    root: Mat<f64>,
    outside: Option<(f64, ChiSquared<f64>)>,
}

impl Unchanged {
    /// Draws residuals of `rows` equations, one set after the other; `nuisance` is free in any case, and `seen` is Q. Both
    /// are orthonormal, and `rows` are counted without nuisance. Returns `None` if a covariance cannot be factored.
    pub(super) fn draws(
        &self,
        (nuisance, seen): (&Columns, &Columns),
        rows: usize,
        random: &mut ChaCha8Rng,
    ) -> Option<Vec<Draw>> {
        let clean = |column: &Vec<f64>| without(column, nuisance);
        let frames: Columns = columns(&self.frames).iter().map(clean).collect();
        let inside: Columns = [seen.clone(), basis(&frames, seen)].concat();
        let sets = self.projected(&[&inside[..], nuisance].concat(), inside.len(), rows)?;
        let mut draw = |i: usize| {
            let set = &sets[i % sets.len()];
            let z: Vec<f64> = (inside.iter().map(|_| StandardNormal.sample(random))).collect();
            let along = |i: usize| (0..=i).map(|j| set.root[(i, j)] * z[j]).sum();
            let mut y: Vec<f64> = (0..inside.len()).map(along).collect();
            let outside = (set.outside.as_ref()).map_or(0.0, |(g, chi)| g * chi.sample(random));
            let beside = y.split_off(seen.len());
            (y, dot(&beside, &beside) + outside)
        };
        Some((0..DRAWS).map(&mut draw).collect())
    }

    /// Projects every set; the first `inside` columns of the orthonormal `known` are B, and the others are free in any case.
    fn projected(&self, known: &Columns, inside: usize, rows: usize) -> Option<Vec<Drawn>> {
        let f = Mat::from_fn(self.frames.nrows(), known.len(), |i, j| known[j][i]);
        let frames = product(Transposed(&f), &self.frames);
        let frames = frames.rows(0, inside).into_owned();
        let sides: Vec<Mat<f64>> = (self.roots.iter())
            .map(|root| product(Transposed(&f), root))
            .collect();
        let cores: Vec<Mat<f64>> = (sides.iter())
            .map(|side| product(side, Transposed(side)))
            .collect();
        let count = self.roots.len();
        // tr(P K_c), and tr(P K_c P K_d) = |B_cᵀ P B_d|².
        let means: Vec<f64> = (0..count)
            .map(|c| self.roots[c].norm_squared() - sides[c].norm_squared())
            .collect();
        let mut squares = Mat::zeros(count, count);
        for c in 0..count {
            for d in c..count {
                let between = product(Transposed(&self.roots[c]), &self.roots[d])
                    - product(Transposed(&sides[c]), &sides[d]);
                squares[(c, d)] = between.norm_squared();
            }
        }
        let sets = self.sets(&squares)?;
        let outside = rows.saturating_sub(inside) as f64;
        let of = |(more, covariance): &(Vec<f64>, Mat<f64>)| {
            let mut within = product(&product(&frames, covariance), Transposed(&frames));
            let (mut mean, mut square) = (outside, outside);
            for (c, size) in more.iter().enumerate() {
                within += cores[c].view((0, 0), (inside, inside)) * *size;
                mean += size * means[c];
                square += 2.0 * size * means[c] + size * size * squares[(c, c)];
                for d in c + 1..count {
                    square += 2.0 * size * more[d] * squares[(c, d)];
                }
            }
            for i in 0..inside {
                within[(i, i)] += 1.0;
            }
            let is_any = outside > 0.0 && mean > 0.0 && square > 0.0;
            Some(Drawn {
                root: Factor::new(within, 1).ok()?.lower(),
                outside: match is_any {
                    true => Some((square / mean, ChiSquared::new(mean * mean / square).ok()?)),
                    false => None,
                },
            })
        };
        sets.iter().map(of).collect()
    }

    /// Draws sets: v_cs − v_c of every component, and C_s − C. `squares` are tr(P K_c P K_d) on and above the diagonal. Returns
    /// `None` if a matrix cannot be factored.
    fn sets(&self, squares: &Mat<f64>) -> Option<Vec<(Vec<f64>, Mat<f64>)>> {
        let count = self.sizes.len();
        let information = Mat::from_fn(count, count, |c, d| {
            let of_rows = 0.5 * squares[(c.min(d), c.max(d))] * self.sizes[c] * self.sizes[d];
            of_rows + if c == d { PRIOR } else { 0.0 }
        });
        let factor = Factor::new(information, 1).ok()?;
        let root = factor.half_solve(&Mat::identity(count, count));
        let mut random = ChaCha8Rng::seed_from_u64(SEED);
        let draw = |_| -> Vec<f64> {
            let z: Vec<f64> = (0..count)
                .map(|_| StandardNormal.sample(&mut random))
                .collect();
            let along = |c: usize| (0..count).map(|i| root[(i, c)] * z[i]).sum::<f64>();
            (0..count)
                .map(|c| self.sizes[c] * libm::exp(along(c)))
                .collect()
        };
        let wanted = self
            .unknown
            .as_ref()
            .map_or(SETS, |(frames, _)| frames.sets.len());
        let drawn: Vec<Vec<f64>> = (0..wanted).map(draw).collect();
        let covariances = match &self.unknown {
            None => vec![Mat::zeros(0, 0); wanted],
            Some((frames, mean)) => {
                let noise = count - frames.components();
                let own: Vec<Vec<f64>> = drawn.iter().map(|v| v[noise..].to_vec()).collect();
                frames.drawn(mean, &own)?
            }
        };
        let more = |v: Vec<f64>| {
            v.iter()
                .zip(&self.sizes)
                .map(|(v, mean)| v - mean)
                .collect()
        };
        Some(drawn.into_iter().map(more).zip(covariances).collect())
    }
}
