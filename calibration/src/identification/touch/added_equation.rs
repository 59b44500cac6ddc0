//! One linearised equation of a touch problem with added terms, and the scales in which it is weighed.

use crate::identification::touch::noise::Noise;

/// Index of the scale of the errors of the joints that an image shares, behind those of all kinds of noise.
pub const SHARED: usize = Noise::ALL.len();

/// One linearised equation.
pub struct Equation {
    /// Index of the row; of several, that of the first.
    pub row: usize,
    /// Index of the weight: that of the row, or one behind those of all rows for what an image shows of the arm.
    pub weight: usize,
    /// Index of the scale: the kind of noise, or [`SHARED`].
    pub scale: usize,
    /// The stated variance.
    pub stated: f64,
    /// For what an image shows of the arm, the factor by which the variance of a corner beyond the stated one adds to it.
    pub corners: f64,
    /// Prediction minus reading.
    pub residual: f64,
    /// Derivative by the unknowns of the fit, in units of their priors.
    pub unknowns: Vec<f64>,
    /// Derivative by the terms of all parts.
    pub terms: Vec<f64>,
    /// Share of the equation that was taken out with the errors of the joints in its image.
    pub taken: f64,
}

/// Scales in which χ² is counted.
#[derive(Clone, Debug)]
pub struct AddedScales {
    /// τ of every kind of noise, and of the errors of the joints that an image shares.
    pub tau: [f64; SHARED + 1],
    /// Weight of every row, and of what every image shows of the arm.
    pub weights: Vec<f64>,
    /// Mean of the logarithm of the standard deviation of an equation that shows the arm.
    pub scatter: f64,
}

impl Equation {
    /// Adds a multiple of another equation.
    pub fn add(&mut self, other: &Self, by: f64) {
        self.residual += by * other.residual;
        let unknowns = self.unknowns.iter_mut().zip(&other.unknowns);
        unknowns.for_each(|(a, b)| *a += by * b);
        let terms = self.terms.iter_mut().zip(&other.terms);
        terms.for_each(|(a, b)| *a += by * b);
    }

    /// Returns whether it shows the arm, and not corners of an image beside each other.
    pub fn shows_arm(&self) -> bool {
        self.taken == 0.0
    }
}

/// Returns σ² + τ² of an equation.
pub fn variance(equation: &Equation, scales: &AddedScales) -> f64 {
    let of_corners = equation.corners * scales.tau[Noise::Board as usize].powi(2);
    equation.stated + of_corners + scales.tau[equation.scale].powi(2)
}
