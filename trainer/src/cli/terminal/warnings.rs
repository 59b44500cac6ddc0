//! The warnings of a command: one list from which the terminal, the JSON document, the report and a caller are fed.

use std::cell::RefCell;
use std::fmt::Display;

use poegp_calibration::trust::{Cause, Finding, Tier};
use serde::Serialize;

/// A warning as the JSON document has it. One that no statistic decided has neither cause nor value.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Warning {
    pub cause: Option<Cause>,
    pub tier: Tier,
    pub text: String,
    /// Lines of the file concerned, from 1; empty if all of them are, or none in particular.
    pub rows: Vec<usize>,
    pub value: Option<f64>,
    pub threshold: Option<f64>,
}

/// The warnings of the command that runs on this thread.
#[derive(Default)]
struct List {
    warnings: Vec<Warning>,
    /// Whether a document has been made of them.
    is_documented: bool,
}

thread_local! {
    static LIST: RefCell<List> = RefCell::default();
}

/// Forgets the warnings of an earlier command on this thread.
pub fn begin() {
    LIST.take();
}

/// Returns the warnings so far, in their order.
pub fn so_far() -> Vec<Warning> {
    LIST.with_borrow(|list| list.warnings.clone())
}

/// Returns the texts of the warnings so far, for a report.
pub fn texts() -> Vec<String> {
    so_far().into_iter().map(|warning| warning.text).collect()
}

/// Returns the warnings for a document. A later one would be missing in it.
pub fn documented() -> Vec<Warning> {
    LIST.with_borrow_mut(|list| {
        list.is_documented = true;
        list.warnings.clone()
    })
}

/// Adds a warning to the list without printing it: it is printed among the results, after the document is written.
pub fn add(text: impl Display) {
    push(Warning {
        cause: None,
        tier: Tier::Warning,
        text: text.to_string(),
        rows: Vec::new(),
        value: None,
        threshold: None,
    });
}

/// What a printed line begins with that is a warning.
pub const WARNING: &str = "warning: ";

/// Adds the warnings among lines that will be printed, as [`add`] does.
pub fn add_lines(lines: &[String]) {
    let warned = lines.iter().filter_map(|line| line.strip_prefix(WARNING));
    warned.for_each(add);
}

/// Adds the warning of a finding, as [`add`] does.
pub fn add_finding(finding: &Finding) {
    push(Warning {
        cause: Some(finding.cause),
        tier: finding.tier,
        text: finding.text.clone(),
        rows: finding.rows.clone(),
        value: Some(finding.value),
        threshold: Some(finding.threshold),
    });
}

/// Adds a warning that is being printed, unless it is in the list already: one of a finding is printed with its file and cause.
pub(super) fn add_printed(text: &str) {
    if !so_far().iter().any(|known| text.contains(&known.text)) {
        add(text);
    }
}

fn push(warning: Warning) {
    LIST.with_borrow_mut(|list| {
        debug_assert!(
            !list.is_documented,
            "not in the JSON document, because it comes too late: {}",
            warning.text
        );
        list.warnings.push(warning);
    });
}
