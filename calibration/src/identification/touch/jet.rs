//! One row of a touch file as a linearised equation: its residual, and how this depends on the arm and on what was
//! touched.
//!
//! Every residual is a function of the pose T = (R, x) of the tip and of unknowns y of the surroundings: e(T, y) =
//! prediction − reading. A displacement v (m) and a rotation ω (rad) of the tip in the axes of the base change it by P
//! (v, ω); a change of the unknowns changes it by F δy.

/// Largest number of components of a row.
pub const COMPONENTS: usize = 6;

/// One linearised row.
#[derive(Clone, Debug)]
pub struct RowJet {
    /// Number of components of the row.
    pub count: usize,
    /// Residual e.
    pub residual: [f64; COMPONENTS],
    /// Derivative P by motions of the tip.
    pub tip: [[f64; 6]; COMPONENTS],
    /// Non-zero columns of F, each with the index of its unknown.
    pub own: Vec<(usize, [f64; COMPONENTS])>,
}

impl RowJet {
    /// Returns by how much a component changes for each metre that the tip is displaced, in the direction in which it changes
    /// most; zero for angles.
    pub fn per_metre(&self, component: usize) -> f64 {
        let by_position = &self.tip[component][..3];
        by_position.iter().map(|x| x * x).sum::<f64>().sqrt()
    }

    /// Creates a row of `count` components, all zero.
    pub fn new(count: usize) -> Self {
        Self {
            count,
            residual: [0.0; COMPONENTS],
            tip: [[0.0; 6]; COMPONENTS],
            own: Vec::new(),
        }
    }

    /// Adds a column of F.
    pub fn push(&mut self, index: usize, column: &[f64]) {
        let mut own = [0.0; COMPONENTS];
        own[..column.len()].copy_from_slice(column);
        self.own.push((index, own));
    }
}
