//! The sections of a report; each is one function that returns a [`Section`](super::Section).
//!
//! The sections on held-out errors take a [`ReportData`] and its [`HeldOutSummary`], which the JSON document has as
//! `held_out`, so that a number and its position there are written side by side. Where a run does not know something, the
//! section says so in a sentence.

mod calibration;
mod controller;
mod cubes;
pub mod headline;
mod joints;
mod methods;
mod next_steps;
pub mod poses;
mod time;
mod touches;
mod uncertainty;
mod verdict;
mod workspace;

pub use crate::report::sections::calibration::{
    BlobSummary, ListedOutlier, LossJson, Ripple, choice, device, outliers, parameters, provenance,
};
pub use crate::report::sections::controller::controller;
pub use crate::report::sections::headline::headline;
pub use crate::report::sections::joints::{joints, payloads};
pub use crate::report::sections::methods::{distribution, learning, methods};
pub use crate::report::sections::next_steps::next_steps;
pub use crate::report::sections::poses::poses;
pub use crate::report::sections::time::time;
pub use crate::report::sections::touches::{
    class, distances, touch_headline, touch_outliers, touched, units, unseen,
};
pub use crate::report::sections::uncertainty::uncertainty;
pub use crate::report::sections::verdict::{
    line as verdict_line, record, uncertainty_budget, verdict, warning_list,
};
pub use crate::report::sections::workspace::workspace;

use crate::report::chart::{BoxOf, Series};
use crate::report::{HeldOutSummary, Page, ReportData};

/// Explanation of a box plot.
const BOX: &str = "Box: the middle half of the poses, with the median. Whiskers: 5 and 95 %. Diamond: mean. Dot: largest.";

/// Returns a box for each part of the poses, whose errors are `errors`; `unit` follows the name of the part.
fn boxes_of(parts: &[(String, Vec<usize>)], unit: &str, errors: &[f64]) -> Vec<BoxOf> {
    let drawn = parts.iter().filter_map(|(name, members)| {
        let values: Vec<f64> = members.iter().map(|i| errors[*i]).collect();
        BoxOf::new(format!("{name}{unit}"), Series::Calibrated, &values)
    });
    drawn.collect()
}

/// Adds the sections on held-out errors alone, in their order.
#[must_use]
pub fn held_out(page: Page, evidence: &ReportData, summary: &HeldOutSummary) -> Page {
    page.with(methods(evidence, summary))
        .with(distribution(evidence, summary))
        .with(workspace(evidence, summary))
        .with(joints(evidence))
        .with(payloads(evidence, summary))
        .with(time(evidence, summary))
        .with(learning(summary))
        .with(uncertainty(evidence, summary))
        .with(poses(evidence))
}

fn mean_and_error(values: &[f64]) -> (f64, f64) {
    let n = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    (mean, (variance / n).sqrt())
}
