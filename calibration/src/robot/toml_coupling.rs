//! The coupling of the joints in a TOML description.

use poegp_protocol::limits::MAX_COUPLING;
use toml::Spanned;

use crate::input_error::{InputError, counted, number};
use crate::robot::normal_form::moves_each_joint;
use crate::robot::toml_source::TomlSource;

impl TomlSource<'_> {
    /// Checks and returns the coupling matrix; the identity becomes `None`.
    pub(super) fn coupling(
        &self,
        rows: &Spanned<Vec<Spanned<Vec<f64>>>>,
        n: usize,
    ) -> Result<Option<Vec<Vec<f64>>>, InputError> {
        let expected = format!("a matrix of {n} rows of {n} numbers, for {n} joints");
        if rows.get_ref().len() != n {
            let found = counted(rows.get_ref().len(), "row");
            return Err(self.error(rows.span(), "coupling", found, expected));
        }
        for row in rows.get_ref() {
            if row.get_ref().len() != n {
                let found = format!("a row of {}", counted(row.get_ref().len(), "number"));
                return Err(self.error(row.span(), "coupling", found, expected));
            }
            let within = |element: &&f64| element.abs() <= f64::from(MAX_COUPLING);
            if let Some(bad) = row.get_ref().iter().find(|element| !within(element)) {
                let expected = format!("elements within ±{MAX_COUPLING}");
                return Err(self.error(row.span(), "coupling", number(*bad), expected));
            }
        }
        let matrix: Vec<Vec<f64>> = rows
            .get_ref()
            .iter()
            .map(|row| row.get_ref().clone())
            .collect();
        if !moves_each_joint(&matrix) {
            let expected = "an invertible matrix; only the column of a joint without an axis of the controller is all zeros";
            return Err(self.error(rows.span(), "coupling", "a singular matrix", expected));
        }
        let is_identity = matrix.iter().enumerate().all(|(i, row)| {
            row.iter()
                .enumerate()
                .all(|(j, c)| *c == if i == j { 1.0 } else { 0.0 })
        });
        Ok((!is_identity).then_some(matrix))
    }
}
