//! Which features have too few rows to be fitted.

use crate::measurement::touch::TouchSet;

/// Fewest equations that can be fitted.
pub(super) const LEAST_EQUATIONS: usize = 12;

/// The index of a feature that has too few rows, and how many rows it lacks.
pub type Waiting = (usize, usize);

/// Returns the features that have too few rows to be fitted.
pub fn waiting(set: &TouchSet) -> Vec<Waiting> {
    let lacking = |feature: usize| (feature, set.lacking(feature));
    let all = (0..set.features.len()).map(lacking);
    all.filter(|(_, lacking)| *lacking > 0).collect()
}
