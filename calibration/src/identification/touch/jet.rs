//! One row of a touch file as an equation: what it misses by, and how that depends on the arm and on what was touched.
//!
//! Every residual is a function of the pose of the tip T = (R, x) and of unknowns y of the surroundings,
//! e(T, y) = prediction − reading. A displacement v (m) and a rotation ω (rad) of the tip in the axes of the base change it by
//! P (v, ω), a change of the unknowns by F δy.

/// Most components of a row.
pub const COMPONENTS: usize = 6;

/// One row, linearised.
#[derive(Clone, Debug)]
pub struct RowJet {
    /// Components that it has.
    pub count: usize,
    /// e.
    pub residual: [f64; COMPONENTS],
    /// P.
    pub tip: [[f64; 6]; COMPONENTS],
    /// Columns of F that are not zero, each with its index into the unknowns.
    pub own: Vec<(usize, [f64; COMPONENTS])>,
}

impl RowJet {
    /// A row of so many components, all zero.
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
